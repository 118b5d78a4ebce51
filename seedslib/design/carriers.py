"""Simulated paths that carry a filter's memory, in sets that teach its functions in turn."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, MaybeArray, Seed
from seedslib.base.blocks import BLOCK, as_seed_sequence, seed_record
from seedslib.base.checks import as_count
from seedslib.base.tables import mesh
from seedslib.design.held_out import with_held_out
from seedslib.design.kernels import histogram_table, likelihood_table
from seedslib.design.regression import root_mean_squares, scatter
from seedslib.designed.accuracy import Design, Prediction
from seedslib.designed.memory import Memory, Past
from seedslib.designed.tables import Table, arguments, require_like_blocks
from seedslib.filters.weights import most_probable
from seedslib.models.kinds import AnySystem, as_grid, in_steps, switches

LARGEST = 1e50
"""A state beyond this has no fourth power worth averaging."""


class Lesson(NamedTuple):
    """What a function is fitted to, or tried on, at one time.

    Attributes
    ----------
    states : ndarray, shape (n, N)
    measurements : ndarray, shape (m, N), or None
        None between measurements.
    past : Past
    modes : ndarray of int, shape (N,), or None
        Of a system with modes.
    indicators : ndarray of int, shape (N,), or None
    """

    states: np.ndarray
    measurements: MaybeArray
    past: Past
    modes: MaybeArray = None
    indicators: MaybeArray = None

    @property
    def memory(self) -> np.ndarray:
        """Estimates, newest first, then measurements, newest first, (d, N)."""
        past = self.past
        if past.estimates or past.measurements:
            return past.vector
        return np.empty((0, self.states.shape[1]))

    def points(self, system: AnySystem, blind: bool = False) -> list[Any]:
        """Arguments of an output function, see `seedslib.designed.tables.arguments`."""
        y = () if blind or self.measurements is None else self.measurements
        return arguments(system, y, self.indicators, self.past)


class _Paths(NamedTuple):
    """One set of paths: states by time, measurements (K+1, m, N), modes, indicators (K+1, N)."""

    states: dict[Any, Any]
    measurements: np.ndarray
    modes: MaybeArray = None
    indicators: MaybeArray = None


class Carriers:
    """Sets of design paths with the memory that a filter has on them.

    The function for measurement k is fitted to the paths of one set and applied to those of all;
    the next one is fitted to the next set. So the memory of the paths that a function is fitted to
    comes from functions that have not seen them, but for those of a whole round before, and the
    errors of a function are taken on the set after its own.

    Parameters
    ----------
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
    memory : Memory
    times : array_like, shape (K+1,)
    components : int, optional
    paths : int
        In each set.
    sets : int
        At least 2.
    nodes : int
        Number of evenly spaced times inside each interval.
    seed : int, SeedSequence or Generator
    workers : int

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    stops : tuple of ndarray
        Nodes and end of each interval.
    components : int
    root : SeedSequence

    Raises
    ------
    TypeError, ValueError
        An argument that does not fit; no path that stays finite.
    """

    def __init__(
        self,
        system: AnySystem,
        memory: Memory,
        times: ArrayLike,
        components: int | None,
        paths: Count,
        sets: int,
        nodes: Any,
        seed: Seed,
        workers: int,
    ) -> None:
        if not isinstance(memory, Memory):
            raise TypeError(f"memory: wanted a Memory, got {memory!r}")
        if switches(system):
            require_like_blocks(memory, system.indicators)
        elif memory.indicators or memory.log_odds:
            raise ValueError(f"memory: wanted estimates and measurements, got {memory}")
        n = system.state_size
        components = n if components is None else as_count("components", components, 1, n)
        as_count("sets", sets, 2)
        self.system, self.memory = system, memory
        self.components, self.workers = components, workers
        self.times, self.root = as_grid("times", times, system), as_seed_sequence(seed)
        self.paths, self.lost = as_count("paths", paths), 0
        # a system in discrete time has no states between
        parts = 1 if nodes == 0 or in_steps(system) else as_count("nodes", nodes) + 1
        self.stops: tuple[np.ndarray, ...] = tuple(
            np.append(a + (b - a) * np.arange(1, parts) / parts, b) for a, b in pairwise(self.times)
        )
        self.streams: list[Any] = self.root.spawn(sets + 1)
        self.sets: list[Any] = [self._simulated(s) for s in self.streams[:sets]]
        if self.lost:
            warnings.warn(
                f"paths: {self.lost} of {paths * sets} design paths diverged and were left out",
                stacklevel=3,
            )
        self.pasts, self.reached = [Past()] * sets, -1
        self.scores, self.errors, self.wrong = [], [], []

    def _simulated(self, seed):
        grid = np.concatenate([self.times[:1], *self.stops])
        at = np.searchsorted(grid, self.times)
        made = self.system.simulate(grid, self.paths, seed, measured=at, workers=self.workers)
        shown = made.measurements[at]
        with np.errstate(invalid="ignore"):
            good = (np.abs(made.states) <= LARGEST).all(axis=(0, 1))
        good &= np.isfinite(shown).all(axis=(0, 1))
        lost = int(np.count_nonzero(~good))
        if lost == self.paths:
            raise ValueError("paths: wanted some that stay finite, got none")
        self.lost += lost
        kept = good if lost else slice(None)
        states = {float(t): x[:, kept] for t, x in zip(grid, made.states, strict=True)}
        labels = (
            None if part is None else part[at][:, kept] for part in (made.modes, made.indicators)
        )
        return _Paths(states, shown[..., kept], *labels)

    def lesson(self) -> Lesson:
        """What the functions for the next measurement are fitted to."""
        return self._lesson(self.reached + 1)

    def forecast_lesson(self, t: float) -> Lesson:
        """What a forecast for a time up to the next measurement is fitted to."""
        return self._lesson(self.reached + 1, t)

    def _lesson(self, which, t=None):
        """Of one of the sets, counted on and on, at the next measurement or at a time before it."""
        which, k = which % len(self.sets), self.reached + 1
        chosen, past = self.sets[which], self.pasts[which]
        if t is not None:
            return Lesson(chosen.states[float(t)], None, past)
        labels = (None if part is None else part[k] for part in (chosen.modes, chosen.indicators))
        states = chosen.states[float(self.times[k])]
        return Lesson(states, chosen.measurements[k], past, *labels)

    def take(self, function: Any) -> None:
        """Apply the function of the next measurement on all paths, and note its errors."""
        k = self.reached + 1
        examiner = (k + 1) % len(self.sets)
        for which in range(len(self.sets)):
            lesson = self._lesson(which)
            points, batch = lesson.points(self.system), lesson.states.shape[1:]
            found = function(points).on(batch)
            if which == examiner:
                error = lesson.states[: self.components] - found.mean
                self.scores.append((float(self.times[k]), error**2))
                self.errors.append(error @ error.T / error.shape[1])
                if found.mode is not None:
                    self.wrong.append(found.mode != lesson.modes)
            self.pasts[which] = self.memory.push(
                self.pasts[which],
                estimate=found.mean,
                measurement=lesson.measurements,
                mode=found.mode,
                indicator=lesson.indicators,
            )
        self.reached = k

    def score(self, t: float, forecast: Any) -> None:
        """Note the errors of a forecast, a function of the memory, at a node."""
        lesson = self._lesson(self.reached + 2, t)
        error = lesson.states[: self.components] - forecast(lesson.points(self.system)).mean
        self.scores.append((float(t), error**2))

    @property
    def covariances(self) -> np.ndarray:
        """Error covariances after each measurement, (K+1, n', n')."""
        return np.array(self.errors)

    def prediction(self) -> Prediction:
        """Errors and their standard errors on paths that each function has not seen."""
        return prediction_of(self.scores, self.wrong)

    def examined(self, filter: Any) -> Any:
        """The finished filter with its errors on other paths than those of all sets."""
        return with_held_out(filter, self.root, self.paths, self.workers)

    def design(self) -> Design:
        """Record of how the paths were made."""
        count, root = self.paths * len(self.sets), self.root
        return Design(count, BLOCK, *seed_record(root), self.lost, False)


def prediction_of(
    scores: Sequence[tuple[Any, ...]], wrong: Sequence[Any], *, in_sample: bool = False
) -> Prediction:
    """Errors and their standard errors from those of single paths.

    Parameters
    ----------
    scores : sequence of (time, squares of shape (n', N))
    wrong : sequence of ndarray of bool, shape (N,)
        Where a decision was wrong; none for a system without modes.
    in_sample : bool
        Whether the functions were made of these paths.
    """
    times = np.array([t for t, _ in scores])
    moments = [root_mean_squares(scatter(square), len(square)) for _, square in scores]
    rms, error = (np.array(part) for part in list(zip(*moments, strict=True))[:2])
    if not len(wrong):
        return Prediction(times, rms, error, in_sample)
    rate = np.array([part.mean() for part in wrong])
    count = np.array([len(part) for part in wrong])
    return Prediction(times, rms, error, in_sample, rate, np.sqrt(rate * (1.0 - rate) / count))


def counted(carriers: Any, lesson: Lesson, axes: Any, kernel: float, blind: bool = False) -> Table:
    """Smoothed histogram over indicator, measurement unless blind, and memory."""
    targets, points = _targets(carriers, lesson), _points(carriers, lesson, axes, blind)
    pooled = carriers.system.indicators > 0
    return _table(carriers, axes, histogram_table(targets, points, axes, kernel, pooled))


def likely(carriers: Any, t: float, lesson: Lesson, axes: Any, kernel: float) -> Table:
    """Regression in the memory alone, weighted by the likelihoods of measurement and indicator."""
    targets, first = _targets(carriers, lesson), int(carriers.system.indicators > 0)
    last = first + len(lesson.measurements)
    log_density = _log_density(carriers.system, t, lesson, axes[first:last])
    points = _points(carriers, lesson, axes[last:], blind=True)
    found = likelihood_table(log_density, targets, points, axes[:last], axes[last:], kernel)
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
