"""The Kalman filter of linear systems, with components of which nothing is known at first."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import Seed, align
from seedslib.base.conditioning import gaussian_logpdf
from seedslib.base.linalg import RELATIVE, cholesky, solve_psd, variances
from seedslib.base.objects import Pickled, changed
from seedslib.base.values import Values
from seedslib.filters.base import Estimates
from seedslib.filters.covariance import CovarianceFilter, FilterState
from seedslib.filters.program import Program
from seedslib.linearization.moments import Matrices
from seedslib.models.linear import LinearSystem

UNKNOWN = 1e-9
"""Deviations of a state for one of what no measurement has determined that count as none."""


@dataclass(frozen=True, eq=False)
class Collected(Pickled):
    """What measurements say of unknown numbers d, N(I⁻¹ s, I⁻¹).

    Parameters
    ----------
    score : ndarray, shape (q, *batch)
        s.
    information : ndarray, shape (q, q, *batch)
        I.
    """

    score: np.ndarray
    information: np.ndarray

    @cached_property
    def inverse(self) -> np.ndarray:
        """Pseudo-inverse of the information, (q, q, *batch), whatever the units of d."""
        unit = np.sqrt(variances(self.information))
        unit = np.where(unit > 0, unit, 1.0)
        information = np.moveaxis(self.information / unit / unit[:, None], (0, 1), (-2, -1))
        inverse = np.linalg.pinv(information, RELATIVE, hermitian=True)
        return np.moveaxis(inverse, (-2, -1), (0, 1)) / unit / unit[:, None]

    @cached_property
    def estimate(self) -> np.ndarray:
        """The most probable d, (q, *batch); zero where nothing is known."""
        return np.einsum("pq...,q...->p...", self.inverse, self.score)

    @cached_property
    def _factor(self) -> np.ndarray:
        return cholesky(self.information)

    @property
    def _roots(self) -> np.ndarray:
        return variances(self._factor)

    @cached_property
    def solution(self) -> np.ndarray:
        """A most probable d by substitution, sooner than `estimate`, which is the shortest."""
        L, d, regular = self._factor, self.score.copy(), self._roots > 0
        inverse = regular / np.where(regular, self._roots, 1.0)
        for j in range(len(d)):
            d[j] *= inverse[j]
            d[j + 1 :] -= L[j + 1 :, j] * d[j]
        for j in reversed(range(len(d))):
            d[j] = inverse[j] * (d[j] - (L[j + 1 :, j] * d[j + 1 :]).sum(axis=0))
        return d

    def half_log_determinant(self) -> np.ndarray:
        """Half the logarithm of the determinant of the information that there is."""
        return np.log(np.where(self._roots > 0, self._roots, 1.0)).sum(axis=0)

    def determined(self) -> bool:
        """Whether the measurements determine all unknown numbers."""
        return bool((self._roots > UNKNOWN * np.sqrt(variances(self.information))).all())


class DiffuseState(NamedTuple):
    """A state that depends on q unknown numbers d, N(mean + effect d, cov).

    ``mean`` (n, *batch), ``cov`` (n, n, *batch), ``effect`` (n, q, *batch); ``collected`` is what
    the measurements say of d. ``loglik`` is that of the last measurement, d integrated out.
    """

    time: float | None
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray | float
    interval: float | None
    effect: np.ndarray
    collected: Collected


State = FilterState | DiffuseState


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
        self._marginalizes = True

    def for_smoothing(self) -> KalmanFilter:
        """The same filter, which leaves it to the smoother to integrate unknown numbers out."""
        _ = self._single  # recorded once for both
        return changed(self, _marginalizes=False)

    def initial(self, batch: tuple[int, ...] = (), seed: Seed | None = None) -> State:
        """State before any measurement; see `CovarianceFilter.initial`."""
        state, diffuse = super().initial(batch), self._diffuse
        if not diffuse:
            return state
        q = len(diffuse)
        # a flat distribution plus N(0, c) is flat too, so nothing depends on c; but with none a
        # measurement without noise would have no density given what is unknown
        state.cov[diffuse, diffuse] = self._prior
        effect = np.zeros((self.n, q, *batch))
        effect[diffuse, range(q)] = 1.0
        nothing = Collected(np.zeros((q, *batch)), np.zeros((q, q, *batch)))
        return DiffuseState(*state, effect, nothing)

    def propagate(self, state: State, t: float, p: Values) -> State:
        """See `CovarianceFilter.propagate`; given what is unknown."""
        if isinstance(state, DiffuseState):
            return self.propagate_jointly(state, t, p)[0]
        return super().propagate(state, t, p)

    def propagate_jointly(self, state: State, t: float, p: Values) -> tuple[State, np.ndarray]:
        """See `CovarianceFilter.propagate_jointly`; both given what is unknown."""
        later, cross = super().propagate_jointly(state, t, p)
        if isinstance(state, DiffuseState):
            transition = self.system.dynamics.slope_at(state.time, p)
            effect = np.einsum("ij...,jq...->iq...", transition, state.effect)
            later = later._replace(effect=effect)
        return later, cross

    def update(
        self, state: State, y: np.ndarray, p: Values, indicator: np.ndarray | None = None
    ) -> State:
        """See `Filter.update`."""
        if not isinstance(state, DiffuseState):
            return super().update(state, y, p)
        if np.isnan(y).all():
            return state._replace(loglik=np.zeros(y.shape[1:]))
        corrected = super().update(FilterState(*state[:5]), y, p)  # given that d is zero
        expected, cross, S = self.expected(state, p)
        depth = state.mean.ndim - 1
        innovation = y - align(expected, 1, depth)
        observed = np.isfinite(innovation)
        sensor = self.system.sensor.slope_at(state.time, p)
        effect = np.einsum("ij...,jq...->iq...", sensor, state.effect)  # on y
        # a missing component weighs nothing and is uncorrelated with the others
        columns = np.where(observed, innovation, 0.0), np.where(observed[:, None], effect, 0.0)
        both, identity = observed & observed[:, None], align(np.eye(len(S)), 2, depth)
        weighted = solve_psd(
            np.where(both, align(S, 2, depth), identity),
            np.concatenate([columns[0][:, None], columns[1]], axis=1),
        )
        before = state.collected
        after = Collected(
            before.score + np.einsum("mq...,m...->q...", columns[1], weighted[:, 0]),
            before.information + np.einsum("mp...,mq...->pq...", columns[1], weighted[:, 1:]),
        )
        # at the best d: at zero the squares may be large, and their difference has no digits
        expected = np.einsum("mq...,q...->m...", effect, after.solution)
        density = gaussian_logpdf(innovation, expected, S)
        change = after.solution - before.solution
        density -= 0.5 * np.einsum("p...,pq...,q...->...", change, before.information, change)
        loglik = density + before.half_log_determinant() - after.half_log_determinant()
        effect = state.effect - np.einsum("nm...,mq...->nq...", cross, weighted[:, 1:])
        now = DiffuseState(*corrected._replace(loglik=loglik), effect, after)
        return self.settled(now) if self._marginalizes else now

    def settled(self, state: Any) -> Any:
        """The state with unknown numbers integrated out, once measurements determine them all."""
        if not isinstance(state, DiffuseState) or not state.collected.determined():
            return state
        mean, cov = self._marginalized(state)
        if np.isnan(cov).any():  # known by rounding only
            return state
        return FilterState(state.time, mean, cov, state.loglik, state.interval)

    def _marginalized(self, state: DiffuseState) -> tuple[np.ndarray, np.ndarray]:
        return marginalized(state.mean, state.cov, state.effect, state.collected, self.scale)

    def program(self, **options: Any) -> Program:
        """See `Filter.program`; the first state must have a distribution."""
        if self._diffuse and not options.get("floats"):
            raise ValueError(
                "system: wanted a first state with a distribution to write in C, got a diffuse one"
            )
        return super().program(**options)

    def carries(self, state: Any) -> bool:
        """See `Filter.carries`: once everything unknown is determined."""
        return not isinstance(state, DiffuseState)

    def steps_alone(self, state: Any, t: float) -> bool:
        """See `Filter.steps_alone`."""
        return self.carries(state) and super().steps_alone(state, t)

    def expected(self, state: Any, p: Values) -> Any:
        """Moments of the measurement that the filter expects, given what is unknown."""
        return super().expected(FilterState(*state[:5]), p)

    def predictive(self, state: Any, p: Values) -> tuple[np.ndarray, np.ndarray]:
        """See `Filter.predictive`; infinite variances where something unknown is measured."""
        mean, cov = super().predictive(state, p)
        if not isinstance(state, DiffuseState):
            return mean, cov
        slope = self.system.sensor.slope_at(state.time, p)
        effect = np.einsum("ij...,jq...->iq...", slope, state.effect)
        return marginalized(mean, cov, effect, state.collected, self._measured_scale(slope))

    def _measured_scale(self, sensor: np.ndarray) -> np.ndarray:
        """Units of the measurement in those of the unknown numbers, (m, q); one for none."""
        scale = np.einsum("ij...,jq->iq...", np.abs(sensor), self.scale)
        return np.where(scale > 0, scale, 1.0)

    def report(self, state: Any) -> Estimates:
        """Mean and covariance; infinite variances of components that no measurement determines."""
        if isinstance(state, DiffuseState) and self._covariances:
            mean, cov = self._marginalized(state)
            state = FilterState(state.time, mean, cov, state.loglik)
        return super().report(state)


def _deviations(system: LinearSystem) -> np.ndarray:
    """Deviations of the components of the state, (n,), that are neither wide nor narrow for them.

    That of the noise of its own, or of what it is measured by; else the smallest of the others.
    """
    try:
        p, maps = system.nominal_values(), (system.dynamics, system.sensor)
        Q, R = (np.sqrt(np.diagonal(map.cov_at(0.0, p))) for map in maps)
        H = np.abs(system.sensor.slope_at(0.0, p))
    except LookupError:  # matrices from a table that may lack this time
        return np.ones(system.state_size)
    noisy = (H > 0) & (R > 0)[:, None]
    measured = np.where(noisy, R[:, None] / np.where(noisy, H, 1.0), np.inf)
    own = np.where(Q > 0, Q, measured.min(axis=0))
    least = own.min()
    return np.where(np.isfinite(own), own, least if np.isfinite(least) else 1.0)


def marginalized(
    mean: np.ndarray,
    cov: np.ndarray,
    effect: np.ndarray,
    collected: Collected,
    scale: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of a state over what the measurements say of the unknown numbers.

    Parameters
    ----------
    mean, cov, effect : ndarray
        As in `DiffuseState`, of one time.
    collected : Collected
        What is known of the numbers.
    scale : ndarray, shape (n, q)
        What an effect is measured by, see `KalmanFilter`.

    Returns
    -------
    mean, cov : ndarray, shapes (n, *batch) and (n, n, *batch)
        Of a component that depends on what nothing has determined the variance is infinite and
        its covariances are NaN.
    """
    inverse, depth = collected.inverse, effect.ndim - 2
    mean = mean + np.einsum("nq...,q...->n...", effect, collected.estimate)
    cov = align(cov, 2, depth) + np.einsum("np...,pq...,kq...->nk...", effect, inverse, effect)
    determined = np.einsum("pk...,kq...->pq...", inverse, collected.information)
    rest = effect - np.einsum("np...,pq...->nq...", effect, determined)
    unit = align(scale, 2, depth)
    whole, rest = (np.abs(part / unit).max(axis=1) for part in (effect, rest))
    unknown = rest > UNKNOWN * whole.max(axis=0)
    cov = np.where(unknown[:, None] | unknown[None, :], np.nan, cov)
    for k in range(len(mean)):
        cov[k, k] = np.where(unknown[k], np.inf, cov[k, k])
    return mean, cov
