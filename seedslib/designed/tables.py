"""Filters of output functions: the optimal functions of theorems 1 and 2, mostly as tables."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray, align
from seedslib.base.checks import outside
from seedslib.base.clock import Clock
from seedslib.base.tables import Axis, Labels, locate
from seedslib.base.values import Values
from seedslib.designed.accuracy import Accuracy, Design, measurement_line, page
from seedslib.designed.base import DesignedFilter, FilterState, freeze
from seedslib.designed.between import Interval
from seedslib.designed.memory import Memory, Past
from seedslib.designed.program import DesignedProgram
from seedslib.filters.base import Estimates
from seedslib.models.kinds import AnySystem, switches

if TYPE_CHECKING:
    from typing import Self


class Output(NamedTuple):
    """What an output function gives.

    Attributes
    ----------
    mean : ndarray, shape (n', *batch)
    mode : ndarray of int, shape (*batch), or None
        The decided mode, of a system with modes.
    """

    mean: np.ndarray
    mode: MaybeArray = None

    def on(self, batch: tuple[int, ...]) -> Output:
        """The same on all paths of a batch, of a function that is constant over them."""
        if self.mean.ndim > len(batch):
            return self
        mean = np.tile(align(self.mean, 1, len(batch)), (1, *batch))
        return Output(mean, None if self.mode is None else np.full(batch, self.mode))


OutputFunction = Callable[[Sequence[np.ndarray]], Output]
"""Function of arguments as `arguments` lists them."""


class Table(NamedTuple):
    """Estimate, and where there are modes the decided one, as tables.

    Estimates are multilinear between the nodes and constant beyond the ends of an axis; the
    decided mode is that of the nearest node.

    Attributes
    ----------
    axes : tuple of Axis or Labels
    estimate : ndarray, shape (n', count of each axis...)
    mode : ndarray of int8, shape (count of each axis...), or None
    """

    axes: tuple[Axis | Labels, ...]
    estimate: np.ndarray
    mode: MaybeArray = None

    @classmethod
    def of(cls, axes: tuple[Axis | Labels, ...], output: Output) -> Table:
        """From the output for one component at all nodes, in the order of the axes."""
        shape = tuple(axis.count for axis in axes)
        mode = None if output.mode is None else output.mode.reshape(shape)
        return cls(axes, output.mean.reshape(1, *shape), mode)

    def __call__(self, points: Sequence[np.ndarray]) -> Output:
        """Values at points, one for each axis, of shapes that broadcast to (*batch)."""
        place = locate(self.axes, points)
        mode = None if self.mode is None else place.nearest(self.mode.reshape(-1))
        return Output(place.rows(self.estimate), mode)


class Step(NamedTuple):
    """Output functions of one measurement, of arguments as `arguments` lists them.

    Attributes
    ----------
    update : callable
        Of the measurement and the memory before it.
    forecast : callable
        Of the memory alone, where the measurement is missing.
    """

    update: Any
    forecast: OutputFunction


def _warn_beyond(axes: Sequence[Axis], y: Sequence[np.ndarray]) -> None:
    """Warn of measurements beyond the first axes of a table."""
    for axis, values in zip(axes, y, strict=False):
        if np.any(values < axis.low) or np.any(values > axis.high):
            warnings.warn(
                f"y: wanted measurements from {axis.low:g} to {axis.high:g}, where the tables are, "
                "got others, which count as the nearer end",
                stacklevel=outside(),
            )


def prior(system: AnySystem, components: int) -> Table:
    """The forecast for the first measurement of a system without modes: its initial mean."""
    return Table((), np.array(system.mean0[:components]))


def step_axes(
    system: AnySystem, memory: Memory, measured: tuple[Any, ...], estimated: tuple[Any, ...], k: int
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Axes of the tables of measurement k.

    The first axis of both is the indicator, where there is one; its last label is a missing one.

    Parameters
    ----------
    system : object
        Of any kind.
    memory : Memory
    measured, estimated : tuple of Axis
        Of the components of a measurement, and of an estimate.
    k : int

    Returns
    -------
    update, forecast : tuple of Axis or Labels
    """
    values = system.indicators
    indicator = (Labels(values + 1),) if values else ()
    modes, indicators = block_labels(system, memory)
    remembered = (modes + indicators + estimated) * min(k, memory.estimates)
    remembered += (indicators + measured) * min(k, memory.measurements)
    return indicator + measured + remembered, indicator + remembered


def block_labels(system: AnySystem, memory: Memory) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Labels before the numbers of a remembered estimate: its decided mode, and its indicator."""
    modes = (Labels(system.modes),) if switches(system) and memory.estimates else ()
    return modes, ((Labels(system.indicators),) if memory.indicators else ())


def require_like_blocks(memory: Memory, indicators: int, place: str = "") -> None:
    """Refuse a memory whose blocks are not all alike.

    Parameters
    ----------
    memory : Memory
    indicators : int
        Values of the indicator, 0 without one.
    place : str
        For the message: what they are wanted for.

    Raises
    ------
    ValueError
        Estimates and measurements, or neither; log-odds; other than as many indicators.
    """
    if (
        bool(memory.estimates) == bool(memory.measurements)
        or memory.log_odds
        or (memory.indicators and not indicators)
        or memory.indicators not in (0, memory.depth)
    ):
        raise ValueError(f"memory: wanted estimates or measurements alone{place}, got {memory}")


def recalled(
    system: AnySystem, memory: Memory, components: int, k: int, points: Sequence[np.ndarray]
) -> Past:
    """The memory after measurement k from what `arguments` lists of it, (d, *batch)."""
    modes, indicators = block_labels(system, memory)
    past: dict[str, list] = {name: [] for name in Past._fields}
    rows = list(points)
    for name, size in (("estimates", components), ("measurements", system.measurement_size)):
        for _ in range(min(k + 1, getattr(memory, name))):
            if modes and name == "estimates":
                past["modes"].append(rows.pop(0).astype(int))
            if indicators:
                past["indicators"].append(rows.pop(0).astype(int))
            past[name].append(np.array([rows.pop(0) for _ in range(size)]))
    return Past(**{name: tuple(blocks) for name, blocks in past.items()})


def arguments(
    system: AnySystem, y: Sequence[np.ndarray], indicator: ArrayLike | None, past: Past
) -> list[np.ndarray]:
    """Arguments of an output function, in the order of the axes of its table.

    Parameters
    ----------
    system : object
        Of any kind.
    y : sequence of ndarray
        Components of the measurement; none for a function without it.
    indicator : ndarray of int, or None
        -1 is a missing one, and so is None.
    past : Past
        The memory before the measurement.
    """
    points, values = [], system.indicators
    if values:
        # the label after the last value is a missing indicator
        indicator = np.asarray(-1 if indicator is None else indicator)
        points.append(np.where(indicator < 0, values, indicator))
    points += tuple(y)
    for number, block in enumerate(past.estimates + past.measurements):
        if past.modes:
            points.append(past.modes[number])
        if past.indicators:
            points.append(past.indicators[number])
        points += tuple(block)
    return points


@dataclass(frozen=True, eq=False, repr=False)
class OutputFilter(DesignedFilter):
    """Filter whose estimate is any function of measurement and memory.

    Z_k = f_k(Y_k, U_{k-1}), theorem 1 of the jump-diffusion paper; with modes also the decided
    mode, iota_k(j, y, z) and g_k(j, y, z) of (3.1), (3.2) of the switching paper. There is no
    likelihood, and the covariance is the unconditional one that the design found, NaN from a
    missing measurement on.

    A missing measurement or indicator is left out, exactly for that step given the memory, by
    functions of its own. The result is remembered like any other estimate.

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
    predicted : Accuracy
        Accuracy; without standard errors where no random numbers were used.
    covariances : ndarray, shape (K+1, n', n')
        Error covariances that the design found.
    design : Design
    changes : ndarray, shape (2, K+1), or None
        Of a design on a grid: how far each function is from the one before, root mean square of
        the difference of the estimates, probability of another mode; NaN where the memory was
        still filling. They are those of arguments that are rounded to the nodes at random, as the
        design has them. Between the nodes a run interpolates, so it finds less by the convexity
        of the square: a tenth where the difference moves as much from node to node as it is large.
    cycle : int
        See `DesignedFilter`.
    held_out : Accuracy, optional
        Errors on paths that the design has not seen; none where it took no paths.
    """

    node_times = node_fits = ()  # between measurements, an interpolation to the next forecast
    system: object
    memory: Memory
    times: np.ndarray
    steps: tuple[Step, ...]
    method: object
    predicted: Accuracy
    covariances: np.ndarray
    design: Design
    changes: MaybeArray = None
    cycle: int = 0
    held_out: Accuracy | None = None
    per_step: ClassVar[Mapping[str, int]] = {"steps": 0, "covariances": 0}

    def __post_init__(self) -> None:
        self.check()
        vars(self).update(clock=Clock(self.times))
        freeze((self.times, self.steps, self.changes))
        freeze((self.covariances, self.predicted, self.held_out))

    def check(self) -> None:
        """See `DesignedFilter.check`."""
        super().check()
        steps, n, m = len(self.times), self.components, self.system.measurement_size
        if not len(self.steps) == len(self.covariances) == steps:
            raise ValueError(f"steps, covariances: wanted {steps}, got {len(self.steps)}")
        for k, step in enumerate(self.steps):
            axes = step_axes(self.system, self.memory, (None,) * m, (None,) * n, k)
            for table, wanted in zip(step, axes, strict=True):
                if isinstance(table, Table) and len(table.axes) != len(wanted):
                    raise ValueError(
                        f"steps[{k}]: wanted tables over {len(wanted)} arguments, for the memory "
                        f"{self.memory}, got {len(table.axes)}"
                    )

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
        """The output of measurement k for arguments whose batch axes broadcast.

        Parameters
        ----------
        k : int
        y, u : array_like, shapes (m, *batch) and (d, *batch)
            The measurement, below the indicator where there is one; the memory, empty at k = 0.
        """
        return self.steps[k].update([*y, *u])

    # Step by step

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> FilterState:
        """State before any measurement; the filter draws nothing from `seed`."""
        return FilterState(-1, np.full((self.components, *batch), np.nan))

    def predict(
        self, state: FilterState, t: float, *, inputs: Mapping[Any, Any] | None = None
    ) -> FilterState:
        """See `DesignedFilter.predict`."""
        state = super().predict(state, t, inputs=inputs)
        mean, mode = self._output(state, None, None)
        return state._replace(mean=mean, mode=mode)

    def propagate(
        self, state: FilterState, t: float, p: Values, interval: Interval | None = None
    ) -> FilterState:
        """The state at the next measurement time, still with the estimate before it."""
        before = state._replace(before=None) if state.corrected else None
        return state._replace(index=state.index + 1, cov=None, before=before, corrected=False)

    def _output(self, state, y, indicator) -> Output:
        """The output of a measurement; y is None where it is missing."""
        step = self.steps[self.served(state.index)]
        function, y = (step.forecast, ()) if y is None else (step.update, y)
        if isinstance(function, Table):
            _warn_beyond(function.axes[int(self.system.indicators > 0) :], y)
        points = arguments(self.system, y, indicator, state.past)
        return function(points).on(state.mean.shape[1:])

    def update(
        self,
        state: FilterState,
        y: np.ndarray,
        p: Values,
        indicator: MaybeArray = None,
        covariance: bool = True,
    ) -> FilterState:
        """The state after a measurement."""
        missing = np.isnan(y)
        if missing.any():
            output = self._output_with_gaps(state, y, indicator, missing)
        else:
            output = self._output(state, y, indicator)
        if self.memory.indicators and indicator is not None and (indicator < 0).any():
            raise ValueError("indicator: wanted by the memory, got a missing one")
        mean, mode = output
        past = self.memory.push(
            state.past, estimate=mean, measurement=y, mode=mode, indicator=indicator
        )
        cov = self.covariances[self.served(state.index)]
        return state._replace(mean=mean, cov=cov, mode=mode, past=past, corrected=True)

    def _output_with_gaps(self, state, y, indicator, missing) -> Output:
        """The output where some measurements are missing."""
        absent = missing.all(axis=0)
        if not np.array_equal(missing.any(axis=0), absent):
            raise ValueError("y: wanted all components of a measurement or none, got some NaN")
        if self.memory.measurements:
            raise ValueError("y: wanted a measurement, it is to be remembered; got NaN")
        forecast = self._output(state, None, indicator)
        if absent.all():
            return forecast
        update = self._output(state, np.where(missing, 0.0, y), indicator)
        pairs = zip(update, forecast, strict=True)
        return Output(*(None if a is None else np.where(absent, b, a) for a, b in pairs))

    def ahead(self, state: FilterState, row: int, p: Values) -> list[np.ndarray]:
        """The forecast at the end of an interval."""
        points = arguments(self.system, (), None, state.past)
        forecast = self.steps[self.served(state.index + 1)].forecast
        return [forecast(points).on(state.mean.shape[1:]).mean]

    def forecast(
        self,
        state: FilterState,
        t: float,
        kind: str | None = None,
        *,
        inputs: Mapping[Any, Any] | None = None,
    ) -> Estimates:
        """Estimate at a time up to the next measurement, see `DesignedFilter.forecast`.

        With modes, of the next measurement time only.
        """
        if switches(self.system):
            ahead = self.predict(state, t)
            return Estimates(ahead.mean, modes=ahead.mode)
        return super().forecast(state, t, kind, inputs=inputs)

    def taking(self, chosen: list[int]) -> Self:
        """See `DesignedFilter.taking`."""
        filter = super().taking(chosen)
        return filter if self.changes is None else replace(filter, changes=self.changes[:, chosen])

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of order {self.order}: {self.memory}; {self.made}>"

    def __str__(self) -> str:
        modes = f"{self.system.modes} modes, of " if switches(self.system) else ""
        return page(
            self,
            f"Finite-order filter of {modes}order {self.order}: {self.memory}",
            f"estimates    {self.components} of {self.system.state_size} state components",
            f"by           {self.made}",
            measurement_line(self),
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

    def program(self, **options: Any) -> DesignedProgram:
        """See `Filter.program`; all output functions must be tables."""
        from seedslib.designed.memory_programs import table

        functions = (function for step in self.steps for function in step)
        others = {type(f).__name__ for f in functions if not isinstance(f, Table)}
        if others:
            names = ", ".join(sorted(others))
            raise TypeError(f"filter: wanted tables over even axes, got {names}")
        step = DesignedProgram(self, **options)
        table(step)
        return step

    def state_of(self, parts: dict[str, Any], t: float, before: FilterState) -> FilterState:
        """See `Filter.state_of`."""
        state, mode = super().state_of(parts, t, before), parts.get("mode")
        mode = None if mode is None else self._mode_type(mode)
        return state._replace(loglik=None, mode=mode)

    def estimates_of(self, parts: dict[str, Any], covariances: bool = True) -> Estimates:
        """See `Filter.estimates_of`; there is no likelihood."""
        result = super().estimates_of(parts, covariances)
        modes = None if result.modes is None else result.modes.astype(self._mode_type)
        return result._replace(loglik=None, modes=modes)

    @property
    def _mode_type(self) -> Any:
        return self.steps[0].update.mode.dtype.type

    @property
    def bytes(self) -> int:
        """Memory of the tables."""
        tables = [table for row in self.steps for table in row]
        return sum(part.nbytes for table in tables for part in table[1:] if part is not None)

    @property
    def made(self) -> str:
        """How the tables were made, and their axes."""
        step = self.steps[min(1, len(self.steps) - 1)]
        first, m = int(self.system.indicators > 0), self.system.measurement_size
        measured, memory = (
            "; ".join(map(str, axes))
            for axes in (step.update.axes[first : first + m], step.forecast.axes[first:])
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
