"""Filters that carry a mean and a full covariance: extended, assumed-density, sigma-point."""

from __future__ import annotations

from functools import cached_property, partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import BLOCK
from seedslib.base.checks import as_count, as_positive
from seedslib.base.correction import correct
from seedslib.base.objects import Remade
from seedslib.base.semidefinite import lower_triangle, settled
from seedslib.filters.estimates import Estimates, require_time
from seedslib.filters.integration import euler, finite_or_nan, rk4
from seedslib.filters.verbs import Filter
from seedslib.linearization.moments import Linearization, Moments, as_linearization, symmetric
from seedslib.linearization.points import PointRule
from seedslib.models.kinds import AnySystem, as_system, elapsed, in_steps
from seedslib.models.maps import doubled

INTEGRATORS = {"rk4": rk4, "euler": euler}


class FilterState(NamedTuple):
    """What the filter remembers: time (None before the first), mean, covariance.

    ``mean`` has shape (n, *batch); ``cov`` has shape (n, n) while it is common to all paths,
    (n, n, *batch) otherwise; ``loglik`` is that of the last correction, ``interval`` the length of
    the first step.
    """

    time: float | None
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray | float = 0.0
    interval: float | None = None


class CovarianceFilter(Filter, Remade):
    """Approximate posterior mean and covariance, N(m, P) between and at the measurements.

    Forecast: the moment equations (8.1) of the jump-diffusion paper, with the jumps, or for a
    system in discrete time the moments of its dynamics map. Correction: (8.2). With Taylor
    expansion it is the extended Kalman filter (EKF; the paper's OFK), with exact Gaussian means
    the assumed-density filter (the paper's FNA). For a linear system with Gaussian noise every
    linearization gives the Kalman filter.

    Parameters
    ----------
    system : JumpDiffusion or DiscreteSystem
        Anything with `mean0`, `cov0`, a `sensor` map, and either `drift_map` and `spread_map`
        or a `dynamics` map.
    linearization : Linearization
    step : float, optional
        Largest integration step; the system's own by default.
    integrator : {"rk4", "euler"}
        Runge-Kutta or Euler steps. Euler may diverge on rare paths where the other does not.
    bound : float, optional
        A path counts as diverged when any component of its mean is beyond `bound` in absolute
        value, or not a number; by default only the latter.

    Raises
    ------
    TypeError, ValueError
        Another system, something that is no linearization; an unknown integrator; a step or
        bound that is not positive.
    NoClosedForm
        The linearization has no formulas for this system; the message offers one that works.
    """

    _systems: ClassVar[tuple[str, ...]] = ("JumpDiffusion", "DiscreteSystem")
    _shown = "linearization", "integrator", "integration_step", "bound"
    alone = True  # numbers of one path are plain floats, which are faster than arrays of one

    def __init__(
        self,
        system: AnySystem,
        linearization: Linearization,
        *,
        step: float | None = None,
        integrator: str = "rk4",
        bound: float | None = None,
    ) -> None:
        if integrator not in INTEGRATORS:
            raise ValueError(
                f"integrator: wanted one of {', '.join(INTEGRATORS)}, got {integrator!r}"
            )
        as_system("system", system, *self._systems)
        self.system: Any = system
        self.linearization: Linearization = as_linearization(linearization, system)
        self.integrator: str = integrator
        self.continuous: bool = not in_steps(system)
        step = getattr(system, "step", 1.0) if step is None else step
        self.integration_step: float = as_positive("step", step, infinite=True)
        self.bound: float = np.inf if bound is None else as_positive("bound", bound, infinite=True)
        self.n: int = len(system.mean0)
        self._sensor = linearization.moments(system.sensor)
        # a rule of points wants a factor of the covariance
        self._by_points = isinstance(linearization, PointRule)
        if self.continuous:
            self._rate = linearization.rate(system)
            self._integrate = partial(finite_or_nan, INTEGRATORS[integrator])
        else:
            self._dynamics = linearization.transition(system.dynamics)

    def initial(self, batch: tuple[int, ...] = (), seed: Any = None) -> FilterState:
        """State before any measurement: the moments of the initial law.

        Parameters
        ----------
        batch : tuple of int
            Batch axes, for example (paths,).
        seed : object
            Not used; every filter has the same verbs.
        """
        mean = np.asarray(self.system.mean0, dtype=float)
        mean = np.broadcast_to(mean.reshape(-1, *(1,) * len(batch)), (self.n, *batch)).copy()
        return FilterState(None, mean, np.array(self.system.cov0, dtype=float))

    def moved(self, state: FilterState, t: float) -> FilterState:
        """Mean and covariance at time t, by the moment equations or the dynamics map."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if not self.continuous:
                mean, cov = self._dynamics(state.time, state.mean, state.cov)
                return state._replace(mean=mean, cov=cov)
            rows, columns = lower_triangle(self.n)
            lower = state.cov[rows, columns]
            if state.mean.ndim == 1:
                components = [*state.mean.tolist(), *lower.tolist()]
            else:
                components = [*state.mean, *lower]
            moved = self._integrate(self._rate, components, state.time, t, self.integration_step)
        mean = np.empty_like(state.mean)
        for k in range(self.n):
            mean[k] = moved[k]
        batch = np.broadcast_shapes(*(np.shape(c) for c in moved[self.n :]))
        change = np.empty((len(rows), *batch))
        for k, component in enumerate(moved[self.n :]):
            change[k] = component
        return state._replace(mean=mean, cov=symmetric(change, self.n))

    def smoother(self) -> Any:
        """See `Filter.smoother`."""
        from seedslib.filters.backward import Rauch

        return Rauch(self)

    def apart(self) -> CovarianceFilter:
        """The filter as `smooth` runs it."""
        return self

    def moved_jointly(self, state: Any, t: float) -> tuple[Any, np.ndarray]:
        """What `moved` gives, and the covariance of the state now with the one at time t.

        Between measurements that covariance C obeys dC/dt = cov(x, b), the mean velocity b being
        linearized in the joint law of both states.
        """
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if not self.continuous:
                with elapsed(self.system, state.time, t):
                    mean, cross, cov = self._jointly(state.time, state.mean, state.cov)
                return state._replace(mean=mean, cov=cov), cross
            n, size = self.n, len(lower_triangle(self.n)[0])
            lower = state.cov[lower_triangle(n)]
            parts = [*state.mean, *lower, *state.cov.reshape(n * n, *state.cov.shape[2:])]
            rate = partial(_joint_rate, *self._jointly, state.cov)
            moved = self._integrate(rate, parts, state.time, t, self.integration_step)
        batch = np.broadcast_shapes(*(np.shape(c) for c in moved))
        full = np.stack([np.broadcast_to(c, batch) for c in moved])
        later = state._replace(mean=full[:n], cov=symmetric(full[n : n + size], n))
        return later, full[n + size :].reshape(n, n, *batch)

    @cached_property
    def _jointly(self) -> Any:
        """Moments of the dynamics with the state they start from, compiled when first wanted."""
        if not self.continuous:
            return self.linearization.moments(self.system.dynamics)
        both, spread = doubled(self.system.drift_map), self.system.spread_map
        return tuple(self.linearization.moments(map, spread=False) for map in (both, spread))

    def correct(self, state: FilterState, y: ArrayLike) -> FilterState:
        """Correct by the measurement y, shape (m, *batch), at the time of the state.

        Raises
        ------
        ValueError
            A state without a time: `predict` gives it one.
        """
        require_time(state)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            moments = Moments(*self._sensor(state.time, state.mean, state.cov))
            mean, cov, loglik = correct(
                state.mean, state.cov, y, moments,
                noise=lambda: self._sensor(state.time, state.mean, np.zeros_like(state.cov)).cov,
                exact=True,
                periods=self.system.sensor.period,
            )  # fmt: skip
            if self._by_points:
                cov = settled(cov, state.cov)
            return state._replace(mean=mean, cov=cov, loglik=loglik)

    def expect(self, state: FilterState) -> Moments:
        """Moments of the measurement that the filter expects at the time of the state."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return Moments(*self._sensor(state.time, state.mean, state.cov))

    def report(self, state: FilterState) -> Estimates:
        """Mean and covariance; a path diverges where its mean is beyond the bound."""
        beyond = None
        if np.isfinite(self.bound):
            beyond = (np.abs(state.mean) > self.bound).any(axis=0)
        return Estimates(state.mean, state.cov, None, state.loglik, beyond)

    def block(self, times: np.ndarray, paths: int, workers: int) -> int:
        """Paths do not meet, so the size of a block is free."""
        return max(BLOCK, min(4 * BLOCK, -(-paths // as_count("workers", workers))))


def _joint_rate(velocity, spread, before, t, components):
    """Rates of mean, covariance and covariance with the state before, on a list of components."""
    n = len(before)
    rows, columns = lower_triangle(n)
    batch = np.broadcast_shapes(before.shape[2:], *(np.shape(c) for c in components))
    full = np.stack([np.broadcast_to(c, batch) for c in components])
    mean, cov = full[:n], symmetric(full[n : n + len(rows)], n)
    cross = full[n + len(rows) :].reshape(n, n, *batch)
    joint = np.empty((2 * n, 2 * n, *batch))
    joint[:n, :n] = before.reshape(
        *before.shape[:2], *(1,) * (len(batch) + 2 - before.ndim), *before.shape[2:]
    )
    joint[:n, n:], joint[n:, :n], joint[n:, n:] = cross, np.swapaxes(cross, 0, 1), cov
    b, lean, _ = velocity(t, np.concatenate([mean, mean]), joint)
    sigma = spread(t, mean, cov).mean
    lean = np.broadcast_to(lean, (2 * n, n, *lean.shape[2:]))
    change = [
        lean[n + i, j] + lean[n + j, i] + sigma[k]
        for k, (i, j) in enumerate(zip(rows, columns, strict=True))
    ]
    return [*b, *change, *lean[:n].reshape(n * n, *lean.shape[2:])]


def extended_kalman(system: AnySystem, **options: Any) -> CovarianceFilter:
    """Extended Kalman filter (the paper's OFK, or L-AOF): `CovarianceFilter` with `Taylor`."""
    from seedslib.linearization.symbolic import Taylor

    return CovarianceFilter(system, Taylor(), **options)


def assumed_density(system: AnySystem, **options: Any) -> CovarianceFilter:
    """Gaussian assumed-density filter (the paper's FNA): `CovarianceFilter` with exact means."""
    from seedslib.linearization.symbolic import ExactGaussian

    return CovarianceFilter(system, ExactGaussian(), **options)


def unscented_kalman(
    system: AnySystem, *, alpha: float = 1.0, beta: float = 0.0, kappa: float | None = None,
    **options: Any,
) -> CovarianceFilter:  # fmt: skip
    """Unscented Kalman filter: `CovarianceFilter` with `Unscented(alpha, beta, kappa)`."""
    from seedslib.linearization.points import Unscented

    return CovarianceFilter(system, Unscented(alpha, beta, kappa), **options)


def cubature_kalman(system: AnySystem, **options: Any) -> CovarianceFilter:
    """Cubature Kalman filter: `CovarianceFilter` with `Cubature`."""
    from seedslib.linearization.points import Cubature

    return CovarianceFilter(system, Cubature(), **options)
