"""Blocks of paths with their own random streams, on a pool of threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import Any

import numpy as np

from seedslib.base.checks import as_count, is_whole

BLOCK = 8192
"""Paths in a block: their arrays stay in the processor's cache."""


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
    work: Callable[..., Any], total: int, seed: object, *, workers: int = 1, block: int = BLOCK
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
    here = [copy_context() for _ in jobs]  # threads know nothing of what is assigned here
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(lambda context, job: context.run(work, *job), here, jobs))
