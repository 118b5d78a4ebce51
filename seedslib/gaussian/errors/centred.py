"""Variances of polynomials, and of polynomials switched on one plane, from centred monomials.

``f(x) = p(x) + 1{u > 0} d(x)`` with ``u = c'x + b`` is expanded about the estimate:
``x = xhat + e``, ``e ~ N(0, P)``. On the side of the plane where xhat lies the polynomial of
that side is the base, and only the mass of e that crosses the plane corrects it. The variance is
then a quadratic form in the covariances of ``e^alpha`` and ``1{crossed} e^alpha``: quantities of
the size of P, never differences of quantities of the size of f.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from math import comb, prod
from typing import Any, NamedTuple

import numpy as np

from seedslib.gaussian.means.kernels import Group, HalfSpace, half_space_means, inner_product
from seedslib.gaussian.means.polynomial import Coefficients, Index, monomial_means, polynomial_value


class Switched(NamedTuple):
    """``base(x) + 1{plane} jump(x)``; on the plane itself ``base(x) + edge(x)``."""

    size: int
    base: Coefficients
    jump: Coefficients
    edge: Coefficients
    plane: HalfSpace | None


def switched(groups: Sequence[Group], size: int) -> Switched:
    """Collect the groups of a polynomial or piecewise function; p 1{-u > 0} is p - p 1{u > 0}."""
    planes = [group.plane for group in groups if group.plane]
    plane = planes[-1] if planes else None
    base, jump, edge = [], [], []
    for group in groups:
        p = group.polynomial
        if group.plane is None:
            base.append((p, 1.0))
        elif np.array_equal(group.plane.normal, plane.normal):
            jump.append((p, 1.0))
            edge.append((p, group.plane.edge))
        else:
            base.append((p, 1.0))
            jump.append((p, -1.0))
            edge.append((p, group.plane.edge - 1.0))
    return Switched(size, _total(base), _total(jump), _total(edge), plane)


def _total(parts: Iterable[tuple[Coefficients, float]]) -> Coefficients:
    """Weighted sum of polynomials."""
    total: Coefficients = {}
    for polynomial, weight in parts:
        for alpha, c in polynomial.items():
            total[alpha] = total.get(alpha, 0.0) + weight * c
    return total


def _taylor(polynomial: Coefficients) -> dict[Index, Coefficients]:
    """Polynomials ``d^alpha p / alpha!`` for every alpha that does not annihilate p."""
    table: dict[Index, Coefficients] = {}
    for gamma, c in polynomial.items():
        for alpha in product(*(range(k + 1) for k in gamma)):
            weight = prod(comb(g, a) for g, a in zip(gamma, alpha, strict=True))
            rest = tuple(g - a for g, a in zip(gamma, alpha, strict=True))
            entry = table.setdefault(alpha, {})
            entry[rest] = entry.get(rest, 0.0) + weight * c
    return table


class CentredMoments:
    """Conditional moments of a switched polynomial given the estimate, batched.

    Parameters
    ----------
    function : Switched
        The function of p values.
    dimension : int
        n.
    """

    def __init__(self, function: Switched, dimension: int) -> None:
        self.function = function
        self.zero: tuple[int, ...] = (0,) * dimension
        self.base: Any = _taylor(function.base)
        self.jump: Any = _taylor(function.jump)
        self.indices: tuple[Any, ...] = tuple(sorted({*self.base, *self.jump, self.zero}))
        self.pairs: tuple[Any, ...] = tuple(
            sorted({_sum(a, b) for a in self.indices for b in self.indices} | set(self.indices))
        )

    def moments(self, xhat: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Variance (p, p, *batch) and excess ``E f - f(xhat)`` (p, *batch).

        `xhat` is (n, *batch), `cov` is (n, n) or (n, n, *batch).
        """
        batch = xhat.shape[1:]
        names, columns = self._columns(xhat, cov)
        whole = monomial_means(self.pairs, np.zeros(xhat.shape[:1]), cov)
        crossed = self._crossed(xhat, cov) if self.function.plane else {}

        def mean(name: tuple[Index, bool]) -> np.ndarray:
            return (crossed if name[1] else whole)[name[0]]

        variance = np.zeros((self.function.size, self.function.size, *batch))
        excess = np.zeros((self.function.size, *batch))
        for name, column in zip(names, columns, strict=True):
            if name != (self.zero, False):
                excess += column * mean(name)
            # one row of the covariance matrix of the basis, applied to the coefficients
            row = np.zeros_like(column)
            for other, entry in zip(names, columns, strict=True):
                both = _sum(name[0], other[0])
                joint = (crossed if name[1] or other[1] else whole)[both]
                row += (joint - mean(name) * mean(other)) * entry
            variance += column[:, None] * row[None]
        if self.function.plane is not None:
            excess += self._edge_gap(xhat, cov)
        return variance, excess

    def _side(self, xhat: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Switching function at xhat and whether it varies given xhat."""
        normal = self.function.plane.normal
        spread = np.einsum("i,ij...,j->...", normal, cov, normal)
        return inner_product(normal, xhat) + self.function.plane.offset, spread > 0

    def _columns(self, xhat: np.ndarray, cov: np.ndarray) -> tuple[list, list]:
        """Basis functions (alpha, crossed) and their coefficients (p, *batch) at xhat."""
        size, batch = self.function.size, xhat.shape[1:]

        def at(table: dict[Index, Coefficients]) -> dict[Index, np.ndarray]:
            return {alpha: polynomial_value(poly, xhat, size) for alpha, poly in table.items()}

        base = at(self.base)
        if self.function.plane is None:
            return [(alpha, False) for alpha in base], list(base.values())
        u, varies = self._side(xhat, cov)
        on = (u > 0) | ((u == 0) & varies)
        settled = (u == 0) & ~varies
        edge = at(_taylor(self.function.edge)) if settled.any() else {}
        names, columns = [], []
        for alpha in self.indices:
            jump = polynomial_value(self.jump.get(alpha, {}), xhat, size)
            column = base.get(alpha, np.zeros((size, *batch))) + on * jump
            if alpha in edge:
                column = column + settled * edge[alpha]
            names += [(alpha, False), (alpha, True)]
            columns += [column, np.where(on, -jump, jump)]
        return names, columns

    def _crossed(self, xhat: np.ndarray, cov: np.ndarray) -> dict[Index, np.ndarray]:
        """``E e^alpha 1{xhat + e lies on the other side of the plane than xhat}``.

        Both sides are the tail ``c'e > |u|``, mirrored where xhat lies on the positive side.
        """
        u, _ = self._side(xhat, cov)
        tail = HalfSpace(self.function.plane.normal, -np.abs(u), 0.0)
        means, log_scale = half_space_means(self.pairs, tail, np.zeros_like(xhat), cov)
        scale = np.exp(log_scale)
        mirrored = np.where(u >= 0, -scale, scale)
        return {a: (mirrored if sum(a) % 2 else scale) * value for a, value in means.items()}

    def _edge_gap(self, xhat: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """What the base has beyond f(xhat) where xhat lies exactly on the plane."""
        u, varies = self._side(xhat, cov)
        exact = (u == 0) & varies
        if not exact.any():
            return np.zeros((self.function.size, *xhat.shape[1:]))
        jump = polynomial_value(self.function.jump, xhat, self.function.size)
        return exact * (jump - polynomial_value(self.function.edge, xhat, self.function.size))


def _sum(left: Index, right: Index) -> Index:
    return tuple(a + b for a, b in zip(left, right, strict=True))
