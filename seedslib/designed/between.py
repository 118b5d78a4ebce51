"""Forecasts between measurements from the values of a filter at the nodes of an interval."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.base.clock import slack

FORECAST_KINDS = (
    "interpolated",
    "piecewise constant",
    "piecewise linear",
    "piecewise linear, first constant",
    "constant",
    "linear",
)


class Interval(NamedTuple):
    """Estimates of a filter from a measurement to the next.

    Attributes
    ----------
    times : ndarray, shape (L+2,), or (1,) after the last measurement of the design
        t_k, the L nodes, the next measurement time.
    values : list of ndarray, shape (n', *batch)
        Z_k, the estimates at the nodes, the forecast for the next measurement.
    before : Interval or None
        The interval that ended with this measurement.
    """

    times: np.ndarray
    values: list[np.ndarray]
    before: Interval | None = None

    @property
    def last_node(self) -> int:
        """Number of the last node; 0, the measurement, without nodes."""
        return max(0, len(self.times) - 2)


def require_kind(name: str, kind: str) -> None:
    """Refuse what is none of `FORECAST_KINDS`.

    Raises
    ------
    ValueError
    """
    if kind not in FORECAST_KINDS:
        raise ValueError(f"{name}: wanted one of {', '.join(FORECAST_KINDS)}; got {kind!r}")


def at(interval: Interval, t: float, kind: str) -> np.ndarray:
    """Forecast (n', *batch) at a time of the interval.

    (2.4) of the jump-diffusion paper for "constant" and "linear", (2.7) for "piecewise constant"
    and "piecewise linear". The last takes its first slope across the measurement, from the last
    node before it, as printed; "piecewise linear, first constant" keeps the estimate until the
    first node. "interpolated" runs linearly from node to node and to the forecast for the next
    measurement; it is causal too, since all of them are functions of the same memory.

    Raises
    ------
    ValueError
        An unknown kind.
    """
    require_kind("kind", kind)
    times, values, before = interval.times, interval.values, interval.before
    if kind == "constant":
        return values[0]
    if kind == "linear":
        return _extended(before, 0, interval, 0, t)
    # a time that is a node but for rounding is the node
    first, end = times.item(0), times.item(-1)
    nodes = times[: interval.last_node + 1]
    i = int(np.searchsorted(nodes, t + slack(end - first, abs(end)), side="right")) - 1
    i = max(0, i)
    if kind == "interpolated" and len(times) > 1:
        share = (t - times[i]) / (times[i + 1] - times[i])
        return values[i] + share * (values[i + 1] - values[i])
    if kind in ("interpolated", "piecewise constant"):
        return values[i]
    if i > 0:
        return _extended(interval, i - 1, interval, i, t)
    if kind == "piecewise linear" and before is not None:
        return _extended(before, before.last_node, interval, 0, t)
    return values[0]


def _extended(earlier: Interval | None, j: int, interval: Interval, i: int, t: float) -> np.ndarray:
    """The line through two values, continued to t; constant where there is only the second."""
    time, value = interval.times[i], interval.values[i]
    if earlier is None:
        return value
    return value + (t - time) / (time - earlier.times[j]) * (value - earlier.values[j])
