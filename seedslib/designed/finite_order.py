"""Finite-order filter: designed offline, it runs on a frozen table of forecasts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_count
from seedslib.base.circle import Periods, nearest
from seedslib.base.clock import Clock
from seedslib.base.conditioning import update
from seedslib.base.linalg import symmetric
from seedslib.base.values import Values
from seedslib.designed.accuracy import Accuracy, Design, measurement_line, page
from seedslib.designed.arrivals import fit_of, with_history
from seedslib.designed.base import DesignedFilter, FilterState, freeze, nan_where, require_forecast
from seedslib.designed.between import Interval, require_kind
from seedslib.designed.memory import Memory
from seedslib.designed.predictors import Affine, AffineFit, Continuous, Polynomial
from seedslib.designed.program import DesignedProgram
from seedslib.linearization.moments import Linearization, Moments
from seedslib.models.kinds import AnySystem


class Start(NamedTuple):
    """Moments for the first estimate, which is the best affine one in Y_0.

    Attributes
    ----------
    mean, cov : ndarray, shapes (n,) and (n, n)
        Of X_0.
    moments : Moments
        Of Y_0, with cov(X_0, Y_0).
    """

    mean: np.ndarray
    cov: np.ndarray
    moments: Moments

    def moments_for(self, depth: int) -> Moments:
        """The moments of Y_0, shaped for `depth` batch axes."""
        mean = self.moments.mean.reshape(-1, *(1,) * depth)
        return self.moments._replace(mean=mean)


@dataclass(frozen=True)
class Rules:
    """The steps of a filter that its design and its run share.

    Attributes
    ----------
    memory : Memory
    components : int
        n'.
    sensor : callable
        Moments of the measurement.
    velocity : callable, or None
        E b(t, X) of a continuous forecast, see `_mean_velocity`.
    periods : tuple
        Components of a measurement on a circle.
    """

    memory: Memory
    components: int
    sensor: Callable[..., Moments]
    velocity: Callable[..., Any] | None = None
    periods: Periods = ()

    @classmethod
    def of(
        cls,
        system: AnySystem,
        memory: Memory,
        predictor: Affine | Polynomial | Continuous,
        linearization: Linearization,
        components: int,
    ) -> Rules:
        """Rules of a filter; the moment functions are compiled here."""
        velocity = None
        if isinstance(predictor, Continuous):
            velocity = _mean_velocity(system, linearization)
        sensor = linearization.moments(system.sensor)
        return cls(memory, components, sensor, velocity, system.sensor.period)

    def first(
        self,
        state: FilterState,
        t: float,
        y: np.ndarray,
        p: Values,
        start: Start,
        covariance: bool = True,
    ) -> FilterState:
        """State after the first measurement, whose moments are fixed."""
        moments = start.moments_for(state.mean.ndim - 1)
        return self._corrected(state, t, y, p, moments, covariance, start.mean)

    def correct(
        self, state: FilterState, t: float, y: np.ndarray, p: Values, covariance: bool = True
    ) -> FilterState:
        """State after a measurement, from the forecast; its covariance where that is wanted."""
        moments = self.sensor(t, state.mean, state.cov, p)
        return self._corrected(state, t, y, p, moments, covariance, state.mean)

    def _corrected(self, state, t, y, p, moments, covariance, mean):
        if self.periods:
            y = nearest(y, moments.mean, self.periods)
        n = self.components
        estimate, cov, loglik = update(
            state.mean[:n],
            state.cov[:n, :n] if covariance else None,
            y,
            (moments.mean, moments.cross[:n], moments.cov),
            noise=lambda: self.sensor(t, mean, np.zeros_like(state.cov), p).cov,
        )
        # a missing measurement is remembered as what was expected
        missing = np.isnan(y)
        remembered = np.where(missing, moments.mean, y) if missing.any() else y
        past = self.memory.push(state.past, estimate=estimate, measurement=remembered)
        return state._replace(mean=estimate, cov=cov, past=past, loglik=loglik, corrected=True)

    @np.errstate(over="ignore", invalid="ignore")  # diverged paths show as NaN
    def move(self, fit: AffineFit, t: float, step: float, z: np.ndarray, p: Values) -> np.ndarray:
        """Euler step of the continuous forecast, dZ/dt = E b'(t, X) given Z."""
        moved = np.empty_like(z)
        rates = self.velocity(t, list(fit.mean(z)), fit.cov, p)[: self.components]
        for k, rate in enumerate(rates):
            moved[k] = z[k] + rate * step
        return moved


def _mean_velocity(system: AnySystem, linearization: Linearization) -> Callable[..., Any]:
    """E b(t, X) for X ~ N(mean, cov), as ``f(t, mean components, cov, p) -> components``.

    The covariance is common to all paths, (n, n).
    """
    if not hasattr(linearization, "formulas"):
        moments = linearization.moments(system.drift_map, spread=False)
        return lambda t, mean, cov, p: list(moments(t, np.stack(mean), cov, p).mean)
    from seedslib.models.codegen import compile_components

    n = system.state_size
    mean, lower, cov = gaussian_symbols(n)
    velocity = linearization.formulas(system.drift_map, list(mean), cov, spread=False)[0]
    evaluate = compile_components((system.time, mean, lower, system.parameters), list(velocity))
    rows, columns = np.tril_indices(n)
    return lambda t, mean, cov, p: evaluate(t, mean, cov[rows, columns].tolist(), p)


def gaussian_symbols(n: int) -> tuple[Any, ...]:
    """Symbols of a mean, of a covariance on and below the diagonal, and that covariance (n, n)."""
    import sympy

    mean = sympy.symbols(f"m:{n}", cls=sympy.Dummy, real=True)
    lower = sympy.symbols(f"P:{n * (n + 1) // 2}", cls=sympy.Dummy, real=True)
    return mean, lower, sympy.Matrix(symmetric(np.array(lower, dtype=object), n))


@dataclass(frozen=True, eq=False, repr=False)
class FiniteOrderFilter(DesignedFilter):
    """A designed filter of finite order; `seedslib.design.synthesize` makes it.

    At measurement k the state is forecast from the memory, Lambda_k = Gamma_k U_{k-1} + kappa_k
    with covariance T_k, and corrected by the lines that every filter uses; the first n'
    components are the estimate Z_k, which is pushed on the memory. Equations (6.2).

    Attributes
    ----------
    system : JumpDiffusion or DiscreteSystem
    memory : Memory
    predictor : Affine, Polynomial or Continuous
    linearization : Linearization
    times : ndarray, shape (K+1,)
        Times of the measurements.
    node_times : tuple of ndarray, length K
        Nodes within each interval.
    components : int
        n': the first components of the state are estimated.
    start : Start
    fits : tuple of AffineFit or PolynomialFit, length K
        Of ClassFits where there is an availability.
    node_fits : tuple of tuple of AffineFit
        Forecasts Z_k^i; for `Continuous` the fits at the start of each integration step.
    predicted : Accuracy
    design : Design
    between : str
        Kind of the forecasts between measurements, see `seedslib.designed.between.at`.
    held_out : Accuracy, optional
    cycle : int
    measured, availability : ndarray, optional
        See `DesignedFilter`.
    rules : Rules
        The compiled steps.
    """

    takes = ("covariances",)
    alone = True  # one record runs without a batch axis, which is twice as fast

    system: Any
    memory: Memory
    predictor: Affine | Polynomial | Continuous
    linearization: Linearization
    times: np.ndarray
    node_times: tuple[np.ndarray, ...]
    components: int
    start: Start
    fits: tuple[Any, ...]
    node_fits: tuple[Any, ...]
    predicted: Accuracy
    design: Design
    between: str = "interpolated"
    held_out: Accuracy | None = None
    cycle: int = 0
    measured: MaybeArray = None
    availability: MaybeArray = None

    def __post_init__(self) -> None:
        require_kind("between", self.between)
        self.check()
        as_count("components", self.components, 1, len(self.start.mean))
        self.check_fits(self.components, len(self.start.moments.mean))
        if self.cycle and self.availability is not None:
            raise ValueError("cycle: wanted 0 with an availability")
        vars(self).update(clock=Clock(self.times))
        _ = self.rules  # a linearization without formulas is refused now
        freeze((self.times, self.node_times, self.measured, self.availability, self.start))
        freeze((self.predicted, self.held_out, self.fits, self.node_fits))

    @cached_property
    def rules(self) -> Rules:
        """The compiled steps."""
        return Rules.of(
            self.system, self.memory, self.predictor, self.linearization, self.components
        )

    @property
    def order(self) -> int:
        """Dimension of the memory when it is full: l n' for the large-order filter."""
        return self.memory.order(self.components, self.system.sensor.size)

    # Step by step

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> FilterState:
        """State before any measurement; the filter draws nothing from `seed`."""
        mean = self.start.mean.reshape(-1, *(1,) * len(batch))
        mean = np.broadcast_to(mean, (len(mean), *batch)).copy()
        return FilterState(-1, mean, self.start.cov, loglik=0.0)

    def propagate(
        self, state: FilterState, t: float, p: Values, interval: Interval | None = None
    ) -> FilterState:
        """The forecast of the whole state for the next measurement; the first is the prior."""
        k = state.index + 1
        if k == 0:
            return state._replace(index=0)
        if self.rules.velocity is None:
            u = state.past.vector
        else:  # the estimate has moved on
            u = (interval or self.interval(state, p, with_before=False)).values[-1]
        mean, cov = fit_of(self.fits[self.served(k) - 1], state.history).forecast(u)
        before = state._replace(before=None)
        return state._replace(
            index=k, mean=mean, cov=cov, loglik=0.0, before=before, corrected=False
        )

    def update(
        self,
        state: FilterState,
        y: np.ndarray,
        p: Values,
        indicator: MaybeArray = None,
        covariance: bool = True,
    ) -> FilterState:
        """The state after a measurement, with its covariance where that is wanted."""
        t = self.clock.moment(state.index, self.cycle)
        if state.index == 0:
            state = self.rules.first(state, t, y, p, self.start, covariance)
        else:
            state = self.rules.correct(state, t, y, p, covariance)
        return state if self.availability is None else with_history(self, state, y)

    def expect(self, state: FilterState, inputs: Mapping[Any, Any] | None = None) -> Moments:
        """Moments of the measurement that a forecast expects; after a gap the mean alone.

        Raises
        ------
        ValueError
            A state without a forecast.
        """
        require_forecast(state)
        if state.index == 0:
            return self.start.moments_for(state.mean.ndim - 1)
        t = self.clock.moment(state.index, self.cycle)
        p = self.values(inputs)
        mean, cross, cov = self.rules.sensor(t, state.mean, state.cov, p)
        return Moments(mean, nan_where(state.gap, cross), nan_where(state.gap, cov))

    def ahead(self, state: FilterState, row: int, p: Values) -> list[np.ndarray]:
        """Estimates at the nodes of an interval and at its end; Euler's steps if continuous."""
        fits = self.node_fits[row] if self.node_fits else ()
        if self.rules.velocity is None:
            values = [fit_of(fit, state.history).mean(state.past.vector) for fit in fits]
            last = fit_of(self.fits[row], state.history).mean(state.past.vector)
            return [*values, last[: self.components]]
        start, end = (self.clock.moment(state.index + k, self.cycle) for k in (0, 1))
        stops = [start, *(self.node_times[row] + (start - self.times[row])), end]
        values = [state.mean]
        for fit, (t, after) in zip(fits, pairwise(stops), strict=True):
            values.append(self.rules.move(fit, t, after - t, values[-1], p))
        return values[1:]

    def program(self, **options: Any) -> DesignedProgram:
        """See `Filter.program`; forecasts must be affine or polynomial, and not by classes."""
        from seedslib.designed.memory_programs import finite_order

        step = DesignedProgram(self, **options)
        finite_order(step)
        return step

    def __repr__(self) -> str:
        rules = f"{self.predictor}; {self.linearization}"
        return f"<FiniteOrderFilter of order {self.order}: {self.memory}; {rules}>"

    def __str__(self) -> str:
        return page(
            self,
            f"Finite-order filter of order {self.order}: {self.memory}",
            f"forecasts    {self.predictor}; {self.between} between measurements",
            f"corrections  {self.linearization}",
            f"estimates    {self.components} of {len(self.start.mean)} state components",
            measurement_line(self),
        )
