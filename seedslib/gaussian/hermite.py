"""Hermite expansion of a function under a prior: exact errors and the degree-K hierarchy.

With ``C = T T'`` and ``P = T diag(pi) T'`` the state is ``x = mu + T xi`` and its Kalman-Bucy
estimate ``mu + T eta`` with ``xi_i, eta_i`` of correlation ``sqrt(1 - pi_i)``. In orthonormal
Hermite polynomials of ``xi`` the conditional mean multiplies the coefficient ``a_beta`` by
``(1 - pi)^(beta / 2)``, so every mean-square error is a weighted sum of squares:
nothing is subtracted and relative accuracy is kept however small P is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from math import factorial, sqrt

import numpy as np
import sympy as sp
from scipy.special import eval_hermitenorm, roots_hermitenorm

from seedslib.base.linalg import symmetrized
from seedslib.base.symbols import as_symbols
from seedslib.gaussian.algebra import check_symbols, components_of
from seedslib.gaussian.arguments import estimate_arguments
from seedslib.gaussian.means import (
    FunctionClass,
    Index,
    expectation_function,
    factorial_of,
    mean_derivatives,
    smoothing_bias,
)
from seedslib.gaussian.quadrature import rule_of_rank

LARGEST_TENSOR = 3_000_000  # entries, tens of megabytes
RANK = 1e-13  # eigenvalues of a correlation matrix below this part of the largest are rounding
UNINFORMED = 1e-14  # a share that is this near to one is one, up to rounding


def joint_factor(cov: np.ndarray, error_cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T (n, rank) and shares (rank,) with ``C = T T'`` and ``P = T diag(shares) T'``.

    Shares are in [0, 1]; one stands for no information. Small P keep their relative accuracy.
    """
    scale = np.sqrt(np.diag(cov))
    scale = np.where(scale > 0, scale, 1.0)
    # any eigenvectors will do: every error is the same in all of them
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))
    keep = values > RANK * max(values[-1], 0.0)
    root = np.sqrt(values[keep])
    whiten = vectors[:, keep] / (scale[:, None] * root)
    shares, rotation = np.linalg.eigh(symmetrized(whiten.T @ error_cov @ whiten))
    # whiten transposed maps back: scale * vectors * root is its pseudo-inverse
    factor = (scale[:, None] * vectors[:, keep] * root) @ rotation
    return factor, np.where(shares > 1.0 - UNINFORMED, 1.0, np.maximum(shares, 0.0))


@dataclass(frozen=True, eq=False)
class HermiteExpansion:
    """Expansion of a function of p values under N(mean, C), beside an error covariance P.

    Attributes
    ----------
    shares : ndarray (rank,)
        pi, the unexplained share of each prior direction, in [0, 1].
    indices : ndarray of int (count, rank)
        Multi-indices beta.
    coefficients : ndarray (p, count)
        a_beta in orthonormal Hermite polynomials.
    remainder : ndarray (p, p)
        ``Cov f`` beyond the expansion; zero for polynomials.
    """

    shares: np.ndarray
    indices: np.ndarray
    coefficients: np.ndarray
    remainder: np.ndarray

    def _unexplained(self) -> np.ndarray:
        """``1 - (1 - pi)^beta``, exact for small and for unit shares."""
        with np.errstate(divide="ignore"):  # a share of one is meant: log1p(-1) = -inf
            logs = np.log1p(-self.shares)
        logs = np.where(self.indices > 0, self.indices * np.where(self.indices > 0, logs, 0.0), 0)
        return -np.expm1(logs.sum(axis=1))

    def _weighted(self, weights: np.ndarray) -> np.ndarray:
        return (self.coefficients * weights) @ self.coefficients.T

    def optimal_error(self) -> np.ndarray:
        """Optimal mean-square error (p, p) of the expanded part: exact, or a lower bound."""
        return self._weighted(self._unexplained())

    def degree_errors(self) -> np.ndarray:
        """Errors P_K (degree + 1, p, p) of the best estimators of degree 0, 1, ..., degree.

        ``P_0`` is the prior covariance of f, ``P_1`` the error of the linear estimator, and the
        sequence falls to the optimal error, or to an upper bound of it where there is a remainder,
        all of which counts as unexplained.
        """
        unexplained, degrees = self._unexplained(), self.indices.sum(axis=1)
        errors = [
            self._weighted(np.where((degrees > k) & (degrees > 0), 1.0, unexplained))
            for k in range(int(degrees.max(initial=0)) + 1)
        ]
        return np.array(errors) + self.remainder


def hermite_expansion(
    f: object,
    variables: Sequence[sp.Symbol],
    mean: object,
    cov: object,
    error_cov: object,
    *,
    degree: int = 20,
    nodes: int = 80,
) -> HermiteExpansion:
    """Hermite expansion of f under the prior: the hierarchy of polynomial estimators.

    Exact for polynomials; for any other function of the closed class by Gauss-Hermite quadrature,
    which converges slowly where f has kinks or jumps.

    Parameters
    ----------
    f : expression, list or column Matrix of p expressions
        Real function of `variables`.
    variables : sequence of n Symbols
        Components of the state.
    mean, cov, error_cov : array_like (n,), (n, n), (n, n)
        Prior mean, prior covariance C, error covariance P <= C.
    degree : int
        Largest exponent of one coordinate that the quadrature keeps.
    nodes : int
        Nodes of the rule along each of the `rank` directions of the prior.

    Returns
    -------
    HermiteExpansion

    Raises
    ------
    NoClosedForm
        f is outside the closed class.
    TypeError, ValueError
        Unknown symbols, bad mean or covariances, `degree` not below `nodes`, too large a rule.
    """
    size, coordinates, symbols = active(f, variables)
    moments = marginal(coordinates, *estimate_arguments(mean, cov, error_cov, size))
    function = expectation_function(f, symbols)
    if function.kind is FunctionClass.POLYNOMIAL:
        return polynomial_expansion(function.compiled.polynomial(), *moments)
    mean, cov, error_cov = moments
    factor, shares = joint_factor(cov, error_cov)
    rank = factor.shape[1]
    if not 0 <= degree < nodes:
        raise ValueError(f"degree: wanted 0 <= degree < nodes = {nodes}, got {degree}")
    grid, density = rule_of_rank(rank, nodes)
    values = function.compiled.value(mean[:, None] + factor @ grid)
    points, weights = roots_hermitenorm(nodes)
    table = [eval_hermitenorm(k, points) / sqrt(factorial(k)) for k in range(degree + 1)]
    table = np.array(table) * (weights / weights.sum())
    average = values @ density
    cov_f = ((values - average[:, None]) * density) @ (values - average[:, None]).T
    # expanding the centred values keeps a large mean out of the remainder
    tensor = (values - average[:, None]).reshape(len(values), *(nodes,) * rank)
    for _ in range(rank):
        tensor = np.tensordot(tensor, table, axes=(1, 1))
    coefficients = tensor.reshape(len(values), -1)
    coefficients[:, 0] = average
    indices = np.array(list(product(range(degree + 1), repeat=rank)), dtype=int)
    rest = coefficients[:, 1:]
    indices = indices.reshape(coefficients.shape[1], rank)
    return HermiteExpansion(shares, indices, coefficients, cov_f - rest @ rest.T)


def active(
    f: object, variables: Sequence[sp.Symbol]
) -> tuple[int, tuple[int, ...], list[sp.Symbol]]:
    """Number of variables; indices of those that f contains (at least one); their symbols."""
    variables = as_symbols("variables", variables)
    expressions, _ = components_of(f)
    check_symbols(expressions, variables)
    present = set().union(*(e.free_symbols for e in expressions))
    coordinates = tuple(i for i, s in enumerate(variables) if s in present) or (0,)
    return len(variables), coordinates, [variables[i] for i in coordinates]


def marginal(
    coordinates: Sequence[int], mean: np.ndarray, *covs: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Mean and covariances of some components."""
    pick = list(coordinates)
    return (mean[pick], *(cov[pick][:, pick] for cov in covs))


def plugin_excess(
    polynomial: Mapping[Index, np.ndarray], mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
) -> np.ndarray:
    """``E (zhat - f(xhat)) (zhat - f(xhat))'`` (p, p) of a polynomial, checked arguments.

    The bias ``zhat - f(xhat)`` is itself a polynomial of xhat, built without its leading part.
    """
    bias = smoothing_bias(polynomial, error_cov)
    size = len(next(iter(polynomial.values())))
    if not bias:
        return np.zeros((size, size))
    factor, shares = joint_factor(cov, error_cov)
    estimate_cov = symmetrized((factor * (1.0 - shares)) @ factor.T)
    coefficients = polynomial_expansion(bias, mean, estimate_cov, estimate_cov).coefficients
    return coefficients @ coefficients.T


def polynomial_expansion(
    polynomial: Mapping[Index, np.ndarray], mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
) -> HermiteExpansion:
    """Exact Hermite expansion of a polynomial map.

    Parameters
    ----------
    polynomial : dict from multi-index to ndarray (p,)
        Coefficients.
    mean, cov, error_cov : ndarray (n,), (n, n), (n, n)
        Prior mean mu, prior covariance C and error covariance P <= C, checked.

    Raises
    ------
    ValueError
        A degree and dimension beyond about 3e6 tensor entries.
    """
    size = mean.size
    factor, shares = joint_factor(cov, error_cov)
    degree = max(sum(alpha) for alpha in polynomial)
    if size**degree > LARGEST_TENSOR:
        raise ValueError(f"f: wanted n**degree of at most {LARGEST_TENSOR}, got {size}**{degree}")
    means = mean_derivatives(polynomial, mean, cov)
    rank = factor.shape[1]
    indices, columns = [], []
    for order in range(degree + 1):
        tensor = contracted(means, order, factor)
        for axes in combinations_with_replacement(range(rank), order):
            beta = tuple(axes.count(i) for i in range(rank))
            indices.append(beta)
            columns.append(tensor[(slice(None), *axes)] / sqrt(factorial_of(beta)))
    coefficients = np.array(columns).T
    indices = np.array(indices, dtype=int).reshape(len(indices), rank)
    return HermiteExpansion(shares, indices, coefficients, np.zeros((len(coefficients),) * 2))


def contracted(means: Mapping[Index, np.ndarray], order: int, factor: np.ndarray) -> np.ndarray:
    """Symmetric tensor ``E grad^k f`` with every axis contracted with the factor."""
    size = factor.shape[0]
    values = len(next(iter(means.values())))
    tensor = np.zeros((values, *(size,) * order))
    # a multi-index and the axes of a tensor entry meet in one code: digit i counts the axes i
    digits = (order + 1) ** np.arange(size)
    codes = digits[np.indices((size,) * order).reshape(order, size**order)].sum(axis=0)
    flat = tensor.reshape(values, -1)
    wanted = {int(np.dot(digits, beta)): m for beta, m in means.items() if sum(beta) == order}
    present, place = np.unique(codes, return_inverse=True)
    table = np.array([wanted.get(int(code), np.zeros(values)) for code in present])
    flat[:] = table[place].T
    for _ in range(order):
        # contracting the first tensor axis moves it to the end: after `order` turns all are done
        tensor = np.tensordot(tensor, factor, axes=(1, 0))
    return tensor
