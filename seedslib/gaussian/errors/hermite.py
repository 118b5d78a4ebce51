"""Hermite expansion of a function under a prior: exact errors and the degree-K hierarchy.

With ``C = T T'`` and ``P = T diag(pi) T'`` the state is ``x = mu + T xi`` and its Kalman-Bucy
estimate ``mu + T eta`` with ``xi_i, eta_i`` of correlation ``sqrt(1 - pi_i)``. In orthonormal
Hermite polynomials of ``xi`` the conditional mean multiplies the coefficient ``a_beta`` by
``(1 - pi)^(beta / 2)``, so every mean-square error is a weighted sum of squares:
nothing is subtracted and relative accuracy is kept however small P is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from math import factorial, sqrt

import numpy as np
from scipy.special import roots_hermitenorm

from seedslib.base.arrays import MaybeArray
from seedslib.gaussian.errors.joint import joint_factor, symmetric_part
from seedslib.gaussian.errors.tensors import contracted, factorial_of, mean_derivatives
from seedslib.gaussian.means.polynomial import Index, heat
from seedslib.gaussian.quadrature import rule_of_rank

LARGEST_TENSOR = 3_000_000


@dataclass(frozen=True, eq=False)
class HermiteExpansion:
    """Expansion of a function of p values under N(mean, C), beside an error covariance P.

    Attributes
    ----------
    mean : ndarray (n,)
        Prior mean mu.
    factor : ndarray (n, rank)
        T with ``C = T T'`` and ``P = T diag(shares) T'``.
    shares : ndarray (rank,)
        pi, the unexplained share of each prior direction, in [0, 1].
    indices : ndarray of int (count, rank)
        Multi-indices beta.
    coefficients : ndarray (p, count)
        a_beta in orthonormal Hermite polynomials.
    remainder : ndarray (p, p)
        ``Cov f`` beyond the expansion; zero for polynomials.
    coordinates : tuple of int, optional
        Components of the state that the n coordinates are; all of them by default.
    rule_error : ndarray (p, p), optional
        How far `lower` and `upper` may be wrong because the coefficients come from a rule, as
        two coarser rules tell; zero for polynomials. None where nobody looked.
    """

    mean: np.ndarray
    factor: np.ndarray
    shares: np.ndarray
    indices: np.ndarray
    coefficients: np.ndarray
    remainder: np.ndarray
    coordinates: tuple[int, ...] | None = None
    rule_error: MaybeArray = None

    @property
    def degrees(self) -> np.ndarray:
        """Total degree of each term, shape (count,)."""
        return self.indices.sum(axis=1)

    def _unexplained(self) -> np.ndarray:
        """``1 - (1 - pi)^beta``, exact for small and for unit shares."""
        with np.errstate(divide="ignore"):  # a share of one is meant: log1p(-1) = -inf
            logs = np.log1p(-self.shares)
        logs = np.where(self.indices > 0, self.indices * np.where(self.indices > 0, logs, 0.0), 0)
        return -np.expm1(logs.sum(axis=1))

    def _weighted(self, weights: np.ndarray) -> np.ndarray:
        return (self.coefficients * weights) @ self.coefficients.T

    def lower(self) -> np.ndarray:
        """Optimal mean-square error (p, p) of the expanded part: a lower bound, or exact."""
        return self._weighted(self._unexplained())

    def upper(self) -> np.ndarray:
        """Upper bound (p, p) of the optimal error: all of the remainder counts as lost."""
        return self.lower() + self.remainder

    def degree_errors(self) -> np.ndarray:
        """Errors P_K (degree + 1, p, p) of the best estimators of degree 0, 1, ..., degree.

        ``P_0`` is the prior covariance of f, ``P_1`` the error of the linear estimator, and the
        sequence falls to the optimal error (its upper bound, where there is a remainder).
        """
        lost = self._unexplained()
        degrees = self.degrees
        errors = [
            self._weighted(np.where((degrees > k) & (degrees > 0), 1.0, lost)) + self.remainder
            for k in range(int(degrees.max(initial=0)) + 1)
        ]
        return np.array(errors)

    def estimate(self, xhat: np.ndarray, degree: int) -> np.ndarray:
        """Best estimate that is a polynomial of at most `degree` in the linear estimate.

        Parameters
        ----------
        xhat : ndarray (n, ...)
            Kalman-Bucy estimates of the whole state, batch axes last.
        degree : int
            K.

        Returns
        -------
        ndarray (p, ...)
        """
        xhat = np.asarray(xhat, dtype=float)
        if self.coordinates is not None:
            xhat = xhat[list(self.coordinates)]
        centred = xhat - self.mean.reshape(-1, *(1,) * (xhat.ndim - 1))
        eta = np.tensordot(np.linalg.pinv(self.factor), centred, axes=1)
        # He_k of variance v = 1 - pi: y He_k - k v He_{k-1}; v = 0 is the coordinate y = 0
        tables = []
        for y, variance in zip(eta, 1.0 - self.shares, strict=True):
            rows = [np.ones_like(y), y]
            for k in range(1, degree):
                rows.append(y * rows[k] - k * variance * rows[k - 1])
            tables.append(rows)
        total = np.zeros((len(self.coefficients), *xhat.shape[1:]))
        for beta, a in zip(self.indices, self.coefficients.T, strict=True):
            if beta.sum() <= degree:
                term = np.ones(xhat.shape[1:])
                for table, k in zip(tables, beta, strict=True):
                    term = term * table[k] / sqrt(factorial(k))
                total += a.reshape(-1, *(1,) * term.ndim) * term
        return total

    def estimate_rule(self, nodes: int) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Hermite points (n, N) and weights (N,) of the law of the estimate."""
        moving = self.shares < 1.0
        root = self.factor[:, moving] * np.sqrt(1.0 - self.shares[moving])
        grid, weights = rule_of_rank(root.shape[1], nodes)
        return self.mean[:, None] + root @ grid, weights


def plugin_excess(
    polynomial: Mapping[Index, np.ndarray], mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
) -> np.ndarray:
    """``E (zhat - f(xhat)) (zhat - f(xhat))'`` (p, p) of a polynomial, checked arguments.

    The bias ``zhat - f(xhat)`` is itself a polynomial of xhat, built without its leading part.
    """
    bias = heat(polynomial, error_cov, first=1)
    size = len(next(iter(polynomial.values())))
    if not bias:
        return np.zeros((size, size))
    factor, shares = joint_factor(cov, error_cov)
    known = symmetric_part((factor * (1.0 - shares)) @ factor.T)
    coefficients = polynomial_expansion(bias, mean, known, known).coefficients
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
    return HermiteExpansion(
        mean,
        factor,
        shares,
        np.array(indices, dtype=int).reshape(len(indices), rank),
        coefficients,
        np.zeros((len(coefficients),) * 2),
        rule_error=np.zeros((len(coefficients),) * 2),
    )


def quadrature_expansion(
    function: Callable[[np.ndarray], np.ndarray],
    mean: np.ndarray,
    cov: np.ndarray,
    error_cov: np.ndarray,
    *,
    degree: int = 20,
    nodes: int = 80,
) -> HermiteExpansion:
    """Hermite expansion of any square-integrable function by Gauss-Hermite quadrature.

    Approximate: the coefficients carry the error of the rule, which converges slowly where f
    has kinks or jumps.

    Parameters
    ----------
    function : callable
        Vectorised f: points (n, N) to values (N,) or (p, N).
    mean, cov, error_cov : ndarray (n,), (n, n), (n, n)
        Prior mean, prior covariance and error covariance, checked.
    degree : int
        Largest exponent of one coordinate that is kept.
    nodes : int
        Nodes of the rule along each of the `rank` directions of the prior.

    Raises
    ------
    ValueError
        `degree` not below `nodes`, values of f that are not finite, or a
        rule of more than two million points.
    """
    factor, shares = joint_factor(cov, error_cov)
    rank = factor.shape[1]
    if not 0 <= degree < nodes:
        raise ValueError(f"degree: wanted 0 <= degree < nodes = {nodes}, got {degree}")
    grid, density = rule_of_rank(rank, nodes)
    values = np.atleast_2d(np.asarray(function(mean[:, None] + factor @ grid), dtype=float))
    values = np.broadcast_to(values, (len(values), grid.shape[1]))
    if not np.isfinite(values).all():
        raise ValueError("function: wanted finite values at the quadrature nodes")
    points, weights = roots_hermitenorm(nodes)
    table = [np.ones(nodes), points]
    for k in range(1, degree):
        table.append((points * table[k] - sqrt(k) * table[k - 1]) / sqrt(k + 1))
    table = np.array(table[: degree + 1]) * (weights / weights.sum())
    average = values @ density
    spread = ((values - average[:, None]) * density) @ (values - average[:, None]).T
    # expanding the centred values keeps a large mean out of the remainder
    tensor = (values - average[:, None]).reshape(len(values), *(nodes,) * rank)
    for _ in range(rank):
        tensor = np.tensordot(tensor, table, axes=(1, 1))
    coefficients = tensor.reshape(len(values), -1)
    coefficients[:, 0] = average
    indices = np.array(list(product(range(degree + 1), repeat=rank)), dtype=int)
    rest = coefficients[:, 1:]
    return HermiteExpansion(
        mean,
        factor,
        shares,
        indices.reshape(coefficients.shape[1], rank),
        coefficients,
        spread - rest @ rest.T,
    )
