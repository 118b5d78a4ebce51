"""The square-root form of the Kalman filter: a root of the covariance is carried in its place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import Seed, align, batch_shape, product
from seedslib.base.circle import nearest
from seedslib.base.conditioning import LOG_2PI, observed_in
from seedslib.base.linalg import cholesky, variances
from seedslib.base.roots import correct_root, square, triangle
from seedslib.base.values import Values
from seedslib.filters.base import Estimates, Filter
from seedslib.linearization.moments import Matrices, Moments
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.kinds import as_system
from seedslib.models.linear import LinearSystem


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

    Of a `LinearSystem` it is the Kalman filter, of another system the extended one. In exact
    arithmetic the results are those of `KalmanFilter` and `extended_kalman`. But both the forecast
    and the correction are QR factorizations, which form no covariance and subtract none: small
    variances keep their digits beside large ones, and the covariance is always positive
    semidefinite (Kaminski, Bryson, Schmidt 1971, the square-root covariance filter). The diagonal
    of the root is not negative, so that the root of a definite covariance is unique.

    Parameters
    ----------
    system : DiscreteSystem or LinearSystem
        With a distribution of its first state, and of formulas or matrices.

    Raises
    ------
    TypeError, ValueError
        A system in continuous time or one that switches; a diffuse first state.
    NoClosedForm
        A map of array functions, which has no Taylor expansion.

    Notes
    -----
    It has no program, so it is not compiled or written in C, and it is not smoothed.
    """

    def __init__(self, system: DiscreteSystem) -> None:
        as_system("system", system, "DiscreteSystem")
        self.system: Any = system
        rule: Any = Matrices()
        if not isinstance(system, LinearSystem):
            from seedslib.linearization.taylor_and_exact import Taylor

            rule = Taylor()
        self._dynamics: Callable[..., Moments] = rule.moments(system.dynamics)
        self._sensor: Callable[..., Moments] = rule.moments(system.sensor)

    def initial(self, batch: tuple[int, ...] = (), seed: Seed | None = None) -> RootState:
        """State before any measurement; see `Filter.initial`."""
        mean = align(np.asarray(self.system.mean0, dtype=float), 1, len(batch))
        mean = np.broadcast_to(mean, (len(mean), *batch)).copy()
        return RootState(None, mean, cholesky(self.system.cov0))

    def propagate(self, state: RootState, t: float, p: Values) -> RootState:
        """See `Filter.propagate`: the triangle of (F L, Q½)."""
        mean, slope, noise = _expanded(self._dynamics, state, p)
        root = triangle(product(slope, state.root, 2), cholesky(noise))
        return state._replace(mean=mean, root=root)

    def update(
        self, state: RootState, y: np.ndarray, p: Values, indicator: np.ndarray | None = None
    ) -> RootState:
        """See `Filter.update`, and `correct_root`.

        A component of y that the ones before it determine, up to rounding, is left out: the
        likelihood is the density of the others.
        """
        expected, slope, noise = _expanded(self._sensor, state, p)
        depth = max(y.ndim, state.mean.ndim, expected.ndim) - 1
        mean, y, expected = (align(part, 1, depth) for part in (state.mean, y, expected))
        y = nearest(y, expected, self.system.sensor.period)
        cov_batch = batch_shape(state.root.shape[2:], slope.shape[2:], noise.shape[2:])
        batch = batch_shape(mean.shape[1:], y.shape[1:], expected.shape[1:], cov_batch)
        observed = observed_in(y)
        if not observed.any():
            return state._replace(loglik=np.zeros(batch))
        root, slope, noise = (align(part, 2, depth) for part in (state.root, slope, noise))
        noise_root = cholesky(noise)
        # a component that no run has is dropped: a root common to all runs stays common
        some = observed.reshape(len(y), -1).any(axis=1)
        slope, noise_root, observed = slope[some], noise_root[some], observed[some]
        innovation = np.zeros((len(slope), *batch)) + (y - expected)[some]
        if observed.all():
            observed = observed.reshape(len(slope), -1)[:, 0]
        else:
            cov_batch = batch_shape(cov_batch, observed.shape[1:])
        parts = root, product(slope, root, 2), noise_root, observed
        S, gain, root, used = correct_root(*parts)
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
        expected, slope, noise = _expanded(self._sensor, state, p)
        return expected, square(triangle(product(slope, state.root, 2), cholesky(noise)))

    def report(self, state: RootState) -> Estimates:
        """Mean and covariance."""
        return Estimates(state.mean, square(state.root), None, state.loglik)


def _expanded(moments: Callable[..., Moments], state: RootState, p: Values) -> tuple[Any, ...]:
    """Value, slope and covariance of the noise of a map about the mean of a state.

    An expansion has cov(x, y) = P slopeᵀ and cov y = slope P slopeᵀ + noise for any P: the identity
    shows the slope, and zero the noise.
    """
    size, t = len(state.mean), state.time
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        value, cross, _ = moments(t, state.mean, np.eye(size), p)
        noise = moments(t, state.mean, np.zeros((size, size)), p).cov
    return value, cross.swapaxes(0, 1), noise
