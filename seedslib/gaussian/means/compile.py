"""From symbolic terms to numeric groups and norms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from seedslib.gaussian.arguments import align
from seedslib.gaussian.means.classes import Key, quadratic_gram
from seedslib.gaussian.means.kernels import Group, HalfSpace, group_mean, group_value
from seedslib.gaussian.means.norm import norm_mean
from seedslib.gaussian.means.parse import Parsed
from seedslib.gaussian.means.polynomial import Coefficients

Number = Callable[[sp.Expr], complex]
CONJUGATE = 1e-12  # relative rounding between the two halves of a sine or cosine


@dataclass(frozen=True, eq=False)
class Norm:
    """``coefficient |factor [1; x]|`` with coefficient (p,) and factor (rows, n + 1)."""

    coefficient: np.ndarray
    factor: np.ndarray

    def law(self, mean: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of the affine map under the norm."""
        slope = self.factor[:, 1:]
        origin = self.factor[:, 0].reshape(-1, *(1,) * (mean.ndim - 1))
        if cov.ndim == 2:
            spread = slope @ cov @ slope.T
        else:
            spread = np.einsum("ia,ab...,jb->ij...", slope, cov, slope)
        return origin + np.tensordot(slope, mean, axes=1), 0.5 * (spread + spread.swapaxes(0, 1))


@dataclass(frozen=True, eq=False)
class Compiled:
    """A function of p values as groups and norms of numbers."""

    size: int
    dimension: int
    groups: tuple[Group, ...]
    norms: tuple[Norm, ...]

    def mean(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Gaussian mean (p, *batch); arguments are not checked."""
        batch = np.broadcast_shapes(mean.shape[1:], cov.shape[2:])
        if cov.ndim > 2:
            # both get all batch axes, so that components broadcast against one another
            mean = np.broadcast_to(align(mean, 1, len(batch)), (self.dimension, *batch))
            cov = align(cov, 2, len(batch))
        total = np.zeros((self.size, *batch))
        for group in self.groups:
            total += group_mean(group, mean, cov, batch)
        for norm in self.norms:
            length = norm_mean(*norm.law(mean, cov))
            total += norm.coefficient.reshape(-1, *(1,) * len(batch)) * length
        return total

    def polynomial(self) -> Coefficients:
        """Coefficients of a function without exponentials, planes and norms."""
        if not self.groups:
            return {(0,) * self.dimension: np.zeros(self.size)}
        (group,) = self.groups
        return group.polynomial

    def value(self, point: np.ndarray) -> np.ndarray:
        """Function itself, (p, *batch), at points (n, *batch)."""
        total = np.zeros((self.size, *point.shape[1:]))
        for group in self.groups:
            total += group_value(group, point, self.size)
        for norm in self.norms:
            affine, _ = norm.law(point, np.zeros((len(point),) * 2))
            length = np.linalg.norm(affine, axis=0)
            total += norm.coefficient.reshape(-1, *(1,) * length.ndim) * length
        return total


def compile_terms(parsed: Parsed, number: Number = complex) -> Compiled:
    """Numeric form of a parsed function; `number` evaluates its coefficients.

    Of two conjugate exponentials one is kept, with twice its coefficient: the function is real.

    Raises
    ------
    ValueError
        A coefficient that is no number or out of range, or a function that is not real.
    """
    number = _finite(number)
    n, p = len(parsed.symbols), len(parsed.components)
    polynomials: dict[Key, dict] = {}
    for row, terms in enumerate(parsed.components):
        for key, poly in terms.items():
            table = polynomials.setdefault(key, {})
            for monomial, coefficient in poly.terms():
                column = table.setdefault(monomial, np.zeros(p, dtype=complex))
                column[row] = number(coefficient)
    groups, norms, waves = [], [], []
    for key, table in polynomials.items():
        if key.norm is not None:
            gram = np.array(
                [[number(c) for c in row] for row in quadratic_gram(key.norm).tolist()]
            ).real
            norms.append(Norm(table[(0,) * n].real, _rows(gram)))
            continue
        quadratic, linear = _exponent(key, n, number)
        plane = _plane(key, number)
        parts = [v.imag.ravel() for v in (linear, quadratic) if v is not None]
        phase = next((turn for part in parts for turn in part if turn), 0.0)
        if phase:
            waves.append(Group(table, quadratic, linear, plane))
        if phase < 0:
            continue
        table = {alpha: 2 * c if phase else _real(c) for alpha, c in table.items()}
        groups.append(Group(table, _narrow(quadratic), _narrow(linear), plane))
    if waves:
        _check_conjugates(waves, n)
    return Compiled(p, n, tuple(groups), tuple(norms))


def _finite(number: Number) -> Number:
    """The same evaluation of coefficients, passing finite numbers only."""

    def checked(expression: sp.Expr) -> complex:
        try:
            value = number(expression)
        except TypeError as error:
            raise ValueError(f"f: wanted numbers as coefficients, got {expression}") from error
        except OverflowError:
            value = complex(np.inf)
        if not np.isfinite(value):
            raise ValueError(f"f: wanted coefficients in the range of float64, got {expression}")
        return value

    return checked


def _check_conjugates(waves: Sequence[Group], n: int) -> None:
    """Refuse complex exponentials that do not come in conjugate pairs: their sum is not real."""
    rows = []
    for wave in waves:
        quadratic = np.zeros((n, n)) if wave.quadratic is None else wave.quadratic
        linear = np.zeros(n) if wave.linear is None else wave.linear
        plane = [*wave.plane.normal, *wave.plane[1:]] if wave.plane else []
        rows.append(
            np.concatenate([quadratic.ravel(), linear, plane, np.zeros(n + 3 - len(plane))])
        )
    places = np.array(rows)
    scale = max(np.abs(c).max() for wave in waves for c in wave.polynomial.values())
    for place, wave in zip(places, waves, strict=True):
        gaps = np.abs(places - place.conj()).max(axis=1)
        # a tie is one of equal waves, whose tables are equal as well
        twin = waves[int(gaps.argmin())]
        table = twin.polynomial if gaps.min() <= CONJUGATE * np.abs(place).max() else {}
        for alpha, c in wave.polynomial.items():
            if (np.abs(c.conj() - table.get(alpha, 0.0)) > CONJUGATE * scale).any():
                raise ValueError(
                    "f: wanted real values, got a complex exponential without its conjugate, "
                    f"exponent coefficients {place[place.imag != 0]}"
                )


def _exponent(key: Key, n: int, number: Number) -> tuple[np.ndarray | None, np.ndarray | None]:
    quadratic, linear = np.zeros((n, n), dtype=complex), np.zeros(n, dtype=complex)
    key.put(quadratic, linear, number)
    return quadratic if quadratic.any() else None, linear if linear.any() else None


def _plane(key: Key, number: Number) -> HalfSpace | None:
    if key.plane is None:
        return None
    normal = np.array([number(c) for c in key.plane.normal]).real
    offset, edge = number(key.plane.offset).real, number(key.plane.edge).real
    return HalfSpace(normal, offset, edge, float(key.plane.blurred))


def _rows(gram: np.ndarray) -> np.ndarray:
    """Rows R with ``R' R = gram``, those of rounding size left out."""
    # any rows will do: only RᵀR is used
    values, vectors = np.linalg.eigh(gram)
    keep = values > 1e-14 * values[-1]
    return (vectors[:, keep] * np.sqrt(values[keep])).T


def _narrow(array: np.ndarray | None) -> np.ndarray | None:
    if array is None or (np.iscomplexobj(array) and array.imag.any()):
        return array
    return array.real


def _real(coefficient: np.ndarray) -> np.ndarray:
    if (np.abs(coefficient.imag) > 1e-12 * np.abs(coefficient)).any():
        raise ValueError(f"f: wanted real coefficients, got {coefficient}")
    return coefficient.real
