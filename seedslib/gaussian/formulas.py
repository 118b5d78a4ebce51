"""Gaussian means of SymPy expressions in symbols: `expectation` and the formulas behind it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import sympy as sp

from seedslib.base.symbols import as_expression, as_symbols, real_part
from seedslib.gaussian.algebra import Key, NoClosedForm, Terms
from seedslib.gaussian.polynomial import heat, monomial_means, predecessors
from seedslib.gaussian.reader import components_of, parse
from seedslib.gaussian.special import Difference, Divisor, NormalCDF, TiltedCDF


def expectation(
    f: object, variables: Sequence[sp.Symbol], mean: Sequence[Any],
    cov: sp.MatrixBase | Sequence[Any], *, parameters: Sequence[sp.Symbol] = (),
) -> Any:  # fmt: skip
    """Mean of f(x) for x ~ N(mean, cov), as a SymPy expression.

    Polynomials (equation (3.2) of Choi, Song, Shin 2019, for any degree), times exponentials of
    quadratics, times the indicator of one half-space or one error function (erf, erfc) of an
    affine argument. The result is not simplified.

    Parameters
    ----------
    f : expression, list or column Matrix of expressions
        Real function of `variables`.
    variables : sequence of n Symbols
        Components of x.
    mean : list or Matrix of n expressions
        Real.
    cov : Matrix (n, n) of expressions
        Real, symmetric. The formula of a function with a switching plane divides by the variance
        of the switching function; use `expectation_function` for degenerate numbers.
    parameters : sequence of Symbols
        Further symbols that f may contain; taken as real constants.

    Returns
    -------
    Expr, or Matrix (p, 1) for a vector f

    Raises
    ------
    NoClosedForm
        A term is outside the class; a norm has only a numeric mean.
    TypeError, ValueError
        Unknown symbols in f, wrong shapes, an asymmetric covariance.

    Examples
    --------
    >>> x, m, P = sp.symbols("x m P", real=True)
    >>> expectation(sp.sin(x), [x], [m], sp.Matrix([[P]]))
    exp(-P/2)*sin(m)
    """
    result = mean_expression(f, variables, mean, cov, parameters=parameters)
    if isinstance(result, sp.MatrixBase):
        return result.applyfunc(lambda part: part.rewrite(sp.erf))
    return result.rewrite(sp.erf)


def mean_expression(
    f: object, variables: Sequence[sp.Symbol], mean: Sequence[Any],
    cov: sp.MatrixBase | Sequence[Any], *, parameters: Sequence[sp.Symbol] = (),
) -> sp.Expr | sp.Matrix:  # fmt: skip
    """As `expectation`, with probabilities of half-spaces as `NormalCDF`.

    Code made of it keeps the relative accuracy of small probabilities.
    """
    variables = as_symbols("variables", variables)
    n = len(variables)
    mean, cov = _matrix("mean", list(mean)), _matrix("cov", cov)
    if mean.shape != (n, 1):
        raise ValueError(f"mean: wanted {n} components, got shape {mean.shape}")
    if cov.shape != (n, n):
        raise ValueError(f"cov: wanted shape ({n}, {n}), got {cov.shape}")
    if any(sp.expand(entry) != 0 for entry in cov - cov.T):
        raise ValueError("cov: wanted a symmetric matrix")
    formulas, means, covs, scalar = _template(
        components_of(f), variables, as_symbols("parameters", parameters)
    )
    values = _values(means, covs, mean, cov)
    results = [formula.xreplace(values) for formula in formulas]
    return results[0] if scalar else sp.Matrix(results)


def covariance_expression(
    f: sp.Expr,
    g: sp.Expr,
    variables: Sequence[sp.Symbol],
    mean: Sequence[Any],
    cov: sp.MatrixBase,
    *,
    parameters: Sequence[sp.Symbol] = (),
) -> sp.Expr:
    """Covariance of f(x) and g(x) for x ~ N(mean, cov), as a SymPy expression.

    Its linear part, grad(E f)' P grad(E g) by Stein's identity, and ``E f g - E f E g`` beyond
    that where it is more than rounding: about eight digits of it are left however small P is.

    Parameters
    ----------
    f, g : expressions
        Real functions of `variables`.
    variables, mean, cov, parameters
        As in `expectation`.

    Raises
    ------
    NoClosedForm
        A term of f, of g or of their product is outside the class.
    """
    product = sp.expand(f * g, power_exp=False, power_base=False, log=False)
    components = (sp.sympify(f), sp.sympify(g), product), False
    (left, right, square), means, covs, _ = _template(
        components, as_symbols("variables", variables), tuple(parameters)
    )
    left, right, square = map(real_part, (left, right, square))
    slopes = [sp.Matrix([part]).jacobian(means) for part in (left, right)]
    linear = (slopes[0] * sp.Matrix(covs) * slopes[1].T)[0]
    formula = linear + Difference(square, left * right, linear)
    return formula.xreplace(_values(means, covs, mean, cov))


def _values(means: Sequence, covs: Sequence, mean: Sequence, cov: Any) -> dict[sp.Symbol, Any]:
    """What the stand-ins stand for."""
    n = len(means)
    values = dict(zip(means, mean, strict=True))
    return values | {covs[i][j]: cov[i, j] for i in range(n) for j in range(i, n)}


def _matrix(name: str, value: object) -> sp.Matrix:
    """Matrix of expressions; SymPy alone would evaluate strings."""
    if isinstance(value, sp.MatrixBase):
        return sp.Matrix(value)
    array = np.array(value, dtype=object)
    entries = [as_expression(name, entry) for entry in array.ravel()]
    return sp.Matrix(*(array.shape if array.ndim == 2 else (array.size, 1)), entries)


@lru_cache(maxsize=256)
def _template(components: tuple, variables: tuple, parameters: tuple) -> tuple:
    """Formulas in stand-ins for the mean and covariance, cached by (expressions, symbols)."""
    expressions, scalar = components
    parsed = parse(list(expressions), variables, parameters)
    for expression, terms in zip(expressions, parsed.components, strict=True):
        if any(key.norm is not None for key in terms):
            raise NoClosedForm(
                f"no closed form in symbols for {expression}: the mean of a norm is an integral; "
                "expectation_function gives its numbers"
            )
    means, covs = stand_ins(len(variables))
    back = dict(zip(parsed.parameters, parameters, strict=True))
    formulas = tuple(
        mean_formula(terms, parsed.symbols, means, covs).xreplace(back)
        for terms in parsed.components
    )
    return formulas, means, covs, scalar


def stand_ins(n: int) -> tuple[tuple[sp.Symbol, ...], tuple[tuple[sp.Symbol, ...], ...]]:
    """Symbols for a mean (n,) and a covariance (n, n)."""
    means = tuple(sp.Dummy(f"m{i}", real=True) for i in range(n))
    upper = {
        (i, j): sp.Dummy(f"P{i}{j}", real=True, nonnegative=True if i == j else None)
        for i in range(n)
        for j in range(i, n)
    }
    return means, tuple(tuple(upper[min(i, j), max(i, j)] for j in range(n)) for i in range(n))


def mean_formula(
    terms: Terms, symbols: Sequence[sp.Symbol], mean: Sequence[Any], cov: Sequence[Any]
) -> sp.Expr:
    """Mean of a sum of terms under N(mean, cov), in the components of both."""
    return sum((_term(*term, symbols, mean, cov) for term in terms.items()), sp.S.Zero)


def _term(key: Key, poly: sp.Poly, symbols: Sequence, mean: Sequence, cov: Sequence) -> sp.Expr:
    n = len(symbols)
    quadratic, linear = sp.zeros(n, n), sp.zeros(n, 1)
    key.put(quadratic, linear)
    m, p = sp.Matrix(list(mean)), sp.Matrix(n, n, lambda i, j: cov[i][j])
    factor, exponent = sp.S.One, sp.S.Zero
    if any(quadratic):
        m, p, factor, exponent = _tilted(quadratic, linear, m, p)
    elif any(linear):
        exponent = (linear.T * m)[0] + (linear.T * p * linear)[0] / 2
        m = m + p * linear
    oscillating = any(c.has(sp.I) for _, c in key.exponent)
    if key.plane is not None:
        return factor * _half_space(key, poly, m, p, exponent)
    if any(quadratic):
        means = monomial_means(poly.monoms(), list(m), p.tolist(), zeroth=sp.S.One)
        value = sum((c * means[a] for a, c in poly.terms()), sp.S.Zero)
    else:
        image = heat(dict(poly.terms()), p.tolist())
        value = sum(
            (c * sp.prod([v**k for v, k in zip(m, a, strict=True)]) for a, c in image.items()),
            sp.S.Zero,
        )
        value = sp.expand(value)
    if oscillating and not any(quadratic):
        # the conjugate term adds the mirror image: together twice the real part
        modulus, phase = sp.expand(exponent).as_real_imag()
        real, imaginary = value.as_real_imag()
        wave = real * sp.cos(phase) - imaginary * sp.sin(phase)
        return factor * sp.exp(modulus) * wave
    return factor * sp.exp(exponent) * value


def _tilted(quadratic: sp.Matrix, linear: sp.Matrix, m: sp.Matrix, p: sp.Matrix) -> tuple:
    """Mean, covariance, root factor and exponent of ``exp(-x'Mx/2 + a'x) N(x; m, P)``.

    The root of ``|I + P M|`` follows M from its real part, whose determinant is positive, through
    the squares of its imaginary part: each ratio of successive determinants has the form
    ``1 + i d l'Ql`` with ``Re Q >= 0``, so it stays off the negative half-line and its principal
    root is the continuous one.
    """
    identity = sp.eye(m.rows)
    partial = quadratic.applyfunc(sp.re)
    last = (identity + p * partial).det()
    factor = 1 / sp.sqrt(last)
    for weight, row in _squares(quadratic.applyfunc(sp.im)):
        partial = partial + sp.I * weight * row * row.T
        determinant = (identity + p * partial).det()
        factor /= sp.sqrt(determinant / last)
        last = determinant
    kernel = identity + p * quadratic
    reduced = kernel.adjugate() / last  # K^-1
    new_p = reduced * p
    exponent = (
        -(m.T * quadratic * reduced * m)[0] / 2
        + (linear.T * reduced * m)[0]
        + (linear.T * new_p * linear)[0] / 2
    )
    return reduced * m + new_p * linear, new_p, factor, exponent


def _squares(matrix: sp.Matrix) -> list[tuple[sp.Expr, sp.Matrix]]:
    """Lagrange's reduction ``matrix = sum_k weight_k row_k row_k'`` of a symmetric matrix."""
    rest, squares = matrix.copy(), []
    n = rest.rows
    while any(sp.expand(entry) != 0 for entry in rest):
        pivot = next((i for i in range(n) if sp.expand(rest[i, i]) != 0), None)
        if pivot is None:
            # only products x_i x_j are left: (x_i + x_j)^2 / 4 - (x_i - x_j)^2 / 4
            i, j = next((i, j) for i in range(n) for j in range(n) if sp.expand(rest[i, j]) != 0)
            unit = sp.eye(n)
            plus, minus = unit[:, i] + unit[:, j], unit[:, i] - unit[:, j]
            value = rest[i, j] / 2
            found = [(value, plus), (-value, minus)]
        else:
            found = [(1 / rest[pivot, pivot], rest[:, pivot])]
        for weight, row in found:
            rest = (rest - weight * row * row.T).applyfunc(sp.expand)
        squares += found
    return squares


def _half_space(key: Key, poly: sp.Poly, m: sp.Matrix, p: sp.Matrix, exponent: sp.Expr) -> sp.Expr:
    """``exp(exponent) E p(x) 1{u > 0}`` under N(m, P), by the Stein recursion with its boundary.

    For a blurred half-space u has one more component, which is independent of x. A real exponent
    and the logarithm of a probability are added before the exponential can overflow.
    """
    normal = sp.Matrix(key.plane.normal)
    direction = p * normal
    location = (normal.T * m)[0] + key.plane.offset
    variance = (normal.T * direction)[0]
    variance = variance + 1 if key.plane.blurred else Divisor(variance)
    z = location / sp.sqrt(variance)
    if exponent == 0 or exponent.has(sp.I):
        mass = sp.exp(exponent) * NormalCDF(z)
    else:
        mass = TiltedCDF(exponent, z, exponent - z**2 / 2)
    height = sp.exp(exponent - z**2 / 2) / sp.sqrt(2 * sp.pi * variance)
    gain = direction / variance
    indices = tuple(poly.monoms())
    visited = predecessors(indices)
    on_cov = (p - gain * direction.T).tolist()
    on_plane = monomial_means(visited, list(m - gain * location), on_cov, zeroth=sp.S.One)
    boundary = (list(direction), {a: height * value for a, value in on_plane.items()})
    means = monomial_means(indices, list(m), p.tolist(), zeroth=mass, boundary=boundary)
    return sum((c * means[a] for a, c in poly.terms()), sp.S.Zero)
