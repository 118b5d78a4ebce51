"""The Kalman filter of linear systems, with components of which nothing is known at first."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.correction import correct
from seedslib.base.semidefinite import RELATIVE, factor
from seedslib.base.values import Values
from seedslib.filters.base import Estimates
from seedslib.filters.covariance import CovarianceFilter, FilterState
from seedslib.linearization.moments import Matrices
from seedslib.models.linear import LinearSystem

UNKNOWN = 1e-9
"""Deviations of a state for one of what no measurement has determined that count as none."""


class DiffuseState(NamedTuple):
    """A state that depends on q unknown numbers d, N(mean + effect d, cov).

    ``mean`` (n, *batch), ``cov`` (n, n, *batch), ``effect`` (n, *batch, q). Of d the measurements
    say N(I⁻¹ s, I⁻¹), with the ``score`` s (q, *batch) and the ``information`` I (q, q, *batch).
    ``loglik`` is that of the last measurement, d integrated out.
    """

    time: float | None
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray | float
    interval: float | None
    effect: np.ndarray
    score: np.ndarray
    information: np.ndarray

    def inverse(self) -> np.ndarray:
        """Pseudo-inverse of the information, (q, q, *batch), whatever the units of d."""
        unit = np.sqrt(np.einsum("ii...->i...", self.information))
        unit = np.where(unit > 0, unit, 1.0)
        information = np.moveaxis(self.information / unit / unit[:, None], (0, 1), (-2, -1))
        inverse = np.linalg.pinv(information, RELATIVE, hermitian=True)
        return np.moveaxis(inverse, (-2, -1), (0, 1)) / unit / unit[:, None]

    def best(self) -> np.ndarray:
        """The most probable d, (q, *batch); zero where nothing is known."""
        return np.einsum("pq...,q...->p...", self.inverse(), self.score)

    def log_spread(self) -> np.ndarray:
        """Half the logarithm of the information that there is of the unknown numbers."""
        root = np.einsum("ii...->i...", factor(self.information))
        return np.log(np.where(root > 0, root, 1.0)).sum(axis=0)


class KalmanFilter(CovarianceFilter):
    """Kalman filter of a `LinearSystem`; diffuse components are treated exactly.

    With the diffuse components of the first state as unknown numbers, everything is Gaussian
    given them, and what the measurements say of them is collected (de Jong 1991). Until they are
    known the variances that depend on them are infinite. The log-likelihood is the diffuse one,
    with a constant log 2 pi for every measured number.

    Parameters
    ----------
    system : LinearSystem
    bound : float, optional
        As `CovarianceFilter`.

    Raises
    ------
    TypeError, ValueError
        Another system; a bound that is not positive.
    """

    _systems = ("LinearSystem",)

    def __init__(self, system: LinearSystem, *, bound: float | None = None) -> None:
        super().__init__(system, Matrices(), bound=bound)
        self._diffuse = list(system.diffuse)
        deviations = _deviations(system) if self._diffuse else np.ones(self.n)
        self._prior: np.ndarray = deviations[self._diffuse] ** 2
        # units of the state in those of the unknown numbers, (n, q)
        self.scale: np.ndarray = deviations[:, None] / deviations[self._diffuse]
        self._settles = True

    def unsettled(self) -> KalmanFilter:
        """The same filter, which keeps unknown numbers when they are known, for smoothing."""
        other = KalmanFilter(self.system, bound=self.bound)
        other._settles = False
        return other

    def initial(self, batch: tuple[int, ...] = (), seed: Any = None) -> Any:
        """State before any measurement; see `CovarianceFilter.initial`."""
        state, diffuse = super().initial(batch), self._diffuse
        if not diffuse:
            return state
        q = len(diffuse)
        # a flat law plus N(0, c) is that flat law, so nothing depends on c; but with none a
        # measurement without noise would have no density given what is unknown
        state.cov[diffuse, diffuse] = self._prior
        effect = np.zeros((self.n, *batch, q))
        effect[diffuse, ..., range(q)] = 1.0
        return DiffuseState(*state, effect, np.zeros((q, *batch)), np.zeros((q, q, *batch)))

    def moved(self, state: Any, t: float, p: Values) -> Any:
        """See `CovarianceFilter.moved`; given what is unknown."""
        if isinstance(state, DiffuseState):
            return self.moved_jointly(state, t, p)[0]
        return super().moved(state, t, p)

    def moved_jointly(self, state: Any, t: float, p: Values) -> tuple[Any, np.ndarray]:
        """See `CovarianceFilter.moved_jointly`; both given what is unknown."""
        later, cross = super().moved_jointly(state, t, p)
        if isinstance(state, DiffuseState):
            effect = _times(self.system.dynamics.slope_at(state.time, p), state.effect)
            later = later._replace(effect=effect)
        return later, cross

    def corrected(self, state: Any, y: np.ndarray, p: Values) -> Any:
        """See `Filter.corrected`."""
        if not isinstance(state, DiffuseState):
            return super().corrected(state, y, p)
        known = super().corrected(FilterState(*state[:5]), y, p)
        expected, cross, innovation_cov = (part[..., None] for part in self.expected(state, p))
        y = y[..., None]
        observed, m = np.isfinite(y), len(y)
        slope = _times(self.system.sensor.slope_at(state.time, p), state.effect)
        # columns of a measurement of zero, missing where the measurement is
        zero = np.where(observed, 0.0, np.nan)
        effect, _, _ = correct(state.effect, None, zero, (slope, cross, innovation_cov))
        columns = np.concatenate([y - expected, np.where(observed, slope, np.nan)], axis=-1)
        none = np.zeros_like(columns)
        weighted = correct(none, None, columns, (none, np.eye(m), innovation_cov))[0]
        score = state.score + np.einsum("m...q,m...->q...", slope, weighted[..., 0])
        added = np.einsum("m...p,m...q->pq...", slope, weighted[..., 1:])
        now = DiffuseState(*known, effect, score, state.information + added)
        # at the best d: at zero the squares may be large, and their difference has no digits
        best = now.best()
        rest = columns[..., :1] - np.einsum("m...q,q...->m...", slope, best)[..., None]
        none = none[..., :1]
        density = correct(none, None, rest, (none, np.eye(m), innovation_cov))[2][..., 0]
        gap = best - state.best()
        density = density - 0.5 * np.einsum("p...,pq...,q...->...", gap, state.information, gap)
        now = now._replace(loglik=density + state.log_spread() - now.log_spread())
        root = np.einsum("ii...->i...", factor(now.information))
        diagonal = np.einsum("ii...->i...", now.information)
        if not self._settles or not (root > UNKNOWN * np.sqrt(diagonal)).all():
            return now
        mean, cov = settle(now.mean, now.cov, now.effect, now, self.scale)
        if np.isnan(cov).any():  # known by rounding only
            return now
        return FilterState(now.time, mean, cov, now.loglik, now.interval)

    def expected(self, state: Any, p: Values) -> Any:
        """Moments of the measurement that the filter expects, given what is unknown."""
        return super().expected(FilterState(*state[:5]), p)

    def report(self, state: Any) -> Estimates:
        """Mean and covariance; infinite variances of components that no measurement determines."""
        if isinstance(state, DiffuseState):
            mean, cov = settle(state.mean, state.cov, state.effect, state, self.scale)
            state = FilterState(state.time, mean, cov, state.loglik)
        return super().report(state)


def _deviations(system: LinearSystem) -> np.ndarray:
    """Deviations of the components of the state, (n,), that are neither wide nor narrow for them.

    That of the noise of its own, or of what it is measured by; else the smallest of the others.
    """
    try:
        p = system.nominal_values()
        maps = system.dynamics, system.sensor
        Q, R = (np.sqrt(np.diagonal(map.cov_at(0.0, p))) for map in maps)
        H = np.abs(system.sensor.slope_at(0.0, p))
    except LookupError:  # matrices from a table, which need not have this time
        return np.ones(system.state_size)
    noisy = (H > 0) & (R > 0)[:, None]
    measured = np.where(noisy, R[:, None] / np.where(noisy, H, 1.0), np.inf)
    own = np.where(Q > 0, Q, measured.min(axis=0))
    least = own.min()
    return np.where(np.isfinite(own), own, least if np.isfinite(least) else 1.0)


def settle(
    mean: np.ndarray, cov: np.ndarray, effect: np.ndarray, known: DiffuseState, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance with the unknown numbers at what the measurements say of them.

    Parameters
    ----------
    mean, cov, effect : ndarray
        As in `DiffuseState`, of one time.
    known : DiffuseState
        Its score and information.
    scale : ndarray, shape (n, q)
        What an effect is measured by, see `KalmanFilter`.

    Returns
    -------
    mean, cov : ndarray, shapes (n, *batch) and (n, n, *batch)
        Of a component that depends on what nothing has determined the variance is infinite and
        its covariances are NaN.
    """
    n, inverse = len(mean), known.inverse()
    mean = mean + np.einsum("n...q,q...->n...", effect, known.best())
    spread = np.einsum("n...p,pq...,k...q->nk...", effect, inverse, effect)
    determined = np.einsum("pk...,kq...->pq...", inverse, known.information)
    rest = effect - np.einsum("n...p,pq...->n...q", effect, determined)
    unit = scale.reshape(n, *(1,) * (effect.ndim - 2), -1)
    part, rest = (np.abs(x / unit).max(axis=-1) for x in (effect, rest))
    unknown = rest > UNKNOWN * part.max(axis=0)
    cov = cov.reshape(n, n, *cov.shape[2:], *(1,) * (spread.ndim - cov.ndim)) + spread
    cov = np.where(unknown[:, None] | unknown[None, :], np.nan, cov)
    for k in range(n):
        cov[k, k] = np.where(unknown[k], np.inf, cov[k, k])
    return mean, cov


def _times(matrix: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Matrix (m, n) or (m, n, *batch) times columns (n, *batch, q)."""
    return np.einsum("ij...,j...->i...", matrix if matrix.ndim == 2 else matrix[..., None], columns)
