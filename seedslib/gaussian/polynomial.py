"""Gaussian means of polynomials: the Stein-Isserlis recursion, and what follows from it.

A polynomial map of n variables with p values is a dictionary ``{alpha: c}`` from multi-indices
(tuples of n exponents) to coefficients, arrays of shape (p,). The recursion uses only sums and
products of the components of the mean and of the covariance, so the same lines serve single
numbers, batches (batch axes last), complex shifts of the mean and SymPy symbols.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import product
from math import comb, factorial, prod
from typing import Any, NamedTuple

import numpy as np

Index = tuple[int, ...]
Coefficients = dict[Index, np.ndarray]


class _Step(NamedTuple):
    """``M[target] = x[axis] M[source] + sum_j count_j P[axis, j] M[below_j] (+ boundary)``."""

    target: Index
    axis: int
    source: Index
    below: tuple[tuple[int, int, Index], ...]


def _lowered(index: Index, axis: int) -> Index:
    return (*index[:axis], index[axis] - 1, *index[axis + 1 :])


@lru_cache(maxsize=1024)
def _plan(indices: tuple[Index, ...]) -> tuple[_Step, ...]:
    """Order in which the recursion reaches the wanted monomials, lowest degree first.

    The axis with the smallest positive exponent is lowered: the other monomials then share one
    another's predecessors, and few superfluous ones are visited.
    """
    # which monomials are met depends on the indices alone, and one function is asked for often
    steps: dict[Index, _Step] = {}
    waiting = list(indices)
    while waiting:
        target = waiting.pop()
        if target in steps or not any(target):
            continue
        axis = min((i for i, k in enumerate(target) if k), key=lambda i: target[i])
        source = _lowered(target, axis)
        below = tuple((j, k, _lowered(source, j)) for j, k in enumerate(source) if k)
        steps[target] = _Step(target, axis, source, below)
        waiting += [source, *(lower for _, _, lower in below)]
    return tuple(sorted(steps.values(), key=lambda step: sum(step.target)))


def monomial_means(
    indices: Iterable[Index],
    mean: Sequence[Any],
    cov: Sequence[Any],
    *,
    zeroth: object = 1.0,
    boundary: tuple[Sequence[Any], Mapping[Index, object]] | None = None,
    tidy: Callable[..., Any] = lambda value: value,
) -> dict[Index, object]:
    """E x^alpha for the wanted multi-indices by the Stein-Isserlis recursion.

    ``M_{beta + e_i} = m_i M_beta + sum_j P_ij beta_j M_{beta - e_j}``, ``M_0 = 1``.

    Parameters
    ----------
    indices : iterable of tuple of int
        Multi-indices alpha.
    mean : sequence of n components
        Numbers, arrays of one batch shape, or SymPy expressions; may be complex.
    cov : n by n nested sequence or array (n, n) or (n, n, ...)
        Components of the same kind.
    zeroth : component
        ``M_0``; the mass of a half-space, when the mean is taken over one.
    boundary : (direction, means), optional
        For a mean over a half-space {u > 0}: ``direction[i] = cov(x_i, u)`` and ``means[beta]``
        the boundary values ``E x^beta delta(u)``; the recursion gains ``direction_i means_beta``.
    tidy : callable
        Applied to each mean; ``sympy.expand`` keeps symbolic ones short.

    Returns
    -------
    dict
        From every visited multi-index (the wanted ones and their predecessors) to its mean.
    """
    indices = tuple(indices)
    means: dict[Index, object] = {}
    if indices:
        means[(0,) * len(indices[0])] = zeroth
    for target, axis, source, below in _plan(indices):
        value = mean[axis] * means[source]
        for j, count, lower in below:
            value = value + (count * cov[axis][j]) * means[lower]
        if boundary is not None:
            value = value + boundary[0][axis] * boundary[1][source]
        means[target] = tidy(value)
    return means


def predecessors(indices: Iterable[Index]) -> tuple[Index, ...]:
    """Every multi-index that the recursion for `indices` visits."""
    indices = tuple(indices)
    zero = ((0,) * len(indices[0]),) if indices else ()
    return (*zero, *(step.target for step in _plan(indices)))


def polynomial_mean(
    polynomial: Mapping[Index, np.ndarray], means: Mapping[Index, object], batch: tuple[int, ...]
) -> np.ndarray:
    """Linear combination ``sum_alpha c_alpha M_alpha``, shape (p, *batch)."""
    size = len(next(iter(polynomial.values())))
    kind = np.result_type(*polynomial.values(), *(means[alpha] for alpha in polynomial))
    total = np.zeros((size, *batch), dtype=kind)
    for alpha, coefficient in polynomial.items():
        # a component has few of the monomials of all
        for row in np.flatnonzero(coefficient):
            total[row] += coefficient[row] * means[alpha]
    return total


def factorial_of(index: Index) -> int:
    """``beta! = prod beta_i!``."""
    return prod(map(factorial, index))


def _splits(indices: Iterable[Index]) -> list[tuple[Index, Index, Index]]:
    """Every alpha with every beta <= alpha and the rest, alpha - beta."""
    return [
        (alpha, beta, tuple(a - b for a, b in zip(alpha, beta, strict=True)))
        for alpha in indices
        for beta in product(*(range(k + 1) for k in alpha))
    ]


def mean_derivatives(
    polynomial: Mapping[Index, np.ndarray], mean: np.ndarray, cov: np.ndarray
) -> Coefficients:
    """``E (d/dx)^beta f`` (p, *batch) for every multi-index beta that does not annihilate f."""
    splits = _splits(polynomial)
    rests = dict.fromkeys(rest for *_, rest in splits)
    means = monomial_means(rests, mean, cov, zeroth=np.ones(mean.shape[1:]))
    result: Coefficients = {}
    for alpha, beta, rest in splits:
        weight = factorial_of(alpha) // factorial_of(rest)  # of the derivative of a monomial
        part = np.multiply.outer(weight * polynomial[alpha], means[rest])
        result[beta] = result.get(beta, 0.0) + part
    return result


def smoothing_bias(polynomial: Mapping[Index, np.ndarray], cov: np.ndarray) -> Coefficients:
    """Coefficients of ``E f(x + e) - f(x)``, e ~ N(0, cov), a polynomial in x.

    Nothing is subtracted: it consists of the even moments of e of positive degree.
    """
    splits = [s for s in _splits(polynomial) if any(s[1]) and sum(s[1]) % 2 == 0]
    means = monomial_means({beta: None for _, beta, _ in splits}, np.zeros(len(cov)), cov)
    result: Coefficients = {}
    for alpha, beta, rest in splits:
        weight = prod(map(comb, alpha, beta)) * means[beta]
        result[rest] = result.get(rest, 0.0) + weight * polynomial[alpha]
    return result


def taylor_coefficients(polynomial: Mapping[Index, np.ndarray], point: np.ndarray) -> Coefficients:
    """Coefficients (p, *batch) of a polynomial map in the step from points (n, *batch)."""
    derivatives = mean_derivatives(polynomial, point, np.zeros((len(point),) * 2))
    return {beta: value / factorial_of(beta) for beta, value in derivatives.items()}


def polynomial_value(
    polynomial: Mapping[Index, np.ndarray], point: np.ndarray, size: int
) -> np.ndarray:
    """Values of a polynomial map, shape (p, *batch), at points of shape (n, *batch)."""
    batch = point.shape[1:]
    if not polynomial:
        return np.zeros((size, *batch))
    # the recursion of the means without its covariance is the one of the powers
    powers: dict[Index, object] = {(0,) * len(point): 1.0}
    for step in _plan(tuple(polynomial)):
        powers[step.target] = point[step.axis] * powers[step.source]
    return polynomial_mean(polynomial, powers, batch)
