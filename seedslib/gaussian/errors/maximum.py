"""Mean, variance and exact errors of the larger of two Gaussian variables.

With the larger mean first, alpha = (m1 - m2) / s and s the deviation of the difference,

    var max = (Phi(alpha) - h) C11 + (Phi(-alpha) - h) C22 + 2 h C12,    h = e (alpha + e),

where e = phi - alpha Phi(-alpha). The weights are positive and sum to one, and the last term is
at most 0.47 of the others, so nothing is lost when one variance is many orders below the other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from seedslib.gaussian.arguments import gaussian_arguments
from seedslib.gaussian.errors.bivariate import density, ratio
from seedslib.gaussian.errors.functions import (
    NODES,
    REACH,
    WEIGHTS,
    FunctionMoments,
    MeanSquareErrors,
)
from seedslib.gaussian.errors.joint import as_joint_law

FAR, DEPTH = 2.5, 60
"""Beyond FAR the tails are a continued fraction of this depth, short of it differences."""


class Tails(NamedTuple):
    """At alpha >= 0: weight Phi(-alpha) - h of the other variable, h, and e squared."""

    other: np.ndarray
    shared: np.ndarray
    square: np.ndarray


def max_moments(mean: ArrayLike, cov: ArrayLike) -> FunctionMoments:
    """Mean and variance of the larger of two correlated Gaussian variables (Clark's formulas).

    Parameters
    ----------
    mean : array_like
        Shape (2, ...).
    cov : array_like
        Shape (2, 2) or (2, 2, ...). Variables with a constant difference are allowed.

    Returns
    -------
    FunctionMoments
        Arrays of shape (...).

    Raises
    ------
    TypeError, ValueError
        Not two components, not real, not finite, or not a covariance.
    """
    mean, cov = gaussian_arguments(mean, cov, 2)
    root, gap = np.sqrt(_spread(cov)), mean[0] - mean[1]
    scaled = ratio(gap, root)
    tails = _tails(np.abs(scaled))
    first = 1.0 - ndtr(-np.abs(scaled)) - tails.shared
    weights = np.where(gap >= 0, first, tails.other), np.where(gap >= 0, tails.other, first)
    top = np.maximum(mean[0], mean[1]) + root * np.sqrt(tails.square)
    return FunctionMoments(top, _combined(cov, *weights, tails.shared))


def max_errors(mean: ArrayLike, cov: ArrayLike, error_cov: ArrayLike) -> MeanSquareErrors:
    """Exact mean-square errors of the estimates of ``max(x₁, x₂)`` (example 2).

    The optimal error is the mean of the conditional variance over the estimate of the difference,
    integrated on either side of the kink.

    Parameters
    ----------
    mean : array_like
        Unconditional mean μ, shape (2,).
    cov, error_cov : array_like
        C and P, shape (2, 2), P not above C.

    Returns
    -------
    MeanSquareErrors

    Raises
    ------
    TypeError, ValueError
        Not two components, not real, not finite, not covariances, or P above C.
    """
    mean, cov, error_cov = as_joint_law(mean, cov, error_cov, 2)
    spread, gap = _spread(error_cov), mean[0] - mean[1]
    known = np.sqrt(np.maximum(_spread(cov) - spread, 0.0))
    root = np.sqrt(spread)
    if known == 0.0:  # the estimate of the difference does not vary
        var = max_moments(mean, error_cov).var
        square = spread * _tails(np.abs(ratio(gap, root))).square
        return MeanSquareErrors(var, var + square)
    offset = np.clip(ratio(gap, known), -1e150, 1e150)
    width = ratio(known, root)
    sides = [_side(sign * offset, width) for sign in (1.0, -1.0)]
    (mine, others), (mine_below, others_below) = sides
    weights = (ndtr(offset) - mine + others_below.other, ndtr(-offset) - mine_below + others.other)
    shared = others.shared + others_below.shared
    optimal = _combined(error_cov, *weights, shared)
    return MeanSquareErrors(optimal, optimal + spread * (others.square + others_below.square))


def _spread(cov: np.ndarray) -> np.ndarray:
    """Variance of the difference."""
    return np.maximum(cov[0, 0] + cov[1, 1] - 2 * cov[0, 1], 0.0)


def _combined(
    cov: np.ndarray, first: np.ndarray, second: np.ndarray, shared: np.ndarray
) -> np.ndarray:
    """Variances weighed; a singular covariance may leave a negative rounding error."""
    total = first * cov[0, 0] + second * cov[1, 1] + 2 * shared * cov[0, 1]
    return np.maximum(total, 0.0)


def _tails(scaled: np.ndarray) -> Tails:
    """Weights at alpha >= 0, each to full relative accuracy."""
    scaled = np.minimum(scaled, 40.0)
    tail, phi = ndtr(-scaled), density(scaled)
    first = phi - scaled * tail
    second = tail - scaled * first
    far = scaled > FAR
    if np.any(far):
        # ratios of the repeated integrals of the tail, r_n = 1 / (alpha + (n + 1) r_{n+1})
        point = np.maximum(scaled, FAR)
        ratio = (np.sqrt(point * point + 4 * DEPTH) - point) / (2 * DEPTH)
        ratios = []
        for n in range(DEPTH - 1, 0, -1):
            ratio = 1.0 / (point + n * ratio)
            ratios.append(ratio)
        mills, once, twice = ratios[-1], ratios[-2], ratios[-3]
        first = np.where(far, phi * mills * once, first)
        second = np.where(far, 2 * phi * mills * once * twice, second)
    return Tails(second - first * first, first * (scaled + first), first * first)


def _side(offset: float, width: float) -> tuple[float, Tails]:
    """Means over alpha ~ N(offset width, width²), alpha > 0: Phi(-alpha) + h, and the tails.

    All that is averaged falls as exp(-alpha²/2), which leaves a Gaussian law of mean
    offset width / (1 + width²) to be integrated.
    """
    width = min(width, 1e100)
    both = np.hypot(1.0, width)
    scale, near = width / both, offset / both  # deviation of that law, and its mean in those
    low = max(near - REACH, 0.0)
    # where the kink is beyond the law's mean, up to a fall by exp(-45)
    high = near + REACH if near > 0 else 90.0 / (np.sqrt(near * near + 90.0) - near)
    half = 0.5 * (high - low)
    steps = half * (1.0 + NODES)
    point = scale * (low + steps)
    # point / width - offset, without its cancellation where the law is narrow
    away = (max(-near, -REACH) + steps) / both - near * width * scale
    weight = WEIGHTS * half / both * density(away)
    tails = _tails(point)
    mine = np.sum(weight * (ndtr(-point) + tails.shared))
    return mine, Tails(*(np.sum(weight * part) for part in tails))
