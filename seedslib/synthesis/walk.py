"""Paths of a system that move forward together, in fixed blocks, for a design."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np

from seedslib.synthesis.regression import merge, scatter
from seedslib.systems.simulation import BLOCK, as_count

LARGEST = 1e100
"""A state beyond this has no square worth averaging."""


@contextmanager
def crew(workers):
    """Map over blocks, on a pool of threads where there are workers for it."""
    workers = as_count("workers", workers)
    if workers == 1:
        yield lambda work, *lists: list(map(work, *lists))
        return
    with ThreadPoolExecutor(workers) as pool:
        yield lambda work, *lists: list(pool.map(work, *lists))


class Walk:
    """Paths block by block, with the random streams of `seedslib.systems.simulation`.

    The states at the stops are those of ``system.simulate(stops, paths, seed)``. A path that
    leaves the range of numbers is left out of all averages from then on; a harmless state stands
    in its place, so that the streams of the others do not shift.

    Parameters
    ----------
    system : JumpDiffusion
    paths : int
    root : SeedSequence
    stops : int
        Number of times to stop at, the first included.
    each : callable
        Map over blocks, see `crew`.
    options : mapping
        Of ``system.advance``.
    bound : float
        Largest believable component.
    """

    def __init__(self, system, paths, root, stops, each, options, bound):
        self.system, self.each, self.options = system, each, options
        self.bound, self.n = min(bound, LARGEST), system.state_size
        self.counts = [min(BLOCK, paths - a) for a in range(0, paths, BLOCK)]
        children = [stream.spawn(stops) for stream in root.spawn(len(self.counts))]
        self.children = zip(*children, strict=True)
        self.states, self.alive, self.sensing = [], [], []

    @property
    def lost(self) -> int:
        """Number of paths left out."""
        return sum(int(np.count_nonzero(~alive)) for alive in self.alive)

    def begin(self, t):
        """Draw the initial states."""
        moving = self._streams()
        self.states = self.each(self.system.initial_sample, moving, self.counts)
        self.alive = [np.ones(count, dtype=bool) for count in self.counts]
        self._look()

    def advance(self, start, stop):
        """Move all paths to a later time."""
        self.states = self.each(
            lambda x, rng: self.system.advance(x, start, stop, rng, **self.options),
            self.states,
            self._streams(),
        )
        self._look()

    def measure(self, t) -> list:
        """What the sensor shows, (m, paths) for each block."""
        shown = self.each(
            lambda x, rng: self.system.sensor.sample(t, x, rng), self.states, self.sensing
        )
        self.leave_out(shown)
        return shown

    def leave_out(self, arrays):
        """Leave out the paths with a column that is not finite, and put zeros in its place."""
        for values, alive in zip(arrays, self.alive, strict=True):
            finite = np.isfinite(values).all(axis=0)
            if not finite.all():
                alive &= finite
                values[:, ~finite] = 0.0

    def gather(self, rows, *lists):
        """Moments of ``rows(x, *others)``, (p, paths), over the paths that are left."""

        def reduce(x, alive, *others):
            found = rows(x, *others)
            return scatter(found if alive.all() else found[:, alive])

        total = merge(self.each(reduce, self.states, self.alive, *lists))
        if total.count < 2:
            raise ValueError(f"paths: wanted at least 2 that stay finite, got {total.count}")
        return total

    def _streams(self):
        pairs = [child.spawn(2) for child in next(self.children)]
        self.sensing = [np.random.default_rng(sensing) for _, sensing in pairs]
        return [np.random.default_rng(moving) for moving, _ in pairs]

    def _look(self):
        """Leave out the paths that have just left the range of numbers."""
        for x, alive in zip(self.states, self.alive, strict=True):
            with np.errstate(invalid="ignore"):
                alive &= (np.abs(x) <= self.bound).all(axis=0)
            if not alive.all():
                x[:, ~alive] = self.system.mean0[:, None]
