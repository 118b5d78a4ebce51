"""Symbolic Gaussian means of terms: the formulas behind `expectation`."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from seedslib.gaussian.means.classes import Key, Terms
from seedslib.gaussian.means.normal_cdf import NormalCDF
from seedslib.gaussian.means.polynomial import heat, monomial_means, predecessors


def mean_formula(
    terms: Terms, symbols: Sequence[sp.Symbol], mean: Sequence, cov: Sequence
) -> sp.Expr:
    """Mean of a sum of terms under N(mean, cov), in the components of both."""
    total = sp.S.Zero
    for key, poly in terms.items():
        total += _term(key, poly, symbols, mean, cov)
    return total


def _term(key: Key, poly: sp.Poly, symbols: Sequence, mean: Sequence, cov: Sequence) -> sp.Expr:
    n = len(symbols)
    quadratic, linear = _exponent(key, n)
    m, p = sp.Matrix(list(mean)), sp.Matrix(n, n, lambda i, j: cov[i][j])
    factor, exponent = sp.S.One, sp.S.Zero
    if any(quadratic):
        m, p, factor, exponent = _tilted(quadratic, linear, m, p)
    elif any(linear):
        exponent = (linear.T * m)[0] + (linear.T * p * linear)[0] / 2
        m = m + p * linear
    oscillating = any(c.has(sp.I) for _, c in key.exponent)
    if key.plane is not None:
        value = _half_space(key, poly, m, p)
    elif any(quadratic):
        means = monomial_means(poly.monoms(), list(m), p.tolist(), zeroth=sp.S.One)
        value = sum((c * means[a] for a, c in poly.terms()), sp.S.Zero)
    else:
        image = heat(dict(poly.terms()), p.tolist())
        value = sum(
            (c * sp.prod([v**k for v, k in zip(m, a, strict=True)]) for a, c in image.items()),
            sp.S.Zero,
        )
        value = sp.expand(value)
    if oscillating and key.plane is None and not any(quadratic):
        # the conjugate term adds the mirror image: together twice the real part
        modulus, phase = sp.expand(exponent).as_real_imag()
        real, imaginary = value.as_real_imag()
        wave = real * sp.cos(phase) - imaginary * sp.sin(phase)
        return factor * sp.exp(modulus) * wave
    return factor * sp.exp(exponent) * value


def _exponent(key: Key, n: int) -> tuple[sp.Matrix, sp.Matrix]:
    """M and a of ``-x'Mx/2 + a'x``."""
    quadratic, linear = sp.zeros(n, n), sp.zeros(n, 1)
    for monomial, c in key.exponent:
        axes = [i for i, k in enumerate(monomial) for _ in range(k)]
        if len(axes) == 1:
            linear[axes[0]] += c
        else:
            quadratic[axes[0], axes[1]] -= c
            quadratic[axes[1], axes[0]] -= c
    return quadratic, linear


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


def _half_space(key: Key, poly: sp.Poly, m: sp.Matrix, p: sp.Matrix) -> sp.Expr:
    """``E p(x) 1{u > 0}`` under N(m, P) by the Stein recursion with its boundary term.

    For a blurred half-space u has one more component, which is independent of x.
    """
    normal = sp.Matrix(key.plane.normal)
    direction = p * normal
    location = (normal.T * m)[0] + key.plane.offset
    variance = (normal.T * direction)[0] + int(key.plane.blurred)
    mass = NormalCDF(location / sp.sqrt(variance))
    height = sp.exp(-(location**2) / (2 * variance)) / sp.sqrt(2 * sp.pi * variance)
    gain = direction / variance
    indices = tuple(poly.monoms())
    visited = predecessors(indices)
    on_cov = (p - gain * direction.T).tolist()
    on_plane = monomial_means(visited, list(m - gain * location), on_cov, zeroth=sp.S.One)
    boundary = (list(direction), {a: height * value for a, value in on_plane.items()})
    means = monomial_means(indices, list(m), p.tolist(), zeroth=mass, boundary=boundary)
    return sum((c * means[a] for a, c in poly.terms()), sp.S.Zero)
