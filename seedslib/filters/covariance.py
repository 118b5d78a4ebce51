"""Filters that carry a mean and a full covariance: extended, assumed-density, sigma-point."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Seed, align
from seedslib.base.blocks import BLOCK
from seedslib.base.checks import as_count, as_positive
from seedslib.base.clock import MOST_STEPS, SAME, step_count
from seedslib.base.conditioning import update
from seedslib.base.linalg import lower_triangle, solve_psd, symmetric, without_rounding
from seedslib.base.objects import changed
from seedslib.base.values import Values
from seedslib.filters.base import Estimates, Filter, first_step, stays
from seedslib.filters.program import Program
from seedslib.linearization.moments import Linearization, Matrices, Moments, as_linearization
from seedslib.linearization.points import PointRule
from seedslib.models.kinds import AnySystem, as_system, in_steps
from seedslib.models.maps import StochasticMap

if TYPE_CHECKING:
    from typing import Self


def euler_step(rate: Callable[..., Any], t: float, y: Any, h: float) -> Any:
    """One explicit Euler step of size h."""
    return [a + h * b for a, b in zip(y, rate(t, y), strict=True)]


def rk4_step(rate: Callable[..., Any], t: float, y: Any, h: float) -> Any:
    """One classical Runge-Kutta step of size h."""
    k1 = rate(t, y)
    k2 = rate(t + 0.5 * h, [a + (0.5 * h) * b for a, b in zip(y, k1, strict=True)])
    k3 = rate(t + 0.5 * h, [a + (0.5 * h) * b for a, b in zip(y, k2, strict=True)])
    k4 = rate(t + h, [a + h * b for a, b in zip(y, k3, strict=True)])
    return [
        a + (h / 6.0) * (b + 2.0 * (c + d) + e)
        for a, b, c, d, e in zip(y, k1, k2, k3, k4, strict=True)
    ]


STEPS = {"rk4": rk4_step, "euler": euler_step}


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


class SensorUpdate:
    """Update of a mean and covariance by a measurement through a linearized sensor.

    Parameters
    ----------
    sensor : StochasticMap
    linearization : Linearization

    Attributes
    ----------
    moments : callable
        ``moments(t, mean, cov, p) -> Moments`` of the measurement that is expected.
    """

    def __init__(self, sensor: StochasticMap, linearization: Linearization) -> None:
        self.moments: Callable[..., Moments] = linearization.moments(sensor)
        self._periods = sensor.period
        # points are laid along a factor of the covariance, which must not consist of rounding
        self._by_points = isinstance(linearization, PointRule)

    def __call__(
        self,
        t: float,
        mean: np.ndarray,
        cov: np.ndarray,
        y: ArrayLike,
        p: Values,
        moments: Moments | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean, covariance and log-likelihood given y, (8.2) of the jump-diffusion paper.

        Parameters
        ----------
        t : float
        mean, cov : ndarray, shapes (n, *batch) and (n, n) or (n, n, *batch)
        y : array_like, shape (m, *batch)
            NaN marks a missing component.
        p : tuple
            Numbers of the parameters.
        moments : Moments, optional
            Those of a branch of the sensor, in place of the whole one's.
        """
        if moments is None:
            moments = self.moments(t, mean, cov, p)
        new_mean, new_cov, loglik = update(
            mean,
            cov,
            y,
            moments,
            noise=lambda: self.moments(t, mean, np.zeros_like(cov), p).cov,
            periods=self._periods,
            exact=True,
        )
        if self._by_points:
            new_cov = without_rounding(new_cov, cov)
        return new_mean, new_cov, loglik


class CovarianceFilter(Filter):
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
    _covariances = True
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
        if integrator not in STEPS:
            raise ValueError(f"integrator: wanted one of {', '.join(STEPS)}, got {integrator!r}")
        as_system("system", system, *self._systems)
        self.system: Any = system
        self.linearization: Linearization = as_linearization(linearization)
        self.integrator: str = integrator
        self.continuous: bool = not in_steps(system)
        step = getattr(system, "step", 1.0) if step is None else step
        self.integration_step: float = as_positive("step", step, infinite=True)
        self.bound: float = np.inf if bound is None else as_positive("bound", bound, infinite=True)
        self.n: int = len(system.mean0)
        _ = self._sensor, self._rate if self.continuous else self._dynamics  # refused now or never

    @cached_property
    def _sensor(self) -> SensorUpdate:
        return SensorUpdate(self.system.sensor, self.linearization)

    @cached_property
    def _dynamics(self) -> Callable[..., Moments]:
        return self.linearization.moments(self.system.dynamics)

    @cached_property
    def _rate(self) -> Callable[..., list[Any]]:
        return self.linearization.rate(self.system)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.system!r}, {self.linearization})"

    def initial(self, batch: tuple[int, ...] = (), seed: Seed | None = None) -> FilterState:
        """State before any measurement: the moments of the initial distribution.

        Parameters
        ----------
        batch : tuple of int
            Batch axes, for example (paths,).
        seed : object
            Not used; every filter has the same verbs.
        """
        mean = align(np.asarray(self.system.mean0, dtype=float), 1, len(batch))
        mean = np.broadcast_to(mean, (self.n, *batch)).copy()
        return FilterState(None, mean, np.array(self.system.cov0, dtype=float))

    def propagate(self, state: FilterState, t: float, p: Values) -> FilterState:
        """Mean and covariance at time t, by the moment equations or the dynamics map."""
        if not self.continuous:
            return self.propagate_jointly(state, t, p)[0]
        mean, lower = state.mean, state.cov[lower_triangle(self.n)]
        if mean.ndim == 1:  # plain floats are faster than arrays without axes
            mean, lower = mean.tolist(), lower.tolist()
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            later = self._integrate(
                lambda t, parts: self._rate(t, parts, p), [*mean, *lower], state.time, t
            )
        mean = _filled(later[: self.n], state.mean.shape[1:])
        return state._replace(mean=mean, cov=symmetric(_filled(later[self.n :]), self.n))

    def propagate_jointly(self, state: Any, t: float, p: Values) -> tuple[Any, np.ndarray]:
        """What `propagate` gives, and the covariance of the state now with the one at time t.

        Between measurements that covariance C obeys dC/dt = C P⁻¹ cov(x, b), with the mean
        velocity b linearized about the state of that time, of covariance P.
        """
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if not self.continuous:
                mean, cross, cov = self._dynamics(state.time, state.mean, state.cov, p)
                return state._replace(mean=mean, cov=cov), cross
            n, (rows, columns) = self.n, lower_triangle(self.n)
            lower = slice(n, n + len(rows))

            def split(parts: list[Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
                full = _filled(parts)
                cross = full[lower.stop :].reshape(n, n, *full.shape[1:])
                return full[:n], symmetric(full[lower], n), cross

            def rate(t: float, parts: list[Any]) -> list[Any]:
                mean, cov, cross = split(parts)
                b, *squares = self._flow(t, mean, cov, p)
                with_b, diffusion = (align(part, 2, mean.ndim - 1) for part in squares)
                change = with_b + np.swapaxes(with_b, 0, 1) + diffusion
                joint = np.einsum("ij...,jk...->ik...", cross, solve_psd(cov, with_b))
                return [*b, *change[rows, columns], *joint.reshape(n * n, *joint.shape[2:])]

            now = state.cov
            parts = [*state.mean, *now[rows, columns], *now.reshape(n * n, *now.shape[2:])]
            mean, cov, cross = split(self._integrate(rate, parts, state.time, t))
        return state._replace(mean=mean, cov=cov), cross

    @cached_property
    def _flow(self) -> Callable[..., Moments]:
        return self.linearization.flow(self.system)

    def _integrate(self, rate: Callable[..., Any], parts: list, start: float, stop: float) -> list:
        """Components at a later time; NaN where Python's numbers overflow, as arrays would."""
        steps = step_count(start, stop, self.integration_step)
        h, step = (stop - start) / steps, STEPS[self.integrator]
        try:
            for k in range(steps):
                parts = step(rate, start + k * h, parts, h)
        except (OverflowError, ZeroDivisionError):
            return [np.full(np.shape(part), np.nan) for part in parts]
        return parts

    def program(self, **options: Any) -> Program:
        """See `Filter.program`; the maps must have formulas."""
        from seedslib.filters import kernels

        self._require_formulas()
        step, system, rule, n = Program(self, **options), self.system, self.linearization, self.n
        step.initial = {"mean": system.mean0, "cov": system.cov0}
        by_points, t = isinstance(rule, PointRule), step.timed(again=True)
        moving = step.array("moving", (n * (n + 3) // 2,))
        moving.store([*step.mean.all, *kernels.lower_of(step.cov.all)])
        last_time = step.last_time.all
        later = (step.started.all > 0.0) & (t > last_time)
        span = t - last_time
        if self.continuous:
            count = np.maximum(1.0, np.ceil(span / self.integration_step - SAME))
            step.refuse(later & ~(count <= float(MOST_STEPS)), "TIME")
        with step.when(later):
            p = step.since(span)
            if self.continuous:
                rates = partial(self._rate, p=p)
                if by_points:
                    rates = kernels.moment_rates(step, rule, system, p)
                h = span / count
                with step.loop(count) as i:
                    moved = STEPS[self.integrator](rates, last_time + i * h, list(moving.all), h)
                    moving.store(moved)
            else:
                given = last_time, *kernels.unpacked(moving.all, n), p
                mean, _, cov = kernels.map_moments(step, rule, system.dynamics, *given)
                moving.store([*mean, *kernels.lower_of(cov)])
        mean, cov = kernels.unpacked(moving.all, n)
        moments = kernels.map_moments(step, rule, system.sensor, t, mean, cov, step.at_time())
        mean, after, loglik, _ = kernels.correct(
            step, mean, cov, moments, system.sensor, exact=True
        )
        step.cov.store(kernels.without_rounding(step, after, cov) if by_points else after)
        step.mean.store(mean)
        step.loglik.store(loglik)
        step.last_time.store(t)
        step.started.store(1.0)
        return step

    def _require_formulas(self) -> None:
        """Refuse maps and rules without formulas."""
        system, rule = self.system, self.linearization
        if not (hasattr(rule, "formulas") or isinstance(rule, PointRule | Matrices)):
            raise TypeError(
                f"linearization: wanted formulas or a rule with points to write in C, got {rule!r}"
            )
        maps = [system.sensor, system.drift_map if self.continuous else system.dynamics]
        if not all(map.symbolic or getattr(map, "formulas", None) is not None for map in maps):
            raise ValueError(
                "system: wanted symbolic expressions to write in C, got array functions"
            )

    def steps_alone(self, state: Any, t: float) -> bool:
        """See `Filter.steps_alone`."""
        if not stays(state, t):
            first_step(state, t, self.system)
        return state.mean.ndim == 1

    def numbers_of(self, state: Any) -> dict[str, Any]:
        """See `Filter.numbers_of`."""
        started = state.time is not None
        time = {"t": state.time if started else 0.0, "started": started}
        return time | {"mean": state.mean, "cov": state.cov}

    def state_of(self, parts: dict[str, Any], t: float, before: FilterState) -> FilterState:
        """See `Filter.state_of`."""
        interval = before.interval
        if interval is None and not stays(before, t):
            interval = t - before.time
        return FilterState(t, parts["mean"], parts["cov"], parts["loglik"], interval)

    def estimates_of(self, parts: dict[str, Any], covariances: bool = True) -> Estimates:
        """See `Filter.estimates_of`; a record diverges where its mean is beyond the bound."""
        beyond = (np.abs(parts["mean"]) > self.bound).any()
        return super().estimates_of(parts)._replace(diverged=beyond)

    def smoother(self) -> Any:
        """See `Filter.smoother`."""
        from seedslib.filters.smoothing import RauchTungStriebel

        return RauchTungStriebel(self)

    def settled(self, state: Any) -> Any:
        """A state with unknown numbers integrated out, if it has any that can be."""
        return state

    def for_smoothing(self) -> CovarianceFilter:
        """The filter whose states `smooth` goes back through."""
        return self

    def update(
        self, state: FilterState, y: np.ndarray, p: Values, indicator: np.ndarray | None = None
    ) -> FilterState:
        """See `Filter.update`."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            mean, cov, loglik = self._sensor(state.time, state.mean, state.cov, y, p)
        return state._replace(mean=mean, cov=cov, loglik=loglik)

    def expect(self, state: FilterState, inputs: Mapping[Any, Any] | None = None) -> Moments:
        """Moments of the measurement that the filter expects at the time of the state."""
        return self.expected(state, self.values(inputs))

    def expected(self, state: FilterState, p: Values) -> Moments:
        """The same with the numbers of all parameters."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return Moments(*self._sensor.moments(state.time, state.mean, state.cov, p))

    def predictive(self, state: Any, p: Values) -> tuple[np.ndarray, np.ndarray]:
        """See `Filter.predictive`."""
        moments = self.expected(state, p)
        return moments.mean, moments.cov

    def report(self, state: FilterState) -> Estimates:
        """Mean and covariance; a path diverges where its mean is beyond the bound."""
        beyond = None
        if np.isfinite(self.bound):
            beyond = (np.abs(state.mean) > self.bound).any(axis=0)
        cov = state.cov if self._covariances else None
        return Estimates(state.mean, cov, None, state.loglik, beyond)

    def _for_likelihoods(self) -> Self:
        """See `Filter._for_likelihoods`: without covariances."""
        return changed(self, _covariances=False)

    def block(self, times: np.ndarray, paths: int, workers: int) -> int:
        """Paths do not meet, so the size of a block is free."""
        return max(BLOCK, min(4 * BLOCK, -(-paths // as_count("workers", workers))))


def _filled(parts: list[Any], batch: tuple[int, ...] | None = None) -> np.ndarray:
    """Array of components, which may lack some of the batch axes."""
    batch = np.broadcast_shapes(*map(np.shape, parts)) if batch is None else batch
    full = np.empty((len(parts), *batch))
    for k, part in enumerate(parts):
        full[k] = part
    return full


def extended_kalman(system: AnySystem, **options: Any) -> CovarianceFilter:
    """Extended Kalman filter (the paper's OFK, or L-AOF): `CovarianceFilter` with `Taylor`."""
    from seedslib.linearization.taylor_and_exact import Taylor

    return CovarianceFilter(system, Taylor(), **options)


def assumed_density(system: AnySystem, **options: Any) -> CovarianceFilter:
    """Gaussian assumed-density filter (the paper's FNA): `CovarianceFilter` with exact means."""
    from seedslib.linearization.taylor_and_exact import ExactGaussian

    return CovarianceFilter(system, ExactGaussian(), **options)


def unscented_kalman(
    system: AnySystem, *, alpha: float = 1, beta: float = 0, kappa: float | None = None, **options
) -> CovarianceFilter:
    """Unscented Kalman filter: `CovarianceFilter` with `Unscented(alpha, beta, kappa)`."""
    from seedslib.linearization.points import Unscented

    return CovarianceFilter(system, Unscented(alpha, beta, kappa), **options)


def cubature_kalman(system: AnySystem, **options: Any) -> CovarianceFilter:
    """Cubature Kalman filter: `CovarianceFilter` with `Cubature`."""
    from seedslib.linearization.points import Cubature

    return CovarianceFilter(system, Cubature(), **options)
