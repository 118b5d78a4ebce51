"""Gaussian covariances of SymPy expressions, whose digits do not depend on the variances.

``E f g - E f E g`` is a difference of numbers of the size of f g, a covariance is one of the size
of the variances. For polynomials, exponentials, sines and their products the difference is taken
before numbers are put in: with ``E e^(a'x) = e^(V_a)``

    cov(e^(a'x), e^(b'x)) = e^(V_a + V_b) (e^(a'Pb) - 1),

and of polynomials beside them the part without P cancels term by term. Sines and cosines go in
pairs, cov(cos a'x, cos b'x) = e^w (cos cos (cosh s - 1) + sin sin sinh s) with s = a'Pb, where
nothing cancels wherever the mean is. Of half-spaces with the probability q the square is written
as q^2 = q - q (1 - q).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import sympy as sp

from seedslib.base.symbols import as_symbols
from seedslib.gaussian.means.classes import Clash, NoClosedForm, Terms, folded, multiply
from seedslib.gaussian.means.covariance_tilted import Wave, tilted_pair
from seedslib.gaussian.means.exp_difference import ExpDifference
from seedslib.gaussian.means.formulas import mean_formula, stand_ins
from seedslib.gaussian.means.normal_cdf import NormalCDF, TiltedTail
from seedslib.gaussian.means.parse import parse
from seedslib.gaussian.means.polynomial import heat

ZERO = sp.S.Zero


def covariance_expression(
    f: sp.Expr, g: sp.Expr, variables: Sequence[sp.Symbol], mean: Sequence[Any], cov: sp.MatrixBase,
    *, parameters: Sequence[sp.Symbol] = (),
) -> sp.Expr:  # fmt: skip
    """Covariance of f(x) and g(x) for x ~ N(mean, cov), as a SymPy expression.

    Parameters
    ----------
    f, g : expressions
        Real functions of `variables`.
    variables, mean, cov, parameters
        As in `seedslib.gaussian.expectation`.

    Raises
    ------
    NoClosedForm
        A term of f, of g or of their product is outside the class.
    """
    formula, means, covs = _template(f, g, as_symbols("variables", variables), tuple(parameters))
    values = dict(zip(means, mean, strict=True))
    n = len(means)
    values |= {covs[i][j]: cov[i, j] for i in range(n) for j in range(i, n)}
    return formula.xreplace(values)


@lru_cache(maxsize=256)
def _template(f: sp.Expr, g: sp.Expr, variables: tuple, parameters: tuple) -> tuple:
    """Formula in stand-ins for the mean and covariance, cached by (expressions, symbols)."""
    parsed = parse([f, g], variables, parameters)
    means, covs = stand_ins(len(variables))
    m, p = sp.Matrix(means), sp.Matrix(covs)
    (calm_f, other_f), (calm_g, other_g) = map(_apart, parsed.components)
    total = sum((_pair(a, b, m, p) for a in _waves(calm_f) for b in _waves(calm_g)), ZERO)
    try:
        for left, right in ((calm_f, other_g), (other_f, parsed.components[1])):
            if left and right:
                total += _difference(left, right, parsed.symbols, means, covs)
    except Clash as clash:
        raise NoClosedForm(f"no closed form for {f * g}: {clash}") from None
    back = dict(zip(parsed.parameters, parameters, strict=True))
    return total.xreplace(back), means, covs


def _apart(terms: Terms) -> tuple[Terms, Terms]:
    """Terms without a plane whose quadratic exponents are real, and the others."""
    calm, other = {}, {}
    for key, poly in terms.items():
        if key.norm is not None:
            raise NoClosedForm("the mean of a norm is an integral")
        real = not any(sum(a) == 2 and sp.sympify(c).has(sp.I) for a, c in key.exponent)
        (calm if real and key.plane is None else other)[key] = poly
    return calm, other


def _waves(terms: Terms) -> list[Wave]:
    """Terms as real functions: one of two that are conjugate, doubled."""
    found, done = [], set()
    for key, poly in terms.items():
        n = len(poly.gens)
        bend, linear = sp.zeros(n, n), sp.zeros(n, 1)
        key.put(bend, linear)
        bend = sp.ImmutableMatrix(bend)
        growth, phase = (
            sp.ImmutableMatrix([sp.expand(_parts(c)[k]) for c in linear]) for k in range(2)
        )
        if (bend, growth, -phase) in done:
            continue
        done.add((bend, growth, phase))
        even, odd = (
            sp.Poly.from_dict({a: _parts(c)[k] for a, c in poly.terms()}, *poly.gens)
            for k in range(2)
        )
        wave = Wave(2 * even, 2 * odd, bend, growth, phase)
        found.append(wave if any(phase) else wave._replace(even=even, odd=0 * even))
    return found


def _parts(number: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    """Real and imaginary part; symbols are real, and so are functions of them."""
    number = sp.sympify(number)
    return number.as_real_imag() if number.has(sp.I) else (number, ZERO)


def _pair(a: Wave, b: Wave, m: sp.Matrix, p: sp.Matrix) -> sp.Expr:
    """Covariance of two waves, in products of sines and differences of exponentials."""
    if any(a.bend) or any(b.bend):
        return tilted_pair(a, b, m, p)
    (one, turn), (other, twist) = a[-2:], b[-2:]
    w = _dot(one + other, m) + (_dot(one, p * one) + _dot(other, p * other)) / 2
    w = sp.expand(w - (_dot(turn, p * turn) + _dot(twist, p * twist)) / 2)
    phases = [sp.expand(_dot(t, m) + _dot(o, p * t)) for o, t in ((one, turn), (other, twist))]
    book = _Book()
    ca, sa = book(sp.cos(phases[0])), book(sp.sin(phases[0]))
    cb, sb = book(sp.cos(phases[1])), book(sp.sin(phases[1]))
    pairs, share = ([(b, 1)], 1) if a.real or b.real else ([(b, 1), (b.conjugate, -1)], sp.S.Half)
    total = ZERO
    for second, sign in pairs:
        grow, swing = _less_one(w, a, second, p, book, sign)
        whole, rest = _means(a, second, m, p)
        scale = book(sp.exp(w))
        real = grow * whole[0] - swing * whole[1] + scale * rest[0]
        imaginary = grow * whole[1] + swing * whole[0] + scale * rest[1]
        cosine, sine = ca * cb - sign * sa * sb, sa * cb + sign * ca * sb
        total += cosine * real - sine * imaginary
    symbols = list(book.table)
    if not symbols:
        return sp.expand(share * total)
    grouped = sp.Poly(sp.expand(share * total), *symbols)
    return sum(
        (c * sp.prod([book.table[s] ** k for s, k in zip(symbols, powers, strict=True)])
         for powers, c in grouped.terms()), ZERO,
    )  # fmt: skip


class _Book:
    """Symbols for functions, so that sums of products are put in order without looking inside."""

    def __init__(self) -> None:
        self.table: dict[sp.Symbol, sp.Expr] = {}
        self._known: dict[sp.Expr, sp.Symbol] = {}

    def __call__(self, function: sp.Expr) -> sp.Expr:
        if function.is_number:
            return function
        if function not in self._known:
            self._known[function] = sp.Dummy(f"f{len(self._known)}", real=True)
            self.table[self._known[function]] = function
        return self._known[function]


def _less_one(
    w: sp.Expr, a: Wave, b: Wave, p: sp.Matrix, book: _Book, sign: int
) -> tuple[sp.Expr, sp.Expr]:
    """Real and imaginary part of ``e^w (e^s - 1)``, where s = a'Pb."""
    (one, turn), (other, twist) = a[-2:], b[-2:]
    s = sp.expand(_dot(one, p * other) - _dot(turn, p * twist))
    angle = sp.expand(_dot(one, p * twist) + _dot(turn, p * other))
    if s == 0 and angle == 0:
        return ZERO, ZERO
    if not any((*a.growth, *b.growth)):
        # e^w (cosh s - 1 -+ sinh s): of both signs together only one of them is left
        s = -sign * s
        up, down = sp.expand(w + s), sp.expand(w - s)
        root = book(ExpDifference(up / 2, down / 2, s))
        both = book(sp.exp(up / 2)) + book(sp.exp(down / 2))
        return root**2 / 2 - sign * root * both / 2, ZERO
    grow = book(ExpDifference(sp.expand(w + s), w, s))
    if angle == 0:
        return grow, ZERO
    half, scale = book(sp.sin(angle / 2)), book(sp.exp(w))
    up = book(sp.exp(sp.expand(w + s)))
    return grow * book(sp.cos(angle)) - 2 * scale * half**2, up * book(sp.sin(angle))


def _means(a: Wave, b: Wave, m: sp.Matrix, p: sp.Matrix) -> tuple[Any, Any]:
    """Real and imaginary part of N and of N - D, the polynomials of E f g and of E f E g."""
    shift_a, shift_b = (p * (wave.growth + sp.I * wave.phase) for wave in (a, b))
    first, second = (wave.even + sp.I * wave.odd for wave in (a, b))
    whole = _image(first * second, m + shift_a + shift_b, p)
    apart = sp.expand(_image(first, m + shift_a, p) * _image(second, m + shift_b, p))
    return _parts(whole), _parts(sp.expand(whole - apart))


def _image(poly: sp.Poly, centre: sp.Matrix, p: sp.Matrix) -> sp.Expr:
    """Mean of a polynomial under the law of this centre."""
    terms = heat(dict(poly.terms()), p.tolist()).items()
    powers = (c * sp.prod([v**k for v, k in zip(centre, a, strict=True)]) for a, c in terms)
    return sp.expand(sum(powers, ZERO))


def _dot(left: sp.Matrix, right: sp.Matrix) -> sp.Expr:
    return (left.T * right)[0]


def _difference(left: Terms, right: Terms, *law: Any) -> sp.Expr:
    """``E f g - E f E g``, expanded, with squares of probabilities taken apart."""
    product = mean_formula(folded(multiply(left, right)), *law)
    whole = product - mean_formula(left, *law) * mean_formula(right, *law)
    book = _Book()
    sides: dict[sp.Expr, sp.Symbol] = {}
    table: dict[sp.Expr, sp.Expr] = {}
    for part in sorted(whole.atoms(NormalCDF), key=str):
        z = part.args[0]
        if -z in sides:
            table[part] = 1 - sides[-z]
        else:
            table[part] = sides[z] = sp.Dummy(f"q{len(sides)}", real=True)
    whole = whole.xreplace(table)
    whole = whole.xreplace({part: book(part) for part in _functions(whole)})
    for z, q in sides.items():
        whole = _centred(sp.expand(whole), q, NormalCDF(z), NormalCDF(-z))
    return whole.xreplace(book.table)


def _functions(expression: sp.Expr) -> Iterable[sp.Expr]:
    return sorted(expression.atoms(sp.exp, sp.sin, sp.cos, TiltedTail), key=str)


def _centred(whole: sp.Expr, q: sp.Symbol, inside: sp.Expr, outside: sp.Expr) -> sp.Expr:
    """An expression of degree two in a probability, by ``q^2 = q - q (1 - q)``."""
    square, once, free = (sp.expand(whole.coeff(q, k)) for k in (2, 1, 0))
    once = sp.expand(once + square)
    linear = free * outside if sp.expand(once + free) == 0 else free + once * inside
    return linear - square * inside * outside
