"""Simulated paths with the memory that a filter has on them, in sets that are fitted to in turn."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, MaybeArray, Seed
from seedslib.base.blocks import BLOCK, as_seed_sequence, seed_record
from seedslib.base.checks import as_count, outside
from seedslib.design.held_out import with_held_out
from seedslib.design.regression import root_mean_squares, scatter
from seedslib.designed.accuracy import Accuracy, Design
from seedslib.designed.memory import Memory, Past
from seedslib.designed.tables import Output, OutputFunction, arguments, require_like_blocks
from seedslib.models.kinds import AnySystem, as_grid, switches

LARGEST = 1e50
"""A state beyond this has no fourth power worth averaging."""


class Sample(NamedTuple):
    """What a function is fitted to, or validated on, at one time.

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

    def arguments(self, system: AnySystem, measured: bool = True) -> list[np.ndarray]:
        """Arguments of an output function, see `seedslib.designed.tables.arguments`."""
        y = self.measurements if measured else ()
        return arguments(system, y, self.indicators, self.past)

    def output(self, system: AnySystem, function: OutputFunction) -> Output:
        """Values of an output function."""
        return function(self.arguments(system)).on(self.states.shape[1:])


class _Paths(NamedTuple):
    """One set: states (K+1, n, N), measurements (K+1, m, N), modes and indicators (K+1, N)."""

    states: np.ndarray
    measurements: np.ndarray
    modes: MaybeArray = None
    indicators: MaybeArray = None


class MemoryPaths:
    """Sets of design paths with the memory that a filter has on them.

    The function for measurement k is fitted to the paths of one set and applied to those of all;
    the next one is fitted to the next set. So the memory of the paths that a function is fitted to
    comes from functions that have not seen them, but for those of a whole round before, and the
    errors of a function are taken on the set after its own, the validation set. With one set all
    errors are in-sample.

    Parameters
    ----------
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
    memory : Memory
    times : array_like, shape (K+1,)
    paths : int
        In each set.
    sets : int
    seed : int, SeedSequence or Generator
    workers : int

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    spare : SeedSequence
        A stream that no path has.

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
        paths: Count,
        sets: int,
        seed: Seed,
        workers: int,
    ) -> None:
        if not isinstance(memory, Memory):
            raise TypeError(f"memory: wanted a Memory, got {memory!r}")
        if switches(system):
            require_like_blocks(memory, system.indicators)
        elif memory.indicators or memory.log_odds:
            raise ValueError(f"memory: wanted estimates and measurements, got {memory}")
        self.system, self.memory, self.workers = system, memory, workers
        self.times, self._root = as_grid("times", times, system), as_seed_sequence(seed)
        self.paths, self.diverged = as_count("paths", paths), 0
        streams = [self._root] if sets == 1 else self._root.spawn(sets + 1)
        self.spare: np.random.SeedSequence = streams[-1]
        self.sets: list[_Paths] = [self._simulated(stream) for stream in streams[:sets]]
        if self.diverged:
            warnings.warn(
                f"paths: {self.diverged} of {paths * sets} design paths diverged and were left out",
                stacklevel=outside(),
            )
        self._pasts, self._k = [Past()] * sets, 0  # the next measurement
        self._scores, self._errors, self._wrong = [], [], []

    def _simulated(self, stream):
        data = self.system.simulate(self.times, self.paths, stream, workers=self.workers)
        y = data.measurements
        with np.errstate(invalid="ignore"):
            good = (np.abs(data.states) <= LARGEST).all(axis=(0, 1))
        good &= np.isfinite(y).all(axis=(0, 1))
        diverged = int(np.count_nonzero(~good))
        if diverged == self.paths:
            raise ValueError("paths: wanted some that stay finite, got none")
        self.diverged += diverged
        good = good if diverged else slice(None)
        labels = (None if part is None else part[:, good] for part in (data.modes, data.indicators))
        return _Paths(data.states[..., good], y[..., good], *labels)

    def sample(self) -> Sample:
        """What the function of the next measurement is fitted to."""
        return self._sample(self._k % len(self.sets))

    def _sample(self, number: int) -> Sample:
        """Of one of the sets."""
        k, paths = self._k, self.sets[number]
        labels = (None if part is None else part[k] for part in (paths.modes, paths.indicators))
        return Sample(paths.states[k], paths.measurements[k], self._pasts[number], *labels)

    def apply(self, function: OutputFunction) -> None:
        """Apply the function of the next measurement on all paths, and note its errors."""
        for number in range(len(self.sets)):
            sample = self._sample(number)
            output = sample.output(self.system, function)
            if number == (self._k + 1) % len(self.sets):
                error = sample.states - output.mean
                self._scores.append((float(self.times[self._k]), error**2))
                self._errors.append(error @ error.T / error.shape[1])
                if output.mode is not None:
                    self._wrong.append(output.mode != sample.modes)
            self._pasts[number] = self.memory.push(
                self._pasts[number],
                estimate=output.mean,
                measurement=sample.measurements,
                mode=output.mode,
                indicator=sample.indicators,
            )
        self._k += 1

    def designed(self, kind: Callable[..., Any], **fields: Any) -> Any:
        """The filter of the functions, with its errors on the paths and on held-out ones."""
        in_sample = len(self.sets) == 1
        filter = kind(
            system=self.system,
            memory=self.memory,
            times=self.times,
            predicted=prediction_of(self._scores, self._wrong, in_sample=in_sample),
            covariances=np.array(self._errors),
            design=Design(
                self.paths * len(self.sets), BLOCK, *seed_record(self._root), self.diverged
            ),
            **fields,
        )
        return with_held_out(filter, self._root, self.paths, self.workers)


def prediction_of(
    scores: Sequence[tuple[float, np.ndarray]],
    wrong: Sequence[np.ndarray],
    *,
    in_sample: bool = False,
) -> Accuracy:
    """Errors and their standard errors from those of single paths.

    Parameters
    ----------
    scores : sequence of (time, squares of shape (n', N))
    wrong : sequence of ndarray of bool, shape (N,)
        Where a decision was wrong; none for a system without modes.
    in_sample : bool
        Whether the functions were fitted to these paths.
    """
    times = np.array([t for t, _ in scores])
    moments = [root_mean_squares(scatter(square), len(square)) for _, square in scores]
    rms, error = (np.array(part) for part in list(zip(*moments, strict=True))[:2])
    if not len(wrong):
        return Accuracy(times, rms, error, in_sample)
    rate = np.array([part.mean() for part in wrong])
    count = np.array([len(part) for part in wrong])
    return Accuracy(times, rms, error, in_sample, rate, np.sqrt(rate * (1.0 - rate) / count))
