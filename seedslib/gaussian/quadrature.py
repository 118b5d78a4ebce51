"""Quadrature rules for the mean of a function of a Gaussian vector.

A rule is a set of points and weights for the standard normal vector; the points of N(mean, cov) are
``mean + L points`` with any factor L of the covariance. Rules with negative weights are legal:
they give sums, not probabilities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, reduce
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import roots_hermitenorm

from seedslib.base.arrays import align
from seedslib.base.checks import as_count, as_real
from seedslib.base.linalg import cholesky
from seedslib.gaussian.arguments import gaussian_arguments

MOST_POINTS = 2_000_000  # of a product rule: tens of megabytes


@dataclass(frozen=True, eq=False)
class Rule:
    """Points and weights for means of functions of a standard normal vector.

    Attributes
    ----------
    points : ndarray
        Shape (n, L).
    weights : ndarray
        Shape (L,), sum one.
    """

    points: np.ndarray
    weights: np.ndarray

    def __post_init__(self) -> None:
        for array in (self.points, self.weights):
            array.flags.writeable = False


def gauss_hermite(n: int, order: int) -> Rule:
    """Tensor product of Gauss-Hermite rules with `order` points on each of n axes.

    Raises
    ------
    TypeError, ValueError
        Not positive integers, or more than two million points.
    """
    n, order = as_count("n", n), as_count("order", order)
    return Rule(*rule_of_rank(n, order))


@cache
def rule_of_rank(rank: int, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Hermite points (rank, L) and weights (L,); one point for rank zero."""
    if rank == 0:
        return np.empty((0, 1)), np.ones(1)
    if order**rank > MOST_POINTS:
        raise ValueError(
            f"order: wanted at most {MOST_POINTS} points, got {order}**{rank}; "
            "use fifth_degree or cubature"
        )
    nodes, weights = roots_hermitenorm(order)
    grid = np.meshgrid(*[nodes] * rank, indexing="ij")
    mass = reduce(np.multiply.outer, [weights / weights.sum()] * rank)
    return np.stack([g.ravel() for g in grid]), mass.ravel()


def cubature(n: int) -> Rule:
    """Third-degree rule of 2n equally weighted points at distance √n on the axes.

    Raises
    ------
    TypeError, ValueError
        Not a positive integer.
    """
    n = as_count("n", n)
    eye = np.sqrt(n) * np.eye(n)
    return Rule(np.hstack([eye, -eye]), np.full(2 * n, 0.5 / n))


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
    n = as_count("n", n)
    kappa = as_real("kappa", kappa, ()).item()
    if not -n < kappa:
        raise ValueError(f"kappa: wanted a number above {-n}, got {kappa}")
    eye = np.sqrt(n + kappa) * np.eye(n)
    side = 0.5 / (n + kappa)
    weights = np.concatenate([[kappa / (n + kappa)], np.full(2 * n, side)])
    return Rule(np.hstack([np.zeros((n, 1)), eye, -eye]), weights)


def fifth_degree(n: int) -> Rule:
    """Fifth-degree rule of 2n²+1 points; some weights are negative for n above 4.

    Raises
    ------
    TypeError, ValueError
        Not a positive integer.
    """
    n = as_count("n", n)
    sides, axes = (np.sqrt(3.0), -np.sqrt(3.0)), np.eye(n)
    points = [np.zeros(n), *(sign * axis for axis in axes for sign in sides)]
    for one, other in combinations(axes, 2):
        points += [a * one + b * other for a, b in product(sides, repeat=2)]
    shares = [1.0 + (n * n - 7.0 * n) / 18.0, (4.0 - n) / 18.0, 1.0 / 36.0]
    weights = np.repeat(shares, [1, 2 * n, 2 * n * (n - 1)])
    return Rule(np.stack(points, axis=1), weights)


def mean_of(f: Callable[..., Any], mean: ArrayLike, cov: ArrayLike, rule: Rule) -> np.ndarray:
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
    mean, cov = gaussian_arguments(mean, cov)
    n = mean.shape[0]
    if rule.points.shape[0] != n:
        raise ValueError(f"rule: wanted a rule for {n} variables, got {rule.points.shape[0]}")
    offsets = np.einsum("ij...,jk->ik...", cholesky(cov), rule.points)
    depth = max(mean.ndim - 1, offsets.ndim - 2)
    points = align(mean[:, None], 2, depth) + align(offsets, 2, depth)
    flat = points.reshape(n, -1)
    values = np.asarray(f(flat))
    if values.shape[-1:] != flat.shape[1:] or values.ndim > 2:
        raise ValueError(
            f"f: wanted values of shape (N,) or (p, N) with N = {flat.shape[1]}, got {values.shape}"
        )
    values = values.reshape(*values.shape[:-1], *points.shape[1:])
    return np.tensordot(rule.weights, values, (0, values.ndim - points.ndim + 1))[()]
