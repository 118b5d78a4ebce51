"""Blocks of paths with their own random streams, on a pool of threads.

A block is the unit of random streams. It is too small a unit of work for threads: they would hand
the interpreter to one another after every few microseconds. A bundle of neighbouring blocks, each
with its own random numbers, is a better one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.random import Generator

from seedslib.base.checks import as_count, is_whole
from seedslib.base.progress import followed

Result = TypeVar("Result")

BLOCK = 8192
"""Paths in a block: their arrays stay in the processor's cache."""

FILTERS = 0x46494C54
"""Key of the filters' own streams among the children of a block's: no block of paths has it."""

BLOCKS = 16
"""Most blocks in a bundle: with more, threads gain nothing further and memory grows."""


def as_seed_sequence(seed: object) -> np.random.SeedSequence:
    """Root of all streams from an int, a SeedSequence or a Generator (which is advanced).

    Raises
    ------
    TypeError, ValueError
        Anything else, None included: a run that cannot be repeated is not wanted here.
    """
    if isinstance(seed, np.random.SeedSequence):
        # a copy without the memory of children: equal seeds give equal runs
        return child(seed)
    if isinstance(seed, np.random.Generator):
        return np.random.SeedSequence(seed.integers(0, 2**32, size=4, dtype=np.uint32).tolist())
    if is_whole(seed):
        if seed < 0:
            raise ValueError(f"seed: wanted a whole number from 0 on, got {seed}")
        return np.random.SeedSequence(int(seed))
    raise TypeError(f"seed: wanted an int, a SeedSequence or a Generator, got {seed!r}")


def child(root: np.random.SeedSequence, *key: int) -> np.random.SeedSequence:
    """Descendant of a root by a key of one's own; `spawn` numbers its children from 0."""
    return np.random.SeedSequence(
        root.entropy, spawn_key=(*root.spawn_key, *key), pool_size=root.pool_size
    )


def seed_record(root: np.random.SeedSequence) -> tuple[object, tuple[int, ...]]:
    """Entropy (a whole number or a tuple of them) and spawn key: what a file keeps of a root."""
    entropy = root.entropy
    if not isinstance(entropy, int):
        entropy = tuple(np.ravel(entropy).tolist())
    return entropy, tuple(map(int, root.spawn_key))


def in_blocks(
    work: Callable[..., Any],
    total: int,
    seed: object,
    *,
    workers: int = 1,
    block: int = BLOCK,
    what: str | None = None,
) -> list[Any]:
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
    what : str, optional
        What the work is, where its progress is to be shown.

    Returns
    -------
    list
        Results in the order of the blocks.
    """
    workers = as_count("workers", workers)
    starts = range(0, max(total, 1), block)  # no paths are one empty block
    streams = as_seed_sequence(seed).spawn(len(starts))
    jobs = [(a, min(a + block, total), s) for a, s in zip(starts, streams, strict=True)]

    def shown(results: Iterable[Any]) -> list[Any]:
        one = what is None or len(jobs) == 1  # which is over when there is something to show
        return list(results if one else followed(results, what, len(jobs)))

    if workers == 1 or len(jobs) == 1:
        return shown(work(*job) for job in jobs)
    with ThreadPoolExecutor(workers) as pool:
        return shown(pool.map(lambda job: work(*job), jobs))


class Bundle:
    """Generators of neighbouring blocks, in place of a `numpy.random.Generator`.

    Parameters
    ----------
    generators : sequence of numpy.random.Generator
        One for each block.
    counts : sequence of int
        Number of paths in each block.
    """

    def __init__(self, generators: Iterable[Generator], counts: Iterable[int]) -> None:
        self.generators: tuple[Generator, ...] = tuple(generators)
        self.counts: tuple[int, ...] = tuple(counts)

    def spawn(self, number: int) -> list[Bundle]:
        """Children, as those of a generator."""
        children = zip(*(one.spawn(number) for one in self.generators), strict=True)
        return [Bundle(generators, self.counts) for generators in children]


Source = Generator | Bundle
"""Where random numbers of paths come from."""


def parts(rng: Source, count: int) -> list[tuple[Generator, slice]]:
    """Generators with the paths that each of them is to draw for next, as (generator, slice).

    Parameters
    ----------
    rng : numpy.random.Generator or Bundle
        A generator comes several times where there are more paths than a block has.
    count : int
        Number of all paths.
    """
    if isinstance(rng, Bundle):
        ends = np.cumsum(rng.counts).tolist()
        return list(zip(rng.generators, map(slice, [0, *ends], ends), strict=False))
    return [(rng, slice(a, min(a + BLOCK, count))) for a in range(0, count, BLOCK)]


def drawn(rng: Source, count: int, draw: Callable[[Generator, int], np.ndarray]) -> np.ndarray:
    """Result of ``draw(generator, count)``, shape (..., count), block by block.

    Parameters
    ----------
    rng : numpy.random.Generator or Bundle
    count : int
        Number of all paths.
    draw : callable
    """
    if not isinstance(rng, Bundle):
        return draw(rng, count)
    draws = [draw(one, part) for one, part in zip(rng.generators, rng.counts, strict=True)]
    return np.concatenate(draws, axis=-1)


def normal(rng: Source, size: int, count: int) -> np.ndarray:
    """Standard normal numbers (size, count), path by path."""
    return drawn(rng, count, lambda one, part: one.standard_normal((part, size)).T)


def bundles(paths: int) -> list[tuple[int, ...]]:
    """Numbers of paths in the blocks of each bundle.

    Where there are two blocks or more, the number of bundles is even: two threads have equal
    shares.
    """
    counts = [min(BLOCK, paths - a) for a in range(0, paths, BLOCK)]
    pairs = -(-len(counts) // (2 * BLOCKS))
    number = min(len(counts), 2 * pairs)
    ends = [len(counts) * k // number for k in range(number + 1)]
    return [tuple(counts[a:b]) for a, b in pairwise(ends)]
