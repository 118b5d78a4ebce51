"""Linear diffusion augmented by a function of its state, through Ito's formula.

The alternative to the two-step estimator (Choi, Song, Shin 2019, section 2.3): ``z = f(x)`` obeys
``dz = a dt + b dv`` and is filtered as one more component of a nonlinear system. The drift is not
unique: on the surface z = f(x) it may be written through x, or partly through z, and a filter that
leaves the surface behaves differently for each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from seedslib.base import symbols
from seedslib.two_step.linear import LinearDiffusion


@dataclass(frozen=True, eq=False)
class AugmentedDiffusion:
    """Linear diffusion with constant coefficients and the additional component z = f(x).

    Parameters
    ----------
    system : LinearDiffusion
        With n components of state and constant coefficients.
    f : SymPy expression
        The function, twice differentiable.
    variables : sequence of n Symbols
        The state in f.
    symbol : Symbol
        Stands for z.
    drift : SymPy expression, optional
        The drift of z written through `variables` and `symbol`. By default Ito's formula,
        through the state alone; `rewritten` gives one through z.

    Raises
    ------
    ValueError
        Coefficients that depend on time, not n variables, unknown symbols, an f that is not twice
        differentiable, or a `drift` that differs from Ito's formula where z = f(x).
    """

    system: LinearDiffusion
    f: Any
    variables: Sequence[Any]
    symbol: Any
    drift: Any = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if not self.system.constant:
            raise ValueError("system: wanted constant coefficients, got functions of time")
        n, variables = self.system.state_size, symbols.as_symbols("variables", self.variables)
        if len(variables) != n:
            raise ValueError(f"variables: wanted {n} symbols, got {len(variables)}")
        symbols.require_distinct(variables=variables, symbol=(self.symbol,))
        vars(self).update(variables=variables, f=symbols.as_expression("f", self.f))
        _require("f", self.f, variables)
        for expression in (self.ito_drift, *self.noise):
            if expression.has(sympy.DiracDelta, sympy.Derivative, sympy.Subs):
                raise ValueError(f"f: wanted a twice differentiable function, got {self.f}")
        drift = self.ito_drift if self.drift is None else self.drift
        vars(self).update(drift=symbols.as_expression("drift", drift))
        _require("drift", self.drift, (*variables, self.symbol))
        gap = sympy.expand(self.drift.subs(self.symbol, self.f) - self.ito_drift)
        if not _vanishes(gap, variables):
            raise ValueError(
                f"drift: wanted Ito's {self.ito_drift} where {self.symbol} = {self.f}, "
                f"got a difference of {gap}"
            )

    @cached_property
    def ito_drift(self) -> sympy.Expr:
        """Drift ``∇fᵀ F x + ½ tr(G Q Gᵀ ∇²f)`` as an expression in the state."""
        known, x, gradient = self.system.matrices(0.0), self.variables, self._gradient
        flow = [sum(_number(c) * s for c, s in zip(row, x, strict=True)) for row in known.drift]
        rates = np.ndenumerate(known.diffusion)
        spread = sum(_number(c) * sympy.diff(gradient[i], x[j]) for (i, j), c in rates)
        return sympy.expand(sum(g * v for g, v in zip(gradient, flow, strict=True)) + spread / 2)

    @cached_property
    def noise(self) -> sympy.Matrix:
        """Row ``b Q Gᵀ = ∇fᵀ G Q Gᵀ``: covariance rate of z with the state, Matrix (1, n)."""
        diffusion = sympy.Matrix(self.system.matrices(0.0).diffusion.tolist())
        return self._gradient * diffusion.applyfunc(_number)

    @cached_property
    def _gradient(self) -> sympy.Matrix:
        """Row ∇fᵀ, Matrix (1, n)."""
        return sympy.Matrix([[sympy.diff(self.f, s) for s in self.variables]])

    def rewritten(self) -> AugmentedDiffusion:
        """The same system with the drift reduced by ``f(x) = z`` (polynomial division).

        Raises
        ------
        ValueError
            f or its drift is not a polynomial.
        """
        try:
            for expression in (self.f, self.ito_drift):
                sympy.Poly(expression, *self.variables)
            rest = sympy.reduced(self.ito_drift, [self.f - self.symbol], *self.variables)[1]
        except sympy.PolynomialError as error:
            raise ValueError(
                f"f: wanted a polynomial to rewrite the drift, got {self.f}"
            ) from error
        return replace(self, drift=sympy.expand(rest))

    @cached_property
    def functions(self) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]]:
        """Numeric drift a with its derivatives, and noise, at states (n, N) and values z (N,).

        Returns ``a (N,), ∂a/∂x (n, N), ∂a/∂z (N,), G Q bᵀ (n, N), b Q bᵀ (N,)``.
        """
        x, n = self.variables, self.system.state_size
        drift = [self.drift, *(sympy.diff(self.drift, s) for s in (*x, self.symbol))]
        power = (self.noise * self._gradient.T)[0, 0]
        both = sympy.lambdify((*x, self.symbol), [*drift, *self.noise, power], "numpy", cse=True)

        def evaluate(state: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, ...]:
            rows = np.stack([np.broadcast_to(r, value.shape) for r in both(*state, value)])
            return rows[0], rows[1 : n + 1], rows[n + 1], rows[n + 2 : 2 * n + 2], rows[-1]

        return evaluate

    def initial_moments(self) -> tuple[float, np.ndarray, float]:
        """Mean of z at time 0, its covariance (n,) with the state, and its variance.

        Raises
        ------
        NoClosedForm
            They have no closed form.
        """
        from seedslib.gaussian.errors import posterior_variance_function
        from seedslib.gaussian.means import expectation_function

        mean0, cov0 = self.system.mean0, self.system.cov0
        products = [self.f, *(self.f * s for s in self.variables)]
        first, *mixed = expectation_function(products, self.variables)(mean0, cov0)
        variance = posterior_variance_function(self.f, self.variables)(mean0, cov0)
        return float(first), np.array(mixed) - first * mean0, float(variance)


def _require(name: str, expression: sympy.Expr, allowed: Sequence) -> None:
    symbols.require_known(name, [expression], allowed)
    symbols.require_number(name, expression)


def _number(value: float) -> sympy.Rational:
    """Exact rational of a float, so that expressions cancel exactly."""
    return sympy.Rational(float(value))


def _vanishes(expression: sympy.Expr, variables: Sequence) -> bool:
    """Whether an expression is zero at some generic points, within rounding."""
    points = np.random.default_rng(0).uniform(0.3, 1.7, (8, len(variables)))
    numeric = sympy.lambdify(variables, expression, "numpy")
    return all(abs(numeric(*point)) < 1e-9 for point in points)
