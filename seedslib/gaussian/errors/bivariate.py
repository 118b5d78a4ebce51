"""Distribution of two correlated standard normal variables."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, owens_t

from seedslib.base.checks import as_bound, as_real

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
