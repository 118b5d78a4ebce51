"""Smoothing: estimates from what was measured later as well."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import align
from seedslib.base.checks import as_count
from seedslib.base.conditioning import kalman_gain
from seedslib.base.linalg import solve_psd, symmetrized
from seedslib.base.values import Inputs
from seedslib.filters.base import Estimates, Filter, Record, stacked, walk
from seedslib.filters.covariance import FilterState
from seedslib.filters.kalman import Collected


def smooth(
    filter: Filter,
    times: ArrayLike,
    measurements: ArrayLike,
    *,
    lag: int | None = None,
    indicators: ArrayLike | None = None,
    inputs: Inputs | None = None,
) -> Estimates:
    """Estimates of the state at each time from the measurements up to a later one.

    The state at a time is corrected by the smoothed state at the next one, as by a measurement:
    with the covariance C of the two, which the filter's linearization gives, the gain is
    G = C P⁻¹ for the forecast covariance P (Rauch, Tung and Striebel). It is exact for linear
    systems; otherwise it is the smoother of the filter's linearization: of `extended_kalman` the
    extended, of `unscented_kalman` the unscented one, and so on.

    A `GridBayesFilter` is smoothed exactly on its nodes, in mode and state.

    Parameters
    ----------
    filter : Filter
        A covariance filter of continuous dynamics and jumps or of discrete ones, or one on a grid.
    times : array_like, shape (K+1,)
    measurements : array_like, shape (K+1, m, *batch)
        NaN marks a missing component.
    lag : int, optional
        Use the measurements of so many later times only (fixed lag); all of them by default
        (fixed interval).
    indicators : array_like of int, shape (K+1, *batch), optional
    inputs : mapping of Input to array_like, optional
        As in `run` of the filter.

    Returns
    -------
    Estimates
        ``mean`` (K+1, n, *batch) and ``cov`` (K+1, n, n, *batch) or (K+1, n, n); of modes
        ``mode_prob`` (K+1, L, *batch) and ``modes`` (K+1, *batch). ``loglik`` is that of the
        filter, and ``diverged`` says where it has diverged or an estimate is no number.

    Raises
    ------
    TypeError, ValueError
        A filter that has no smoother; a lag below one; as `run` of the filter.
    """
    if not isinstance(filter, Filter):
        raise TypeError(f"filter: wanted a filter of this library, got {type(filter).__name__}")
    smoother, lag = filter.smoother(), lag if lag is None else as_count("lag", lag)
    filter = smoother.filter
    batch, record = filter.records_of(times, measurements, indicators, None, inputs)

    def work(record: Record, stream: object) -> Estimates:
        states, links = smoother.forward(record)
        last = len(states) - 1
        smoothed: list[Any] = []  # from the last time to the first
        for k in range(last, -1, -1):
            if lag is None and smoothed:
                end, now = k + 1, smoothed[-1]
            else:
                end = last if lag is None else min(k + lag, last)
                now = smoother.last(states[end])
            for j in range(end - 1, k - 1, -1):
                now = smoother.back(states[j], now, links[j + 1])
            smoothed.append(now)
        filtered = (filter.report(state) for state in states)
        reports = (
            smoother.report(now)._replace(loglik=report.loglik, diverged=report.diverged)
            for now, report in zip(reversed(smoothed), filtered, strict=True)
        )
        return stacked(reports, len(states))

    return filter.in_blocks(work, record, batch)


class Smoother:
    """What `smooth` needs of a filter beside its verbs: steps forward that can be gone back.

    A smoothed state is of any type: `last` makes the first of them from the filter's last state,
    `back` each one from that of the next time, and `report` gives the estimates.

    Parameters
    ----------
    filter : Filter
    """

    def __init__(self, filter: Any) -> None:
        self.filter: Any = filter

    def forecast(self, state: Any, t: float, inputs: Any = None) -> tuple[Any, Any]:
        """The filter's prediction, as by `predict`, and what `back` has to know of the step."""
        return self.filter.predict(state, t, inputs=inputs), None

    def forward(self, record: Record) -> tuple[list[Any], list[Any]]:
        """The filter's states after each measurement, and the links of the steps to them."""
        links: list[Any] = []
        return list(self.walk(record, links)), links

    def walk(self, record: Record, links: list[Any]) -> Iterator[Any]:
        """The filter's states one after the other; links are put into a list on the way."""

        def predict(state: Any, t: float, inputs: Any) -> Any:
            state, link = self.forecast(state, t, inputs)
            links.append(link)
            return state

        return walk(self.filter, record, None, predict)

    def last(self, state: Any) -> Any:
        """Smoothed state at the time of a state without later measurements."""
        raise NotImplementedError

    def back(self, state: Any, later: Any, link: Any) -> Any:
        """Smoothed state at the time of a state, from that at the next time.

        Parameters
        ----------
        state : NamedTuple
            The filter's.
        later : object
            Smoothed state at the next time.
        link : object
            From `forecast` of the step between them.
        """
        raise NotImplementedError

    def report(self, smoothed: Any) -> Estimates:
        """Estimates, without the axis of times."""
        raise NotImplementedError


class RauchTungStriebel(Smoother):
    """The smoother of Rauch, Tung and Striebel, of a filter that carries a covariance.

    A smoothed state is the mean, with what unknown numbers add to it as further columns, the
    covariance, and a state by which all measurements determine those numbers. They are there up to
    the time at which the measurements until then have determined them all.

    Differences are taken between two estimates of one time only. They are counted from the same
    turn of a circle, so circular components need no care.
    """

    def __init__(self, filter: Any) -> None:
        super().__init__(filter.for_smoothing())

    def forecast(self, state: Any, t: float, inputs: Any = None) -> tuple[Any, Any]:
        """See `Smoother.forecast`; the link is the prediction and the gain of the step back."""
        if state.time is None:
            return super().forecast(state, t, inputs)
        p = self.filter.values(inputs, t - state.time)
        settled = self.filter.settled(state)
        later, cross = self.filter.propagate_jointly(settled, t, p)
        depth = state.mean.ndim - 1
        cov = align(later.cov, 2, depth)
        link = settled, _columns(later), cov, kalman_gain(align(cross, 2, depth), cov)
        return later._replace(time=float(t)), link

    def forward(self, record: Record) -> tuple[list[Any], list[Any]]:
        """See `Smoother.forward`.

        Of one record, once nothing is unknown, the states are those of the filter's program, and
        all steps between them are taken at once, as a batch, where the dynamics do not change.
        """
        filter = self.filter
        alone = record.y.ndim == 2 and not filter.continuous and filter._single.of(filter)
        if not (alone and filter.system.dynamics.timeless):
            return super().forward(record)
        states: list[Any] = []
        links: list[Any] = []
        for state in self.walk(record, links):
            states.append(state)
            if filter.carries(settled := filter.settled(state)):
                break
        k, last = len(states) - 1, len(record.times) - 1
        if k == last:
            return states, links
        parts = filter._single.run(filter, record, settled, k + 1)
        times, rows = record.times.tolist(), (parts["mean"], parts["cov"], parts["loglik"])
        later = [FilterState(*row) for row in zip(times[k + 1 :], *rows, strict=True)]
        before = [settled, *later[:-1]]
        lengths = np.diff(times[k:]).tolist()
        if not record.inputs.values and len({*lengths}) == 1:
            p = filter.values(record.inputs.at(k), lengths[0])
        else:
            steps = zip(range(k, last), lengths, strict=True)
            numbers = zip(*(filter.values(record.inputs.at(j), dt) for j, dt in steps), strict=True)
            p = tuple(column[0] if len({*column}) == 1 else np.array(column) for column in numbers)
        mean, cov = (np.stack([getattr(s, name) for s in before], -1) for name in ("mean", "cov"))
        ahead, cross = filter.propagate_jointly(FilterState(times[k], mean, cov), times[k + 1], p)
        gains = np.moveaxis(kalman_gain(cross, ahead.cov), -1, 0)
        forecasts = ahead.mean.T[:, :, None], np.moveaxis(ahead.cov, -1, 0)
        return states + later, links + list(zip(before, *forecasts, gains, strict=True))

    def last(self, state: Any) -> Any:
        """See `Smoother.last`."""
        return _columns(state), align(state.cov, 2, state.mean.ndim - 1), state

    def back(self, state: Any, later: Any, link: Any) -> Any:
        """See `Smoother.back`."""
        settled, *forecast = link
        cov = align(settled.cov, 2, settled.mean.ndim - 1)
        columns, smoothed = rts_step(_columns(settled), cov, *forecast, *later[:2])
        if settled is state:
            return columns, smoothed, later[2]
        return _unsettled(state, settled, columns[:, 0], smoothed)

    def report(self, smoothed: Any) -> Estimates:
        """Mean and covariance, over what the measurements say of unknown numbers."""
        columns, cov, last = smoothed
        mean, effect, n = columns[:, 0], columns[:, 1:], len(columns)
        if effect.shape[1]:
            return self.filter.report(last._replace(mean=mean, cov=cov, effect=effect))
        return Estimates(mean, cov.reshape(n, n) if cov.size == n * n else cov)


def _unsettled(state: Any, settled: Any, mean: np.ndarray, cov: np.ndarray) -> tuple[Any, ...]:
    """A smoothed state again as one that depends on unknown numbers.

    At the time of the states the measurements have just determined them. Of the numbers d and the
    state x the covariance there is known; what later measurements say of x says the rest of d.

    Parameters
    ----------
    state : DiffuseState
    settled : FilterState
        The same with d integrated out.
    mean, cov : ndarray, shapes (n, *batch) and (n, n, *batch)
        Smoothed moments of x.
    """
    depth = mean.ndim - 1
    inverse = state.collected.inverse
    cross = np.einsum("pq...,nq...->pn...", inverse, state.effect)
    filtered = align(settled.cov, 2, depth)
    gain = kalman_gain(cross, filtered)
    number = state.collected.estimate + np.einsum("pn...,n...->p...", gain, mean - settled.mean)
    spread = inverse + np.einsum("pn...,nk...,qk...->pq...", gain, cov - filtered, gain)
    information = solve_psd(spread, align(np.eye(len(spread)), 2, depth))
    effect = np.einsum("nk...,pk...,pq...->nq...", cov, gain, information)
    rest = cov - np.einsum("np...,pq...,kq...->nk...", effect, spread, effect)
    mean = mean - np.einsum("np...,p...->n...", effect, number)
    score = np.einsum("pq...,q...->p...", information, number)
    last = state._replace(collected=Collected(score, symmetrized(information)))
    return np.concatenate([mean[:, None], effect], axis=1), symmetrized(rest), last


def rts_step(columns, cov, forecast, forecast_cov, gain, later, later_cov):
    """One step back: m + G (m' - E m'), P + G (P' - E P') Gᵀ.

    Parameters
    ----------
    columns, forecast, later : ndarray, shape (n, c, *batch)
        Means as columns: now, forecast for the next time, and smoothed there.
    cov, forecast_cov, later_cov : ndarray, shape (n, n, *batch)
    gain : ndarray, shape (n, n, *batch)
        From `kalman_gain`.
    """
    if gain.ndim == 2:
        columns = columns + gain @ (later - forecast)
        return columns, cov + symmetrized(gain @ (later_cov - forecast_cov) @ gain.T)
    columns = columns + np.einsum("ij...,jc...->ic...", gain, later - forecast)
    change = np.einsum("ij...,jk...,lk...->il...", gain, later_cov - forecast_cov, gain)
    return columns, cov + symmetrized(change)


def _columns(state: Any) -> np.ndarray:
    """The mean, and what unknown numbers add to it, as columns (n, 1 + q, *batch)."""
    mean = state.mean[:, None]
    effect = getattr(state, "effect", None)
    return mean if effect is None else np.concatenate([mean, effect], axis=1)
