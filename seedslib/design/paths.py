"""Simulated paths of a design, in bundles that may be on other machines."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from itertools import repeat
from typing import Any

import numpy as np

from seedslib.base.blocks import Bundle, bundles, child
from seedslib.base.checks import as_count, is_whole, outside
from seedslib.design.regression import Scatter, combine, scatter
from seedslib.models.kinds import AnySystem

LARGEST = 1e100
"""A state beyond this has no square worth averaging."""


class Executor:
    """Map over the bundles of a design. This one works here; another may work elsewhere.

    Parameters
    ----------
    map : callable
        As the built-in one.
    """

    def __init__(self, map: Callable[..., Iterable[Any]] = map) -> None:
        self._map = map

    def __call__(self, work: Callable[..., Any], *lists: Any) -> list[Any]:
        """List of ``work(*entries)`` over the entries of the lists."""
        return list(self._map(work, *lists))

    def share(self, thing: object) -> repeat[Any]:
        """Stand-in for a list that has the same thing for every bundle."""
        return repeat(thing)

    def unzip(self, pairs: Iterable[tuple[Any, Any]]) -> list[Any]:
        """Lists of the first and of the second parts of the entries of a list."""
        return [list(part) for part in zip(*pairs, strict=True)]


@contextmanager
def executor(workers: int | Executor) -> Iterator[Executor]:
    """An executor on a pool of threads, or the one that was given.

    Parameters
    ----------
    workers : int or Executor
        Number of threads, or who does the work instead.
    """
    if isinstance(workers, Executor):
        yield workers
        return
    if not is_whole(workers):
        raise TypeError(f"workers: wanted a whole number or an Executor, got {workers!r}")
    if (workers := as_count("workers", workers)) == 1:
        yield Executor()
        return
    with ThreadPoolExecutor(workers - 1) as pool:
        yield Executor(partial(_on_threads, pool, workers))


def _on_threads(pool, workers, work, *lists) -> list:
    """Map in which each thread, this one among them, takes the next job until none is left."""
    jobs = list(zip(*lists, strict=False))  # what is shared has no end
    results, numbers = [None] * len(jobs), iter(range(len(jobs)))

    def run():
        for number in numbers:
            results[number] = work(*jobs[number])

    others = [pool.submit(run) for _ in range(min(workers, len(jobs)) - 1)]
    run()
    for other in others:
        other.result()
    return results


class PathSimulator:
    """Paths bundle by bundle, with the random streams of `seedslib.models.simulation`.

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
    executor : Executor
        Map over bundles.
    options : mapping
        Of ``system.advance``.

    Attributes
    ----------
    states, alive : list
        States (n, paths) and marks of the paths that are not left out, for each bundle. On a
        cluster they stay there, and looking at them fetches them.
    counts : list
        Numbers of paths in the blocks of each bundle.
    stop : int
        Number of the last time stopped at.
    """

    def __init__(
        self,
        system: AnySystem,
        paths: int,
        root: np.random.SeedSequence,
        stops: int,
        executor: Executor,
        options: Mapping[str, Any],
    ) -> None:
        self.system, self.executor, self.options = system, executor, options
        self.n: int = system.state_size
        self.counts: list[Any] = bundles(paths)
        self.stops, self.stop = stops, -1
        self.states, self.alive = [], []
        self._roots = [root.spawn(len(counts)) for counts in self.counts]
        self._shared = executor.share(system)

    def warn_of_diverged(self) -> int:
        """Number of paths left out, of which the design's caller is warned if there are any."""
        diverged = sum(self.executor(lambda alive: int(np.count_nonzero(~alive)), self.alive))
        if diverged:
            paths = sum(map(sum, self.counts))
            warnings.warn(
                f"paths: {diverged} of {paths} design paths diverged and were left out",
                stacklevel=outside(),
            )
        return diverged

    def begin(self) -> None:
        """Draw the initial states."""
        sizes = [sum(counts) for counts in self.counts]
        self.alive = [np.ones(size, dtype=bool) for size in sizes]
        self._go(lambda system, rng, size: system.initial_sample(rng, size), sizes)

    def advance(self, start: float, stop: float) -> None:
        """Move all paths to a later time."""
        options, p = self.options, self.system.values(dt=stop - start)
        self._go(
            lambda system, rng, x: system.advance(x, start, stop, rng, p, **options), self.states
        )

    def measure(self, t: float) -> list[Any]:
        """Measurements, (m, paths) for each bundle; once at a stop."""
        p = self.system.values()

        def sampled(system, streams, counts, x):
            return system.sensor.sample(t, x, _generator(streams, counts), p)

        return self.finite(sampled, self._shared, self._streams(1), self.counts, self.states)

    def uniform(self, purpose: int) -> list[Any]:
        """A number from 0 to 1 for each path of a bundle at this stop, for a purpose of its own."""
        stop = self.stop

        def drawn(roots, counts):
            pairs = zip(roots, counts, strict=True)
            return np.concatenate(
                [np.random.default_rng(child(root, purpose, stop)).random(c) for root, c in pairs]
            )

        return self.executor(drawn, self._roots, self.counts)

    def finite(self, work: Callable[..., Any], *lists: Any, array: Any = None) -> list[Any]:
        """Map over bundles; paths whose column of the result is not finite are left out.

        Parameters
        ----------
        work : callable
            Its result is new, and zeros are put in place of what is left out.
        array : callable, optional
            Finds the array (p, paths) in a result that has other parts as well.
        """
        return self._guarded(lambda x: np.isfinite(x).all(axis=0), 0.0, array, work, *lists)

    def gather(self, rows: Callable[..., np.ndarray], *lists: Any) -> Scatter:
        """Moments of ``rows(x, *others)``, (p, paths), over the paths that are left."""

        def reduce(x, alive, *others):
            values = rows(x, *others)
            return scatter(values if alive.all() else values[:, alive])

        total = combine(self.executor(reduce, self.states, self.alive, *lists))
        if total.count < 2:
            raise ValueError(f"paths: wanted at least 2 that stay finite, got {total.count}")
        return total

    def _streams(self, purpose):
        """Streams of the blocks of each bundle at this stop, to move (0) or to measure (1)."""
        return [[child(root, self.stop, purpose) for root in roots] for roots in self._roots]

    def _go(self, work, *lists):
        """States at the next stop, without the paths that have just left the range of numbers."""
        self.stop += 1
        if self.stop >= self.stops:
            raise ValueError(f"stops: wanted at most the {self.stops} that were announced")

        def moved(system, streams, counts, *parts):
            return work(system, _generator(streams, counts), *parts)

        self.states = self._guarded(
            lambda x: (np.abs(x) <= LARGEST).all(axis=0),
            self.system.mean0[:, None],
            None,
            moved,
            self._shared,
            self._streams(0),
            self.counts,
            *lists,
        )

    def _guarded(self, good, harmless, array, work, *lists):
        # the functions refer to nothing of the simulator, so that a cluster can be given them
        def guarded(alive, *parts):
            result = work(*parts)
            if array is None and not result.flags.forc:
                result = result.copy(order="K")  # no other layout outlives a file or a wire
            values = result if array is None else array(result)
            with np.errstate(invalid="ignore"):
                alive = alive & good(values)
            if not alive.all():
                values[:, ~alive] = harmless
            return result, alive

        results, self.alive = self.executor.unzip(self.executor(guarded, self.alive, *lists))
        return results


def _generator(streams, counts):
    generators = [np.random.default_rng(stream) for stream in streams]
    return Bundle(generators, counts) if len(generators) > 1 else generators[0]
