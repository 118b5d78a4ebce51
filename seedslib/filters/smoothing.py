"""Smoothing: estimates from what was measured later as well."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_count
from seedslib.base.correction import correct
from seedslib.base.values import Inputs
from seedslib.filters.covariance import CovarianceFilter
from seedslib.filters.estimates import Estimates
from seedslib.filters.kalman import settle
from seedslib.models.kinds import course_of


def smooth(
    filter: CovarianceFilter, times: ArrayLike, measurements: ArrayLike, *, lag: int | None = None,
    inputs: Inputs | None = None,
) -> Estimates:  # fmt: skip
    """Estimates of the state at each time from the measurements up to a later one.

    The state at a time is corrected by the smoothed state at the next one, as by a measurement:
    with the covariance C of the two, which the filter's linearization gives, the gain is
    G = C P⁻¹ for the forecast covariance P (Rauch, Tung and Striebel). It is exact for linear
    systems; otherwise it is the smoother of the filter's linearization: of `extended_kalman` the
    extended, of `unscented_kalman` the unscented one, and so on.

    Parameters
    ----------
    filter : CovarianceFilter
        With continuous dynamics and jumps, or discrete ones.
    times : array_like, shape (K+1,)
    measurements : array_like, shape (K+1, m, *batch)
        NaN marks a missing component.
    lag : int, optional
        Use the measurements of so many later times only (fixed lag); all of them by default
        (fixed interval).
    inputs : mapping of Input to array_like, optional
        As `run` of the filter.

    Returns
    -------
    Estimates
        ``mean`` (K+1, n, *batch) and ``cov`` (K+1, n, n, *batch) or (K+1, n, n); ``loglik`` and
        ``diverged`` are those of the filter.

    Raises
    ------
    TypeError, ValueError
        Another filter; a lag below one; as `run` of the filter.
    """
    if not isinstance(filter, CovarianceFilter):
        raise TypeError(f"filter: wanted a CovarianceFilter, got {type(filter).__name__}")
    if lag is not None:
        lag = as_count("lag", lag)
    times, y = filter.record(times, measurements)
    batch, n = y.shape[2:], filter.n
    course = course_of(filter.system, inputs, len(times), batch)
    filter = filter.apart()
    state = filter.initial(batch)
    states, forecasts = [], []
    for k, (t, row) in enumerate(zip(times, y, strict=True)):
        if states:
            with course.at(k - 1):
                later, cross = filter.moved_jointly(state, t)
            cov = _wide(later.cov, batch)
            forecasts.append((_columns(later), cov, _gain(_wide(cross, batch), cov)))
            state = later._replace(time=float(t))
        else:
            state = filter.predict(state, t)
        with course.at(k):
            state = filter.correct(state, row)
        states.append(state)
    found = _interval(states, forecasts, batch) if lag is None else (
        _lagged(states, forecasts, batch, lag)
    )  # fmt: skip
    means, covs = zip(*(_settled(*part) for part in found), strict=True)
    means = np.stack([np.broadcast_to(mean, (n, *batch)) for mean in means])
    finite = np.isfinite(means).all(axis=(0, 1))
    for cov in covs:
        finite &= ~np.isnan(cov).all(axis=(0, 1)).reshape(cov.shape[2:] or (1,) * len(batch))
    if all(c.shape[2:] == (1,) * len(batch) for c in covs):  # common to all paths
        covs = [c.reshape(n, n) for c in covs]
    else:
        covs = [np.broadcast_to(c, (n, n, *batch)) for c in covs]
    loglik = np.stack([np.broadcast_to(s.loglik, batch) for s in states])
    return Estimates(means, np.stack(covs), None, loglik, ~finite)


def _columns(state: Any) -> np.ndarray:
    """The mean, and what unknown numbers add to it, as columns (n, *batch, 1 + q)."""
    mean = state.mean[..., None]
    effect = getattr(state, "effect", None)
    return mean if effect is None else np.concatenate([mean, effect], axis=-1)


def _settled(columns: np.ndarray, cov: np.ndarray, told: Any) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance, unknown numbers taken from what the measurements up to `told` say."""
    if columns.shape[-1] == 1:
        return columns[..., 0], cov
    return settle(columns[..., 0], cov, columns[..., 1:], told)


def _wide(cov: np.ndarray, batch: tuple[int, ...]) -> np.ndarray:
    """A matrix with axes of paths, of length one where it is common to them."""
    return cov if cov.ndim > 2 else cov.reshape(*cov.shape, *(1,) * len(batch))


def _gain(cross: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """G = C P⁺, shape (n, n, *batch): what each unit of the later state moves."""
    n = len(cross)
    still = np.zeros((n, *(1,) * (cross.ndim - 1)))
    unit = np.eye(n).reshape(n, *(1,) * (cross.ndim - 2), n)
    gain, _, _ = correct(still, None, unit, (still, cross[..., None], cov[..., None]))
    return np.moveaxis(np.broadcast_to(gain, (*cross.shape[:1], *gain.shape[1:])), -1, 1)


def _interval(states: list, forecasts: list, batch: tuple[int, ...]) -> list[tuple]:
    """Columns and covariance of each time from all measurements, and the last state."""
    last = states[-1]
    found = [(_columns(last), _wide(last.cov, batch), last)]
    for state, forecast in zip(states[-2::-1], forecasts[::-1], strict=True):
        found.append((*_back(state, batch, *forecast, *found[-1][:2]), last))
    return found[::-1]


def _lagged(states: list, forecasts: list, batch: tuple[int, ...], lag: int) -> list[tuple]:
    """The same from the measurements of the next `lag` times, by as many steps back for each."""
    found = []
    for k in range(len(states)):
        end = min(k + lag, len(states) - 1)
        part = _columns(states[end]), _wide(states[end].cov, batch)
        for j in range(end - 1, k - 1, -1):
            part = _back(states[j], batch, *forecasts[j], *part)
        found.append((*part, states[end]))
    return found


def _back(state, batch, forecast, forecast_cov, gain, later, later_cov):
    """One step back: m + G (m' - E m'), P + G (P' - E P') Gᵀ."""
    columns = _columns(state) + np.einsum("ij...,j...c->i...c", gain, later - forecast)
    change = np.einsum("ij...,jk...,lk...->il...", gain, later_cov - forecast_cov, gain)
    return columns, _wide(state.cov, batch) + 0.5 * (change + np.swapaxes(change, 0, 1))
