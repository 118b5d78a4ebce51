"""Gaussian means of parts of a map, for the linearizations that are formulas."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import sympy

from seedslib.base.symbols import real_part
from seedslib.gaussian.algebra import NoClosedForm
from seedslib.gaussian.formulas import covariance_expression, mean_expression
from seedslib.models.maps import StochasticMap
from seedslib.models.noise import tidy

POINTS = "GaussHermite, Unscented and Cubature take this map"


class Names:
    """Symbols that stand for large expressions, so that these are met once.

    Called with an expression or a matrix of them it gives symbols in their place; `table` holds
    the pairs of symbol and meaning in the order in which they can be evaluated.
    """

    def __init__(self) -> None:
        self._known = {}

    def __call__(self, expression: sympy.Expr | sympy.Matrix) -> sympy.Expr | sympy.Matrix:
        """Symbol for an expression, the same for equal ones; short ones stay as they are."""
        if isinstance(expression, sympy.MatrixBase):
            return expression.applyfunc(self)
        if not expression.args or (-expression).is_Symbol:
            return expression
        if expression not in self._known:
            self._known[expression] = sympy.Symbol(f"part{len(self._known)}_", real=True)
        return self._known[expression]

    @property
    def table(self) -> list[tuple[sympy.Symbol, sympy.Expr]]:
        """Pairs of symbol and meaning."""
        return [(symbol, meaning) for meaning, symbol in self._known.items()]

    def meaning(self, expression: sympy.Expr) -> sympy.Expr:
        """What a symbol stands for; other expressions stand for themselves."""
        return {symbol: part for part, symbol in self._known.items()}.get(expression, expression)


def mentions(expression: sympy.Expr, symbols: Iterable[sympy.Symbol]) -> bool:
    """Whether an expression contains one of the symbols."""
    return bool(sympy.sympify(expression).free_symbols & set(symbols))


def joined(map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix) -> tuple[Any, ...]:
    """State, value, its covariance given the state, and the law of the state of a branch.

    Where the weight mentions the noise, the noise is the lower part of the state; its mean is
    named, for derivatives by it, and given in numbers by the last entry.
    """
    noise = map.noise
    if not mentions(map.weight_expression, noise.symbols):
        expressions, spread, _ = map.conditional_expressions
        return map.state, expressions, spread, mean, cov, {}
    if not noise.gaussian:
        raise NoClosedForm(
            "ExactGaussian: wanted Gaussian noise where the weight depends on it; use GaussHermite"
        )
    known = [sympy.sympify(tidy(c)) for c in noise.cov.ravel()]
    named = [sympy.Dummy(f"noise{k}", real=True) for k in range(noise.size)]
    joint = sympy.diag(cov, sympy.Matrix(noise.size, noise.size, known))
    still = {name: sympy.sympify(tidy(c)) for name, c in zip(named, noise.mean, strict=True)}
    nothing = np.zeros((map.size, map.size), dtype=int)
    return (*map.state, *noise.symbols), map.expressions, nothing, [*mean, *named], joint, still


def affine_part(
    expressions: Sequence[Any], state: Sequence[sympy.Symbol]
) -> tuple[sympy.Matrix, sympy.Matrix, list[sympy.Expr]]:
    """Slope (m, n), constant (m, 1) and rest (m,) of y = slope x + constant + rest(x)."""
    flat, rest = [], []
    for expression in expressions:
        terms = sympy.Add.make_args(expand(sympy.sympify(expression)))
        degree = [term.as_poly(*state) for term in terms]
        low = [p is not None and p.total_degree() <= 1 for p in degree]
        flat.append(sympy.Add(*(a for a, ok in zip(terms, low, strict=True) if ok)))
        rest.append(sympy.Add(*(a for a, ok in zip(terms, low, strict=True) if not ok)))
    flat = sympy.Matrix(flat)
    return flat.jacobian(state), flat.subs(dict.fromkeys(state, 0)), rest


def real_formula(expression: sympy.Expr, result: sympy.Expr) -> sympy.Expr:
    """The mean of an expression without the imaginary unit; `NoClosedForm` where there is none."""
    result = real_part(result)
    if result.has(sympy.I, sympy.re, sympy.im):
        raise NoClosedForm(f"no closed form without complex numbers for {expression}; {POINTS}")
    return result


def averager(
    state: Sequence[sympy.Symbol], mean: Sequence[Any], cov: sympy.Matrix
) -> Callable[[sympy.Expr], sympy.Expr]:
    """Exact mean of an expression of the state; what does not depend on the state passes."""
    known = {}

    def average(expression: sympy.Expr) -> sympy.Expr:
        expression = sympy.sympify(expression)
        if not expression.free_symbols & set(state):
            return expression
        if expression not in known:
            others = tuple(expression.free_symbols - set(state))
            try:
                result = mean_expression(expression, state, mean, cov, parameters=others)
            except NoClosedForm as error:
                raise NoClosedForm(f"{error}; {POINTS}") from error
            known[expression] = real_formula(expression, result)
        return known[expression]

    return average


def covariances(
    state: Sequence[sympy.Symbol], mean: Sequence[Any], cov: sympy.Matrix,
    average: Callable[..., Any],
) -> Callable[..., Any]:  # fmt: skip
    """Covariance of two expressions of the state, whose means are given."""

    def covariance(first: Any, second: Any, mean_1: sympy.Expr, mean_2: sympy.Expr) -> sympy.Expr:
        first, second = sympy.sympify(first), sympy.sympify(second)
        if first.is_polynomial(*state) and second.is_polynomial(*state):
            return expand(average(expand(first * second)) - mean_1 * mean_2)
        others = tuple((first.free_symbols | second.free_symbols) - set(state))
        try:
            result = covariance_expression(first, second, state, mean, cov, parameters=others)
        except NoClosedForm as error:
            raise NoClosedForm(f"{error}; {POINTS}") from error
        return real_formula(first * second, result)

    return covariance


def expand(expression: sympy.Expr) -> sympy.Expr:
    """Products multiplied out, exponentials left whole (their factors may overflow)."""
    return sympy.expand(expression, power_exp=False, power_base=False, log=False)


def centred_square(
    average: Callable[..., Any], conditional: Sequence[Any], noise_cov: Sequence[Any],
    mean: Sequence[Any], covariance: Callable[..., Any],
) -> sympy.Matrix:  # fmt: skip
    """Mean of cov(y | x) plus cov of E(y | x); what cancels does so before numbers are put in."""
    size = len(conditional)
    spread = sympy.zeros(size)
    for i in range(size):
        for j in range(i + 1):
            inner = average(noise_cov[i, j])
            between = covariance(conditional[i], conditional[j], mean[i], mean[j])
            spread[i, j] = spread[j, i] = inner + between
    return spread


def raw_square(
    average: Callable[..., Any], weight: sympy.Expr, conditional: Sequence[Any],
    noise_cov: Sequence[Any],
) -> sympy.Matrix:  # fmt: skip
    """Mean of the weight times the second moment of y given the state."""
    size = len(conditional)
    square = sympy.zeros(size)
    for i in range(size):
        for j in range(i + 1):
            inner = conditional[i] * conditional[j] + noise_cov[i, j]
            square[i, j] = square[j, i] = average(expand(weight * inner))
    return square


def noise_spread(map: StochasticMap, value: sympy.Matrix, here: dict[Any, Any]) -> sympy.Matrix:
    """Covariance of y by the expanded noise."""
    if map.noise.size == 0:
        return sympy.zeros(map.size)
    slope = value.jacobian(map.noise.symbols).subs(here)
    return slope * sympy.Matrix(map.noise.cov.tolist()) * slope.T
