"""Filters of output functions: the optimal functions of theorems 1 and 2, in any form."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.clock import Clock, when
from seedslib.base.values import Course
from seedslib.designed.arrivals import Arrivals, ways
from seedslib.designed.between import BetweenFilter, at, known_kind
from seedslib.designed.guards import freeze, want_corrected, want_forecast
from seedslib.designed.memory import Memory
from seedslib.designed.outputs.lookup import Output, Step, Table, arguments, step_axes, summary
from seedslib.designed.outputs.patterns import check_patterns, classes_at
from seedslib.designed.outputs.steps import OutputState, after, arrived, found
from seedslib.designed.prediction import Design, HeldOut, Prediction
from seedslib.designed.shapes import check_array, check_nodes
from seedslib.filters.base import Estimates
from seedslib.models.kinds import switches


@dataclass(frozen=True, eq=False, repr=False)
class OutputFilter(BetweenFilter):
    """Filter whose estimate is any function of measurement and memory.

    Z_k = f_k(Y_k, U_{k-1}) and Z_k^i = g_k^i(U_k), theorem 1 of the jump-diffusion paper; with
    modes also the decided mode, iota_k(j, y, z) and g_k(j, y, z) of (3.1), (3.2) of the switching
    paper. There is no likelihood, and the covariance is the unconditional one that the design
    found, NaN from a missing measurement on.

    A missing measurement or indicator is left out, exactly for that step given the memory, by
    functions of its own. What was found is remembered like any other estimate. A design that was
    told of a schedule or an availability has functions, and covariances, for each pattern.

    Attributes
    ----------
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
    memory : Memory
        Of estimates, with their decided modes where there are modes, of measurements, or of
        both; of indicators too where it says so.
    times : ndarray, shape (K+1,)
    steps : tuple of Step, length K+1
        Output functions of each measurement.
    method : object
        How the functions were made.
    predicted : Prediction
        Accuracy; without standard errors where no random numbers were used.
    covariances : ndarray, shape (K+1, n', n')
        Error covariances that the design found.
    design : Design
    node_times : tuple of ndarray, length K or 0
        Nodes within each interval.
    node_fits : tuple of tuple of callable
        Forecasts Z_k^i, functions of the memory.
    changes : ndarray, shape (2, K+1), or None
        How far each function is from the one before: root mean square of the difference of the
        estimates, probability of another mode; NaN where the memory was still filling.
    between : str
        Kind of the forecasts between measurements, see `seedslib.designed.between.at`.
    cycle : int
        See `DesignedFilter`.
    held_out : HeldOut, optional
        Errors on paths that the design has not seen; none where it took no paths.
    measured, availability : ndarray, optional
        See `DesignedFilter`.
    arrivals : tuple of Arrivals, length K+1 or 0
        Classes of histories, where something may be missing; `ways` leads from one to the next.
    """

    system: object
    memory: Memory
    times: np.ndarray
    steps: tuple[Step, ...]
    method: object
    predicted: Prediction
    covariances: np.ndarray
    design: Design
    node_times: tuple[np.ndarray, ...] = ()
    node_fits: tuple[Any, ...] = ()
    changes: MaybeArray = None
    between: str = "interpolated"
    cycle: int = 0
    held_out: HeldOut | Any = None
    measured: MaybeArray = None
    availability: MaybeArray = None
    arrivals: tuple[Arrivals, ...] = ()
    ways: tuple[np.ndarray, ...] = field(init=False)

    def __post_init__(self) -> None:
        self.check_shapes()
        known_kind("between", self.between)
        object.__setattr__(self, "clock", Clock(self.times))
        object.__setattr__(self, "ways", ways(self.arrivals, self.cycle))
        freeze((
            self.measured, self.availability, self.arrivals, self.times, self.steps, self.changes,
            self.node_times, self.node_fits, self.covariances, self.predicted, self.held_out,
        ))  # fmt: skip

    def check_parts(self) -> None:
        """Tables; functions of one's own are taken as they are, and learned ones have no axes."""
        steps, n, m = len(self.times), self.components, self.system.measurement_size
        if len(self.steps) != steps:
            raise ValueError(f"steps: wanted {steps}, got {len(self.steps)}")
        check_array("covariances", self.covariances, steps, n, n)
        if self.changes is not None:
            check_array("changes", self.changes, 2, steps, finite=False)
        check_nodes(self, steps - 1)
        check_patterns(self)
        axes = [
            step_axes(self.system, self.memory, (None,) * m, (None,) * n, k, classes_at(self, k))
            for k in range(steps + 1)
        ]
        tables = [
            (f"steps[{k}].{place}", table, wanted)
            for k, step in enumerate(self.steps)
            for place, table, wanted in zip(Step._fields, step, axes[k], strict=True)
        ] + [
            (f"node_fits[{k}]", fit, axes[k + 1][1])
            for k, fits in enumerate(self.node_fits)
            for fit in fits
        ]
        for name, table, wanted in tables:
            if isinstance(table, Table):
                table.check(name, wanted, n, getattr(self.system, "modes", 0), self.memory)

    @property
    def components(self) -> int:
        """n': how many state components are estimated."""
        return self.covariances.shape[1]

    @property
    def order(self) -> int:
        """Numbers that are remembered, modes and indicators included: l (n' + 1) for FBP."""
        memory = self.memory
        numbers = memory.order(self.components, self.system.measurement_size)
        return numbers + memory.estimates * switches(self.system) + memory.indicators

    @property
    def horizon(self) -> float:
        """Last time the filter can forecast."""
        return np.inf if self.cycle else float(self.times[-1])

    @property
    def made(self) -> str:
        """How the functions were made."""
        return str(self.method)

    def output(self, k: int, y: ArrayLike, u: ArrayLike) -> Output:
        """What is found at measurement k, from arguments whose batch axes broadcast.

        Parameters
        ----------
        k : int
        y, u : array_like, shapes (m, *batch) and (d, *batch)
            The measurement, below the indicator where there is one; the memory, empty at k = 0.
        """
        return self.steps[k].shown([*y, *u])

    # Step by step

    def initial(self, batch: tuple[int, ...] = (), seed: Any = None) -> OutputState:
        """State before any measurement; the filter draws nothing from `seed`."""
        return OutputState(-1, None, np.full((self.components, *batch), np.nan))

    def predict(self, state: OutputState, t: float) -> OutputState:
        """Forecast for the next measurement time.

        Raises
        ------
        ValueError
            Another time than the next, a state that was not corrected.
        """
        if state.index >= 0:
            want_corrected(state)
        given, t = arrived(self, state), float(t)
        if not self.clock.same(t, given.time):
            raise ValueError(
                f"t: wanted the next measurement time {when(given.time)}, got {when(t)}"
            )
        mean, mode, prob = found(self, given, None, None)
        return given._replace(mean=mean, cov=None, mode=mode, mode_prob=prob)

    def correct(
        self, state: OutputState, y: ArrayLike, indicator: ArrayLike | None = None
    ) -> OutputState:
        """Correct the forecast by a measurement and the indicator.

        Parameters
        ----------
        state : OutputState
        y : array_like, shape (m, *batch)
            NaN where it is missing, in all components or none.
        indicator : array_like of int, shape (*batch), optional
            -1 where it is missing; wanted where the system has one.

        Raises
        ------
        TypeError, ValueError
            A state without a forecast, a wrong shape, an infinite measurement, an indicator out
            of range; a missing measurement or indicator that is to be remembered.
        """
        want_forecast(state)
        y, indicator, gap = self.admitted(y, indicator, state.mean.shape[1:], state.index)
        return after(self, state, y, indicator, gap)

    def nodes(self, state: OutputState, end: bool = True) -> tuple[list, list, tuple | None]:
        """Times and estimates to the last node after a correction, and the next measurement's."""
        times, values = [state.time], [state.mean]
        k = self.served(state.index + 1) - 1 if self.cycle else state.index
        if 0 <= k < len(self.node_times):
            group = state.group if self.arrivals else None
            points = arguments(self.system, (), None, state.past, group)
            # beyond the design the nodes lie as in its last interval
            times += (self.node_times[k] + (state.time - self.times[k])).tolist()
            values += [fit(points).mean for fit in self.node_fits[k]]
        if not end or not (self.cycle or state.index + 1 < len(self.times)):
            return times, values, None
        ahead = arrived(self, state)
        return times, values, (ahead.time, found(self, ahead, None, None).mean)

    def forecast(self, state: OutputState, t: float, kind: str | None = None) -> Estimates:
        """Estimate at a time up to the next measurement; with modes, at the next one.

        Parameters and errors as those of `BetweenFilter.forecast`.
        """
        if switches(self.system):
            ahead = self.predict(state, t)
            return Estimates(ahead.mean, mode_prob=ahead.mode_prob, modes=ahead.mode)
        return super().forecast(state, t, kind)

    # Whole records

    def placed(self, times: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Number of the measurement at each time; with modes, each time is that of one."""
        index = super().placed(times, y)
        if switches(self.system) and (index < 0).any():
            raise ValueError(
                "times: wanted those of measurements alone, for the system has modes, got "
                f"{when(times[index < 0][0])}"
            )
        return index

    def sizes(self, covariances: bool) -> Estimates:
        """Shapes of what is found at each time."""
        like = found(self, arrived(self, self.initial()), None, None)
        mean, modes, prob = (None if part is None else np.shape(part) for part in like)
        cov = (*mean, *mean) if covariances and self.arrivals else None
        return Estimates(mean, cov, mode_prob=prob, modes=modes)

    def fill(
        self, rows: Estimates, times: np.ndarray, index: np.ndarray, y: np.ndarray,
        indicators: np.ndarray | None, held: Course,
    ) -> int:  # fmt: skip
        """Run over a block of records."""
        state, known = self.initial(y.shape[2:]), None
        for j, k in enumerate(index):
            if k < 0:
                known = self.interval(state) if known is None else known
                if rows.cov is not None:
                    rows.cov[j] = np.nan
                rows.mean[j] = at(known, times[j], self.between)
                continue
            shown = None if indicators is None else indicators[j]
            state, known = after(self, arrived(self, state), y[j], shown), None
            rows.mean[j] = state.mean
            if rows.cov is not None:
                rows.cov[j] = state.cov
            if rows.modes is not None:
                rows.modes[j] = state.mode
            if rows.mode_prob is not None:
                rows.mode_prob[j] = state.mode_prob
        return 0

    def finish(self, found: Estimates, lost: np.ndarray, index: np.ndarray) -> Estimates:
        """With the covariances that the design found, where they are those of all histories."""
        if self.arrivals:
            return found._replace(diverged=lost)
        cov = self.covariances[[self.served(k) for k in index]]
        cov[index < 0] = np.nan
        return found._replace(cov=cov, diverged=lost)

    def parts(self, chosen: list[int]) -> dict[str, Any]:
        """Functions of the chosen steps."""
        return {
            "steps": tuple(self.steps[k] for k in chosen),
            "covariances": self.covariances[chosen],
            "arrivals": tuple(self.arrivals[k] for k in chosen) if self.arrivals else (),
            "changes": None if self.changes is None else self.changes[:, chosen],
        }

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of order {self.order}: {self.memory}; {self.made}>"

    def __str__(self) -> str:
        return summary(self)
