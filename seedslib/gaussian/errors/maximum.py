"""Mean, variance and exact errors of the larger of two Gaussian variables.

With the larger mean first, alpha = (m1 - m2) / s and s the deviation of the difference,

    var max = (Phi(alpha) - h) C11 + (Phi(-alpha) - h) C22 + 2 h C12,    h = e (alpha + e),

where e = phi - alpha Phi(-alpha). The weights are positive and sum to one, and the last term is
at most 0.47 of the others, so nothing is lost when one variance is many orders below the other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from seedslib.gaussian.arguments import gaussian_arguments
from seedslib.gaussian.errors.bivariate import ratio
from seedslib.gaussian.errors.functions import FunctionMoments, MeanSquareErrors, _excess
from seedslib.gaussian.errors.joint import as_joint_law
from seedslib.gaussian.errors.planes import split_rule


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
    scaled = np.minimum(np.abs(ratio(gap, root)), 40.0)
    excess = _excess(scaled)
    shared = excess * (scaled + excess)
    tail = ndtr(-scaled)
    shares = 1.0 - tail - shared, np.maximum(tail - shared, 0.0)
    weights = np.where(gap >= 0, *shares), np.where(gap >= 0, *shares[::-1])
    # a singular covariance may leave a negative rounding error
    var = weights[0] * cov[0, 0] + weights[1] * cov[1, 1] + 2 * shared * cov[0, 1]
    return FunctionMoments(np.maximum(*mean) + root * excess, np.maximum(var, 0.0))


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
    z, weight = split_rule(gap, known, np.sqrt(spread))
    top, var = max_moments(np.stack([gap + known * z, 0.0 * z]), error_cov)
    optimal = weight @ var
    bias = top - np.maximum(gap + known * z, 0.0)
    return MeanSquareErrors(optimal, optimal + weight @ bias**2)


def _spread(cov: np.ndarray) -> np.ndarray:
    """Variance of the difference."""
    return np.maximum(cov[0, 0] + cov[1, 1] - 2 * cov[0, 1], 0.0)
