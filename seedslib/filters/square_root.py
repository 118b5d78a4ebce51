"""The square-root form of the Kalman filter: a root of the covariance is carried in its place."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import Seed, align, batch_shape, product
from seedslib.base.circle import nearest
from seedslib.base.conditioning import LOG_2PI, observed_in
from seedslib.base.linalg import cholesky, variances
from seedslib.base.roots import correct_root, square, triangle
from seedslib.base.values import Values
from seedslib.filters.base import Estimates, Filter
from seedslib.linearization.moments import Linearization, Matrices, Moments, as_linearization
from seedslib.linearization.points import PointRule
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.kinds import as_system
from seedslib.models.linear import LinearSystem
from seedslib.models.maps import StochasticMap


class RootState(NamedTuple):
    """Time, mean, and the lower triangular root L of the covariance L Lᵀ.

    ``mean`` has shape (n, *batch); ``root`` has shape (n, n) while it is common to all runs,
    (n, n, *batch) otherwise. ``loglik`` is that of the last correction, ``interval`` the length of
    the first step.
    """

    time: float | None
    mean: np.ndarray
    root: np.ndarray
    loglik: np.ndarray | float = 0.0
    interval: float | None = None


class SquareRootKalmanFilter(Filter):
    """Kalman filter that carries a triangular root of the covariance, in discrete time.

    Of a `LinearSystem` it is the Kalman filter, of another system the extended one, or with a rule
    for points the cubature or another sigma-point filter. In exact arithmetic the results are
    those of `KalmanFilter`, `extended_kalman` and `cubature_kalman`. But both the forecast and the
    correction are QR factorizations, which form no covariance and subtract none: small variances
    keep their digits beside large ones, and the covariance is always positive semidefinite
    (Kaminski, Bryson, Schmidt 1971, the square-root covariance filter; Arasaratnam, Haykin 2009
    with points). The diagonal of the root is not negative, so that the root of a definite
    covariance is unique.

    Parameters
    ----------
    system : DiscreteSystem or LinearSystem
        With a distribution of its first state.
    linearization : Taylor or PointRule, optional
        `Taylor` by default; of a `LinearSystem` nothing is linearized. The weights of points must
        not be negative: those of `Cubature` and `GaussHermite` never are.

    Raises
    ------
    TypeError, ValueError
        A system in continuous time or one that switches; a diffuse first state; another
        linearization, or a negative weight.
    NoClosedForm
        A map of array functions, which has no Taylor expansion.

    Notes
    -----
    It has no program, so it is not compiled or written in C, and it is not smoothed.
    """

    def __init__(self, system: DiscreteSystem, linearization: Linearization | None = None) -> None:
        as_system("system", system, "DiscreteSystem")
        self.system: Any = system
        if linearization is None and isinstance(system, LinearSystem):
            linearization = Matrices()
        else:
            from seedslib.linearization.taylor_and_exact import Taylor

            linearization = Taylor() if linearization is None else as_linearization(linearization)
            if not isinstance(linearization, Taylor | PointRule):
                raise TypeError(
                    f"linearization: wanted Taylor or a rule with points, got {linearization!r}"
                )
        self.linearization: Linearization = linearization
        _ = self._dynamics, self._sensor  # refused now or never

    @cached_property
    def _dynamics(self) -> Callable[..., Any]:
        return _roots(self.linearization, self.system.dynamics)

    @cached_property
    def _sensor(self) -> Callable[..., Any]:
        return _roots(self.linearization, self.system.sensor)

    def initial(self, batch: tuple[int, ...] = (), seed: Seed | None = None) -> RootState:
        """State before any measurement; see `Filter.initial`."""
        mean = align(np.asarray(self.system.mean0, dtype=float), 1, len(batch))
        mean = np.broadcast_to(mean, (len(mean), *batch)).copy()
        return RootState(None, mean, cholesky(self.system.cov0))

    def propagate(self, state: RootState, t: float, p: Values) -> RootState:
        """See `Filter.propagate`: the triangle of (F L, Q½)."""
        mean, _, moved, noise = self._dynamics(state.time, state.mean, state.root, p)
        return state._replace(mean=mean, root=triangle(moved, cholesky(noise)))

    def update(
        self, state: RootState, y: np.ndarray, p: Values, indicator: np.ndarray | None = None
    ) -> RootState:
        """See `Filter.update`, and `correct_root`.

        A component of y that the ones before it determine, up to rounding, is left out: the
        likelihood is the density of the others.
        """
        expected, root, seen, noise = self._sensor(state.time, state.mean, state.root, p)
        depth = max(y.ndim, state.mean.ndim, expected.ndim) - 1
        mean, y, expected = (align(part, 1, depth) for part in (state.mean, y, expected))
        y = nearest(y, expected, self.system.sensor.period)
        cov_batch = batch_shape(root.shape[2:], seen.shape[2:], noise.shape[2:])
        batch = batch_shape(mean.shape[1:], y.shape[1:], expected.shape[1:], cov_batch)
        observed = observed_in(y)
        if not observed.any():
            return state._replace(loglik=np.zeros(batch))
        root, seen, noise = (align(part, 2, depth) for part in (root, seen, cholesky(noise)))
        # a component that no run has is dropped: a root common to all runs stays common
        some = observed.reshape(len(y), -1).any(axis=1)
        seen, noise, observed = seen[some], noise[some], observed[some]
        innovation = np.zeros((len(seen), *batch)) + (y - expected)[some]
        if observed.all():
            observed = observed.reshape(len(seen), -1)[:, 0]
        else:
            cov_batch = batch_shape(cov_batch, observed.shape[1:])
        S, gain, root, used = correct_root(root, seen, noise, observed)
        innovation, loglik = np.where(used, innovation, 0.0), np.zeros(batch)
        for j, pivot in enumerate(variances(S)):  # it is S times independent numbers
            one = innovation[j] / pivot
            density = -0.5 * (one * one + LOG_2PI) - np.log(pivot)
            loglik = loglik + np.where(used[j], density, 0.0)
            mean = mean + gain[:, j] * one
            innovation[j + 1 :] -= S[j + 1 :, j] * one
        mean, root = mean.reshape(len(mean), *batch), root.reshape(*root.shape[:2], *cov_batch)
        return state._replace(mean=mean, root=root, loglik=loglik)

    def predictive(self, state: RootState, p: Values) -> tuple[np.ndarray, np.ndarray]:
        """See `Filter.predictive`."""
        expected, _, seen, noise = self._sensor(state.time, state.mean, state.root, p)
        return expected, square(triangle(seen, cholesky(noise)))

    def report(self, state: RootState) -> Estimates:
        """Mean and covariance."""
        return Estimates(state.mean, square(state.root), None, state.loglik)


def _roots(rule: Linearization, map: StochasticMap) -> Callable[..., tuple[Any, ...]]:
    """Moments of a map without a square, see `PointRule.roots`."""
    if isinstance(rule, PointRule):
        return rule.roots(map)
    return partial(_expanded, rule.moments(map))


def _expanded(
    moments: Callable[..., Moments], t: float, mean: np.ndarray, root: np.ndarray, p: Values
) -> tuple[Any, ...]:
    """The same of an expansion, y = value + slope (x - mean) + noise.

    Its cov(x, y) is P slopeᵀ and its cov y is slope P slopeᵀ + noise for any P: the identity shows
    the slope, and zero the noise.
    """
    size = len(mean)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        value, cross, _ = moments(t, mean, np.eye(size), p)
        noise = moments(t, mean, np.zeros((size, size)), p).cov
    return value, root, product(cross.swapaxes(0, 1), root, 2), noise
