"""Second step of the two-step estimator: a function of a Gaussian vector, its mean and errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.semidefinite import square_root
from seedslib.gaussian.arguments import as_joint_law, in_range
from seedslib.gaussian.functions import MeanSquareErrors
from seedslib.gaussian.quadrature import Rule, points_of

BLOCK_POINTS = 1_000_000


class FunctionLaw(NamedTuple):
    """A function of the state together with its means under Gaussian laws.

    Attributes
    ----------
    kind : str
        Class of functions whose formulas are used.
    scalar : bool
        Whether the function has one value, without a component axis.
    plugin : callable
        x̂ (n, ...) -> f(x̂), shape (...) or (p, ...).
    mean : callable
        (x̂, P) -> E f(x) under N(x̂, P).
    variance : callable
        (x̂, P) -> conditional variance of f(x), shape (...) or (p, p, ...).
    errors : callable
        (μ, C, P), one time -> `MeanSquareErrors` of the optimal and the plug-in estimate.
    polynomial : dict or None
        Coefficients, from multi-index to (p,), of a polynomial.
    """

    kind: str
    scalar: bool
    plugin: Callable[..., Any]
    mean: Callable[..., Any]
    variance: Callable[..., Any]
    errors: Callable[..., Any]
    polynomial: dict[Any, Any] | None = None


class TwoStepPaths(NamedTuple):
    """Along measured paths: optimal estimates, their conditional variances, plug-in estimates.

    Shapes (K+1, ...) for a scalar function; (K+1, p, ...) and (K+1, p, p, ...) for a vector.
    """

    mean: np.ndarray
    variance: np.ndarray
    plugin: np.ndarray


def along(law: FunctionLaw, mean: np.ndarray, cov: np.ndarray) -> TwoStepPaths:
    """Estimates along means (n, K+1, ...) of the state with covariances (n, n, K+1).

    Raises
    ------
    ValueError
        An infinite mean of the function.
    """
    cov = cov.reshape(*cov.shape, *[1] * (mean.ndim - 2))
    values = in_range(
        "increments", lambda: (law.mean(mean, cov), law.variance(mean, cov), law.plugin(mean))
    )
    axes = (0, 0, 0) if law.scalar else (1, 2, 1)
    return TwoStepPaths(*(np.moveaxis(v, a, 0) for v, a in zip(values, axes, strict=True)))


def checked_symbols(
    f: object, groups: Mapping[str, Sequence | None], size: int, quadrature: Rule | None
) -> tuple | None:
    """Symbols of a function, `size` in each group; None for a Python function.

    Raises
    ------
    TypeError, ValueError
        A Python function without a quadrature rule; no symbols, or another number of them.
    """
    if callable(f) and not hasattr(f, "free_symbols"):
        if quadrature is None:
            raise TypeError(
                "f: a Python function has no closed form; give a SymPy expression, or name a "
                "quadrature rule, for instance quadrature=gauss_hermite(n, 20)"
            )
        return None
    from seedslib.base.symbols import as_symbols

    every: list = []
    for name, symbols in groups.items():
        known = () if symbols is None else as_symbols(name, symbols)
        if len(known) != size:
            raise ValueError(f"{name}: wanted {size} symbols, got {len(known) or 'none'}")
        every += known
    return tuple(every)


def used_symbols(f: object, symbols: tuple | None, size: int) -> np.ndarray:
    """Which components of the state a function contains, (size,) bool; all where it is Python's."""
    if symbols is None:
        return np.ones(size, bool)
    from seedslib.gaussian.reader import components_of

    free = set().union(*(e.free_symbols for e in components_of(f)[0]))
    return np.array([s in free for s in symbols]).reshape(-1, size).any(axis=0)


def closed_law(f: object, variables: Sequence) -> FunctionLaw:
    """Law of a SymPy expression by closed forms.

    Parameters
    ----------
    f : SymPy expression, list or column Matrix of expressions
    variables : sequence of Symbol

    Returns
    -------
    FunctionLaw

    Raises
    ------
    NoClosedForm
        The mean, the variance or the errors have none.
    TypeError, ValueError
        Unknown symbols in f, repeated variables, complex or infinite values.
    """
    from seedslib.gaussian.errors import mean_square_errors, posterior_variance_function
    from seedslib.gaussian.means import FunctionClass, expectation_function

    mean = expectation_function(f, variables)
    compiled = mean.compiled

    def plugin(point: np.ndarray) -> np.ndarray:
        value = compiled.value(point)
        return value[0] if mean.scalar else value

    variance, errors = posterior_variance_function(f, variables), mean_square_errors(f, variables)
    polynomial = compiled.polynomial() if mean.kind is FunctionClass.POLYNOMIAL else None
    return FunctionLaw(str(mean.kind), mean.scalar, plugin, mean, variance, errors, polynomial)


def quadrature_law(f: object, variables: Sequence[Any] | None, rule: Rule) -> FunctionLaw:
    """Law of any function by a quadrature rule; approximate, and named so.

    Parameters
    ----------
    f : callable, or SymPy expression, list or column Matrix of expressions
        A callable takes points (n, N) and returns (N,) or (p, N).
    variables : sequence of Symbol or None
        For an expression.
    rule : Rule
        Rule in n dimensions. The errors take the rule of the rule: L² values of f.

    Returns
    -------
    FunctionLaw

    Raises
    ------
    TypeError, ValueError
        Unknown symbols in f; when used, values of a wrong shape or not finite.
    """
    function = f if callable(f) else _numeric(f, variables)
    n = len(rule.points)

    def flat(points: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):  # a pole is found by its value
            sample = np.asarray(function(points))
        if sample.ndim not in (1, 2) or sample.shape[-1] != points.shape[1]:
            count = points.shape[1]
            raise ValueError(
                f"f: wanted values of shape ({count},) or (p, {count}), got {sample.shape}"
            )
        return sample

    scalar = flat(np.zeros((n, 1))).ndim == 1

    def values(points: np.ndarray) -> np.ndarray:
        """Values (p, ...) at points (n, ...)."""
        columns = points.reshape(n, math.prod(points.shape[1:]))
        sample = np.atleast_2d(flat(columns))
        if not np.isfinite(sample).all():
            where = np.argwhere(~np.isfinite(sample))[0][1]
            raise ValueError(f"f: wanted finite values, got none at {columns[:, where]}")
        return sample.reshape(len(sample), *points.shape[1:])

    def moments(mean: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (p, ...) and covariance (p, p, ...) of f."""
        sample = values(points_of(mean, cov, rule))
        first = np.einsum("l,pl...->p...", rule.weights, sample)
        sample = sample - first[:, None]
        return first, np.einsum("l,pl...,ql...->pq...", rule.weights, sample, sample)

    def errors(mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray) -> MeanSquareErrors:
        mean, cov, error_cov = as_joint_law(mean, cov, error_cov, n)
        outer = mean[:, None] + square_root(cov - error_cov) @ rule.points
        optimal = excess = 0.0
        width = max(1, BLOCK_POINTS // rule.weights.size)
        for start in range(0, rule.weights.size, width):
            block = slice(start, start + width)
            first, spread = moments(outer[:, block], error_cov)
            gap = first - values(outer[:, block])
            optimal = optimal + spread @ rule.weights[block]
            excess = excess + np.einsum("l,pl,ql->pq", rule.weights[block], gap, gap)
        pair = MeanSquareErrors(optimal, optimal + excess)
        return MeanSquareErrors(*(float(e[0, 0]) for e in pair)) if scalar else pair

    one, two = (0, (0, 0)) if scalar else (..., ...)
    return FunctionLaw(
        "quadrature", scalar, lambda mean: values(mean)[one],
        lambda mean, cov: moments(mean, cov)[0][one],
        lambda mean, cov: moments(mean, cov)[1][two], errors,
    )  # fmt: skip


def with_estimate(law: FunctionLaw) -> FunctionLaw:
    """Law of a function of the state and of its estimate, from one in twice as many variables.

    Given the measurements the estimate is a constant: the pair has the singular covariance
    diag(P, 0), and everything known of Gaussian laws applies (equations (2.3), (2.4) of Choi,
    Song, Shin 2019).
    """

    def pair(mean: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n = len(cov)
        corner = np.zeros((2 * n, 2 * n, *cov.shape[2:]))
        corner[:n, :n] = cov
        return np.concatenate([mean, mean]), corner

    def errors(mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray) -> MeanSquareErrors:
        known = cov - error_cov
        joint = np.block([[cov, known], [known, known]])
        twice, corner = pair(mean, error_cov)
        return law.errors(twice, joint, corner)

    return law._replace(
        plugin=lambda mean: law.plugin(np.concatenate([mean, mean])),
        mean=lambda mean, cov: law.mean(*pair(mean, cov)),
        variance=lambda mean, cov: law.variance(*pair(mean, cov)),
        errors=errors,
        polynomial=None,
    )


def _numeric(f: object, variables: Sequence) -> Callable:
    """NumPy function of points (n, N), values (N,) or (p, N)."""
    import sympy

    from seedslib.gaussian.reader import check_symbols, components_of

    (expressions, scalar), variables = components_of(f), tuple(variables)
    check_symbols(expressions, variables, ())
    lambdified = sympy.lambdify(variables, list(expressions), ["scipy", "numpy"], cse=True)

    def function(points: np.ndarray) -> np.ndarray:
        rows = [np.broadcast_to(row, points.shape[1:]) for row in lambdified(*points)]
        return rows[0] if scalar else np.stack(rows)

    return function
