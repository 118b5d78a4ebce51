"""Gaussian means as NumPy functions for batches, and the classes of functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
import sympy as sp

from seedslib.base.arrays import align
from seedslib.base.symbols import as_symbols
from seedslib.gaussian.algebra import (
    Key,
    NoClosedForm,
    Parsed,
    components_of,
    parse,
    quadratic_gram,
)
from seedslib.gaussian.arguments import gaussian_arguments, in_range
from seedslib.gaussian.functions import norm_mean
from seedslib.gaussian.kernels import Group, HalfSpace, group_mean, group_value
from seedslib.gaussian.polynomial import Coefficients, polynomial_value


@dataclass(frozen=True, eq=False)
class Norm:
    """``coefficient |factor [1; x]|`` with coefficient (p,) and factor (rows, n + 1)."""

    coefficient: np.ndarray
    factor: np.ndarray

    def affine(self, mean: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of the affine map under the norm."""
        slope = self.factor[:, 1:]
        origin = self.factor[:, 0].reshape(-1, *(1,) * (mean.ndim - 1))
        image = np.einsum("ia,ab...,jb->ij...", slope, cov, slope)
        return origin + np.tensordot(slope, mean, axes=1), 0.5 * (image + image.swapaxes(0, 1))


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
            length = norm_mean(*norm.affine(mean, cov))
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
            affine, _ = norm.affine(point, np.zeros((len(point),) * 2))
            length = np.linalg.norm(affine, axis=0)
            total += norm.coefficient.reshape(-1, *(1,) * length.ndim) * length
        return total


def compile_terms(parsed: Parsed) -> Compiled:
    """Numeric form of a parsed function.

    Of two conjugate exponentials one is kept, with twice its coefficient: the function is real.

    Raises
    ------
    ValueError
        A coefficient that is no number or out of range, or a function that is not real.
    """
    n, p = len(parsed.symbols), len(parsed.components)
    # what multiplies the polynomials is evaluated once for all components
    tables: dict[Key, dict] = {}
    for row, terms in enumerate(parsed.components):
        for key, poly in terms.items():
            table = tables.setdefault(key, {})
            for monomial, coefficient in poly.terms():
                column = table.setdefault(monomial, np.zeros(p, dtype=complex))
                column[row] = _number(coefficient)
    groups, norms, values = [], [], []
    generic = 0.37 + 0.19 * np.arange(n)  # a point where nothing vanishes by chance
    for key, table in tables.items():
        if key.norm is not None:
            gram = quadratic_gram(key.norm)
            rows = _rows(np.real([_number(c) for c in gram]).reshape(gram.shape))
            norms.append(Norm(table[(0,) * n].real, rows))
            continue
        quadratic, linear = np.zeros((n, n), dtype=complex), np.zeros(n, dtype=complex)
        key.put(quadratic, linear, _number)
        exponent = linear @ generic - 0.5 * generic @ quadratic @ generic
        values.append(np.exp(1j * exponent.imag) * polynomial_value(table, generic, p))
        phase = next((turn for turn in [*linear.imag, *quadratic.imag.ravel()] if turn), 0.0)
        if phase < 0:
            continue
        plane = None
        if key.plane is not None:
            place = *key.plane.normal, key.plane.offset, key.plane.edge
            *normal, offset, edge = np.real([_number(c) for c in place])
            plane = HalfSpace(np.array(normal), offset, edge, float(key.plane.blurred))
        # the first imaginary number that is not zero says which of two conjugates this one is
        table = {alpha: 2 * c if phase else c.real for alpha, c in table.items()}
        groups.append(Group(table, narrow(quadratic), narrow(linear), plane))
    # conjugate terms of a real function cancel at any point
    if (np.abs(np.imag(sum(values))) > 1e-12 * sum(map(np.abs, values))).any():
        raise ValueError("f: wanted real values, got complex coefficients or exponents")
    return Compiled(p, n, tuple(groups), tuple(norms))


def _number(expression: sp.Expr) -> complex:
    """Value of a coefficient."""
    try:
        value = complex(expression)
    except TypeError as error:
        raise ValueError(f"f: wanted numbers as coefficients, got {expression}") from error
    except OverflowError:
        value = complex(np.inf)
    if not np.isfinite(value):
        raise ValueError(f"f: wanted coefficients in the range of float64, got {expression}")
    return value


def _rows(gram: np.ndarray) -> np.ndarray:
    """Rows R with ``R' R = gram``, those of rounding size left out."""
    # any rows will do: only RᵀR is used
    values, vectors = np.linalg.eigh(gram)
    keep = values > 1e-14 * values[-1]
    return (vectors[:, keep] * np.sqrt(values[keep])).T


def narrow(array: np.ndarray) -> np.ndarray | None:
    """None for zeros, real numbers for complex ones without imaginary parts."""
    if not array.any():
        return None
    return array if array.imag.any() else array.real


class FunctionClass(StrEnum):
    """How the Gaussian mean of a function is found."""

    POLYNOMIAL = "polynomial"
    EXPONENTIAL = "exponential-polynomial"
    TILT = "tilt"
    PIECEWISE = "piecewise"
    NORM = "norm"
    MIXED = "mixed"
    NONE = "none"


def classify(f: object, variables: Sequence[sp.Symbol]) -> FunctionClass:
    """Class of a function, which decides how its Gaussian mean and its errors are computed.

    Parameters
    ----------
    f : SymPy expression, list or column Matrix of expressions
        Real function of `variables`.
    variables : sequence of Symbol
        The components of the Gaussian vector.

    Returns
    -------
    FunctionClass
        ``polynomial``; ``exponential-polynomial`` (with exponents affine in the variables, sines
        and cosines included); ``tilt`` (quadratic exponents); ``piecewise`` (polynomials, and one
        switching plane in all components); ``norm`` (a constant multiple of one norm of an affine
        map, plus a constant); ``mixed`` (a sum of several of them, and whatever has an error
        function); ``none`` (no closed form).

    Raises
    ------
    TypeError, ValueError
        Unknown symbols in f, repeated variables, complex or infinite values.
    """
    try:
        return class_of(parse(f, variables))
    except NoClosedForm:
        return FunctionClass.NONE


def class_of(parsed: Parsed) -> FunctionClass:
    """Class of a parsed function."""
    keys: set[Key] = {key for terms in parsed.components for key in terms}
    exponents = {key.exponent for key in keys} - {()}
    planes = {key.plane.boundary for key in keys if key.plane}
    blurred = any(key.plane.blurred for key in keys if key.plane)
    norms = {key for key in keys if key.norm is not None}
    if norms:
        rest = [t for terms in parsed.components for k, t in terms.items() if k not in norms]
        alone = len(parsed.components) == 1 and len(norms) == 1 and not (exponents or planes)
        constant = all(poly.total_degree() <= 0 for poly in rest)
        return FunctionClass.NORM if alone and constant else FunctionClass.MIXED
    if planes:
        plain = not exponents and len(planes) == 1 and not blurred
        return FunctionClass.PIECEWISE if plain else FunctionClass.MIXED
    if any(sum(monomial) == 2 for exponent in exponents for monomial, _ in exponent):
        return FunctionClass.TILT
    return FunctionClass.EXPONENTIAL if exponents else FunctionClass.POLYNOMIAL


@dataclass(frozen=True, eq=False)
class GaussianMean:
    """Vectorised ``(mean, cov) -> E f(x)``; made by `expectation_function`.

    Attributes
    ----------
    kind : FunctionClass
        Class of the function.
    dimension : int
        n.
    scalar : bool
        Whether f is scalar: the result then has no component axis.
    compiled : Compiled
        Its terms in numbers.
    """

    kind: FunctionClass
    dimension: int
    scalar: bool
    compiled: Compiled

    def __call__(self, mean: object, cov: object) -> np.ndarray:
        """Mean of f under N(mean, cov).

        Parameters
        ----------
        mean : array_like (n, ...)
            Batch axes last.
        cov : array_like (n, n) or (n, n, ...)
            Positive semidefinite, one for all or one for each member of the batch.

        Returns
        -------
        ndarray (...) for a scalar f, (p, ...) for a vector
        """
        mean, cov = gaussian_arguments(mean, cov, self.dimension)
        result = in_range("mean, cov", lambda: self.compiled.mean(mean, cov))
        return result[0][()] if self.scalar else result


def expectation_function(f: object, variables: Sequence[sp.Symbol]) -> GaussianMean:
    """NumPy function ``(mean, cov) -> E f(x)``, x ~ N(mean, cov), for batches.

    Polynomials by the Stein-Isserlis recursion; the other terms of the closed class after
    completing the square; norms by a one-dimensional integral of full precision. Singular and
    zero covariances are exact. Results are real.

    Parameters
    ----------
    f : expression, list or column Matrix of expressions
        Real function of `variables`.
    variables : sequence of n Symbols
        Components of x.

    Returns
    -------
    GaussianMean
        Callable ``(mean (n, ...), cov (n, n) or (n, n, ...)) -> (...)`` or ``(p, ...)``.

    Raises
    ------
    NoClosedForm
        A term is outside the class; the message names it.
    TypeError, ValueError
        Unknown symbols in f, repeated variables, complex or infinite values. When called: bad
        means or covariances, or an infinite mean (`ValueError`).
    """
    return _function(*components_of(f), as_symbols("variables", variables))


@lru_cache(maxsize=256)
def _function(expressions: tuple, scalar: bool, variables: tuple) -> GaussianMean:
    parsed = parse(list(expressions), variables)
    return GaussianMean(class_of(parsed), len(variables), scalar, compile_terms(parsed))
