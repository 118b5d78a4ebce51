"""Linear diffusion augmented by a function of its state, through Ito's formula.

The alternative to the two-step estimator (Choi, Song, Shin 2019, section 2.3): ``z = f(x)`` obeys
``dz = a dt + b dv`` and is filtered as one more component of a nonlinear system. The drift is not
unique: on the surface z = f(x) it may be written through x, or partly through z, and a filter that
leaves the surface behaves differently for each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

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
    f: object
    variables: Sequence
    symbol: object
    drift: object | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        import sympy

        from seedslib.base.symbols import as_expression, as_symbols, require_distinct

        if not self.system.constant:
            raise ValueError("system: wanted constant coefficients, got functions of time")
        variables = as_symbols("variables", self.variables)
        if len(variables) != self.system.n:
            raise ValueError(f"variables: wanted {self.system.n} symbols, got {len(variables)}")
        require_distinct(variables=variables, symbol=(self.symbol,))
        object.__setattr__(self, "variables", variables)
        object.__setattr__(self, "f", as_expression("f", self.f))
        self._known("f", self.f, variables)
        for expression in (self.ito_drift, *self.noise):
            if expression.has(sympy.DiracDelta, sympy.Derivative, sympy.Subs):
                raise ValueError(f"f: wanted a twice differentiable function, got {self.f}")
        if self.drift is None:
            object.__setattr__(self, "drift", self.ito_drift)
            return
        object.__setattr__(self, "drift", as_expression("drift", self.drift))
        self._known("drift", self.drift, (*variables, self.symbol))
        gap = sympy.expand(self.drift.subs(self.symbol, self.f) - self.ito_drift)
        if not _vanishes(gap, variables):
            raise ValueError(
                f"drift: wanted Ito's {self.ito_drift} where {self.symbol} = {self.f}, "
                f"got a difference of {gap}"
            )

    @cached_property
    def ito_drift(self) -> object:
        """Drift ``∇fᵀ F x + ½ tr(G Q Gᵀ ∇²f)`` as an expression in the state."""
        import sympy

        known, x = self.system.matrices(0.0), self.variables
        gradient = [sympy.diff(self.f, s) for s in x]
        flow = [sum(_number(c) * s for c, s in zip(row, x, strict=True)) for row in known.drift]
        spread = sum(
            _number(known.diffusion[i, j]) * sympy.diff(gradient[i], x[j])
            for i in range(len(x))
            for j in range(len(x))
        )
        return sympy.expand(sum(g * v for g, v in zip(gradient, flow, strict=True)) + spread / 2)

    @cached_property
    def noise(self) -> object:
        """Row ``b Q Gᵀ = ∇fᵀ G Q Gᵀ``: covariance rate of z with the state, Matrix (1, n)."""
        import sympy

        known = self.system.matrices(0.0)
        gradient = sympy.Matrix([[sympy.diff(self.f, s) for s in self.variables]])
        return gradient * sympy.Matrix(known.diffusion.tolist()).applyfunc(_number)

    def rewritten(self) -> AugmentedDiffusion:
        """The same system with the drift reduced by ``f(x) = z`` (polynomial division).

        Raises
        ------
        ValueError
            f or its drift is not a polynomial.
        """
        import sympy

        try:
            for expression in (self.f, self.ito_drift):
                sympy.Poly(expression, *self.variables)
            rest = sympy.reduced(self.ito_drift, [self.f - self.symbol], *self.variables)[1]
        except sympy.PolynomialError as error:
            raise ValueError(
                f"f: wanted a polynomial to rewrite the drift, got {self.f}"
            ) from error
        return AugmentedDiffusion(
            self.system, self.f, self.variables, self.symbol, drift=sympy.expand(rest)
        )

    @cached_property
    def functions(self) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]]:
        """Numeric drift a with its derivatives, and noise, at states (n, N) and values z (N,).

        Returns ``a (N,), ∂a/∂x (n, N), ∂a/∂z (N,), G Q bᵀ (n, N), b Q bᵀ (N,)``.
        """
        import sympy

        x, n = self.variables, self.system.n
        drift = [self.drift, *(sympy.diff(self.drift, s) for s in (*x, self.symbol))]
        gradient = sympy.Matrix([[sympy.diff(self.f, s) for s in x]])
        power = (self.noise * gradient.T)[0, 0]
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
        from seedslib.gaussian.errors.exact import posterior_variance_function
        from seedslib.gaussian.means.symbolic import expectation_function

        mean0, cov0 = self.system.mean0, self.system.cov0
        products = [self.f, *(self.f * s for s in self.variables)]
        first, *mixed = expectation_function(products, self.variables)(mean0, cov0)
        variance = posterior_variance_function(self.f, self.variables)(mean0, cov0)
        return float(first), np.array(mixed) - first * mean0, float(variance)

    def _known(self, name: str, expression: object, allowed: Sequence) -> None:
        from seedslib.base.symbols import require_known, require_number

        require_known(name, [expression], allowed)
        require_number(name, expression)


def _number(value: float) -> object:
    """Exact rational of a float, so that expressions cancel exactly."""
    import sympy

    return sympy.Rational(float(value))


def _vanishes(expression: object, variables: Sequence) -> bool:
    """Whether an expression is zero at some generic points, within rounding."""
    import sympy

    points = np.random.default_rng(0).uniform(0.3, 1.7, (8, len(variables)))
    numeric = sympy.lambdify(variables, expression, "numpy")
    return all(abs(numeric(*point)) < 1e-9 for point in points)
