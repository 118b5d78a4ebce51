"""Errors of any function by a Hermite expansion: exact for polynomials, else with bounds."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import sympy as sp

from seedslib.base.symbols import as_symbols
from seedslib.gaussian.errors.hermite import (
    HermiteExpansion,
    polynomial_expansion,
    quadrature_expansion,
)
from seedslib.gaussian.errors.joint import as_joint_law
from seedslib.gaussian.means.parse import check_symbols, components_of
from seedslib.gaussian.means.symbolic import FunctionClass, classify, expectation_function

RULE_ERROR = 1e-4


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

    Exact for polynomials; for any other function by Gauss-Hermite quadrature with the largest
    exponent `degree` per coordinate (see `quadrature_expansion`). The rule is slow to converge
    where f has a kink or a jump: `rule_error` tells by how much the errors may be wrong.

    Parameters
    ----------
    f : expression, list or column Matrix of p expressions
        Any real function of `variables` that NumPy and SciPy can evaluate.
    variables : sequence of n Symbols
        Components of the state.
    mean, cov, error_cov : array_like (n,), (n, n), (n, n)
        Prior mean, prior covariance C, error covariance P <= C.
    degree, nodes : int
        Of the quadrature.

    Returns
    -------
    HermiteExpansion

    Raises
    ------
    TypeError, ValueError
        Unknown symbols, bad mean or covariances, too large a rule.

    Warns
    -----
    UserWarning
        The error of the rule is above 1e-4 of the error itself.
    """
    size, coordinates, symbols = active(f, variables)
    law = marginal(coordinates, *as_joint_law(mean, cov, error_cov, size))
    if classify(f, symbols) is FunctionClass.POLYNOMIAL:
        polynomial = expectation_function(f, symbols).compiled().polynomial()
        expansion = polynomial_expansion(polynomial, *law)
    else:
        expansion = _judged(_numeric(f, symbols), law, degree, nodes)
    return replace(expansion, coordinates=coordinates)


class ErrorBounds(NamedTuple):
    """Approximate errors by quadrature.

    ``lower <= optimal error <= upper`` up to the error of the rule, which is small for smooth
    functions only; ``plugin`` is the error of the plug-in estimate, by the same rule.
    """

    lower: np.ndarray
    upper: np.ndarray
    plugin: np.ndarray


def approximate_errors(
    f: object, variables: Sequence[sp.Symbol], *, degree: int = 20, nodes: int = 80
) -> Callable[[object, object, object], ErrorBounds]:
    """Bounds of the optimal error and the plug-in error of any function, by quadrature.

    For functions outside the closed class. Never called in place of `mean_square_errors` by the
    library itself.

    Parameters
    ----------
    f : expression, list or column Matrix of p expressions
        Any square-integrable function that NumPy and SciPy can evaluate.
    variables : sequence of n Symbols
        Components of the state.
    degree : int
        Largest exponent of one coordinate in the Hermite expansion.
    nodes : int
        Nodes of the Gauss-Hermite rule along each direction; ``nodes ** n`` at most two million.

    Returns
    -------
    callable
        ``(mean (n,), cov (n, n), error_cov (n, n)) -> ErrorBounds``.

    Raises
    ------
    TypeError, ValueError
        Unknown symbols; when called, bad mean or covariances or too large a rule.

    Warns
    -----
    UserWarning
        When called, as `hermite_expansion`.
    """
    size, coordinates, symbols = active(f, variables)
    numeric, scalar = _numeric(f, symbols), components_of(f)[1]

    def errors(mean: object, cov: object, error_cov: object) -> ErrorBounds:
        law = marginal(coordinates, *as_joint_law(mean, cov, error_cov, size))
        expansion = _judged(numeric, law, degree, nodes)
        points, weights = expansion.estimate_rule(nodes)
        gap = expansion.estimate(points, int(expansion.degrees.max())) - numeric(points)
        upper = expansion.upper()
        bounds = (expansion.lower(), upper, upper + (gap * weights) @ gap.T)
        return ErrorBounds(*(float(b[0, 0]) if scalar else b for b in bounds))

    return errors


def _judged(
    function: Callable, law: tuple[np.ndarray, ...], degree: int, nodes: int
) -> HermiteExpansion:
    """Expansion by quadrature with the error of its rule, told by two rules of fewer nodes.

    Where the error falls as 1 / nodes, as at a kink, a rule of three quarters of the nodes is
    off by a third of the error more; one even and one odd, which meet a kink differently.
    """
    expansion = quadrature_expansion(function, *law, degree=degree, nodes=nodes)
    error = np.zeros_like(expansion.remainder)
    for fewer in {max(3 * nodes // 4, 1), max(3 * nodes // 4 - 1, 1)} - {nodes}:
        same = min(degree, fewer - 1)
        fine, rough = (
            quadrature_expansion(function, *law, degree=same, nodes=count)
            for count in (nodes, fewer)
        )
        for one, other in ((fine.lower(), rough.lower()), (fine.upper(), rough.upper())):
            error = np.maximum(error, 3.0 * np.abs(one - other))
    largest = np.trace(expansion.upper())
    if np.trace(error) > RULE_ERROR * largest:
        warnings.warn(
            f"f: the quadrature rule of {nodes} nodes may miss the error {largest:.3g} by "
            f"{np.trace(error):.1g}; wanted a smoother function or more nodes",
            stacklevel=3,
        )
    return replace(expansion, rule_error=error)


def _numeric(f: object, variables: Sequence[sp.Symbol]) -> Callable[[np.ndarray], np.ndarray]:
    """Vectorised values (p, N) of f at points (n, N)."""
    expressions, _ = components_of(f)
    unknown = set().union(*(e.free_symbols for e in expressions)) - set(variables)
    if unknown:
        raise ValueError(f"f: wanted known symbols, got {', '.join(sorted(map(str, unknown)))}")
    try:
        function = sp.lambdify(variables, expressions, modules=["scipy", "numpy"], cse=True)
        with np.errstate(all="ignore"):  # zero may be a pole
            function(*np.zeros((len(variables), 2)))
    except (NameError, NotImplementedError, ValueError):
        raise ValueError(f"f: wanted functions with NumPy code, got {f}") from None

    def values(point: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):  # a pole is found by its value
            rows = np.broadcast_arrays(*function(*point), point[0])[:-1]
        return np.array(rows, dtype=float)

    return values
