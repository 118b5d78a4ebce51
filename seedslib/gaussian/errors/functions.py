"""Modulus, sine and maximum: means, variances and errors; the bivariate normal distribution.

Every formula is arranged as a sum of terms of one sign, so that an error keeps its relative
accuracy when it is many orders of magnitude smaller than the function.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erfcx, ndtr, owens_t

from seedslib.base.checks import as_bound, as_real
from seedslib.gaussian.arguments import gaussian_arguments, variance_argument
from seedslib.gaussian.errors.joint import as_joint_law
from seedslib.gaussian.errors.planes import split_rule

ROOT_TWO_PI = np.sqrt(2 * np.pi)
FAR, TINY = 100.0, 1e-200
NEAR = 0.99
"""Correlations beyond this are near one of the ends."""


def density(x: ArrayLike) -> np.ndarray:
    """Standard normal density; an infinite argument gives zero."""
    return np.exp(-0.5 * np.square(np.clip(x, -40.0, 40.0))) / ROOT_TWO_PI


def ratio(numerator: ArrayLike, denominator: ArrayLike) -> np.ndarray:
    """Quotient by a nonnegative number; x/0 is infinite, and 0/0 zero."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(numerator == 0, 0.0, np.divide(numerator, denominator))


class FunctionMoments(NamedTuple):
    """Mean and variance of a function of a Gaussian vector."""

    mean: np.ndarray
    var: np.ndarray


class MeanSquareErrors(NamedTuple):
    """Mean-square errors of the optimal estimate and of the plug-in estimate."""

    optimal: np.ndarray
    plugin: np.ndarray


def abs_moments(mean: ArrayLike, var: ArrayLike, origin: float = 0.0) -> FunctionMoments:
    """Mean and variance of ``|x - origin|`` for x ~ N(mean, var).

    Parameters
    ----------
    mean, var : array_like
        Any shapes that broadcast; the variance may be zero.
    origin : float
        Where the modulus vanishes.

    Returns
    -------
    FunctionMoments
        Arrays of the broadcast shape.

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, or a negative variance.
    """
    distance = np.abs(as_real("mean", mean) - as_real("origin", origin))
    var = variance_argument("var", var)
    root = np.sqrt(var)
    scaled = ratio(distance, root)
    gap = 2 * _excess(scaled)
    shrunk = 1.0 - gap * (2 * np.minimum(scaled, 40.0) + gap)
    return FunctionMoments(distance + root * gap, var * shrunk)


def sine_moments(mean: ArrayLike, var: ArrayLike) -> FunctionMoments:
    """Mean and variance of ``sin x`` for x ~ N(mean, var) (equation (2.9)).

    Parameters
    ----------
    mean, var : array_like
        Any shapes that broadcast, radians.

    Returns
    -------
    FunctionMoments

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, or a negative variance.
    """
    mean, var = as_real("mean", mean), variance_argument("var", var)
    return FunctionMoments(np.exp(-0.5 * var) * np.sin(mean), sine_errors(mean, var, var).optimal)


def sine_errors(mean: ArrayLike, var: ArrayLike, error_var: ArrayLike) -> MeanSquareErrors:
    """Exact mean-square errors of the estimates of ``sin θ`` (example 3).

    Parameters
    ----------
    mean, var : array_like
        Unconditional mean and variance of θ.
    error_var : array_like
        Variance of the error of its estimate, at most `var`.

    Returns
    -------
    MeanSquareErrors

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, a negative variance, or an error variance above the variance.
    """
    mean, var, error_var = _scalar_law(mean, var, error_var)
    rest = 2 * var - error_var
    inner = -np.expm1(-rest) + 2 * np.exp(-rest) * np.cos(mean) ** 2
    optimal = -0.5 * np.expm1(-error_var) * inner
    known = var - error_var
    square = -0.5 * np.expm1(-2 * known) + np.exp(-2 * known) * np.sin(mean) ** 2
    return MeanSquareErrors(optimal, optimal + np.expm1(-0.5 * error_var) ** 2 * square)


def abs_errors(
    mean: ArrayLike, var: ArrayLike, error_var: ArrayLike, origin: float = 0.0
) -> MeanSquareErrors:
    """Exact mean-square errors of the estimates of ``|θ - origin|`` (example 4).

    The paper simulates them. They are one-dimensional means of smooth functions of the estimate,
    and are integrated on either side of the kink to a relative error of about 1e-14.

    Parameters
    ----------
    mean, var : array_like
        Unconditional mean and variance of θ.
    error_var : array_like
        Variance of the error of its estimate, at most `var`.
    origin : float
        Where the modulus vanishes.

    Returns
    -------
    MeanSquareErrors

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, a negative variance, or an error variance above the variance.
    """
    mean, var, error_var = _scalar_law(mean, var, error_var)
    mean, known = np.abs(mean - as_real("origin", origin)), np.sqrt(var - error_var)
    z, weight = split_rule(mean, known, np.sqrt(error_var))
    modulus, variance = abs_moments(mean + known * z, error_var)
    bias = modulus - np.abs(mean + known * z)
    optimal = (weight * variance).sum(axis=0)
    return MeanSquareErrors(optimal, optimal + (weight * bias * bias).sum(axis=0))


def _excess(scaled: np.ndarray) -> np.ndarray:
    """``φ(α) - α Φ(-α)`` for α >= 0: by how much E(X+α)⁺ exceeds α. Positive to underflow."""
    scaled = np.minimum(scaled, 40.0)
    return density(scaled) * (1.0 - scaled * np.sqrt(np.pi / 2) * erfcx(scaled / np.sqrt(2)))


def _scalar_law(
    mean: ArrayLike, var: ArrayLike, error_var: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    mean = as_real("mean", mean)
    var, error_var = variance_argument("var", var), variance_argument("error_var", error_var)
    mean, var, error_var = np.broadcast_arrays(mean, var, error_var)
    if (error_var > var * (1 + 1e-8)).any():
        where = np.argmax(error_var - var)
        raise ValueError(
            f"error_var: wanted at most the variance, got {error_var.flat[where]:.6g} "
            f"above {var.flat[where]:.6g}"
        )
    return mean, var, np.minimum(error_var, var)


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


def bivariate_normal_cdf(h: ArrayLike, k: ArrayLike, rho: ArrayLike) -> np.ndarray:
    """Probability that X <= h and Y <= k for standard normals with correlation rho.

    By Owen's function T; absolute error below 1e-15. Infinite limits are allowed, and at
    ``rho = ±1`` the limit is returned.

    Parameters
    ----------
    h, k, rho : array_like
        Broadcast together; ``-1 <= rho <= 1``.

    Returns
    -------
    ndarray
        The broadcast shape; a scalar for scalars.

    Raises
    ------
    TypeError, ValueError
        Not real, NaN, or a correlation outside [-1, 1].
    """
    h, k, rho = np.broadcast_arrays(as_bound("h", h), as_bound("k", k), _correlation(rho))
    # nothing changes beyond a hundred standard deviations, or below 1e-200 of one
    h, k = (
        np.where(np.abs(v) < TINY, 0.0, np.where(np.abs(v) > FAR, np.copysign(np.inf, v), v))
        for v in (h, k)
    )
    root = np.sqrt((1.0 - rho) * (1.0 + rho))
    below, above = np.minimum(h, k), np.maximum(h, k)
    edge = np.where(rho > 0, ndtr(below), np.maximum(0.0, ndtr(below) - ndtr(-above)))
    regular = (root > 0) & np.isfinite(h) & np.isfinite(k)
    h, k, rho = (np.where(regular, values, 0.0) for values in (h, k, rho))
    root = np.where(regular, root, 1.0)
    inner = 0.5 * (ndtr(h) + ndtr(k)) - _owen(h, k, rho, root) - _owen(k, h, rho, root)
    inner -= 0.5 * ((h * k < 0) | ((h * k == 0) & (h + k < 0)))
    inner = np.where((h == 0) & (k == 0), 0.25 + np.arcsin(rho) / (2 * np.pi), inner)
    unbounded = np.where(np.isneginf(below), 0.0, ndtr(below))
    edge = np.where(np.isinf(below) | np.isposinf(above), unbounded, edge)
    return np.where(regular, np.clip(inner, 0.0, 1.0), edge)[()]


def _owen(h: np.ndarray, k: np.ndarray, rho: np.ndarray, root: np.ndarray) -> np.ndarray:
    zero = h == 0
    # near one of the ends k - rho h cancels, but what it is made of is exact
    end = np.copysign(1.0, rho)
    apart = np.where(np.abs(rho) > NEAR, (k - end * h) + (end - rho) * h, k - rho * h)
    slope = apart / np.where(zero, 1.0, h * root)
    return owens_t(h, np.where(zero, np.copysign(np.inf, k), slope))


def _correlation(rho: ArrayLike) -> np.ndarray:
    rho = as_real("rho", rho)
    if (np.abs(rho) > 1).any():
        raise ValueError(f"rho: wanted a correlation in [-1, 1], got {rho[np.abs(rho) > 1][0]:g}")
    return rho
