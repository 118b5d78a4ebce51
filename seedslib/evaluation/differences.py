"""Derivatives of a function that is computed at many points at once, by differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

STEP = 1e-3
"""Step of the differences."""

CORNERS = (1, 1), (1, -1), (-1, 1), (-1, -1)


class Local(NamedTuple):
    """A function at a point: value, slopes (q,) and, where wanted, second derivatives (q, q)."""

    value: float
    slopes: np.ndarray
    bend: np.ndarray | None


def derivatives(
    function: Callable[[np.ndarray], np.ndarray], u: np.ndarray, along: Sequence[int], bend: bool
) -> Local:
    """First and second derivatives along some axes, of fourth order in the step.

    Parameters
    ----------
    function : callable
        Of points (p, N), gives values (N,); it is called once.
    u : ndarray, shape (p,)
    along : sequence of int, length q
    bend : bool
        Whether second derivatives are wanted.
    """
    q, p = len(along), len(u)
    first = np.zeros((p, 4 * q + 1))
    for k, axis in enumerate(along):
        first[axis, 4 * k : 4 * k + 4] = STEP * np.array([1, -1, 2, -2])
    pairs = [(i, i) for i in range(q)] + list(combinations(range(q), 2)) if bend else []
    sizes = np.array([STEP, 2 * STEP])
    second = np.zeros((p, len(pairs), 2, 4))
    for k, (i, j) in enumerate(pairs):
        for c, (a, b) in enumerate(CORNERS):
            second[along[i], k, :, c] += a * sizes
            second[along[j], k, :, c] += b * sizes
    found = function(u[:, None] + np.concatenate([first, second.reshape(p, -1)], axis=1))
    one, back, two, far = found[: 4 * q].reshape(-1, 4).T
    value, slopes = found[4 * q], (8 * (one - back) - (two - far)) / (12 * STEP)
    if not bend:
        return Local(value, slopes, None)
    parts = found[4 * q + 1 :].reshape(len(pairs), 2, 4) @ np.array([1, -1, -1, 1]) / (4 * sizes**2)
    square = np.empty((q, q))
    for (i, j), (fine, coarse) in zip(pairs, parts, strict=True):
        square[i, j] = square[j, i] = (4 * fine - coarse) / 3
    return Local(value, slopes, square)
