"""Taylor expansion and exact Gaussian means: the linearizations that are formulas."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from seedslib.base.linalg import symmetric
from seedslib.base.symbols import real_part
from seedslib.gaussian.algebra import NoClosedForm
from seedslib.gaussian.formulas import covariance_expression, mean_expression
from seedslib.linearization.formulas import BranchFormulas, Formulas, Parts, mentions
from seedslib.models.codegen import fold
from seedslib.models.maps import StochasticMap, tidy

POINTS = "GaussHermite, Unscented and Cubature take this map"


class Means:
    """Exact means and covariances of expressions of a state N(mean, cov), each taken once."""

    def __init__(
        self, state: Sequence[sympy.Symbol], mean: Sequence[Any], cov: sympy.Matrix
    ) -> None:
        self.distribution = state, mean, cov
        self._taken: dict[Any, sympy.Expr] = {}

    def __call__(self, expression: Any) -> sympy.Expr:
        """Mean; what does not depend on the state passes."""
        expression = sympy.sympify(expression)
        if not mentions(expression, self.distribution[0]):
            return expression
        if expression not in self._taken:
            self._taken[expression] = self._closed(mean_expression, expression)
        return self._taken[expression]

    def covariance(self, first: Any, second: Any) -> sympy.Expr:
        """Covariance of two expressions; what cancels does so before numbers are put in."""
        first, second, state = sympy.sympify(first), sympy.sympify(second), self.distribution[0]
        if first.is_polynomial(*state) and second.is_polynomial(*state):
            return expand(self(expand(first * second)) - self(first) * self(second))
        return self._closed(covariance_expression, first, second)

    def squares(self, conditional: Sequence[Any], noise_cov: Sequence[Any]) -> sympy.Matrix:
        """Covariance of y: the mean of cov(y | x) plus the covariance of E(y | x)."""

        def entry(i: int, j: int) -> sympy.Expr:
            return self(noise_cov[i, j]) + self.covariance(conditional[i], conditional[j])

        return _symmetric(len(conditional), entry)

    def raw_squares(
        self, weight: sympy.Expr, conditional: Sequence[Any], noise_cov: Sequence[Any]
    ) -> sympy.Matrix:
        """Mean of the weight times the second moment of y given the state."""

        def entry(i: int, j: int) -> sympy.Expr:
            return self(expand(weight * (conditional[i] * conditional[j] + noise_cov[i, j])))

        return _symmetric(len(conditional), entry)

    def _closed(self, formula: Callable[..., sympy.Expr], *parts: sympy.Expr) -> sympy.Expr:
        """A formula without the imaginary unit, or `NoClosedForm` with what takes its parts."""
        others = set().union(*(part.free_symbols for part in parts)) - set(self.distribution[0])
        try:
            result = real_part(formula(*parts, *self.distribution, parameters=tuple(others)))
        except NoClosedForm as error:
            raise NoClosedForm(f"{error}; {POINTS}") from error
        if result.has(sympy.I, sympy.re, sympy.im):
            raise NoClosedForm(f"no closed form without complex numbers for {parts[0]}; {POINTS}")
        return result


def _symmetric(size: int, entry: Callable[[int, int], sympy.Expr]) -> sympy.Matrix:
    lower = [entry(i, j) for i in range(size) for j in range(i + 1)]
    return sympy.Matrix(symmetric(np.array(lower, dtype=object), size))


def expand(expression: sympy.Expr) -> sympy.Expr:
    """Products multiplied out, exponentials left whole (their factors may overflow)."""
    return sympy.expand(expression, power_exp=False, power_base=False, log=False)


def augmented(map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix) -> tuple[Any, ...]:
    """State of a branch, E y and cov y given it, and its mean and covariance.

    Where the weight mentions the noise, the noise is the lower part of the state. Its mean is then
    a symbol, so that a mean can be differentiated by it; the last entry has the numbers.
    """
    noise = map.noise
    if not mentions(map.weight_expression, noise.symbols):
        expressions, noise_cov, _ = map.conditional_expressions
        return map.state, expressions, noise_cov, mean, cov, {}
    if not noise.gaussian:
        raise NoClosedForm(
            "ExactGaussian: wanted Gaussian noise where the weight depends on it; use GaussHermite"
        )
    entries = [sympy.sympify(tidy(c)) for c in noise.cov.ravel()]
    symbols = [sympy.Dummy(f"noise{k}", real=True) for k in range(noise.size)]
    joint_cov = sympy.diag(cov, sympy.Matrix(noise.size, noise.size, entries))
    numbers = {s: sympy.sympify(tidy(c)) for s, c in zip(symbols, noise.mean, strict=True)}
    state, noise_cov = (*map.state, *noise.symbols), np.zeros((map.size, map.size), dtype=int)
    return state, map.expressions, noise_cov, [*mean, *symbols], joint_cov, numbers


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


def _expanded(map: StochasticMap, mean: Sequence) -> tuple[sympy.Matrix, ...]:
    """Value, slope by the state and covariance by the noise of a map expanded about the means."""
    noise, value = map.noise, sympy.Matrix(map.expressions)
    here = dict(zip((*map.state, *noise.symbols), (*mean, *noise.mean.tolist()), strict=True))
    slope = value.jacobian(map.state).subs(here)
    if noise.size == 0:
        return value.subs(here), slope, sympy.zeros(map.size)
    gain = value.jacobian(noise.symbols).subs(here)
    return value.subs(here), slope, gain * sympy.Matrix(noise.cov.tolist()) * gain.T


@dataclass(frozen=True)
class Taylor(Formulas):
    """First-order expansion about the mean, the linearization of the extended Kalman filter.

    (7.1) and (8.4) of the jump-diffusion paper; noise may enter nonlinearly.
    """

    def formulas(
        self, map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix, spread: bool = True
    ) -> Parts:
        """See `Formulas.formulas`."""
        value, slope, noise_cov = _expanded(map, mean)
        cross = cov * slope.T
        return value, cross, slope * cross + noise_cov if spread else None

    def branch(self, map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix) -> BranchFormulas:
        """Moments of a branch, (7.3) of the switching paper.

        It is the exact Gaussian mean of the product of the expansions of weight and value.
        Where the expanded weight would make a variance negative, A' D A'ᵀ >= A², its slope is
        dropped (guard).

        Raises
        ------
        NoClosedForm
            The weight depends on the noise, which the paper's linearization excludes.
        """
        if mentions(map.weight_expression, map.noise.symbols):
            raise NoClosedForm("Taylor: wanted a weight without noise; use GaussHermite")
        value, slope, noise_cov = _expanded(map, mean)
        weight, here = map.weight_expression, dict(zip(map.state, mean, strict=True))
        mass, gradient = weight.subs(here), sympy.Matrix([weight]).jacobian(map.state).subs(here)
        weight_cov = cov * gradient.T  # cov(x, weight)
        usable = sympy.Heaviside(mass**2 - (gradient * weight_cov)[0], 0)
        # cov(x, weight) / mass, or 0 where the slope is dropped: then nothing is divided by zero
        shift = usable / (mass + 1 - usable) * weight_cov
        state_cov = cov - shift * shift.T
        cross = state_cov * slope.T
        state = sympy.Matrix(mean) + shift, state_cov
        square = slope * cross + noise_cov
        return BranchFormulas(mass, *state, value + slope * shift, cross, square)


@dataclass(frozen=True)
class ExactGaussian(Formulas):
    """Exact means of the map over N(m, D): statistical linearization (Kazakov).

    (6.1) and (8.3) of the jump-diffusion paper, (6.22) and (6.36) of the switching paper. It
    gives the normal-approximation (assumed-density) filters. The cross-covariance follows from
    Stein's identity, cov(x, y) = D (dE y / dm)ᵀ. A state that is known to be where the map jumps
    is on either side with probability one half: the limit of a variance that vanishes.
    """

    def formulas(
        self, map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix, spread: bool = True
    ) -> Parts:
        """See `Formulas.formulas`."""
        conditional, noise_cov, _ = map.conditional_expressions
        average = Means(map.state, mean, cov)
        y = sympy.Matrix([average(part) for part in conditional])
        cross = cov * y.jacobian(mean).T
        return y, cross, average.squares(conditional, noise_cov) if spread else None

    def branch(self, map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix) -> BranchFormulas:
        """Moments of a branch, the centred form of (6.22) and (6.36) of the switching paper.

        With the mass q(m, D) = E w the state in the branch has the mean m + D grad log q and the
        covariance D + D (Hessian of log q) D, by Stein's identity applied twice. What of y is
        affine in the state follows from these two; only the rest takes raw means, so that no
        digits are lost far from the origin. A weight that mentions the noise, (6.23) and (6.27),
        makes the noise part of the state.
        """
        state, expressions, noise_cov, mean, cov, numbers = augmented(map, mean, cov)
        weight, n = fold(map.weight_expression), map.state_size
        average = Means(state, mean, cov)
        if not mentions(weight, state):
            y = sympy.Matrix([average(part) for part in expressions])
            square, cross = average.squares(expressions, noise_cov), cov * y.jacobian(mean).T
            return BranchFormulas(weight, sympy.Matrix(mean), cov, y, cross, square)

        mass = average(weight)
        gradient = sympy.Matrix([mass]).jacobian(mean)
        hessian = gradient.jacobian(mean)
        slope, constant, rest = affine_part(expressions, state)
        raw = sympy.Matrix([average(expand(weight * part)) for part in rest])
        raw_slope, squares = raw.jacobian(mean), average.raw_squares(weight, rest, noise_cov)
        # the mean of a noise in the state was a symbol for the sake of the derivatives
        mass, mean = mass.xreplace(numbers), sympy.Matrix(mean).xreplace(numbers)
        gradient, hessian, raw, raw_slope, squares = (
            part.xreplace(numbers) for part in (gradient, hessian, raw, raw_slope, squares)
        )
        shift, rest_mean = cov * gradient.T / mass, raw / mass
        state_cov = cov + cov * hessian * cov / mass - shift * shift.T
        rest_cross = cov * raw_slope.T / mass - shift * rest_mean.T  # cov(state, rest)
        cross = state_cov * slope.T + rest_cross
        centre = mean + shift
        y = slope * centre + constant + rest_mean
        rest_cov = squares / mass - rest_mean * rest_mean.T
        square = slope * cross + rest_cross.T * slope.T + rest_cov
        return BranchFormulas(mass, centre[:n, :], state_cov[:n, :n], y, cross[:n, :], square)
