"""Where the entries of a symmetric matrix are in the list of those below its diagonal."""

from __future__ import annotations

from functools import lru_cache

import numpy as np


@lru_cache(maxsize=64)
def lower_triangle(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the entries on and below the diagonal, row by row."""
    pair = np.tril_indices(n)
    for part in pair:
        part.flags.writeable = False
    return pair


@lru_cache(maxsize=64)
def mirrored(n: int) -> np.ndarray:
    """Number of each entry of a symmetric (n, n) matrix among those of `lower_triangle`."""
    rows, columns = lower_triangle(n)
    index = np.empty((n, n), dtype=int)
    index[rows, columns] = index[columns, rows] = np.arange(len(rows))
    index.flags.writeable = False
    return index
