"""Forecasts between measurements from the values of a filter at the nodes of an interval."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from seedslib.base.clock import Clock, slack, when
from seedslib.base.values import InputTrajectory, Values
from seedslib.designed.base import DesignedFilter, want_corrected
from seedslib.filters.base import Estimates
from seedslib.models.kinds import inputs_of

if TYPE_CHECKING:
    from typing import Self

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
    values: list[Any]
    nodes: int
    last: tuple[Any, ...] | None = None
    last_node: tuple[Any, ...] | None = None


class BetweenFilter(DesignedFilter):
    """A designed filter that forecasts between measurements, from its values at nodes.

    Attributes
    ----------
    between : str
        Kind of the forecasts, see `at`.
    """

    between: str
    clock: Clock

    @property
    def evaluated(self) -> frozenset[Any]:
        """Parameters and inputs in the maps that a step evaluates."""
        return frozenset()

    def values(self, inputs: Mapping[Any, Any] | None = None) -> Values:
        """Numbers of the parameters; inputs that are in the design's own numbers may be missing."""
        unused = inputs_of(self.system) - self.evaluated
        return self.system.values({**dict.fromkeys(unused, np.nan), **(inputs or {})})

    def nodes(self, state: Any, p: Values, end: bool = True) -> tuple[list, list, tuple | None]:
        """Times and estimates (n', *batch) from a correction to the last node after it.

        And, where it is wanted and known, time and forecast of the next measurement.
        """
        raise NotImplementedError

    def interval(self, state: Any, p: Values) -> Interval:
        """All that is known from a correction to the next: Z_k, nodes, end."""
        times, values, end = self.nodes(state, p)
        count, last, last_node = len(times) - 1, None, None
        if state.before is not None:
            before = list(zip(*self.nodes(state.before, p, end=False)[:2], strict=True))
            last, last_node = before[0], before[-1]
        if end is not None:
            times.append(end[0])
            values.append(end[1])
        return Interval(np.array(times), values, count, last, last_node)

    def advanced(self, state: Any, p: Values, interval: Interval | None = None) -> Any:
        """The state at the next measurement time."""
        raise NotImplementedError

    def corrected(
        self,
        state: Any,
        y: np.ndarray,
        p: Values,
        indicator: np.ndarray | None = None,
        covariance: bool = True,
    ) -> Any:
        """The state after a measurement of a record."""
        raise NotImplementedError

    def fill(
        self,
        rows: Estimates,
        times: np.ndarray,
        index: np.ndarray,
        y: np.ndarray,
        indicators: np.ndarray | None,
        inputs: InputTrajectory,
    ) -> int:
        """Run over a block of records; covariances are formed where they are wanted."""
        state, interval, covariance = self.initial(y.shape[2:]), None, rows.cov is not None
        numbers = self.values
        last = 0  # row of the last measurement: its inputs hold until the next
        for j, k in enumerate(index):
            if k < 0:
                interval = interval or self.interval(state, numbers(inputs.at(last)))
                rows.mean[j] = at(interval, times[j], self.between)
                if rows.loglik is not None:
                    rows.loglik[j] = 0.0
                if covariance:
                    rows.cov[j] = np.nan
                continue
            state = self.advanced(state, numbers(inputs.at(last)), interval)
            indicator = None if indicators is None else indicators[j]
            p = numbers(inputs.at(j))
            state = self.corrected(state, y[j], p, indicator, covariance)
            rows.mean[j], interval, last = state.mean, None, j
            if rows.loglik is not None:
                rows.loglik[j] = state.loglik
            if covariance:
                rows.cov[j].T[...] = state.cov.T  # with or without an axis of records
            if rows.modes is not None:
                rows.modes[j] = state.mode
            if rows.mode_prob is not None:
                rows.mode_prob[j] = state.mode_prob
        return 0

    def forecasting(self, kind: str) -> Self:
        """The same filter with another kind of forecast between measurements."""
        return replace(self, between=kind)

    def forecast(
        self,
        state: Any,
        t: float,
        kind: str | None = None,
        *,
        inputs: Mapping[Any, Any] | None = None,
    ) -> Estimates:
        """Estimate of the first n' components at a time up to the next measurement.

        Parameters
        ----------
        state : NamedTuple
            After a correction.
        t : float
            From the time of the state to the next measurement time (before that measurement),
            or to the horizon.
        kind : str, optional
            One of `FORECAST_KINDS`; the filter's own `between` by default.
        inputs : mapping of Input to number or ndarray, shape (*batch), optional
            Inputs from the time of the state on.

        Raises
        ------
        ValueError
            A time outside the interval, an unknown kind, a state that was not corrected.
        """
        want_corrected(state)
        p = self.values(inputs)
        known, room = self.interval(state, p), self.clock.tolerance
        start, end = known.times[0], known.times[-1]
        if not start - room <= t <= end + room:
            raise ValueError(f"t: wanted a time from {when(start)} to {when(end)}, got {when(t)}")
        return Estimates(at(known, t, self.between if kind is None else kind))


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
