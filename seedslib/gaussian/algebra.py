"""The closed class of functions, as an algebra of SymPy terms.

A term is ``polynomial x exp(quadratic) x indicator of a half-space``, the quadratic with complex
coefficients, so that sines and cosines are exponentials; beside it stands the Euclidean norm of an
affine map. A half-space may be blurred: its boundary is moved by a normal number of its own, which
makes its indicator on average the normal distribution function, hence the error function. Sums and
products of terms are terms again (at most one half-space to a term).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import sympy as sp


class NoClosedForm(ValueError):
    """The Gaussian mean of a term has no closed form in this library; the message names it."""


class Clash(ValueError):
    """Two factors that the algebra cannot multiply; the reader adds the term's name."""


class Plane(NamedTuple):
    """Half-space ``normal . x + offset > 0``; its indicator is `edge` on the boundary.

    A blurred one is ``normal . x + offset > U`` with an independent standard normal U.
    """

    normal: tuple[sp.Expr, ...]
    offset: sp.Expr
    edge: sp.Expr
    blurred: bool = False

    @property
    def place(self) -> tuple[Any, ...]:
        """The half-space without its boundary."""
        return self.normal, self.offset, self.blurred

    @property
    def boundary(self) -> frozenset[tuple[Any, ...]]:
        """Both half-spaces of the plane."""
        return frozenset((self.place, opposite(self).place))


class Key(NamedTuple):
    """What multiplies the polynomial of a term.

    ``exponent`` holds the (monomial, coefficient) pairs of degrees one and two; ``plane`` the
    half-space, if any; ``norm`` the square of a norm, a polynomial of degree two, if any.
    """

    exponent: tuple[tuple[tuple[int, ...], sp.Expr], ...] = ()
    plane: Plane | None = None
    norm: sp.Poly | None = None

    def put(
        self, quadratic: object, linear: object, number: Callable[..., Any] = lambda c: c
    ) -> None:
        """Add M (n, n) and a (n,) of the exponent ``-x'Mx/2 + a'x``, evaluated by `number`."""
        for monomial, coefficient in self.exponent:
            axes = [i for i, k in enumerate(monomial) for _ in range(k)]
            value = number(coefficient)
            if len(axes) == 1:
                linear[axes[0]] += value
            else:
                # c x_i x_j is -c on both off-diagonal places, -2c on the diagonal
                quadratic[axes[0], axes[1]] -= value
                quadratic[axes[1], axes[0]] -= value


Terms = dict[Key, sp.Poly]
PLAIN = Key()


def clean(terms: Terms) -> Terms:
    """The same sum without the terms that are zero."""
    return {key: poly for key, poly in terms.items() if not poly.is_zero}


def add_terms(left: Terms, right: Terms) -> Terms:
    """Sum of two term sums."""
    total = dict(left)
    for key, poly in right.items():
        total[key] = total[key] + poly if key in total else poly
    return clean(total)


def multiply(left: Terms, right: Terms) -> Terms:
    """Product of two term sums; `Clash` for two different half-spaces or norms."""
    total: Terms = {}
    for key_a, a in left.items():
        for key_b, b in right.items():
            if key_a.plane and key_b.plane and _apart(key_a.plane, key_b.plane):
                continue
            poly = a * b
            exponent = dict(key_a.exponent)
            for monomial, c in key_b.exponent:
                exponent[monomial] = exponent.get(monomial, sp.S.Zero) + c
            exponent = {m: sp.expand(c) for m, c in exponent.items()}
            norm = key_a.norm or key_b.norm
            if key_a.norm is not None and key_b.norm is not None:
                if key_a.norm != key_b.norm:
                    raise Clash("wanted at most one norm to a term")
                poly, norm = poly * key_a.norm, None
            key = Key(
                tuple(sorted((m, c) for m, c in exponent.items() if c != 0)),
                _meet(key_a.plane, key_b.plane),
                norm,
            )
            total = add_terms(total, {key: poly})
    return total


def opposite(plane: Plane) -> Plane:
    """The other side of a plane."""
    return Plane(tuple(-c for c in plane.normal), -plane.offset, 1 - plane.edge, plane.blurred)


def folded(terms: Terms) -> Terms:
    """The same sum with ``p - p 1{u > 0}`` written as ``p 1{-u > 0}``, blurred or not.

    The mean of a tail then keeps its digits, which the difference from the whole would lose.
    """
    result = dict(terms)
    for whole, poly in terms.items():
        if whole.plane is not None:
            continue
        sides: dict[tuple[Any, ...], Terms] = {}  # those that differ on the boundary together
        for key, part in terms.items():
            if key.plane and key._replace(plane=None) == whole:
                sides.setdefault(key.plane.place, {})[key] = part
        for side in sides.values():
            if sum(side.values(), poly).is_zero:
                del result[whole]
                for key, part in side.items():
                    del result[key]
                    other = key._replace(plane=opposite(key.plane))
                    result = add_terms(result, {other: -part})
                break
    return result


def _apart(left: Plane, right: Plane) -> bool:
    """Whether two half-spaces share nothing but their boundary."""
    return not left.blurred and left.place == opposite(right).place


def _meet(left: Plane | None, right: Plane | None) -> Plane | None:
    if left is None or right is None:
        return left or right
    if left.blurred or right.blurred:
        raise Clash("wanted one error function and no other switching function to a term")
    if left.place != right.place:
        raise Clash("wanted one affine switching function to a term, got two")
    return left._replace(edge=left.edge * right.edge)


def quadratic_gram(square: sp.Poly) -> sp.Matrix:
    """Gram matrix G of ``square = [1; x]' G [1; x]``, shape (n + 1, n + 1)."""
    n = len(square.gens)
    gram = sp.zeros(n + 1, n + 1)
    for monomial, c in square.terms():
        axes = [i + 1 for i, k in enumerate(monomial) for _ in range(k)]
        i, j = (*axes, 0, 0)[:2]
        gram[i, j] += c / 2
        gram[j, i] += c / 2
    return gram


def is_semidefinite(gram: sp.Matrix) -> bool:
    """Whether a matrix of numbers has no eigenvalue below rounding."""
    if gram.free_symbols:
        return False
    values = np.linalg.eigvalsh(np.array(gram.evalf().tolist(), dtype=float))
    return bool(values[0] >= -1e-12 * max(values[-1], 0.0))
