"""Finite-order filter: designed offline, it runs on a frozen table of forecasts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_count
from seedslib.base.clock import Clock
from seedslib.base.objects import by_fields
from seedslib.base.values import Course
from seedslib.designed.between import BetweenFilter, at, known_kind
from seedslib.designed.finite_order_rules import FiniteOrderState, Rules, Start, initial_moments
from seedslib.designed.gaps import step_unclaimed, unexpected
from seedslib.designed.guards import freeze, want_corrected, want_forecast, want_next
from seedslib.designed.memory import Memory, Past
from seedslib.designed.patterns import PatternFit, chosen, pattern_ways, regrouped
from seedslib.designed.prediction import Design, HeldOut, Prediction, finite_order_page, headline
from seedslib.designed.predictors import AffineFit, Continuous, PolynomialFit
from seedslib.designed.shapes import check_covariances, check_nodes, check_start, check_verbs
from seedslib.filters.base import Estimates
from seedslib.linearization.moments import Linearization, Moments


@dataclass(frozen=True, eq=False, repr=False)
class FiniteOrderFilter(BetweenFilter):
    """A designed filter of finite order; `seedslib.design.synthesize` makes it.

    At measurement k the state is forecast from the memory, Lambda_k = Gamma_k U_{k-1} + kappa_k
    with covariance T_k, and corrected by the lines that every filter uses; the first n'
    components are the estimate Z_k, which is pushed on the memory. Equations (6.2).

    Attributes
    ----------
    system : JumpDiffusion
    memory : Memory
    predictor : Affine, Polynomial or Continuous
    linearization : Linearization
    times : ndarray, shape (K+1,)
        Times of the measurements.
    node_times : tuple of ndarray
        Nodes within each interval, and after the last measurement where a horizon was given.
    components : int
        n': the first components of the state are estimated.
    start : Start
    fits : tuple of AffineFit or PolynomialFit, length K
    node_fits : tuple of tuple of AffineFit
        Forecasts Z_k^i; for `Continuous` the fits at the start of each integration step.
    predicted : Prediction
    design : Design
    measured_nodes : bool
        Whether Z_k^i also looks at Y_k directly (remark 1 of the paper).
    between : str
        Kind of the forecasts between measurements, see `seedslib.designed.between.at`.
    held_out : HeldOut, optional
    cycle : int
    measured, availability : ndarray, optional
        See `DesignedFilter`.
    rules : Rules
        The compiled steps; made from the other fields.
    clock : Clock
        The measurement times, and what else is one of them.
    """

    takes = ("covariances",)
    alone = True  # one record goes through compiled lines for plain numbers

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
    measured_nodes: bool = False
    between: str = "interpolated"
    held_out: HeldOut | Any = None
    cycle: int = 0
    measured: MaybeArray = None
    availability: MaybeArray = None
    rules: Rules | None = None

    def __post_init__(self) -> None:
        self.check_shapes()
        if self.rules is None:
            rules = Rules.of(
                self.system, self.memory, self.predictor, self.linearization, self.components,
                self.measured_nodes,
            )  # fmt: skip
            object.__setattr__(self, "rules", rules)
        known_kind("between", self.between)
        freeze((self.times, self.node_times, self.measured, self.availability, self.start))
        freeze((self.predicted, self.held_out, self.fits, self.node_fits))
        end = None if self.cycle else self.horizon
        object.__setattr__(self, "clock", Clock(self.times, end))
        object.__setattr__(self, "ways", pattern_ways(self.fits, self.cycle))

    def check_parts(self) -> None:
        """First estimate, nodes and forecasts, held against memory and times."""
        start, memory, components = self.start, self.memory, self.components
        (n, m), intervals = check_start("start", start), len(self.times) - 1
        as_count("components", components, 1, n)
        check_covariances("start", (start.cov, start.moments.cov))
        if len(self.fits) != intervals:
            raise ValueError(f"fits: wanted {intervals}, got {len(self.fits)}")
        check_nodes(self, intervals, intervals + 1)
        sizes = [memory.dimension(k, components, m) for k in range(intervals + 1)]
        extra = m if self.measured_nodes and not memory.measurements else 0
        continuous = isinstance(self.predictor, Continuous)
        targets = n if continuous else components
        regressions = [(f"fits[{k}]", fit, n, sizes[k]) for k, fit in enumerate(self.fits)]
        for k, (grid, fits) in enumerate(zip(self.node_times, self.node_fits, strict=True)):
            count = len(grid) + (continuous and k < intervals)
            if len(fits) != count:
                raise ValueError(f"node_fits[{k}]: wanted {count}, got {len(fits)}")
            size = sizes[k] + extra
            regressions += [
                (f"node_fits[{k}][{i}]", fit, targets, size) for i, fit in enumerate(fits)
            ]
        verb = "forecast" if self.availability is None else "one"
        check_verbs([row[:2] for row in regressions], verb)
        kinds = AffineFit | PolynomialFit if self.availability is None else PatternFit
        known = [row for row in regressions if isinstance(row[1], kinds)]
        for name, fit, *wanted in known:
            fit.check(name, *wanted)
        check_covariances("fits", [fit.cov for _, fit, *_ in known])

    @property
    def order(self) -> int:
        """Dimension of the memory when it is full: l n' for the large-order filter."""
        return self.memory.order(self.components, self.system.sensor.size)

    @property
    def horizon(self) -> float:
        """Last time the filter can forecast."""
        if self.cycle:
            return np.inf
        tail = self.node_times[len(self.fits) :]
        return float(tail[0][-1] if tail else self.times[-1])

    def __reduce__(self) -> tuple:
        return by_fields(self, rules=None)  # what was compiled is compiled again elsewhere

    # Step by step

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> FiniteOrderState:
        """State before any measurement; the filter draws nothing from `seed`."""
        mean = self.start.mean.reshape(-1, *(1,) * len(batch))
        mean = np.broadcast_to(mean, (len(mean), *batch)).copy()
        return FiniteOrderState(-1, mean, self.start.cov, Past(), None, 0.0, None, False)

    def predict(self, state: FiniteOrderState, t: float) -> FiniteOrderState:
        """Forecast for the next measurement time, (n, *batch); the first has none to make.

        Raises
        ------
        ValueError
            Not the next measurement time of the design, or no more of them.
        """
        return self._predict(state, t)

    def _predict(self, state, t, interval=None):
        k = state.index + 1
        want_next(self.clock, k, t, self.cycle)
        if k == 0:
            return state._replace(index=0)
        want_corrected(state)
        if self.rules.velocity is None:
            u = state.past.vector
        else:  # the estimate has moved on
            u = interval.values[-1] if interval else self.nodes_after(k - 1, state)[1]
        mean, cov = chosen(self.fits[self.served(k) - 1], state.group).forecast(u)
        before, seen = state._replace(before=None), state.measurement
        return FiniteOrderState(
            k, mean, cov, state.past, seen, 0.0, before, False, state.gap, state.group
        )

    def correct(self, state: FiniteOrderState, y: ArrayLike) -> FiniteOrderState:
        """Correct the forecast by y, (m, *batch); of NaN components see `run`.

        Raises
        ------
        TypeError, ValueError
            A state without a forecast, a wrong shape, an infinite measurement.
        """
        y, _, gap = self.admitted(y, None, state.mean.shape[1:], state.index)
        return step_unclaimed(self._correct(state, y, True), state, gap)

    def _correct(self, state, y, spread):
        want_forecast(state)
        t = self.clock.moment(state.index, self.cycle)
        if state.index == 0:
            found = self.rules.first(state, t, y, self.start, spread)
        else:
            found = self.rules.correct(state, t, y, spread)
        return found if self.ways is None else regrouped(self, found, y)

    def expect(self, state: FiniteOrderState) -> Moments:
        """Moments of the measurement that a forecast expects; after a gap the mean alone.

        Raises
        ------
        ValueError
            A state without a forecast.
        """
        want_forecast(state)
        if state.index == 0:
            return initial_moments(self.start.moments, state.mean.ndim - 1)
        t = self.clock.moment(state.index, self.cycle)
        moments = self.rules.sensor(t, state.mean, state.cov)
        return unexpected(moments, state)

    def nodes(self, state: FiniteOrderState, end: bool = True) -> tuple[list, list, tuple | None]:
        """Times and estimates to the last node after a correction, and the next measurement's."""
        k, row = state.index, self._row(state.index)
        start = self.clock.moment(k, self.cycle)
        grid, values, last = [start], [state.mean], None
        if row < len(self.node_times) and (end or len(self.node_times[row])):
            found, last = self.nodes_after(k, state)
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
        self, k: int, state: FiniteOrderState
    ) -> tuple[list[np.ndarray], np.ndarray | None]:
        """Estimates at the nodes after measurement k, and at the next one; see `Rules.nodes`.

        The second is None where the nodes do not lead there.
        """
        row, clock = self._row(k), self.clock
        start = clock.moment(k, self.cycle)
        nodes = self.node_times[row] + (start - self.times[row])
        end = clock.moment(k + 1, self.cycle) if row < len(self.fits) else nodes[-1]
        return self.rules.nodes(self.node_fits[row], [start, *nodes, end], state)

    def parts(self, chosen: list[int]) -> dict[str, Any]:
        """Forecasts of the chosen steps."""
        return {"fits": tuple(self.fits[k - 1] for k in chosen[1:])}

    # Whole records

    def sizes(self, covariances: bool) -> Estimates:
        """Shapes of what is found at each time."""
        n = self.components
        return Estimates((n,), (n, n) if covariances else None, None, ())

    def fill(
        self, rows: Estimates, times: np.ndarray, index: np.ndarray, y: np.ndarray,
        indicators: np.ndarray | None, held: Course,
    ) -> int:  # fmt: skip
        """Run over a block of records; covariances are formed where they are wanted."""
        state, interval, spread = self.initial(y.shape[2:]), None, rows.cov is not None
        last = 0  # row of the last measurement
        for j, (t, k) in enumerate(zip(times, index, strict=True)):
            if k < 0:
                with held.at(last):
                    interval = interval or self.interval(state)
                rows.mean[j], rows.loglik[j] = at(interval, t, self.between), 0.0
                if spread:
                    rows.cov[j] = np.nan
                continue
            if not held.values:  # steps are short here, and two contexts would be a part of them
                state = self._correct(self._predict(state, t, interval), y[j], spread)
            else:
                with held.at(last):
                    state = self._predict(state, t, interval)
                with held.at(j):
                    state = self._correct(state, y[j], spread)
            last = j
            rows.mean[j], rows.loglik[j], interval = state.mean, state.loglik, None
            if spread:
                rows.cov[j].T[...] = state.cov.T  # with or without an axis of records
        return 0

    def __repr__(self) -> str:
        return f"<FiniteOrderFilter of {headline(self)}>"

    def __str__(self) -> str:
        return finite_order_page(self)
