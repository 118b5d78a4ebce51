"""Neighbouring blocks of paths that are worked on together, each with its own random numbers.

A block is the unit of random streams. It is too small a unit of work for threads: they would hand
the interpreter to one another after every few microseconds. A bundle of blocks is a better one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.random import Generator

from seedslib.base.blocks import BLOCK

BLOCKS = 16
"""Most blocks in a bundle: with more, threads gain nothing further and memory grows."""


class Bundle:
    """Generators of neighbouring blocks, in the place of a `numpy.random.Generator`.

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


def parts(rng: Source, count: int) -> list[Any]:
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


def drawn(rng: Source, count: int, draw: Callable[..., Any]) -> np.ndarray:
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
    found = [draw(one, part) for one, part in zip(rng.generators, rng.counts, strict=True)]
    return np.concatenate(found, axis=-1)


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
