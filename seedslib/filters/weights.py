"""Weights from their logarithms, the most probable mode, and moments of mixtures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.base.arrays import align

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
    weight, highest, none = relative(score, axis)
    total = logarithm(weight.sum(axis=axis))
    # the largest is subtracted first: it may be so large that a sum would be rounded off beside it
    shifted = (score - np.where(none, 0.0, highest)) - np.where(none, 0.0, total)
    return shifted, highest + np.where(none, 0.0, total)


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
    none : ndarray of bool, shape (*batch)
        Where it is not finite.
    """
    highest = score.max(axis=axis)
    none = ~np.isfinite(highest)
    weight = score - np.where(none, 0.0, highest)
    return np.exp(weight, out=weight), highest, none


class Mixture(NamedTuple):
    """Mass, mean and covariance of a mixture."""

    mass: np.ndarray
    mean: np.ndarray
    cov: np.ndarray


def mix(mass: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> Mixture:
    """Moments of a mixture by the law of total covariance, in centred form.

    No digits are lost far from the origin.

    Parameters
    ----------
    mass : ndarray, shape (P, *batch)
    mean : ndarray, shape (d, P, *batch)
    cov : ndarray, shape (d, d, P, *batch)
        Moments of parts without mass are not looked at.

    Returns
    -------
    Mixture
        Of no mass: mean zero and unit covariance, so that later steps are finite.
    """
    empty = mass <= 0  # rules with negative weights give negative masses
    if empty.any():
        mass, mean, cov = (np.where(empty, 0.0, part) for part in (mass, mean, cov))
        total = mass.sum(axis=0)
        none = total == 0
        share = mass / np.where(none, 1.0, total)
    else:
        total = mass.sum(axis=0)
        none, share = None, mass / total
    centre = (share * mean).sum(axis=1)
    offset = mean - centre[:, None]
    weighted = share * offset
    total_cov = (share * cov).sum(axis=2)
    for i in range(len(mean)):
        for j in range(i + 1):
            between = (weighted[i] * offset[j]).sum(axis=0)
            total_cov[i, j] += between
            if j < i:
                total_cov[j, i] += between
    if none is not None and none.any():
        total_cov = np.where(none, align(np.eye(len(mean)), 2, none.ndim), total_cov)
    return Mixture(total, centre, total_cov)
