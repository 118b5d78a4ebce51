"""Smoothing: estimates from what was measured later as well."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_count
from seedslib.base.values import Inputs, on_paths
from seedslib.filters.backward import Smoother
from seedslib.filters.estimates import Estimates, as_indicators
from seedslib.filters.verbs import Filter
from seedslib.models.kinds import course_of, elapsed


def smooth(
    filter: Filter, times: ArrayLike, measurements: ArrayLike, *, lag: int | None = None,
    indicators: ArrayLike | None = None, inputs: Inputs | None = None,
) -> Estimates:  # fmt: skip
    """Estimates of the state at each time from the measurements up to a later one.

    The state at a time is corrected by the smoothed state at the next one, as by a measurement:
    with the covariance C of the two, which the filter's linearization gives, the gain is
    G = C P⁻¹ for the forecast covariance P (Rauch, Tung and Striebel). It is exact for linear
    systems; otherwise it is the smoother of the filter's linearization: of `extended_kalman` the
    extended, of `unscented_kalman` the unscented one, and so on.

    A `SwitchingFilter` without a memory is smoothed in mode and state, by Gaussian laws in each
    mode; what that neglects stands in `seedslib.designed.switching.smoothing`. A
    `GridBayesFilter` is smoothed exactly on its nodes, in mode and state.

    Parameters
    ----------
    filter : Filter
        A covariance filter of continuous dynamics and jumps or of discrete ones, or one of those
        named above.
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
    found = _in_blocks(filter, times, measurements, lag, indicators, inputs)
    batch, covs = np.shape(measurements)[2:], [one.cov for one in found]

    def joined(parts):
        if parts[0] is None or found[0].mean.ndim == 2:  # one record without an axis of records
            return parts[0]
        whole = np.concatenate(parts, axis=-1)
        return whole.reshape((*whole.shape[:-1], *batch))

    if all(c.ndim == 3 and np.array_equal(c, covs[0], equal_nan=True) for c in covs):
        cov = covs[0]
    else:
        shapes = [(*one.cov.shape[:3], *one.mean.shape[2:]) for one in found]
        covs = [c if c.ndim > 3 else c[..., None] for c in covs]
        cov = joined([np.broadcast_to(c, s) for c, s in zip(covs, shapes, strict=True)])
    rest = (one._replace(cov=None) for one in found)
    return Estimates(*map(joined, zip(*rest, strict=True)))._replace(cov=cov)


def _in_blocks(filter, times, measurements, lag, indicators, inputs) -> list[Estimates]:
    """Estimates of each block of records, in their order."""
    if not isinstance(filter, Filter):
        raise TypeError(f"filter: wanted a filter of this library, got {type(filter).__name__}")
    smoother = filter.smoother()
    lag = None if lag is None else as_count("lag", lag)
    filter = smoother.filter
    times, y = filter.record(times, measurements)
    batch, shape = y.shape[2:], (len(times), *y.shape[2:])
    course = course_of(filter.system, inputs, len(times), batch)
    indicators = as_indicators(indicators, filter.system, shape)
    flat = y.reshape(*y.shape[:2], -1)
    shown = None if indicators is None else indicators.reshape(len(times), -1)
    wide, paths = bool(batch) or not filter.alone, flat.shape[2]

    def work(start, stop, _stream):
        own = slice(start, stop)
        with on_paths(batch, own) if batch else nullcontext():
            return smoothed(own, course.of(own) if wide else course)

    def smoothed(own, held):
        states, links = [], []
        state = filter.initial((own.stop - own.start,) if wide else ())
        for k, t in enumerate(times):
            seen = () if shown is None else (shown[k, own],)
            with held.at(max(k - 1, 0)):
                state, link = smoother.forecast(state, t)
            with held.at(k):
                state = filter.correct(state, flat[k, :, own] if wide else y[k], *seen)
            states.append(state)
            links.append((link, *seen))

        def back(k, part):
            with held.at(k), elapsed(filter.system, times[k], times[k + 1]):
                return smoother.back(states[k], part, *links[k + 1])

        return _estimated(smoother, _parts(smoother, back, states, lag), states)

    return in_blocks(work, paths, 0, block=filter.block(times, paths, 1))


def _parts(smoother: Smoother, back: Any, states: list[Any], lag: int | None) -> list[Any]:
    """What is known of each time from all measurements, or from those of `lag` later times."""
    last = len(states) - 1
    if lag is not None:
        found = []
        for k in range(last + 1):
            end = min(k + lag, last)
            part = smoother.last(states[end])
            for j in range(end, k, -1):
                part = back(j - 1, part)
            found.append(part)
        return found
    found = [smoother.last(states[last])]
    for j in range(last, 0, -1):
        found.append(back(j - 1, found[-1]))
    return found[::-1]


def _estimated(smoother: Smoother, parts: list, states: list) -> Estimates:
    """Estimates of one block of records."""
    said = [smoother.report(part) for part in parts]
    loglik = [state.loglik for state in states]
    batch = np.broadcast_shapes(*(one.mean.shape[1:] for one in said), *map(np.shape, loglik))
    mean = np.stack([np.broadcast_to(one.mean, (len(one.mean), *batch)) for one in said])
    diverged = ~np.isfinite(mean).all(axis=(0, 1))
    for one, state in zip(said, states, strict=True):
        diverged = diverged | ~_known(one.cov, batch) | smoother.lost(state)
    covs = [one.cov for one in said]
    if all(c.shape[2:] in ((), (1,) * len(batch)) for c in covs):  # common to all paths
        covs = [c.reshape(c.shape[:2]) for c in covs]
    else:
        covs = [np.broadcast_to(c, (*c.shape[:2], *batch)) for c in covs]
    prob = modes = None
    if said[0].mode_prob is not None:
        prob, modes = (np.stack([one[p] for one in said]) for p in (2, 5))
    loglik = np.stack([np.broadcast_to(one, batch) for one in loglik])
    return Estimates(mean, np.stack(covs), prob, loglik, diverged, modes)


def _known(cov: np.ndarray, batch: tuple[int, ...]) -> np.ndarray:
    """Where a covariance is one at least in part: of what nothing told some entries are NaN."""
    return ~np.isnan(cov).all(axis=(0, 1)).reshape(cov.shape[2:] or (1,) * len(batch))
