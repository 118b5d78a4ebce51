"""Blocks of paths with their own random streams, on a pool of threads."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import copy_context
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from seedslib.base.checks import as_count, is_whole

BLOCK = 8192
"""Paths in a block: their arrays stay in the processor's cache."""

STREAM = 500
"""Bytes that the stream of a block takes, about."""


@cache
def room() -> float:
    """Bytes of memory that there are for this process, infinite where nobody says."""
    found = [math.inf]
    with suppress(AttributeError, ValueError, OSError):  # not on Windows
        found.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with suppress(OSError, ValueError):  # a container, unless it says "max"
        found.append(int(Path("/sys/fs/cgroup/memory.max").read_text()))
    with suppress(ImportError, OSError):
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        found += [limit] if limit >= 0 else []
    return min(found)


def require_room(name: str, value: object, size: float) -> None:
    """Refuse what takes more bytes than there are, before it grows until the process is killed.

    Parameters
    ----------
    name : str
        The caller's name of the argument, for the message.
    value : object
        What the caller passed.
    size : float
        Bytes that it takes at least.

    Raises
    ------
    ValueError
        It does not fit.
    """
    if size > room():
        raise ValueError(
            f"{name}: wanted what fits in {room() / 1e9:.3g} GB of memory, got {value}, which "
            f"takes {size / 1e9:.3g} GB or more"
        )


def as_paths(paths: object, size: int, least: int = 1, name: str = "paths") -> int:
    """Number of paths, each of them with `size` numbers that are kept.

    Raises
    ------
    TypeError, ValueError
        As `as_count`; more than there is memory for.
    """
    count = as_count(name, paths, least)
    require_room(name, paths, 8.0 * size * count)
    return count


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
    """Entropy (a whole number or a list of them) and spawn key: what a file keeps of a root."""
    entropy = root.entropy if isinstance(root.entropy, int) else np.ravel(root.entropy).tolist()
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
    require_room("paths", total, STREAM * float(len(starts)))
    streams = as_seed_sequence(seed).spawn(len(starts))
    jobs = [(a, min(a + block, total), s) for a, s in zip(starts, streams, strict=True)]
    if workers == 1 or len(jobs) == 1:
        return [work(*job) for job in jobs]
    here = [copy_context() for _ in jobs]  # threads know nothing of what is assigned here
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(lambda context, job: context.run(work, *job), here, jobs))
