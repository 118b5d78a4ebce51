"""Simulated paths that carry a filter's memory, in sets that teach its functions in turn."""

from __future__ import annotations

import warnings
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from seedslib.base.blocks import BLOCK, as_count, as_seed_sequence, seed_record
from seedslib.design.paths.held_out import examined
from seedslib.design.paths.walk import crew
from seedslib.designed.finite_order_rules import Design, Prediction
from seedslib.designed.memory import Memory, Past
from seedslib.models.kinds import as_grid, in_steps

LARGEST = 1e50
"""A state beyond this has no fourth power worth averaging."""


class Lesson(NamedTuple):
    """What a function is fitted to at one time.

    Attributes
    ----------
    states : ndarray, shape (n, N)
    measurements : ndarray, shape (m, N), or None
        None between measurements.
    memory : ndarray, shape (d, N)
    """

    states: np.ndarray
    measurements: np.ndarray | None
    memory: np.ndarray


class _Paths(NamedTuple):
    """One set of paths: states by time, measurements (K+1, m, N), modes, indicators (K+1, N)."""

    states: dict
    measurements: np.ndarray
    modes: np.ndarray | None = None
    indicators: np.ndarray | None = None


class Carriers:
    """Sets of design paths with the memory that a filter has on them.

    The function for measurement k is fitted to the paths of one set and applied to those of all;
    the next one is fitted to the next set. So the memory of the paths that a function is fitted to
    comes from functions that have not seen them, but for those of a whole round before, and the
    errors of a function are taken on the set after its own.

    Parameters
    ----------
    system : JumpDiffusion
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

    def __init__(self, system, memory, times, components, paths, sets, nodes, seed, workers):
        if not isinstance(memory, Memory):
            raise TypeError(f"memory: wanted a Memory, got {memory!r}")
        self._check_memory(system, memory)
        n = system.state_size
        components = n if components is None else as_count("components", components)
        if components > n:
            raise ValueError(f"components: wanted 1 to {n}, got {components}")
        if as_count("sets", sets) < 2:
            raise ValueError(f"sets: wanted at least 2, got {sets}")
        self.memory, self.components, self.workers = memory, components, workers
        self.times, self.root = as_grid("times", times, system), as_seed_sequence(seed)
        self.paths, self.lost = as_count("paths", paths), 0
        # a system in discrete time has no states between
        parts = 1 if nodes == 0 or in_steps(system) else as_count("nodes", nodes) + 1
        self.stops = tuple(
            np.append(a + (b - a) * np.arange(1, parts) / parts, b) for a, b in pairwise(self.times)
        )
        self.streams = self.root.spawn(sets + 1)
        self.sets = [self._simulated(system, s, workers) for s in self.streams[:sets]]
        if self.lost:
            warnings.warn(
                f"paths: {self.lost} of {paths * sets} design paths diverged and were left out",
                stacklevel=3,
            )
        self.pasts, self.reached = [Past()] * sets, -1
        self.scores, self.errors = [], []

    def _check_memory(self, system, memory):
        if memory.indicators or memory.log_odds:
            raise ValueError(f"memory: wanted estimates and measurements, got {memory}")

    def _simulated(self, system, seed, workers):
        grid = np.concatenate([self.times[:1], *self.stops])
        at = np.searchsorted(grid, self.times)
        made = system.simulate(grid, self.paths, seed, measured=at, workers=workers)
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
        """What the function for the next measurement is fitted to."""
        k = self.reached + 1
        return self._lesson(k % len(self.sets), k, self.times[k])

    def forecast_lesson(self, t: float) -> Lesson:
        """What a forecast for a time up to the next measurement is fitted to."""
        return self._lesson((self.reached + 1) % len(self.sets), None, t)

    def _lesson(self, which, k, t):
        chosen, past = self.sets[which], self.pasts[which]
        x = chosen.states[float(t)]
        shown = None if k is None else chosen.measurements[k]
        u = past.vector if self.reached >= 0 else np.empty((0, x.shape[1]))
        return Lesson(x, shown, u)

    def take(self, output) -> None:
        """Apply the function of the next measurement, ``output(y, u)``, on all paths."""
        k = self.reached + 1
        examiner, t = (k + 1) % len(self.sets), float(self.times[k])
        for which, chosen in enumerate(self.sets):
            lesson = self._lesson(which, k, t)
            estimate = output(lesson.measurements, lesson.memory)
            if which == examiner:
                error = chosen.states[t][: self.components] - estimate
                self.scores.append((t, error**2))
                self.errors.append(error @ error.T / error.shape[1])
            self.pasts[which] = self.memory.push(
                self.pasts[which], estimate=estimate, measurement=lesson.measurements
            )
        self.reached = k

    def score(self, t: float, forecast) -> None:
        """Note the errors of a forecast, ``forecast(u)``, at a node."""
        x, _, u = self._lesson((self.reached + 2) % len(self.sets), None, t)
        self.scores.append((float(t), (x[: self.components] - forecast(u)) ** 2))

    @property
    def covariances(self) -> np.ndarray:
        """Error covariances after each measurement, (K+1, n', n')."""
        return np.array(self.errors)

    def prediction(self) -> Prediction:
        """Root-mean-square errors and their standard errors."""
        times = np.array([t for t, _ in self.scores])
        mse = np.array([square.mean(axis=1) for _, square in self.scores])
        deviation = np.array(
            [square.std(axis=1) / np.sqrt(square.shape[1]) for _, square in self.scores]
        )
        rms = np.sqrt(mse)
        error = np.divide(deviation, 2.0 * rms, out=np.zeros_like(rms), where=rms > 0)
        return Prediction(times, rms, error, False)

    def examined(self, filter):
        """The finished filter with its errors on other paths than those of all sets."""
        stops = np.concatenate([self.times[:1], *self.stops])
        with crew(self.workers) as each:
            return examined(filter, self.root, self.paths, each, stops, bound=LARGEST)

    def design(self) -> Design:
        """Record of how the paths were made."""
        count, root = self.paths * len(self.sets), self.root
        return Design(count, BLOCK, *seed_record(root), self.lost, False)
