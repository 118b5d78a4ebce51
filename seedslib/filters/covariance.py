"""Filters that carry a mean and a full covariance: extended, assumed-density, sigma-point."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import BLOCK
from seedslib.base.checks import as_count
from seedslib.base.correction import correct
from seedslib.base.objects import Remade
from seedslib.base.semidefinite import settled
from seedslib.filters.blind import warn_blind
from seedslib.filters.estimates import Estimates, require_time, stays
from seedslib.filters.integration import adaptive, euler, rk4
from seedslib.filters.verbs import Filter
from seedslib.linearization.moments import Linearization, Moments, symmetric
from seedslib.linearization.points import PointRule
from seedslib.models.kinds import AnySystem, as_system, in_steps

INTEGRATORS = {"rk4": rk4, "euler": euler, "adaptive": adaptive}


class FilterState(NamedTuple):
    """What the filter remembers: time (None before the first), mean, covariance.

    ``mean`` has shape (n, *batch); ``cov`` has shape (n, n) while it is common to all paths,
    (n, n, *batch) otherwise; ``loglik`` is that of the last correction.
    """

    time: float | None
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray | float = 0.0


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
    integrator : {"rk4", "euler", "adaptive"}
        Fixed Runge-Kutta or Euler steps, or Dormand-Prince 5(4) steps common to the paths of a
        block. Euler may diverge on rare paths where the others do not.
    bound : float, optional
        A path counts as diverged when any component of its mean is beyond `bound` in absolute
        value, or not a number; by default only the latter.
    rtol, atol : float
        Tolerances of the adaptive integrator.

    Raises
    ------
    TypeError, ValueError
        Another system, something that is no linearization; an unknown integrator; a step or
        bound that is not positive.
    NoClosedForm
        The linearization has no formulas for this system; the message offers one that works.

    Warns
    -----
    UserWarning
        A measurement that is uncorrelated with the state wherever that is: it moves no estimate.
    """

    _shown = "linearization", "integrator", "integration_step", "bound"
    alone = True  # numbers of one path are plain floats, which are faster than arrays of one

    def __init__(
        self, system: AnySystem, linearization: Linearization, *, step: float | None = None,
        integrator: str = "rk4", bound: float | None = None, rtol: float = 1e-6, atol: float = 1e-9,
    ) -> None:  # fmt: skip
        if not isinstance(linearization, Linearization):
            raise TypeError(f"linearization: wanted a Linearization, got {linearization!r}")
        if integrator not in INTEGRATORS:
            raise ValueError(
                f"integrator: wanted one of {', '.join(INTEGRATORS)}, got {integrator!r}"
            )
        as_system("system", system, "JumpDiffusion", "DiscreteSystem")
        self.system: Any = system
        self.linearization: Linearization = linearization
        self.integrator: str = integrator
        self.continuous: bool = not in_steps(system)
        self.integration_step: float = float(getattr(system, "step", 1.0) if step is None else step)
        self.bound: float = np.inf if bound is None else float(bound)
        for name, value in (("step", self.integration_step), ("bound", self.bound)):
            if not value > 0:
                raise ValueError(f"{name}: wanted a positive number, got {value}")
        self.n: int = len(system.mean0)
        self._sensor = linearization.moments(system.sensor)
        # a rule of points wants a factor of the covariance
        self._by_points = isinstance(linearization, PointRule)
        warn_blind(self._sensor, system)
        if self.continuous:
            self._rate = linearization.rate(system)
            advance = INTEGRATORS[integrator]
            self._integrate = (
                partial(advance, rtol=rtol, atol=atol) if integrator == "adaptive" else advance
            )
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

    def predict(self, state: FilterState, t: float) -> FilterState:
        """Forecast to time t; a state without a time is only given one.

        Raises
        ------
        ValueError
            A time before that of the state.
        """
        if stays(state, t):
            return state._replace(time=float(t))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if not self.continuous:
                mean, cov = self._dynamics(state.time, state.mean, state.cov)
                return state._replace(time=float(t), mean=mean, cov=cov)
            rows, columns = np.tril_indices(self.n)
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
        return FilterState(float(t), mean, symmetric(change, self.n), state.loglik)

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
            )  # fmt: skip
            if self._by_points:
                cov = settled(cov, state.cov)
            return FilterState(state.time, mean, cov, loglik)

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
        """Paths do not meet, so the size of a block is free, but for the common adaptive step."""
        if self.integrator == "adaptive":
            return BLOCK
        return max(BLOCK, min(4 * BLOCK, -(-paths // as_count("workers", workers))))


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
