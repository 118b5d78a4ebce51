"""Synthesis of filters of switching systems on simulated paths: tables by regression."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.design.tables.carriers import Carriers
from seedslib.design.tables.regression import (
    METHODS,
    likelihood_sums,
    mesh,
    path_sums,
    smoothed_ratio,
    widths,
)
from seedslib.designed.lookup import ModeTable, StepTables, arguments, step_axes
from seedslib.designed.memory import Past
from seedslib.designed.prediction import SwitchingPrediction
from seedslib.designed.switching_table import SwitchingTableFilter
from seedslib.filters.weights import most_probable


class SwitchingLesson(NamedTuple):
    """What the functions of a measurement are fitted to, or tried on.

    Attributes
    ----------
    states : ndarray, shape (n, N)
    modes : ndarray of int, shape (N,)
    measurements : ndarray, shape (m, N)
    indicators : ndarray of int, shape (N,), or None
    past : Past
    """

    states: np.ndarray
    modes: np.ndarray
    measurements: np.ndarray
    indicators: np.ndarray | None
    past: Past


class SwitchingCarriers(Carriers):
    """Sets of design paths of a switching system with the memory that a filter has on them.

    As `Carriers`: each function is fitted to one set of paths, tried on the next one and applied
    to all.
    """

    def __init__(self, system, memory, times, components, paths, sets, seed, workers):
        super().__init__(system, memory, times, components, paths, sets, 0, seed, workers)
        self.wrong, self.changes, self.before = [], [], None

    def _check_memory(self, system, memory):
        told = memory.indicators
        if (
            bool(memory.estimates) == bool(memory.measurements)
            or memory.log_odds
            or (told and not system.has_indicator)
            or told not in (0, memory.depth)
        ):
            raise ValueError(f"memory: wanted estimates or measurements alone, got {memory}")

    def lesson(self, which=None) -> SwitchingLesson:
        """What the functions for the next measurement are fitted to."""
        k = self.reached + 1
        which = k % len(self.sets) if which is None else which
        chosen = self.sets[which]
        told = None if chosen.indicators is None else chosen.indicators[k]
        return SwitchingLesson(
            chosen.states[float(self.times[k])], chosen.modes[k], chosen.measurements[k], told,
            self.pasts[which],
        )  # fmt: skip

    def take(self, system, table) -> None:
        """Apply the functions of the next measurement on all paths and note their errors."""
        k = self.reached + 1
        examiner = (k + 1) % len(self.sets)
        for which in range(len(self.sets)):
            lesson = self.lesson(which)
            points = arguments(
                system, self.memory, lesson.measurements, lesson.indicators, lesson.past
            )
            mean, mode, _ = table.look_up(points, lesson.modes.shape)
            if which == examiner:
                error = lesson.states[: self.components] - mean
                self.scores.append((self.times[k], error**2))
                self.errors.append(error @ error.T / error.shape[1])
                self.wrong.append(mode != lesson.modes)
                self._note_change(table, points, mean, mode)
            self.pasts[which] = self.memory.push(
                self.pasts[which], estimate=mean, measurement=lesson.measurements, mode=mode,
                indicator=lesson.indicators,
            )  # fmt: skip
        self.reached, self.before = k, table

    def _note_change(self, table, points, mean, mode):
        """How far estimates and modes are from those of the table before."""
        change = (np.nan, np.nan)
        if self.before is not None and self.before.axes == table.axes:
            old, other, _ = self.before.look_up(points, mode.shape)
            change = np.sqrt(((mean - old) ** 2).sum(axis=0).mean()), (mode != other).mean()
        self.changes.append(change)

    def prediction(self) -> SwitchingPrediction:
        """Errors and their standard errors on paths that each function has not seen."""
        found = super().prediction()
        wrong = np.array([part.mean() for part in self.wrong])
        count = np.array([len(part) for part in self.wrong])
        error = np.sqrt(wrong * (1.0 - wrong) / count)
        return SwitchingPrediction(found.times, found.rms, found.error, wrong, error)


def switching_tables(
    system, carriers, axes_y, axes_z, method, kernel, probabilities
) -> SwitchingTableFilter:
    """Tables by regression on the paths of the carriers; see `simulated_synthesis`."""
    memory, steps = carriers.memory, []
    letters = axes_z if memory.estimates else axes_y
    for k, t in enumerate(carriers.times):
        axes = step_axes(system, memory, axes_y, letters, min(k, memory.depth))
        lesson = carriers.lesson()
        fitted = _likely if method == "likelihood" else _counted
        shown = fitted(system, float(t), lesson, carriers, axes, len(axes_y), kernel)
        blind = _counted(system, float(t), lesson, carriers, axes, 0, kernel)
        steps.append(StepTables(_table(axes[0], shown, system), _table(axes[1], blind, system)))
        carriers.take(system, steps[-1].shown)
    if not probabilities:
        steps = [StepTables(*(table._replace(prob=None) for table in step)) for step in steps]
    return carriers.examined(SwitchingTableFilter(
        system=system, memory=memory, times=carriers.times, tables=tuple(steps),
        method=METHODS[method], predicted=carriers.prediction(),
        changes=np.array(carriers.changes).T, covariances=carriers.covariances,
        design=carriers.design(),
    ))  # fmt: skip


def _table(axes, found, system):
    """Table of what regression found, (L + n', counts...): probabilities, then estimates."""
    prob, means = np.split(found, [system.modes])
    return ModeTable(axes, means, most_probable(prob).astype(np.int8), prob)


def _targets(lesson, system, components):
    """What is regressed: which mode it is, and the state, (L + n', N)."""
    which = lesson.modes == np.arange(system.modes)[:, None]
    return np.concatenate([which, lesson.states[:components]])


def _counted(system, t, lesson, carriers, axes, measured, kernel):
    """Smoothed histogram over indicator, the measurement's axes if wanted, and memory."""
    y = lesson.measurements if measured else ()
    axes = axes[0] if measured else axes[1]
    targets = _targets(lesson, system, carriers.components)
    points = arguments(system, carriers.memory, y, lesson.indicators, lesson.past)
    points = np.array(points, dtype=float).reshape(len(axes), targets.shape[1])
    sums = path_sums(targets, points, axes)
    if system.has_indicator:
        # all paths together stand for a missing indicator
        sums[:, -1] = sums[:, :-1].sum(axis=1)
    return smoothed_ratio(sums, sums[0], widths(points, axes, kernel), 0)


def _likely(system, t, lesson, carriers, axes, measured, kernel):
    """Regression in the memory alone, weighted by the likelihoods of measurement and indicator."""
    told = 1 if system.has_indicator else 0
    axes_y, axes_u = axes[0][told : told + measured], axes[0][told + measured :]
    targets = _targets(lesson, system, carriers.components)
    points = arguments(system, carriers.memory, (), lesson.indicators, lesson.past)[told:]
    points = np.array(points, dtype=float).reshape(len(axes_u), targets.shape[1])
    rows = np.concatenate([np.ones((1, targets.shape[1])), targets])
    grid = mesh(axes_y)[:, None, :]
    values = [*range(system.indicators), -1] if told else [0]

    def log_density(part):
        mode, x = lesson.modes[part], lesson.states[:, part, None]
        found = np.full((len(mode), len(values), grid.shape[2]), -np.inf)
        for i in range(system.modes):
            here = np.flatnonzero(mode == i)
            state = np.broadcast_to(x[:, here], (len(x), len(here), grid.shape[2]))
            for place, j in enumerate(values):
                reading = system.sensors[i] if j < 0 else system.readings[i][j]
                if reading is not None and here.size:
                    found[here, place] = reading.log_density(t, grid, state)
        return found.reshape(len(mode), -1)

    sums = likelihood_sums(log_density, len(values) * grid.shape[2], rows, points, axes_u)
    shape = [axis.count for axis in axes[0]]
    counts = path_sums(targets[:0], points, axes_u)[0]
    wide = widths(points, axes_u, kernel)
    return smoothed_ratio(sums.reshape(-1, *shape), counts, wide, told + measured)


def want_densities(system) -> None:
    """Refuse a sensor whose likelihood has no closed form.

    Raises
    ------
    ValueError
    """
    if not all(b is None or b.has_log_density for row in system.readings for b in row):
        raise ValueError("method: likelihood wants a sensor with a log-density; use histogram")
