"""Simulation of a system and its measurements, in blocks of paths with their own streams.

Each block of paths has its own random stream and each interval between two times its own child
of it, so the numbers do not depend on the number of threads, on the order of the blocks, or on
how many paths follow: path i of a small run is path i of a large one.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from seedslib._validate import as_times

BLOCK = 8192
"""Paths in a block: their arrays stay in the processor's cache."""


class Simulation(NamedTuple):
    """Simulated paths.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    states : ndarray, shape (K+1, n, paths)
    measurements : ndarray, shape (K+1, m, paths)
        NaN at the times that are not measured.
    modes, indicators : ndarray of int, shape (K+1, paths), or None
        Of a switching system; -1 for an indicator that was not measured.
    """

    times: np.ndarray
    states: np.ndarray
    measurements: np.ndarray
    modes: np.ndarray | None = None
    indicators: np.ndarray | None = None


def as_count(name: str, value: object) -> int:
    """Whole number of at least one.

    Raises
    ------
    TypeError, ValueError
        Anything else.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name}: wanted a whole number, got {value!r}")
    if value < 1:
        raise ValueError(f"{name}: wanted at least 1, got {value}")
    return int(value)


def as_seed_sequence(seed: object) -> np.random.SeedSequence:
    """Root of all streams from an int, a SeedSequence or a Generator (which is advanced).

    Raises
    ------
    TypeError
        Anything else, None included: a run that cannot be repeated is not wanted here.
    """
    if isinstance(seed, np.random.SeedSequence):
        # a copy without the memory of children: equal seeds give equal runs
        return np.random.SeedSequence(
            seed.entropy, spawn_key=seed.spawn_key, pool_size=seed.pool_size
        )
    if isinstance(seed, np.random.Generator):
        return np.random.SeedSequence(seed.integers(0, 2**32, size=4, dtype=np.uint32).tolist())
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool):
        return np.random.SeedSequence(int(seed))
    raise TypeError(f"seed: wanted an int, a SeedSequence or a Generator, got {seed!r}")


def seed_record(root: np.random.SeedSequence) -> tuple[object, tuple[int, ...]]:
    """Entropy (a whole number or a list of them) and spawn key: what a file keeps of a root."""
    entropy = root.entropy if isinstance(root.entropy, int) else np.ravel(root.entropy).tolist()
    return entropy, tuple(map(int, root.spawn_key))


def in_blocks(work: Callable, total: int, seed: object, *, workers: int = 1, block: int = BLOCK):
    """Call ``work(start, stop, stream)`` for every block of paths, on a pool of threads.

    Parameters
    ----------
    work : callable
        Receives the range of the block and its own `numpy.random.SeedSequence`.
    total : int
        Number of paths.
    seed : int, SeedSequence or Generator
    workers : int
        Threads; the results do not depend on it.
    block : int
        Paths in a block.

    Returns
    -------
    list
        Results in the order of the blocks.
    """
    workers = as_count("workers", workers)
    starts = range(0, max(total, 1), block)  # no paths are one empty block
    streams = as_seed_sequence(seed).spawn(len(starts))
    jobs = [(a, min(a + block, total), s) for a, s in zip(starts, streams, strict=True)]
    if workers == 1 or len(jobs) == 1:
        return [work(*job) for job in jobs]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(lambda job: work(*job), jobs))


def as_measured(measured: object, count: int) -> np.ndarray:
    """Mask of the measured times, shape (K+1,), from None (all), a mask, or a list of indices.

    Raises
    ------
    ValueError
        A mask of another length or an index out of range.
    """
    if measured is None:
        return np.ones(count, dtype=bool)
    given = np.asarray(measured)
    if given.dtype == bool:
        if given.shape != (count,):
            raise ValueError(f"measured: wanted a mask of shape ({count},), got {given.shape}")
        return given
    if given.ndim != 1 or given.dtype.kind not in "iu" or (np.abs(given) >= count).any():
        raise ValueError(f"measured: wanted indices from 0 to {count - 1}, got {measured!r}")
    mask = np.zeros(count, dtype=bool)
    mask[given] = True
    return mask


def simulate(system, times, paths, seed, *, measured=None, workers=1, **options) -> Simulation:
    """Simulate paths of any system that can be sampled, and what its sensor shows.

    Parameters
    ----------
    system : object
        With ``initial_sample(rng, count)``, ``advance(x, start, stop, rng, **options)`` and
        ``sensor.sample(t, x, rng)``.
    times : array_like, shape (K+1,)
        Output times; the first is the time of the initial law.
    paths : int
    seed : int, SeedSequence or Generator
    measured : array_like, optional
        Mask or indices of the times with a measurement (default all); NaN at the others.
    workers : int
        Threads over blocks of paths.

    Raises
    ------
    TypeError, ValueError
        Times that do not increase, a count below one, a wrong mask or seed.
    """
    times = as_times("times", times)
    paths = as_count("paths", paths)
    measured = as_measured(measured, len(times))
    states = np.empty((len(times), system.state_size, paths))
    measurements = np.full((len(times), system.sensor.size, paths), np.nan)

    def work(start, stop, stream):
        x = None
        for k, child in enumerate(stream.spawn(len(times))):
            moving, sensing = (np.random.default_rng(s) for s in child.spawn(2))
            # a path that leaves the range of numbers shows as inf or NaN in the result
            with np.errstate(over="ignore", invalid="ignore"):
                if k == 0:
                    x = system.initial_sample(moving, stop - start)
                else:
                    x = system.advance(x, times[k - 1], times[k], moving, **options)
                states[k, :, start:stop] = x
                if measured[k]:
                    measurements[k, :, start:stop] = system.sensor.sample(times[k], x, sensing)

    in_blocks(work, paths, seed, workers=workers)
    return Simulation(times, states, measurements)
