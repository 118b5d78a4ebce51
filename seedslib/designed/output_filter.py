"""Filters of output functions: the optimal functions of theorems 1 and 2, in any form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.clock import Clock, when
from seedslib.base.values import Values
from seedslib.designed.base import freeze, nan_where, want_corrected, want_forecast, want_next
from seedslib.designed.between import BetweenFilter, known_kind
from seedslib.designed.checks import check_array, check_nodes, check_verbs
from seedslib.designed.memory import Memory, Past
from seedslib.designed.prediction import Design, HeldOut, Prediction, page, span
from seedslib.designed.tables import Output, Step, Table, arguments, step_axes
from seedslib.filters.base import Estimates
from seedslib.models.kinds import switches


class OutputState(NamedTuple):
    """What a filter of output functions remembers.

    Attributes
    ----------
    index : int
        Number k of the last measurement time reached; -1 before the first.
    time : float or None
    mean : ndarray, shape (n', *batch)
        Forecast after `predict`, estimate after `correct`, NaN before both.
    cov : ndarray, shape (n', n') or (n', n', *batch), or None
        Error covariance of the estimate that the design found, NaN from a gap on.
    mode : ndarray of int, shape (*batch), or None
        The mode that is likeliest in the forecast, or the decided one.
    mode_prob : ndarray, shape (L, *batch), or None
    past : Past
        The memory; after `predict` still the one before.
    before : OutputState or None
        The state after the measurement before the last, needed by linear forecasts.
    gap : ndarray of bool, shape (*batch), or False
        Whether something that the design does not know of has been missing so far.
    corrected : bool
    """

    index: int
    time: float | None
    mean: np.ndarray
    cov: MaybeArray = None
    mode: MaybeArray = None
    mode_prob: MaybeArray = None
    past: Past = Past()
    before: OutputState | None = None
    gap: np.ndarray | bool = False
    corrected: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class OutputFilter(BetweenFilter):
    """Filter whose estimate is any function of measurement and memory.

    Z_k = f_k(Y_k, U_{k-1}) and Z_k^i = g_k^i(U_k), theorem 1 of the jump-diffusion paper; with
    modes also the decided mode, iota_k(j, y, z) and g_k(j, y, z) of (3.1), (3.2) of the switching
    paper. There is no likelihood, and the covariance is the unconditional one that the design
    found, NaN from a missing measurement on.

    A missing measurement or indicator is left out, exactly for that step given the memory, by
    functions of its own. What was found is remembered like any other estimate.

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
        Of a design on a grid: how far each function is from the one before, root mean square of
        the difference of the estimates, probability of another mode; NaN where the memory was
        still filling. They are those of arguments that are rounded to the nodes at random, as the
        design has them. Between the nodes a run interpolates, so it finds less by the convexity
        of the square: a tenth where the difference moves as much from node to node as it is large.
    between : str
        Kind of the forecasts between measurements, see `seedslib.designed.between.at`.
    cycle : int
        See `DesignedFilter`.
    held_out : HeldOut, optional
        Errors on paths that the design has not seen; none where it took no paths.
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

    def __post_init__(self) -> None:
        self.check_shapes()
        known_kind("between", self.between)
        object.__setattr__(self, "clock", Clock(self.times))
        freeze((self.times, self.steps, self.changes, self.node_times, self.node_fits))
        freeze((self.covariances, self.predicted, self.held_out))

    def check_parts(self) -> None:
        """Tables; functions of one's own are taken as they are, and learned ones have no axes."""
        steps, n, m = len(self.times), self.components, self.system.measurement_size
        if len(self.steps) != steps:
            raise ValueError(f"steps: wanted {steps}, got {len(self.steps)}")
        check_array("covariances", self.covariances, steps, n, n)
        if self.changes is not None:
            check_array("changes", self.changes, 2, steps, finite=False)
        check_nodes(self, steps - 1)
        axes = [
            step_axes(self.system, self.memory, (None,) * m, (None,) * n, k)
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
        check_verbs([row[:2] for row in tables], "__call__")
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

    def predict(
        self, state: OutputState, t: float, *, inputs: Mapping[Any, Any] | None = None
    ) -> OutputState:
        """Forecast for the next measurement time.

        Raises
        ------
        ValueError
            Another time than the next, a state that was not corrected.
        """
        if state.index >= 0:
            want_corrected(state)
        want_next(self.clock, state.index + 1, float(t), self.cycle)
        arrived = self.advanced(state, ())
        mean, mode, prob = self._found(arrived, None, None)
        return arrived._replace(mean=mean, mode=mode, mode_prob=prob)

    def correct(
        self,
        state: OutputState,
        y: ArrayLike,
        indicator: ArrayLike | None = None,
        *,
        inputs: Mapping[Any, Any] | None = None,
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
        return self.corrected(state, y, (), indicator, True, gap)

    def advanced(self, state: OutputState, p: Values = (), interval: Any = None) -> OutputState:
        """The state at the next measurement time, with the estimate that it had."""
        before = state._replace(before=None) if state.corrected else None
        time = self.clock.moment(state.index + 1, self.cycle)
        return OutputState(
            state.index + 1, time, state.mean, past=state.past, before=before, gap=state.gap
        )

    def _found(self, state, y, indicator) -> Output:
        """What the functions of a measurement find; y is None where it is missing."""
        step = self.steps[self.served(state.index)]
        function, y = (step.blind, ()) if y is None else (step.shown, y)
        points = arguments(self.system, y, indicator, state.past)
        return function(points).filling(state.mean.shape[1:])

    def corrected(
        self,
        state: OutputState,
        y: np.ndarray,
        p: Values,
        indicator: MaybeArray,
        covariance: bool,
        gap: np.ndarray | bool = False,
    ) -> OutputState:
        """The state after a measurement; `gap` is where something is missing, shape (*batch)."""
        missing = np.isnan(y)
        if missing.any():
            output = self._with_gaps(state, y, indicator, missing)
        else:
            output = self._found(state, y, indicator)
        if self.memory.indicators and indicator is not None and (indicator < 0).any():
            raise ValueError("indicator: wanted by the memory, got a missing one")
        mean, mode, prob = output
        past = self.memory.push(
            state.past, estimate=mean, measurement=y, mode=mode, indicator=indicator
        )
        gap = state.gap | gap
        cov = nan_where(gap, self.covariances[self.served(state.index)])
        return state._replace(
            mean=mean, cov=cov, mode=mode, mode_prob=prob, past=past, gap=gap, corrected=True
        )

    def _with_gaps(self, state, y, indicator, missing) -> Output:
        """What is found where some measurements are missing."""
        gone = missing.all(axis=0)
        if not np.array_equal(missing.any(axis=0), gone):
            raise ValueError("y: wanted all components of a measurement or none, got some NaN")
        if self.memory.measurements:
            raise ValueError("y: wanted a measurement, it is to be remembered; got NaN")
        forecast = self._found(state, None, indicator)
        if gone.all():
            return forecast
        found = self._found(state, np.where(missing, 0.0, y), indicator)
        pairs = zip(found, forecast, strict=True)
        return Output(*(None if a is None else np.where(gone, b, a) for a, b in pairs))

    def nodes(
        self, state: OutputState, p: Values, end: bool = True
    ) -> tuple[list, list, tuple | None]:
        """Times and estimates to the last node after a correction, and the next measurement's."""
        times, values = [state.time], [state.mean]
        k = self.served(state.index + 1) - 1 if self.cycle else state.index
        if 0 <= k < len(self.node_times):
            points = arguments(self.system, (), None, state.past)
            # beyond the design the nodes lie as in its last interval
            times += (self.node_times[k] + (state.time - self.times[k])).tolist()
            values += [fit(points).mean for fit in self.node_fits[k]]
        if not end or not (self.cycle or state.index + 1 < len(self.times)):
            return times, values, None
        ahead = self.advanced(state)
        return times, values, (ahead.time, self._found(ahead, None, None).mean)

    def forecast(
        self, state: OutputState, t: float, kind: str | None = None, *, inputs: Any = None
    ) -> Estimates:
        """Estimate at a time up to the next measurement; with modes, at the next one.

        Parameters and errors as those of `BetweenFilter.forecast`.
        """
        if switches(self.system):
            ahead = self.predict(state, t)
            return Estimates(ahead.mean, mode_prob=ahead.mode_prob, modes=ahead.mode)
        return super().forecast(state, t, kind, inputs=inputs)

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
        like = self._found(self.advanced(self.initial()), None, None)
        mean, modes, prob = (None if part is None else np.shape(part) for part in like)
        return Estimates(mean, mode_prob=prob, modes=modes)

    def finish(self, found: Estimates, lost: np.ndarray, index: np.ndarray) -> Estimates:
        """With the covariances that the design found."""
        cov = self.covariances[[self.served(k) for k in index]]
        cov[index < 0] = np.nan
        return found._replace(cov=cov, diverged=lost)

    def parts(self, chosen: list[int]) -> dict[str, Any]:
        """Functions of the chosen steps."""
        return {
            "steps": tuple(self.steps[k] for k in chosen),
            "covariances": self.covariances[chosen],
            "changes": None if self.changes is None else self.changes[:, chosen],
        }

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of order {self.order}: {self.memory}; {self.made}>"

    def __str__(self) -> str:
        modes = f"{self.system.modes} modes, of " if switches(self.system) else ""
        return page(
            self,
            f"Finite-order filter of {modes}order {self.order}: {self.memory}",
            f"estimates    {self.components} of {self.system.state_size} state components",
            f"by           {self.made}",
            span(self),
        )


class TableFilter(OutputFilter):
    """Optimal filter of a given memory as tables; `seedslib.design` makes it.

    Of a system of any kind: where it has modes the tables decide them too.

    Examples
    --------
    >>> from seedslib.design import grid_synthesis
    >>> from seedslib.designed.memory import large_order
    >>> from seedslib import zoo
    >>> filter = grid_synthesis(
    ...     zoo.flip_process(), large_order(1), [0.0, 0.25, 0.5],
    ...     x=(-3.5, 3.5, 141), z=(-3, 3, 121), y=(-8, 8, 121),
    ... )
    >>> filter.order
    1
    """

    @property
    def bytes(self) -> int:
        """Memory of the tables."""
        tables = [table for row in (*self.steps, *self.node_fits) for table in row]
        return sum(part.nbytes for table in tables for part in table[1:] if part is not None)

    @property
    def made(self) -> str:
        """How the tables were made, and their axes."""
        step = self.steps[min(1, len(self.steps) - 1)]
        first, m = int(self.system.indicators > 0), self.system.measurement_size
        measured, memory = (
            "; ".join(map(str, axes))
            for axes in (step.shown.axes[first : first + m], step.blind.axes[first:])
        )
        text = f"tables ({self.method}) over {'indicator and ' * first}measurements ({measured})"
        return text + (f" and memory ({memory})" if memory else "")

    @property
    def change(self) -> tuple[float, float]:
        """Change of estimates and modes over the last step; NaN where there is none to compare.

        The first in units of the root-mean-square error.
        """
        if self.changes is None:
            return np.nan, np.nan
        moved, modes = self.changes[:, -1]
        return float(moved / np.sqrt(np.trace(self.covariances[-1]))), float(modes)
