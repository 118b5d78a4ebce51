"""Finite-order filter: designed offline, it runs on a frozen table of forecasts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_count
from seedslib.base.circle import Periods, nearest
from seedslib.base.clock import Clock
from seedslib.base.conditioning import update
from seedslib.base.linalg import symmetric
from seedslib.base.values import Values
from seedslib.designed.base import freeze, nan_where, want_corrected, want_forecast, want_next
from seedslib.designed.between import BetweenFilter, known_kind
from seedslib.designed.checks import check_covariances, check_nodes, check_start, check_verbs
from seedslib.designed.memory import Memory, Past
from seedslib.designed.patterns import PatternFit, chosen, loose, pattern_ways, regrouped
from seedslib.designed.prediction import Design, HeldOut, Prediction, page, span
from seedslib.designed.predictors import AffineFit, Continuous, PolynomialFit
from seedslib.filters.base import Estimates
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


class FiniteOrderState(NamedTuple):
    """What the filter remembers.

    Attributes
    ----------
    index : int
        Number k of the last measurement time reached; -1 before the first.
    mean : ndarray
        After `predict` the forecast of the whole state, (n, *batch); after `correct` the
        estimate Z_k, (n', *batch).
    cov : ndarray or None
        Its covariance as the filter sees it, with or without batch axes.
    past : Past
        The memory U_k; after `predict` still U_{k-1}.
    loglik : ndarray
        Log-density of the last measurement as forecast by the filter.
    before : FiniteOrderState or None
        The state after the measurement before the last, needed by linear forecasts.
    corrected : bool
        Whether the measurement at `index` was taken in.
    gap : ndarray of bool, shape (*batch), or False
        Whether something that the design does not know of has been missing so far.
    group : ndarray of int, shape (*batch), or 0
        Class of what has arrived so far, see `seedslib.designed.patterns`.
    """

    index: int
    mean: np.ndarray
    cov: MaybeArray
    past: Past
    loglik: np.ndarray | float
    before: object
    corrected: bool
    gap: np.ndarray | bool = False
    group: np.ndarray | int = 0


@dataclass(frozen=True)
class Rules:
    """The steps of a filter that its design and its run share."""

    memory: Memory
    components: int
    sensor: object
    velocity: object = None
    periods: Periods = ()

    @classmethod
    def of(
        cls,
        system: AnySystem,
        memory: Memory,
        predictor: Any,
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
        state: FiniteOrderState,
        t: float,
        y: np.ndarray,
        p: Values,
        start: Start,
        spread: bool = True,
    ) -> FiniteOrderState:
        """State after the first measurement, whose moments are fixed."""
        moments = _first_moments(start, state.mean.ndim - 1)
        return self._corrected(state, t, y, p, moments, spread, start.mean)

    def correct(
        self, state: FiniteOrderState, t: float, y: np.ndarray, p: Values, spread: bool = True
    ) -> FiniteOrderState:
        """State after the measurement; its `mean` and `cov` hold the forecast before.

        Without `spread` no covariance is formed.
        """
        moments = self.sensor(t, state.mean, state.cov, p)
        return self._corrected(state, t, y, p, moments, spread, state.mean)

    def _corrected(self, state, t, y, p, moments, spread, place):
        y = nearest(y, moments.mean, self.periods)
        c = self.components
        mean, cov, loglik = update(
            state.mean[:c],
            state.cov[:c, :c] if spread else None,
            y,
            moments._replace(cross=moments.cross[:c]),
            noise=lambda: self.sensor(t, place, np.zeros_like(state.cov), p).cov,
        )
        # a missing measurement is remembered as what was expected
        missing = np.isnan(y)
        remembered = np.where(missing, moments.mean, y) if missing.any() else y
        past = self.memory.push(state.past, estimate=mean, measurement=remembered)
        return state._replace(mean=mean, cov=cov, past=past, loglik=loglik, corrected=True)

    def nodes(
        self, fits: Sequence[AffineFit], stops: Sequence[float], state: FiniteOrderState, p: Values
    ) -> tuple[list[np.ndarray], np.ndarray | None]:
        """Estimates at the nodes of an interval, and at its end where they lead there.

        Parameters
        ----------
        fits : tuple of AffineFit
            Forecasts for the nodes; of a continuous forecast those at the start of each step.
        stops : sequence of float
            Start of the interval, its nodes, its end.
        state : FiniteOrderState
        p : tuple
            Numbers of the parameters.
        """
        if self.velocity is None:
            return [chosen(fit, state.group).mean(state.past.vector) for fit in fits], None
        moved, z = [], state.mean
        for fit, t, after in zip(fits, stops, stops[1:], strict=False):
            z = self.move(fit, t, after - t, z, p)
            moved.append(z)
        return moved[: len(stops) - 2], moved[-1]

    def move(self, fit: AffineFit, t: float, h: float, z: np.ndarray, p: Values) -> np.ndarray:
        """Euler step of the continuous forecast, dZ/dt = E b'(t, X) given Z."""
        with np.errstate(over="ignore", invalid="ignore"):
            mean, moved = fit.mean(z), np.empty_like(z)
            rates = self.velocity(t, list(mean), fit.cov, p)
            for k, rate in enumerate(rates[: self.components]):
                moved[k] = z[k] + rate * h
        return moved


def _first_moments(start, depth):
    """Moments of the first measurement, shaped for `depth` batch axes."""
    return start.moments._replace(mean=start.moments.mean.reshape(-1, *(1,) * depth))


def _mean_velocity(system: AnySystem, linearization: Linearization) -> Callable[..., Any]:
    """E b(t, X) for X ~ N(mean, cov), as ``f(t, mean components, cov, p) -> components``.

    The covariance is common to all paths, (n, n).
    """
    if not (system.symbolic and hasattr(linearization, "formulas")):
        moments = linearization.moments(system.drift_map, spread=False)
        return lambda t, mean, cov, p: list(moments(t, np.stack(mean), cov, p).mean)
    from seedslib.models.codegen import compile_components

    n = system.state_size
    mean, lower, cov = law_symbols(n)
    velocity = linearization.formulas(system.drift_map, list(mean), cov, spread=False)[0]
    evaluate = compile_components((system.time, mean, lower, system.parameters), list(velocity))
    rows, columns = np.tril_indices(n)
    return lambda t, mean, cov, p: evaluate(t, mean, cov[rows, columns].tolist(), p)


def law_symbols(n: int) -> tuple[Any, ...]:
    """Symbols of a mean, of a covariance on and below the diagonal, and that covariance (n, n)."""
    import sympy

    mean = sympy.symbols(f"m:{n}", cls=sympy.Dummy, real=True)
    lower = sympy.symbols(f"P:{n * (n + 1) // 2}", cls=sympy.Dummy, real=True)
    return mean, lower, sympy.Matrix(symmetric(np.array(lower, dtype=object), n))


@dataclass(frozen=True, eq=False, repr=False)
class FiniteOrderFilter(BetweenFilter):
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
        With an availability of PatternFit.
    node_fits : tuple of tuple of AffineFit
        Forecasts Z_k^i; for `Continuous` the fits at the start of each integration step.
    predicted : Prediction
    design : Design
    between : str
        Kind of the forecasts between measurements, see `seedslib.designed.between.at`.
    held_out : HeldOut, optional
    cycle : int
    measured, availability : ndarray, optional
        See `DesignedFilter`.
    rules : Rules
        The compiled steps.
    clock : Clock
        The measurement times, and what else is one of them.
    """

    takes = ("covariances",)
    alone = True  # one record runs without a batch axis, which is twice as fast

    system: Any
    memory: Memory
    predictor: Any
    linearization: Linearization
    times: np.ndarray
    node_times: tuple[np.ndarray, ...]
    components: int
    start: Start
    fits: tuple[Any, ...]
    node_fits: tuple[Any, ...]
    predicted: Prediction
    design: Design
    between: str = "interpolated"
    held_out: HeldOut | Any = None
    cycle: int = 0
    measured: MaybeArray = None
    availability: MaybeArray = None

    def __post_init__(self) -> None:
        self.check_shapes()
        _ = self.rules  # what has no formulas is refused now
        known_kind("between", self.between)
        freeze((self.times, self.node_times, self.measured, self.availability, self.start))
        freeze((self.predicted, self.held_out, self.fits, self.node_fits))
        object.__setattr__(self, "clock", Clock(self.times))
        object.__setattr__(self, "ways", pattern_ways(self.fits, self.cycle))

    @cached_property
    def rules(self) -> Rules:
        return Rules.of(
            self.system, self.memory, self.predictor, self.linearization, self.components
        )

    @property
    def evaluated(self) -> frozenset[Any]:
        """See `BetweenFilter.evaluated`."""
        continuous = isinstance(self.predictor, Continuous)
        maps = [self.system.sensor, *([self.system.drift_map] if continuous else [])]
        return frozenset(p for map in maps for p in map.mentions)

    def check_parts(self) -> None:
        """First estimate, nodes and forecasts, held against memory and times."""
        start, memory, components = self.start, self.memory, self.components
        (n, m), intervals = check_start("start", start), len(self.times) - 1
        as_count("components", components, 1, n)
        check_covariances("start", (start.cov, start.moments.cov))
        if len(self.fits) != intervals:
            raise ValueError(f"fits: wanted {intervals}, got {len(self.fits)}")
        check_nodes(self, intervals)
        sizes = [memory.dimension(k, components, m) for k in range(intervals)]
        continuous = isinstance(self.predictor, Continuous)
        targets = n if continuous else components
        regressions = [(f"fits[{k}]", fit, n, sizes[k]) for k, fit in enumerate(self.fits)]
        for k, (grid, fits) in enumerate(zip(self.node_times, self.node_fits, strict=True)):
            if len(fits) != len(grid) + continuous:
                raise ValueError(
                    f"node_fits[{k}]: wanted {len(grid) + continuous}, got {len(fits)}"
                )
            regressions += [
                (f"node_fits[{k}][{i}]", fit, targets, sizes[k]) for i, fit in enumerate(fits)
            ]
        if self.availability is None:
            check_verbs([row[:2] for row in regressions], "forecast")
            kinds = AffineFit | PolynomialFit
        else:
            kinds, patterns = PatternFit, 2 ** len(loose(self.availability))
            for name, fit, *_ in regressions:
                if not isinstance(fit, PatternFit) or fit.table.shape[1:] != (patterns,):
                    raise ValueError(f"{name}: wanted classes of {patterns} patterns")
        known = [row for row in regressions if isinstance(row[1], kinds)]
        for name, fit, *wanted in known:
            fit.check(name, *wanted)
        check_covariances("fits", [fit.cov for _, fit, *_ in known])

    @property
    def order(self) -> int:
        """Dimension of the memory when it is full: l n' for the large-order filter."""
        return self.memory.order(self.components, self.system.sensor.size)

    # Step by step

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> FiniteOrderState:
        """State before any measurement; the filter draws nothing from `seed`."""
        mean = self.start.mean.reshape(-1, *(1,) * len(batch))
        mean = np.broadcast_to(mean, (len(mean), *batch)).copy()
        return FiniteOrderState(-1, mean, self.start.cov, Past(), 0.0, None, False)

    def predict(
        self, state: FiniteOrderState, t: float, *, inputs: Mapping[Any, Any] | None = None
    ) -> FiniteOrderState:
        """Forecast for the next measurement time, (n, *batch); the first has none to make.

        Raises
        ------
        ValueError
            Not the next measurement time of the design, or no more of them.
        """
        want_next(self.clock, state.index + 1, t, self.cycle)
        if state.index >= 0:
            want_corrected(state)
        return self.advanced(state, self.values(inputs))

    def advanced(
        self, state: FiniteOrderState, p: Values, interval: Any = None
    ) -> FiniteOrderState:
        """The forecast for the next measurement, from what is known of the interval if anything."""
        k = state.index + 1
        if k == 0:
            return state._replace(index=0)
        if self.rules.velocity is None:
            u = state.past.vector
        else:  # the estimate has moved on
            u = interval.values[-1] if interval else self.nodes_after(k - 1, state, p)[1]
        mean, cov = chosen(self.fits[self.served(k) - 1], state.group).forecast(u)
        before = state._replace(before=None)
        return state._replace(
            index=k, mean=mean, cov=cov, loglik=0.0, before=before, corrected=False
        )

    def correct(
        self, state: FiniteOrderState, y: ArrayLike, *, inputs: Mapping[Any, Any] | None = None
    ) -> FiniteOrderState:
        """Correct the forecast by y, (m, *batch); of NaN components see `run`.

        Raises
        ------
        TypeError, ValueError
            A state without a forecast, a wrong shape, an infinite measurement.
        """
        want_forecast(state)
        y, _, gap = self.admitted(y, None, state.mean.shape[1:], state.index)
        gap = state.gap | gap
        found = self.corrected(state, y, self.values(inputs))
        if not np.any(gap):
            return found
        loglik = np.where(state.gap, np.nan, found.loglik)
        return found._replace(cov=nan_where(gap, found.cov), loglik=loglik, gap=gap)

    def corrected(
        self,
        state: FiniteOrderState,
        y: np.ndarray,
        p: Values,
        indicator: MaybeArray = None,
        covariance: bool = True,
    ) -> FiniteOrderState:
        """The state after a measurement, with its covariance where that is wanted."""
        t = self.clock.moment(state.index, self.cycle)
        if state.index == 0:
            found = self.rules.first(state, t, y, p, self.start, covariance)
        else:
            found = self.rules.correct(state, t, y, p, covariance)
        return found if self.ways is None else regrouped(self, found, y)

    def expect(self, state: FiniteOrderState, inputs: Mapping[Any, Any] | None = None) -> Moments:
        """Moments of the measurement that a forecast expects; after a gap the mean alone.

        Raises
        ------
        ValueError
            A state without a forecast.
        """
        want_forecast(state)
        if state.index == 0:
            return _first_moments(self.start, state.mean.ndim - 1)
        t = self.clock.moment(state.index, self.cycle)
        p = self.values(inputs)
        mean, cross, cov = self.rules.sensor(t, state.mean, state.cov, p)
        return Moments(mean, nan_where(state.gap, cross), nan_where(state.gap, cov))

    def nodes(
        self, state: FiniteOrderState, p: Values, end: bool = True
    ) -> tuple[list, list, tuple | None]:
        """Times and estimates to the last node after a correction, and the next measurement's."""
        k, row = state.index, self._row(state.index)
        start = self.clock.moment(k, self.cycle)
        grid, values, last = [start], [state.mean], None
        if row < len(self.node_times) and (end or len(self.node_times[row])):
            found, last = self.nodes_after(k, state, p)
            stops = self.node_times[row] + (start - self.times[row])
            grid, values = [*grid, *stops], values + found
        if not end or row >= len(self.fits):
            return grid, values, None
        if last is None:
            last = chosen(self.fits[row], state.group).mean(state.past.vector)[: self.components]
        return grid, values, (self.clock.moment(k + 1, self.cycle), last)

    def _row(self, k: int) -> int:
        """Number of the interval of the design that serves the one after measurement k."""
        return self.served(k + 1) - 1 if self.cycle else k

    def nodes_after(
        self, k: int, state: FiniteOrderState, p: Values
    ) -> tuple[list[np.ndarray], np.ndarray | None]:
        """Estimates at the nodes after measurement k, and at the next one; see `Rules.nodes`.

        The second is None where the nodes do not lead there.
        """
        row, clock = self._row(k), self.clock
        start, end = clock.moment(k, self.cycle), clock.moment(k + 1, self.cycle)
        stops = [start, *self.node_times[row] + (start - self.times[row]), end]
        return self.rules.nodes(self.node_fits[row], stops, state, p)

    def parts(self, chosen: list[int]) -> dict[str, Any]:
        """Forecasts of the chosen steps."""
        return {"fits": tuple(self.fits[k - 1] for k in chosen[1:])}

    # Whole records

    def sizes(self, covariances: bool) -> Estimates:
        """Shapes of what is found at each time."""
        n = self.components
        return Estimates((n,), (n, n) if covariances else None, None, ())

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
            span(self),
        )
