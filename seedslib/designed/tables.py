"""Output functions as tables: their axes, their arguments, and how they are looked up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.tables import Axis, Labels, locate
from seedslib.designed.checks import check_array
from seedslib.designed.memory import Memory, Past
from seedslib.models.kinds import AnySystem, switches


class Output(NamedTuple):
    """What an output function gives.

    Attributes
    ----------
    mean : ndarray, shape (n', *batch)
    mode : ndarray of int, shape (*batch), or None
        The decided mode, of a system with modes.
    prob : ndarray, shape (L, *batch), or None
        Probabilities of the modes, where they are wanted.
    """

    mean: np.ndarray
    mode: MaybeArray = None
    prob: MaybeArray = None

    def filling(self, batch: tuple[int, ...]) -> Output:
        """The same on all paths, of a function that looked at nothing that has their axes."""
        if self.mean.ndim > len(batch):
            return self
        wide = (..., *(None,) * len(batch))
        parts = (part if part is None else np.asarray(part) for part in self)
        return Output(
            *(
                None if part is None else np.array(np.broadcast_to(part[wide], part.shape + batch))
                for part in parts
            )
        )


class Table(NamedTuple):
    """Estimate, and where there are modes the decided one and their probabilities, as tables.

    Estimates and probabilities are multilinear between the nodes and constant beyond the ends of
    an axis; the decided mode is that of the nearest node.

    Attributes
    ----------
    axes : tuple of Axis or Labels
    estimate : ndarray, shape (n', count of each axis...)
    mode : ndarray of int8, shape (count of each axis...), or None
    prob : ndarray, shape (L, count of each axis...), or None
    """

    axes: tuple[Axis | Labels, ...]
    estimate: np.ndarray
    mode: MaybeArray = None
    prob: MaybeArray = None

    @classmethod
    def of(
        cls, axes: tuple[Axis | Labels, ...], found: Output, probabilities: bool = False
    ) -> Table:
        """What was found for one component at all nodes, in the order of the axes."""
        shape = tuple(axis.count for axis in axes)
        mean, mode, prob = found
        return cls(
            axes,
            mean.reshape(1, *shape),
            None if mode is None else mode.reshape(shape),
            prob.reshape(len(prob), *shape) if probabilities and prob is not None else None,
        )

    def __call__(self, points: Sequence[np.ndarray]) -> Output:
        """Values at points, one for each axis, of shapes that broadcast to (*batch)."""
        place = locate(self.axes, points)
        mode = None if self.mode is None else place.nearest(self.mode.reshape(-1))
        prob = None if self.prob is None else place.rows(self.prob)
        return Output(place.rows(self.estimate), mode, prob)

    def check(self, name: str, axes: Any, components: int, modes: int, memory: Memory) -> None:
        """Refuse other axes, numbers of labels or none, than those of the memory, or shapes."""
        own, wanted = (
            [axis.count if isinstance(axis, Labels) else None for axis in several]
            for several in (self.axes, axes)
        )
        if own != wanted:
            raise ValueError(f"{name} has other axes than the memory {memory}")
        shape, mode = tuple(axis.count for axis in self.axes), self.mode
        check_array(f"{name}.estimate", self.estimate, components, *shape)
        if self.prob is not None:
            check_array(f"{name}.prob", self.prob, modes, *shape)
        if mode is None:
            if modes and ".shown" in name:
                raise ValueError(f"{name}.mode: wanted the decided modes, got none")
            return
        if mode.shape != shape or mode.dtype != np.int8:
            raise ValueError(f"{name}.mode: wanted bytes of shape {shape}")
        if mode.size and not 0 <= mode.min() <= mode.max() < modes:
            raise ValueError(f"{name}.mode: a number that is no mode")


class Step(NamedTuple):
    """Output functions of one measurement, of arguments as `arguments` lists them.

    Attributes
    ----------
    shown : callable
        Of the measurement and the memory before it.
    blind : callable
        Of the memory alone, where the measurement is missing: the forecast.
    """

    shown: Table | Any
    blind: Table | Any


def prior(system: AnySystem, components: int) -> Table:
    """The forecast for the first measurement of a system without modes: its initial mean."""
    return Table((), np.array(system.mean0[:components]))


def step_axes(
    system: AnySystem, memory: Memory, measured: Any, estimated: Any, k: int
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
    shown, blind : tuple of Axis or Labels
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


def recalled(system: AnySystem, memory: Memory, components: int, k: int, points: Any) -> Past:
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


def arguments(system: AnySystem, y: Any, indicator: ArrayLike | None, past: Past) -> list[Any]:
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
