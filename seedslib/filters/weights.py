"""Weights from their logarithms."""

from __future__ import annotations

import numpy as np


def relative(score: np.ndarray, axis) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights relative to the largest, so that none of the large ones overflows or vanishes.

    Parameters
    ----------
    score : ndarray
        Logarithms of weights; -inf for none.
    axis : int or tuple of int
        Leading axes of what is weighted.

    Returns
    -------
    weight : ndarray, as `score`
        exp(score - largest); exp(score) where nothing has a finite weight.
    highest : ndarray, shape (*batch)
        The largest score.
    lost : ndarray of bool, shape (*batch)
        Where it is not finite.
    """
    highest = score.max(axis=axis)
    lost = ~np.isfinite(highest)
    weight = score - np.where(lost, 0.0, highest)
    return np.exp(weight, out=weight), highest, lost
