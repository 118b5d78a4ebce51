"""Gaussian means of SymPy expressions in symbols: `expectation` and the formulas behind it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import sympy as sp

from seedslib.base.symbols import as_expression, as_symbols, real_part
from seedslib.gaussian.algebra import (
    Difference,
    Divisor,
    Key,
    NoClosedForm,
    NormalCDF,
    components_of,
    parse,
)
from seedslib.gaussian.means import monomial_means, predecessors


def expectation(
    f: object,
    variables: Sequence[sp.Symbol],
    mean: Sequence[Any],
    cov: sp.MatrixBase | Sequence[Any],
    *,
    parameters: Sequence[sp.Symbol] = (),
) -> Any:
    """Mean of f(x) for x ~ N(mean, cov), as a SymPy expression.

    Polynomials (equation (3.2) of Choi, Song, Shin 2019, for any degree), times exponentials of
    quadratics, or times the indicator of one half-space or one error function (erf, erfc) of an
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
        A term is outside the class; a norm, or an exponential on one side of a plane, has only a
        numeric mean.
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
    f: object,
    variables: Sequence[sp.Symbol],
    mean: Sequence[Any],
    cov: sp.MatrixBase | Sequence[Any],
    *,
    parameters: Sequence[sp.Symbol] = (),
) -> sp.Expr | sp.Matrix:
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
    formulas, symbols, scalar = _template(
        components_of(f), variables, as_symbols("parameters", parameters)
    )
    values = dict(zip(symbols, [*mean, *cov], strict=True))
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
    # exponentials are left whole: their factors may overflow where the product does not
    product = sp.expand(f * g, power_exp=False, power_base=False, log=False)
    components = (sp.sympify(f), sp.sympify(g), product), False
    variables = as_symbols("variables", variables)
    (left, right, square), symbols, _ = _template(components, variables, tuple(parameters))
    n = len(variables)
    left, right, square = map(real_part, (left, right, square))
    slopes = [sp.Matrix([part]).jacobian(symbols[:n]) for part in (left, right)]
    linear = (slopes[0] * sp.Matrix(n, n, symbols[n:]) * slopes[1].T)[0]
    formula = linear + Difference(square, left * right, linear)
    return formula.xreplace(dict(zip(symbols, [*mean, *cov], strict=True)))


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
        if any(key.norm or (key.plane and key.exponent) for key in terms):
            raise NoClosedForm(
                f"no closed form in symbols for {expression}: the mean of a norm, or of an "
                "exponential on one side of a plane, has numbers only; see expectation_function"
            )
    n = len(variables)
    mean = sp.Matrix([sp.Dummy(f"m{i}", real=True) for i in range(n)])
    upper = {
        (i, j): sp.Dummy(f"P{i}{j}", real=True, nonnegative=True if i == j else None)
        for i in range(n)
        for j in range(i, n)
    }
    cov = sp.Matrix(n, n, lambda i, j: upper[min(i, j), max(i, j)])
    # the caller's own symbols come back only after everything real has been used
    back = dict(zip(parsed.parameters, parameters, strict=True))
    formulas = [
        sum((_term(*term, mean, cov) for term in terms.items()), sp.S.Zero).xreplace(back)
        for terms in parsed.components
    ]
    return formulas, (*mean, *cov), scalar


def _term(key: Key, poly: sp.Poly, m: sp.Matrix, p: sp.Matrix) -> sp.Expr:
    """Mean of a term under N(m, P)."""
    if key.plane is not None:
        return _half_space(key, poly, m, p)
    n = m.rows
    quadratic, linear = sp.zeros(n, n), sp.zeros(n, 1)
    key.put(quadratic, linear)
    tilts = any(quadratic)
    factor, exponent = sp.S.One, sp.S.Zero
    if tilts:
        m, p, factor, exponent = _tilted(quadratic, linear, m, p)
    elif any(linear):
        exponent = (linear.T * m)[0] + (linear.T * p * linear)[0] / 2
        m = m + p * linear
    # a tilted covariance is a ratio of determinants, which expanding would make longer
    tidy = (lambda value: value) if tilts else sp.expand
    means = monomial_means(poly.monoms(), list(m), p.tolist(), zeroth=sp.S.One, tidy=tidy)
    value = tidy(sum((c * means[a] for a, c in poly.terms()), sp.S.Zero))
    if not tilts and any(c.has(sp.I) for _, c in key.exponent):
        # the conjugate term adds the mirror image: together twice the real part
        modulus, phase = sp.expand(exponent).as_real_imag()
        real, imaginary = value.as_real_imag()
        return sp.exp(modulus) * (real * sp.cos(phase) - imaginary * sp.sin(phase))
    return factor * sp.exp(exponent) * value


def _tilted(quadratic: sp.Matrix, linear: sp.Matrix, m: sp.Matrix, p: sp.Matrix) -> tuple:
    """Mean, covariance, root factor and exponent of ``exp(-x'Mx/2 + a'x) N(x; m, P)``.

    The root of ``|I + P M|`` follows M from its real part, whose determinant is positive, through
    the leading blocks of its imaginary part. Each of these adds at most two squares of opposite
    signs, whose factors turn the determinant by less than half a turn each, in opposite directions:
    the principal root of the ratio is the continuous one.
    """
    identity, imaginary = sp.eye(m.rows), quadratic.applyfunc(sp.im)
    partial = quadratic.applyfunc(sp.re)
    last = (identity + p * partial).det()
    factor = 1 / sp.sqrt(last)
    for k in range(m.rows):
        if any(imaginary[k, : k + 1]):
            partial[: k + 1, : k + 1] = quadratic[: k + 1, : k + 1]
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


def _half_space(key: Key, poly: sp.Poly, m: sp.Matrix, p: sp.Matrix) -> sp.Expr:
    """``E p(x) 1{u > 0}`` under N(m, P), by the Stein recursion with its boundary.

    For a blurred half-space u has one more component, which is independent of x.
    """
    normal = sp.Matrix(key.plane.normal)
    direction = p * normal
    location = (normal.T * m)[0] + key.plane.offset
    variance = (normal.T * direction)[0]
    # with a blur the variance is never zero
    variance = variance + 1 if key.plane.blurred else Divisor(variance)
    z = location / sp.sqrt(variance)
    height = sp.exp(-(z**2) / 2) / sp.sqrt(2 * sp.pi * variance)
    gain = direction / variance
    indices = tuple(poly.monoms())
    visited = predecessors(indices)
    on_cov = (p - gain * direction.T).tolist()
    on_plane = monomial_means(visited, list(m - gain * location), on_cov, zeroth=sp.S.One)
    boundary = (list(direction), {a: height * value for a, value in on_plane.items()})
    means = monomial_means(indices, list(m), p.tolist(), zeroth=NormalCDF(z), boundary=boundary)
    return sum((c * means[a] for a, c in poly.terms()), sp.S.Zero)
