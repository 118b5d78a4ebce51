"""The tables of a filter of a switching system, and how they are looked up."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.base.tables import Axis, Labels, locate
from seedslib.designed.memory import Past
from seedslib.designed.prediction import held_out_words, with_held_out
from seedslib.designed.summary import ROWS


class ModeTable(NamedTuple):
    """Estimate, decided mode and, where wanted, probabilities of the modes as tables.

    Estimates and probabilities are multilinear between the nodes and constant beyond the ends of
    an axis; the decided mode is that of the nearest node.

    Attributes
    ----------
    axes : tuple of Axis or Labels
    estimate : ndarray, shape (n', count of each axis...)
    mode : ndarray of int8, shape (count of each axis...)
    prob : ndarray, shape (L, count of each axis...), or None
    """

    axes: tuple
    estimate: np.ndarray
    mode: np.ndarray
    prob: np.ndarray | None = None

    def look_up(self, points, batch):
        """Estimate (n', *batch), mode (*batch) and probabilities (L, *batch) or None.

        Parameters
        ----------
        points : sequence of ndarray
            One for each axis, of shapes that broadcast to `batch`.
        batch : tuple of int
        """
        place = locate(self.axes, points)
        if place.index.shape != batch:
            place = place._replace(index=np.broadcast_to(place.index, batch))
        mean = [place.linear(row.reshape(-1)) for row in self.estimate]
        prob = None
        if self.prob is not None:
            prob = np.stack([place.linear(row.reshape(-1)) for row in self.prob])
        mean = mean[0][None] if len(mean) == 1 else np.stack(mean)
        return mean, place.nearest(self.mode.reshape(-1)), prob


class StepTables(NamedTuple):
    """Tables of one measurement.

    The first axis of both is the indicator, where there is one; its last label is a missing one.

    Attributes
    ----------
    shown : ModeTable
        Of the measurement and the memory before it.
    blind : ModeTable
        Of the memory alone, where the measurement is missing: without an indicator the forecast.
    """

    shown: ModeTable
    blind: ModeTable


class TableState(NamedTuple):
    """What the filter remembers.

    Attributes
    ----------
    index : int
        Number k of the last measurement time reached; -1 before the first.
    time : float or None
    mean : ndarray, shape (n', *batch), or None
        Forecast after `predict`, estimate after `correct`.
    mode : ndarray of int, shape (*batch), or None
        The mode that is likeliest in the forecast, or the decided one.
    mode_prob : ndarray, shape (L, *batch), or None
    past : Past
        The memory; after `predict` still the one before.
    batch : tuple of int
    corrected : bool
    """

    index: int
    time: float | None
    mean: np.ndarray | None
    mode: np.ndarray | None
    mode_prob: np.ndarray | None
    past: Past
    batch: tuple
    corrected: bool


def step_axes(system, memory, measured, letters, held) -> tuple[tuple, tuple]:
    """Axes of the two tables of a step whose memory holds so many blocks.

    Parameters
    ----------
    system : SwitchingSystem
    memory : Memory
    measured : tuple of Axis
        Of the components of a measurement.
    letters : tuple of Axis
        Of the numbers in a block of the memory.
    held : int

    Returns
    -------
    shown, blind : tuple of Axis or Labels
    """
    told = (Labels(system.indicators + 1),) if system.has_indicator else ()
    block = letter_labels(system, memory) + letters
    return told + measured + block * held, told + block * held


def arguments(system, memory, y, indicator, past: Past) -> list:
    """Arguments of a table, in the order of its axes.

    Parameters
    ----------
    system : SwitchingSystem
    memory : Memory
    y : sequence of ndarray
        Components of the measurement; none for a table without it.
    indicator : ndarray of int, or None
        -1 is a missing one, and so is None.
    past : Past
        The memory before the measurement.
    """
    points = []
    if system.has_indicator:
        # the label after the last value is a missing indicator
        indicator = np.asarray(-1 if indicator is None else indicator)
        points.append(np.where(indicator < 0, system.indicators, indicator))
    points += tuple(y)
    blocks = past.estimates or past.measurements
    for number, block in enumerate(blocks):
        if memory.estimates:
            points.append(past.modes[number])
        if memory.indicators:
            points.append(past.indicators[number])
        points += tuple(block)
    return points


def letter_labels(system, memory) -> tuple[Labels, ...]:
    """Labels before the numbers in a block of the memory: decided mode, indicator."""
    modes = (Labels(system.modes),) if memory.estimates else ()
    return modes + ((Labels(system.indicators),) if memory.indicators else ())


def _listed(axes: tuple[Axis | Labels, ...]) -> str:
    return "; ".join(map(str, axes))


def summary(filter) -> str:
    """A filter of tables in words."""
    predicted, times = filter.predicted, filter.times
    made = "densities on a grid, without random numbers"
    if not filter.design.exact:
        made = f"{filter.design.paths} paths, seed {filter.design.entropy}"
    later = "none after the last time"
    if filter.lasting:
        moved, modes = filter.change
        later = (
            "the last table serves all; over its last step it changed by "
            f"{moved:.2g} of the error and {modes:.2g} in the mode"
        )
    lines = [
        f"Filter of {filter.system.modes} modes, of order {filter.order}: {filter.memory}",
        f"  by           tables ({filter.method}) over {_listed(filter.tables[-1].shown.axes)}",
        f"  size         {filter.bytes / 1e3:.0f} kB in {len(filter.tables)} tables",
        f"  measurements {len(times)}, from {times[0]:g} to {times[-1]:g}",
        f"  later times  {later}",
        f"  designed on  {made}",
        "  predicted root-mean-square errors and probability of a wrong mode"
        + ("" if filter.design.exact else " (with standard errors)"),
        *held_out_words(filter.held_out),
    ]
    at = np.arange(len(times))
    if len(at) > ROWS:
        at = at[np.linspace(0, len(at) - 1, ROWS).astype(int)]
    for j in at:
        pairs = [*zip(predicted.rms[j], predicted.error[j], strict=True)]
        pairs.append((predicted.mode_rate[j], predicted.mode_error[j]))
        row = "  ".join(
            f"{value:.4f}" + ("" if filter.design.exact else f" ± {error:.4f}")
            for value, error in pairs
        )
        lines += with_held_out(f"    t = {times[j]:<8g} {row}", filter.held_out, j)
    return "\n".join(lines)
