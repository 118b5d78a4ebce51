"""Tables that are fitted to simulated paths: by counting them, or by their likelihoods."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from seedslib.base.tables import mesh
from seedslib.design.tables.carriers import Lesson
from seedslib.design.tables.regression import histogram_table, likelihood_table
from seedslib.designed.outputs.lookup import Table
from seedslib.filters.weights import most_probable
from seedslib.models.kinds import AnySystem, switches


def counted(carriers: Any, lesson: Lesson, axes: Any, kernel: float, blind: bool = False) -> Table:
    """Smoothed histogram over indicator, measurement unless blind, and memory."""
    targets, points = _targets(carriers, lesson), _points(carriers, lesson, axes, blind)
    pooled = carriers.system.indicators > 0
    return _table(carriers, axes, histogram_table(targets, points, axes, kernel, pooled))


def likely(
    carriers: Any, t: float, lesson: Lesson, axes: Any, kernel: float, all_axes: Any = (),
    rows: Any = None,
) -> Table:  # fmt: skip
    """Regression in the memory alone, weighted by the likelihoods of measurement and indicator.

    Of some components of the measurement, `rows`, whose likelihood is summed over the axes of all.
    """
    targets, told = _targets(carriers, lesson), carriers.system.indicators > 0
    measured = told + len(lesson.measurements if rows is None else rows)
    if rows is None or len(rows) == len(all_axes):
        log_density = _log_density(carriers.system, t, lesson, axes[told:measured])
    else:
        whole = _log_density(carriers.system, t, lesson, all_axes)
        log_density = partial(_summed, whole, [axis.count for axis in all_axes], rows)
    held = axes[measured:]
    points = _points(carriers, lesson, held, blind=True)
    found = likelihood_table(log_density, targets, points, axes[:measured], held, kernel)
    return _table(carriers, axes, found)


def _points(carriers, lesson, axes, blind) -> np.ndarray:
    """Arguments over the axes, the last ones of the function, (d, N)."""
    points = lesson.points(carriers.system, blind)
    points = np.array(points[len(points) - len(axes) :], dtype=float)
    return points.reshape(len(axes), lesson.states.shape[1])


def _log_density(system, t, lesson, axes):
    """Logarithm of the density of indicator and measurement on a grid, for a slice of the paths."""
    grid, x = mesh(axes)[:, None, :], lesson.states
    if not switches(system):
        return lambda part: system.sensor.log_density(t, grid, x[:, part, None])
    values = [*range(system.indicators), -1] if system.indicators else [0]

    def log_density(part):
        mode, state = lesson.modes[part], x[:, part, None]
        found = np.full((len(mode), len(values), grid.shape[2]), -np.inf)
        for i in range(system.modes):
            here = np.flatnonzero(mode == i)
            there = np.broadcast_to(state[:, here], (len(x), len(here), grid.shape[2]))
            for place, j in enumerate(values):
                reading = system.sensors[i] if j < 0 else system.readings[i][j]
                if reading is not None and here.size:
                    found[here, place] = reading.log_density(t, grid, there)
        return found.reshape(len(mode), -1)

    return log_density


def _summed(log_density, counts, rows, part):
    """Logarithm of a density, (paths, nodes), of some components, but for a factor."""
    found = log_density(part)
    found = found.reshape(len(found), -1, *counts)
    others = tuple(2 + i for i in range(len(counts)) if i not in rows)
    for axis in reversed(others):
        found = np.logaddexp.reduce(found, axis=axis)
    return found.reshape(len(found), -1)


def sensors_of(system: AnySystem) -> list[Any]:
    """All that may be measured; None for a reading that never comes."""
    if not switches(system):
        return [system.sensor]
    return [reading for row in system.readings for reading in row]


def _targets(carriers, lesson) -> np.ndarray:
    """What is regressed: which mode it is, where there are modes, and the state, (L + n', N)."""
    states = lesson.states[: carriers.components]
    if lesson.modes is None:
        return states
    return np.concatenate([lesson.modes == np.arange(carriers.system.modes)[:, None], states])


def _table(carriers, axes, found) -> Table:
    """Table of what regression found: probabilities, where there are modes, then estimates."""
    if not switches(carriers.system):
        return Table(axes, found)
    prob, means = np.split(found, [carriers.system.modes])
    return Table(axes, means, most_probable(prob).astype(np.int8), prob)
