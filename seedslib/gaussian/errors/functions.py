"""Means, variances and exact errors of the functions that filters ask for: modulus, sine.

Every formula is arranged as a sum of terms of one sign, so that an error keeps its relative
accuracy when it is many orders of magnitude smaller than the function.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erfcx

from seedslib.base.checks import as_real
from seedslib.gaussian.arguments import variance_argument
from seedslib.gaussian.errors.bivariate import density, ratio
from seedslib.gaussian.errors.planes import split_rule


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
