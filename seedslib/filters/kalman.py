"""The Kalman filter of linear systems, with components of which nothing is known at first."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.correction import correct
from seedslib.base.semidefinite import factor
from seedslib.base.values import looked_at
from seedslib.filters.covariance import CovarianceFilter, FilterState
from seedslib.filters.estimates import Estimates, require_time
from seedslib.linearization.matrices import Matrices
from seedslib.models.kinds import elapsed
from seedslib.models.linear import LinearSystem

UNKNOWN = 1e-9
"""A state that leans more than this on what no measurement has told is not known."""


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
        self.units: np.ndarray = _units(system) if self._diffuse else np.ones(self.n)
        self._apart = False

    def apart(self) -> KalmanFilter:
        """The same filter, which keeps unknown numbers apart when they are known, for smoothing."""
        other = KalmanFilter(self.system, bound=self.bound)
        other._apart = True
        return other

    @property
    def leaning(self) -> np.ndarray:
        """Ratios of the units of the state to those of the unknown numbers, (n, q)."""
        root = np.sqrt(self.units)
        return root[:, None] / root[self._diffuse]

    def initial(self, batch: tuple[int, ...] = (), seed: Any = None) -> Any:
        """State before any measurement; see `CovarianceFilter.initial`."""
        state = super().initial(batch)
        if not self._diffuse:
            return state
        q = len(self._diffuse)
        # a flat law plus N(0, c) is that flat law, so nothing depends on c; but with none a
        # measurement without noise would have no density given what is unknown
        state.cov[self._diffuse, self._diffuse] = self.units[self._diffuse]
        effect = np.zeros((self.n, *batch, q))
        effect[self._diffuse, ..., range(q)] = 1.0
        nothing = np.zeros((q, *batch)), np.zeros((q, q, *batch))
        return DiffuseState(*state, effect, *nothing)

    def moved(self, state: Any, t: float) -> Any:
        """See `CovarianceFilter.moved`; given what is unknown."""
        if isinstance(state, DiffuseState):
            return self.moved_jointly(state, t)[0]
        return super().moved(state, t)

    def moved_jointly(self, state: Any, t: float) -> tuple[Any, np.ndarray]:
        """See `CovarianceFilter.moved_jointly`; both given what is unknown."""
        later, cross = super().moved_jointly(state, t)
        if isinstance(state, DiffuseState):
            with elapsed(self.system, state.time, t):
                effect = _times(self.system.dynamics.slope_at(state.time), state.effect)
            later = later._replace(effect=effect)
        return later, cross

    def correct(self, state: Any, y: ArrayLike) -> Any:
        """Correct by the measurement y, shape (m, *batch), at the time of the state."""
        if not isinstance(state, DiffuseState):
            return super().correct(state, y)
        require_time(state)
        known = super().correct(_given(state), y)
        expected, cross, spread = (part[..., None] for part in self.expect(_given(state)))
        y = np.asarray(y, dtype=float)[..., None]
        slope = _times(self.system.sensor.slope_at(state.time), state.effect)
        # columns of a measurement of zero, missing where the measurement is
        zero = np.where(np.isfinite(y), 0.0, np.nan)
        effect, _, _ = correct(state.effect, None, zero, (slope, cross, spread))
        errors = np.concatenate([y - expected, np.where(np.isfinite(y), slope, np.nan)], axis=-1)
        m = len(errors)
        still, unit = np.zeros_like(errors), np.eye(m)
        weighed, _, _ = correct(still, None, errors, (still, unit, spread))  # S⁻¹ of each column
        score = state.score + np.einsum("m...q,m...->q...", slope, weighed[..., 0])
        added = np.einsum("m...p,m...q->pq...", slope, weighed[..., 1:])
        now = state._replace(
            **known._asdict(), effect=effect, score=score, information=state.information + added
        )
        # at the best d: at zero the squares may be large, and their difference has no digits
        best = _solved(now, score[..., None])
        rest = errors[..., :1] - np.einsum("m...q,q...->m...", slope, best[..., 0])[..., None]
        density = correct(still[..., :1], None, rest, (still[..., :1], unit, spread))[2][..., 0]
        gap = (best - _solved(state, state.score[..., None]))[..., 0]
        density = density - 0.5 * np.einsum("p...,pq...,q...->...", gap, state.information, gap)
        now = now._replace(loglik=density + _narrowed(state) - _narrowed(now))
        if self._apart or not _all_told(now.information):
            return now
        mean, cov = settle(now.mean, now.cov, now.effect, now, self.leaning)
        if np.isnan(cov).any():  # told by rounding only
            return now
        return FilterState(now.time, mean, cov, now.loglik, now.interval)

    def expect(self, state: Any) -> Any:
        """Moments of the measurement that the filter expects, given what is unknown."""
        return super().expect(_given(state))

    def report(self, state: Any) -> Estimates:
        """Mean and covariance; infinite variances of components that no measurement has told."""
        if not isinstance(state, DiffuseState):
            return super().report(state)
        mean, cov = settle(state.mean, state.cov, state.effect, state, self.leaning)
        return super().report(FilterState(state.time, mean, cov, state.loglik))


def _units(system: LinearSystem) -> np.ndarray:
    """A variance for each component of the state, (n,), that is neither wide nor narrow for it.

    That of its own noise, or of the noise of what it moves or of what it is measured by.
    """
    n = system.state_size
    try:
        with looked_at(system.mentions):
            (F, q), (H, r) = (
                (np.asarray(part.slope_at(0.0)), np.einsum("ii...->i...", part.cov_at(0.0)))
                for part in (system.dynamics, system.sensor)
            )
    except LookupError:  # matrices from a table, which need not have this time
        return np.ones(n)
    found = np.array(q, dtype=float)
    for _ in range(n):
        for k in np.flatnonzero(found == 0):
            known = found > 0
            known[k] = False
            told = np.concatenate([_seen_through(F[known, k], found[known]),
                                   _seen_through(H[:, k], r)])  # fmt: skip
            found[k] = told.max(initial=0.0)
    return np.where(found > 0, found, 1.0)


def _seen_through(slope: np.ndarray, variance: np.ndarray) -> np.ndarray:
    used = (slope != 0) & (variance > 0)
    return (np.sqrt(variance[used]) / slope[used]) ** 2


def settle(
    mean: np.ndarray, cov: np.ndarray, effect: np.ndarray, told: Any, leaning: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance with the unknown numbers at what the measurements say of them.

    Parameters
    ----------
    mean, cov, effect : ndarray
        As in `DiffuseState`, of one time.
    told : DiffuseState
        Its score and information.
    leaning : ndarray, shape (n, q)
        What an effect is measured by, see `KalmanFilter.leaning`.

    Returns
    -------
    mean, cov : ndarray, shapes (n, *batch) and (n, n, *batch)
        Of a component that leans on what nothing has told the variance is infinite and its
        covariances are NaN.
    """
    q, n = len(told.score), len(mean)
    unit = np.eye(q).reshape(q, *(1,) * (told.score.ndim - 1), q)
    value = _solved(told, told.score[..., None])[..., 0]
    inverse = _solved(told, np.broadcast_to(unit, (*told.score.shape, q)))
    inverse = np.moveaxis(inverse, -1, 1)
    mean = mean + np.einsum("n...q,q...->n...", effect, value)
    spread = np.einsum("n...p,pq...,k...q->nk...", effect, inverse, effect)
    told_of = np.einsum("pk...,kq...->pq...", inverse, told.information)
    open_part = effect - np.einsum("n...p,pq...->n...q", effect, told_of)
    scale = leaning.reshape(n, *(1,) * (effect.ndim - 2), q)
    size = np.abs(effect / scale).max(axis=(0, -1), initial=0.0)
    unknown = (np.abs(open_part / scale) > UNKNOWN * size[..., None]).any(axis=-1)
    cov = cov.reshape(n, n, *cov.shape[2:], *(1,) * (spread.ndim - cov.ndim)) + spread
    bad = unknown[:, None] | unknown[None, :]
    cov = np.where(bad, np.nan, cov)
    for k in range(n):
        cov[k, k] = np.where(unknown[k], np.inf, cov[k, k])
    return mean, cov


def _all_told(information: np.ndarray) -> bool:
    """Whether the measurements say something of every unknown number, on all paths."""
    root = np.einsum("ii...->i...", factor(information))
    return bool((root > UNKNOWN * np.sqrt(np.einsum("ii...->i...", information))).all())


def _given(state: Any) -> FilterState:
    """The state given what is unknown."""
    return FilterState(*state[:5])


def _narrowed(state: DiffuseState) -> np.ndarray:
    """Half the logarithm of the information that there is of the unknown numbers."""
    root = np.einsum("ii...->i...", factor(state.information))
    return np.log(np.where(root > 0, root, 1.0)).sum(axis=0)


def _solved(told: DiffuseState, columns: np.ndarray) -> np.ndarray:
    """Information pseudo-inverse times columns (q, *batch, columns)."""
    still, whole = np.zeros_like(columns), np.eye(len(columns))
    return correct(still, None, columns, (still, whole, told.information[..., None]))[0]


def _times(matrix: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Matrix (m, n) or (m, n, *batch) times columns (n, *batch, q)."""
    return np.einsum("ij...,j...->i...", matrix if matrix.ndim == 2 else matrix[..., None], columns)
