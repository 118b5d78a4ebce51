"""Weights from their logarithms, and the decision for the most probable."""

from __future__ import annotations

import numpy as np

TIE = 1e-9
"""Probabilities that are closer to the largest than this part of it are equal to it."""


def most_probable(prob: np.ndarray, axis: int = 0) -> np.ndarray:
    """Number of the most probable mode, (3.1); of equal ones the first.

    Equal are all that reach 1 - 1e-9 of the largest, so that rounding decides nothing.

    Parameters
    ----------
    prob : ndarray
        Probabilities, not necessarily normalised.
    axis : int
        Axis of the modes.
    """
    return (prob >= (1.0 - TIE) * prob.max(axis=axis, keepdims=True)).argmax(axis=axis)


def logarithm(weight: np.ndarray) -> np.ndarray:
    """Logarithms of weights; -inf for none, and for negative ones, which count as none."""
    with np.errstate(divide="ignore"):
        return np.log(np.maximum(weight, 0.0))


def normalised(score: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of weights whose sum is one, and the logarithm of their sum before, (*batch).

    Where nothing has a finite weight the logarithms are returned as they are, and the sum is the
    largest of them.
    """
    weight, highest, lost = relative(score, axis)
    total = logarithm(weight.sum(axis=axis))
    # the largest is taken away first: it may be so large that a sum would not be seen beside it
    shifted = (score - np.where(lost, 0.0, highest)) - np.where(lost, 0.0, total)
    return shifted, highest + np.where(lost, 0.0, total)


def relative(score: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
