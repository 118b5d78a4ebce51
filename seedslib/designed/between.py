"""Forecasts between measurements from the values of a filter at the nodes of an interval."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

FORECAST_KINDS = (
    "interpolated",
    "piecewise constant",
    "piecewise linear",
    "piecewise linear, first constant",
    "constant",
    "linear",
)

SAME_TIME = 1e-9
"""A time this fraction of the interval before a node is the node: grids are rounded."""


class Interval(NamedTuple):
    """What a filter knows in the interval that begins with the measurement at times[0].

    Attributes
    ----------
    times : ndarray, shape (L+1,) or (L+2,)
        t_k, the nodes, and the end of the interval where its value is known.
    values : list of ndarray, shape (n', *batch)
        Z_k, the node estimates, and the forecast for the end.
    nodes : int
        L.
    last : tuple (time, estimate), or None
        The measurement before this one and the estimate there.
    last_node : tuple (time, estimate), or None
        The last node before this measurement.
    """

    times: np.ndarray
    values: list
    nodes: int
    last: tuple | None = None
    last_node: tuple | None = None


def at(interval: Interval, t: float, kind: str) -> np.ndarray:
    """Forecast (n', *batch) at a time of the interval.

    (2.4) of the jump-diffusion paper for "constant" and "linear", (2.7) for "piecewise constant"
    and "piecewise linear". The last takes its first slope across the measurement, from the last
    node before it, as the formula says to the letter; "piecewise linear, first constant" holds
    the estimate until the first node. "interpolated" runs linearly from node to node and to the
    forecast for the next measurement; it is still causal, since all of them are functions of the
    same memory.

    Raises
    ------
    ValueError
        An unknown kind.
    """
    if kind not in FORECAST_KINDS:
        raise ValueError(f"kind: wanted one of {', '.join(FORECAST_KINDS)}; got {kind!r}")
    times, values = interval.times, interval.values
    if kind == "constant":
        return values[0]
    if kind == "linear":
        return _extended(interval.last, times[0], values[0], t)
    slack = SAME_TIME * (times[-1] - times[0])
    i = max(0, int(np.searchsorted(times[: interval.nodes + 1], t + slack, side="right")) - 1)
    if kind == "interpolated":
        if i + 1 >= len(times):
            return values[i]
        share = (t - times[i]) / (times[i + 1] - times[i])
        return values[i] + share * (values[i + 1] - values[i])
    if kind == "piecewise constant":
        return values[i]
    if i > 0:
        return _extended((times[i - 1], values[i - 1]), times[i], values[i], t)
    first = interval.last_node if kind == "piecewise linear" else None
    return _extended(first, times[0], values[0], t)


def _extended(before, time, value, t):
    """The line through two values, continued to t; constant where there is only one."""
    if before is None:
        return value
    return value + (t - time) / (time - before[0]) * (value - before[1])
