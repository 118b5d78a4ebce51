"""Forecasts between measurements from the values of a filter at the nodes of an interval."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from seedslib.base.clock import slack

if TYPE_CHECKING:
    from seedslib.designed.finite_order import FiniteOrderFilter
    from seedslib.designed.finite_order_rules import FiniteOrderState

FORECAST_KINDS = (
    "interpolated",
    "piecewise constant",
    "piecewise linear",
    "piecewise linear, first constant",
    "constant",
    "linear",
)


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


def interval_after(filter: FiniteOrderFilter, state: FiniteOrderState) -> Interval:
    """All that a `FiniteOrderFilter` knows from a correction to the next: Z_k, nodes, end."""
    k, times = state.index, filter.times
    grid, values, end, count = [times[k]], [state.mean], None, 0
    if k < len(filter.node_times):
        found, end = nodes_after(filter, k, state)
        grid, values, count = [*grid, *filter.node_times[k]], values + found, len(found)
    if k < len(filter.fits):
        if end is None:
            end = filter.fits[k].mean(state.past.vector)[: filter.components]
        grid, values = [*grid, times[k + 1]], [*values, end]
    last = last_node = None
    if k > 0:
        before = state.before
        last = last_node = (times[k - 1], before.mean)
        if len(filter.node_times[k - 1]):
            last_node = (filter.node_times[k - 1][-1], nodes_after(filter, k - 1, before)[0][-1])
    return Interval(np.array(grid), values, count, last, last_node)


def nodes_after(
    filter: FiniteOrderFilter, k: int, state: FiniteOrderState
) -> tuple[list[np.ndarray], np.ndarray | None]:
    """Estimates of a filter at the nodes after measurement k, and at the next; see `Rules.nodes`.

    The second is None where the nodes do not lead there.
    """
    nodes, times = filter.node_times[k], filter.clock.times
    end = times[k + 1] if k < len(filter.fits) else nodes[-1]
    return filter.rules.nodes(filter.node_fits[k], [times[k], *nodes, end], state)


def known_kind(name: str, kind: str) -> str:
    """The kind of a forecast.

    Raises
    ------
    ValueError
        None of `FORECAST_KINDS`.
    """
    if kind not in FORECAST_KINDS:
        raise ValueError(f"{name}: wanted one of {', '.join(FORECAST_KINDS)}; got {kind!r}")
    return kind


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
    known_kind("kind", kind)
    times, values = interval.times, interval.values
    if kind == "constant":
        return values[0]
    if kind == "linear":
        return _extended(interval.last, times[0], values[0], t)
    # a time that is a node but for rounding is the node
    first, last = times.item(0), times.item(-1)
    room = slack(last - first, abs(last))
    i = max(0, int(np.searchsorted(times[: interval.nodes + 1], t + room, side="right")) - 1)
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
