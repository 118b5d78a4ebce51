"""Covariances of terms ``polynomial x exp(-x'Mx/2 + a'x)`` with complex a, to full digits.

With ``K = I + P M`` and ``W = M K^-1`` the mean of a term is that of its polynomial under
``N(m + d, K^-1 P)``, d = P a - P W (m + P a), times ``|K|^(-1/2) e^X``. Of f g and of f and g apart
these differ by terms that have P as a factor, each of which is written without a subtraction:
``W = M - M P W``, and ``K_f K_g = K_fg (I + Q)`` with ``Q = K_fg^-1 P M_f P M_g``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import sympy as sp
from sympy.codegen.cfunctions import log1p

from seedslib.gaussian.means.exp_difference import ExpDifference
from seedslib.gaussian.means.polynomial import heat


class Wave(NamedTuple):
    """``Re[(even + i odd) exp(-x'Mx/2 + (growth + i phase)'x)]``, real but for the unit."""

    even: sp.Poly
    odd: sp.Poly
    bend: sp.ImmutableMatrix
    growth: sp.ImmutableMatrix
    phase: sp.ImmutableMatrix

    @property
    def conjugate(self) -> Wave:
        """The same wave, written with the opposite phase."""
        return self._replace(odd=-self.odd, phase=-self.phase)

    @property
    def real(self) -> bool:
        """Whether there is no sine in it."""
        return not any(self.phase)


class _Tilt(NamedTuple):
    """A term under N(m, P): det K, X, X - X at P = 0 (real, imaginary), d and K^-1 P."""

    determinant: sp.Expr
    exponent: tuple[sp.Expr, sp.Expr]
    small: tuple[sp.Expr, sp.Expr]
    shift: tuple[sp.Matrix, sp.Matrix]
    spread: sp.Matrix


def tilted_pair(a: Wave, b: Wave, m: sp.Matrix, p: sp.Matrix) -> sp.Expr:
    """Covariance of two waves, of which one has a quadratic exponent."""
    if a.real or b.real:
        return _real_covariance(a, b, m, p)
    both = _real_covariance(a, b, m, p), _real_covariance(a, b.conjugate, m, p)
    return sum(both) / 2


def _real_covariance(f: Wave, g: Wave, m: sp.Matrix, p: sp.Matrix) -> sp.Expr:
    """Real part of E F G - E F E G of the complex functions behind two waves."""
    n = m.rows
    apart = [_tilt(w.bend, w.growth, w.phase, m, p) for w in (f, g)]
    both = _tilt(f.bend + g.bend, f.growth + g.growth, f.phase + g.phase, m, p)
    ratio = _determinant_less_one(
        (sp.eye(n) + p * (f.bend + g.bend)).adjugate() * p * f.bend * p * g.bend / both.determinant
    )
    gap, turn = (both.small[k] - apart[0].small[k] - apart[1].small[k] for k in range(2))
    gap += log1p(ratio) / 2
    # e^u - e^v with the roots of the determinants in the exponents
    u = both.exponent[0] - sp.log(both.determinant) / 2
    v = sum(tilt.exponent[0] - sp.log(tilt.determinant) / 2 for tilt in apart)
    angle = apart[0].exponent[1] + apart[1].exponent[1]
    book: dict[sp.Symbol, sp.Expr] = {}
    first, second = (w.even + sp.I * w.odd for w in (f, g))
    whole = _image(first * second, m, both, book)
    left, right = _image(first, m, apart[0], book), _image(second, m, apart[1], book)
    real, imaginary = (part.xreplace(book) for part in whole.as_real_imag())
    rest = [part.xreplace(book) for part in sp.expand(whole - left * right).as_real_imag()]
    grow = ExpDifference(u, v, gap) * sp.cos(turn) - 2 * sp.exp(v) * sp.sin(turn / 2) ** 2
    swing = sp.exp(u) * sp.sin(turn)
    return sp.cos(angle) * (grow * real - swing * imaginary + sp.exp(v) * rest[0]) - sp.sin(
        angle
    ) * (grow * imaginary + swing * real + sp.exp(v) * rest[1])


def _tilt(
    bend: sp.Matrix, growth: sp.Matrix, phase: sp.Matrix, m: sp.Matrix, p: sp.Matrix
) -> _Tilt:
    kernel = sp.eye(m.rows) + p * bend
    determinant = sp.expand(kernel.det())
    inverse = kernel.adjugate() / determinant
    spread, weight = inverse * p, bend * inverse
    push = (growth.T * spread * growth - phase.T * spread * phase)[0] / 2
    swing = (growth.T * spread * phase)[0]
    exponent = (growth.T * inverse * m - m.T * weight * m / 2)[0] + push
    small = (m.T * bend * p * weight * m / 2 - growth.T * p * weight * m)[0] + push
    return _Tilt(
        determinant,
        (exponent, (phase.T * inverse * m)[0] + swing),
        (small, swing - (phase.T * p * weight * m)[0]),
        (p * growth - p * weight * (m + p * growth), spread * phase),
        spread,
    )


def _determinant_less_one(matrix: sp.Matrix) -> sp.Expr:
    """``|I + Q| - 1`` as a sum of minors."""
    n = matrix.rows
    named = sp.Matrix(n, n, lambda i, j: sp.Dummy() if matrix[i, j] != 0 else 0)
    value = sp.expand((sp.eye(n) + named).det(method="berkowitz") - 1)
    return value.xreplace({s: c for s, c in zip(named, matrix, strict=True) if s != 0})


def _image(poly: sp.Poly, m: Sequence[Any], tilt: _Tilt, book: dict[sp.Symbol, sp.Expr]) -> sp.Expr:
    """Mean of a polynomial, the shift and the covariance as symbols, which the book tells."""

    def named(value: sp.Expr) -> sp.Expr:
        if value == 0:
            return value
        symbol = sp.Dummy(real=True)
        book[symbol] = value
        return symbol

    spread = sp.zeros(len(m), len(m))
    for i in range(len(m)):
        for j in range(i + 1):
            spread[i, j] = spread[j, i] = named(tilt.spread[i, j])
    steps = zip(m, *tilt.shift, strict=True)
    centre = [place + named(step) + sp.I * named(swing) for place, step, swing in steps]
    terms = heat(dict(poly.terms()), spread.tolist()).items()
    return sp.expand(
        sum(c * sp.prod([v**k for v, k in zip(centre, a, strict=True)]) for a, c in terms)
    )
