"""Quadrature rules for the mean of a function of a Gaussian vector.

A rule is a set of points and weights for the standard normal law; the points of N(mean, cov) are
``mean + L points`` with any factor L of the covariance. Rules with negative weights are legal:
they give sums, not probabilities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import combinations, product

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import roots_hermitenorm

from seedslib.base.semidefinite import square_root
from seedslib.gaussian.arguments import gaussian_arguments

MOST_POINTS = 2_000_000


@dataclass(frozen=True, eq=False)
class Rule:
    """Points and weights for means under the standard normal law.

    Attributes
    ----------
    points : ndarray
        Shape (n, L).
    weights : ndarray
        Shape (L,), sum one.
    degree : int
        Total degree up to which means of polynomials are exact.
    """

    points: np.ndarray
    weights: np.ndarray
    degree: int

    def __post_init__(self) -> None:
        for array in (self.points, self.weights):
            array.flags.writeable = False


@cache
def gauss_hermite(n: int, order: int) -> Rule:
    """Tensor product of Gauss-Hermite rules with `order` points on each of n axes.

    Raises
    ------
    TypeError, ValueError
        Not positive integers, or more than two million points.
    """
    _positive(n=n, order=order)
    if order**n > MOST_POINTS:
        raise ValueError(
            f"order: wanted at most {MOST_POINTS} points, got {order}**{n}; "
            "use fifth_degree or cubature"
        )
    nodes, weights = roots_hermitenorm(order)
    grid = np.meshgrid(*[nodes] * n, indexing="ij")
    mass = np.ones(())
    for _ in range(n):
        mass = np.multiply.outer(mass, weights / weights.sum())
    return Rule(np.stack([g.ravel() for g in grid]), mass.ravel(), 2 * order - 1)


@cache
def cubature(n: int) -> Rule:
    """Third-degree rule of 2n equally weighted points at distance √n on the axes.

    Raises
    ------
    TypeError, ValueError
        Not a positive integer.
    """
    _positive(n=n)
    eye = np.sqrt(n) * np.eye(n)
    return Rule(np.hstack([eye, -eye]), np.full(2 * n, 0.5 / n), 3)


@cache
def unscented(n: int, kappa: float) -> Rule:
    """Third-degree rule of 2n+1 points: the centre and points at distance √(n+kappa).

    Parameters
    ----------
    n : int
    kappa : float
        Above -n; ``3 - n`` matches the fourth moment of each axis.

    Raises
    ------
    TypeError, ValueError
        Not a positive integer, or kappa not above -n.
    """
    _positive(n=n)
    if not -n < kappa < np.inf:
        raise ValueError(f"kappa: wanted a number above {-n}, got {kappa}")
    eye = np.sqrt(n + kappa) * np.eye(n)
    side = 0.5 / (n + kappa)
    weights = np.concatenate([[kappa / (n + kappa)], np.full(2 * n, side)])
    return Rule(np.hstack([np.zeros((n, 1)), eye, -eye]), weights, 3)


@cache
def fifth_degree(n: int) -> Rule:
    """Fifth-degree rule of 2n²+1 points; some weights are negative for n above 4.

    Raises
    ------
    TypeError, ValueError
        Not a positive integer.
    """
    _positive(n=n)
    root = np.sqrt(3.0)
    points = [np.zeros(n)]
    weights = [1.0 + (n * n - 7.0 * n) / 18.0]
    for i in range(n):
        for sign in (root, -root):
            points.append(sign * np.eye(n)[i])
            weights.append((4.0 - n) / 18.0)
    for i, j in combinations(range(n), 2):
        for first, second in product((root, -root), repeat=2):
            points.append(first * np.eye(n)[i] + second * np.eye(n)[j])
            weights.append(1.0 / 36.0)
    return Rule(np.stack(points, axis=1), np.array(weights), 5)


def mean_of(f: Callable, mean: ArrayLike, cov: ArrayLike, rule: Rule) -> np.ndarray:
    """Approximate mean of f(x), x ~ N(mean, cov).

    Parameters
    ----------
    f : callable
        Takes points (n, N) with the points on the last axis; returns (N,) or (p, N).
    mean : array_like
        Shape (n, ...), batch axes last.
    cov : array_like
        Shape (n, n) or (n, n, ...); may be singular.
    rule : Rule
        For dimension n.

    Returns
    -------
    ndarray
        Shape (...) or (p, ...).

    Raises
    ------
    TypeError, ValueError
        Illegal mean or covariance, a rule for another dimension, or f returns a wrong shape.
    """
    points = points_of(mean, cov, rule)
    flat = points.reshape(len(points), -1)
    values = np.asarray(f(flat))
    if values.shape[-1:] != flat.shape[1:] or values.ndim > 2:
        raise ValueError(
            f"f: wanted values of shape (N,) or (p, N) with N = {flat.shape[1]}, got {values.shape}"
        )
    values = values.reshape(*values.shape[:-1], *points.shape[1:])
    return np.tensordot(rule.weights, values, (0, values.ndim - points.ndim + 1))[()]


def points_of(mean: ArrayLike, cov: ArrayLike, rule: Rule) -> np.ndarray:
    """Points of a rule for N(mean, cov), shape (n, L, ...).

    Parameters
    ----------
    mean, cov : array_like
        Shapes (n, ...) and (n, n) or (n, n, ...).
    rule : Rule
        For dimension n.

    Raises
    ------
    TypeError, ValueError
        Illegal mean or covariance, or a rule for another dimension.
    """
    mean, cov = gaussian_arguments(mean, cov)
    n = mean.shape[0]
    if rule.points.shape[0] != n:
        raise ValueError(f"rule: wanted a rule for {n} variables, got {rule.points.shape[0]}")
    factors = square_root(np.moveaxis(cov, (0, 1), (-2, -1)))
    offsets = np.moveaxis(factors @ rule.points, (-2, -1), (0, 1))
    depth = max(mean.ndim - 1, offsets.ndim - 2)
    return _padded(mean[:, None], depth) + _padded(offsets, depth)


def _padded(array: np.ndarray, depth: int) -> np.ndarray:
    """Array (n, L, ...) with unit axes put in front of its batch axes, `depth` of them in all."""
    missing = depth + 2 - array.ndim
    return array.reshape(*array.shape[:2], *[1] * missing, *array.shape[2:])


def _positive(**counts: int) -> None:
    for name, value in counts.items():
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            raise TypeError(f"{name}: wanted an integer, got {value!r}")
        if value < 1:
            raise ValueError(f"{name}: wanted at least 1, got {value}")
