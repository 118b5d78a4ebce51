"""Gaussian means in numbers, for batches: polynomials, terms of the closed class, functions.

Polynomials come first, by the Stein-Isserlis recursion: a polynomial map of n variables with p
values is a dictionary ``{alpha: c}`` from multi-indices (tuples of n exponents) to coefficients,
arrays of shape (p,). The recursion uses only sums and products of the components of the mean and of
the covariance, so the same lines serve single numbers, batches (batch axes last), complex shifts of
the mean and SymPy symbols.

Then come terms ``polynomial x exp(quadratic) x half-space``, with means (n, *batch) and covariances
(n, n) or (n, n, *batch), and functions of SymPy that are sums of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from itertools import product
from math import comb, factorial, prod
from typing import Any, NamedTuple

import numpy as np
import sympy as sp
from scipy.special import erfcx, log_ndtr, ndtr

from seedslib.base.arrays import MaybeArray, align
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

Index = tuple[int, ...]
Coefficients = dict[Index, np.ndarray]


class _Step(NamedTuple):
    """``M[target] = x[axis] M[source] + sum_j count_j P[axis, j] M[below_j] (+ boundary)``."""

    target: Index
    axis: int
    source: Index
    below: tuple[tuple[int, int, Index], ...]


def _lowered(index: Index, axis: int) -> Index:
    return (*index[:axis], index[axis] - 1, *index[axis + 1 :])


@lru_cache(maxsize=1024)
def _plan(indices: tuple[Index, ...]) -> tuple[_Step, ...]:
    """Order in which the recursion reaches the wanted monomials, lowest degree first.

    The axis with the smallest positive exponent is lowered: the other monomials then share one
    another's predecessors, and few superfluous ones are visited.
    """
    # which monomials are met depends on the indices alone, and one function is asked for often
    steps: dict[Index, _Step] = {}
    waiting = list(indices)
    while waiting:
        target = waiting.pop()
        if target in steps or not any(target):
            continue
        axis = min((i for i, k in enumerate(target) if k), key=lambda i: target[i])
        source = _lowered(target, axis)
        below = tuple((j, k, _lowered(source, j)) for j, k in enumerate(source) if k)
        steps[target] = _Step(target, axis, source, below)
        waiting += [source, *(lower for _, _, lower in below)]
    return tuple(sorted(steps.values(), key=lambda step: sum(step.target)))


def monomial_means(
    indices: Iterable[Index],
    mean: Sequence[Any],
    cov: Sequence[Any],
    *,
    zeroth: object = 1.0,
    boundary: tuple[Sequence[Any], Mapping[Index, object]] | None = None,
    tidy: Callable[..., Any] = lambda value: value,
) -> dict[Index, object]:
    """E x^alpha for the wanted multi-indices by the Stein-Isserlis recursion.

    ``M_{beta + e_i} = m_i M_beta + sum_j P_ij beta_j M_{beta - e_j}``, ``M_0 = 1``.

    Parameters
    ----------
    indices : iterable of tuple of int
        Multi-indices alpha.
    mean : sequence of n components
        Numbers, arrays of one batch shape, or SymPy expressions; may be complex.
    cov : n by n nested sequence or array (n, n) or (n, n, ...)
        Components of the same kind.
    zeroth : component
        ``M_0``; the mass of a half-space, when the mean is taken over one.
    boundary : (direction, means), optional
        For a mean over a half-space {u > 0}: ``direction[i] = cov(x_i, u)`` and ``means[beta]``
        the boundary values ``E x^beta delta(u)``; the recursion gains ``direction_i means_beta``.
    tidy : callable
        Applied to each mean; ``sympy.expand`` keeps symbolic ones short.

    Returns
    -------
    dict
        From every visited multi-index (the wanted ones and their predecessors) to its mean.
    """
    indices = tuple(indices)
    means: dict[Index, object] = {}
    if indices:
        means[(0,) * len(indices[0])] = zeroth
    for target, axis, source, below in _plan(indices):
        value = mean[axis] * means[source]
        for j, count, lower in below:
            value = value + (count * cov[axis][j]) * means[lower]
        if boundary is not None:
            value = value + boundary[0][axis] * boundary[1][source]
        means[target] = tidy(value)
    return means


def predecessors(indices: Iterable[Index]) -> tuple[Index, ...]:
    """Every multi-index that the recursion for `indices` visits."""
    indices = tuple(indices)
    zero = ((0,) * len(indices[0]),) if indices else ()
    return (*zero, *(step.target for step in _plan(indices)))


def polynomial_mean(
    polynomial: Mapping[Index, np.ndarray], means: Mapping[Index, object], batch: tuple[int, ...]
) -> np.ndarray:
    """Linear combination ``sum_alpha c_alpha M_alpha``, shape (p, *batch)."""
    size = len(next(iter(polynomial.values())))
    kind = np.result_type(*polynomial.values(), *(means[alpha] for alpha in polynomial))
    total = np.zeros((size, *batch), dtype=kind)
    for alpha, coefficient in polynomial.items():
        # a component has few of the monomials of all
        for row in np.flatnonzero(coefficient):
            total[row] += coefficient[row] * means[alpha]
    return total


def factorial_of(index: Index) -> int:
    """``beta! = prod beta_i!``."""
    return prod(map(factorial, index))


def _splits(indices: Iterable[Index]) -> list[tuple[Index, Index, Index]]:
    """Every alpha with every beta <= alpha and the rest, alpha - beta."""
    return [
        (alpha, beta, tuple(a - b for a, b in zip(alpha, beta, strict=True)))
        for alpha in indices
        for beta in product(*(range(k + 1) for k in alpha))
    ]


def mean_derivatives(
    polynomial: Mapping[Index, np.ndarray], mean: np.ndarray, cov: np.ndarray
) -> Coefficients:
    """``E (d/dx)^beta f`` (p, *batch) for every multi-index beta that does not annihilate f."""
    splits = _splits(polynomial)
    rests = dict.fromkeys(rest for *_, rest in splits)
    means = monomial_means(rests, mean, cov, zeroth=np.ones(mean.shape[1:]))
    result: Coefficients = {}
    for alpha, beta, rest in splits:
        weight = factorial_of(alpha) // factorial_of(rest)  # of the derivative of a monomial
        part = np.multiply.outer(weight * polynomial[alpha], means[rest])
        result[beta] = result.get(beta, 0.0) + part
    return result


def smoothing_bias(polynomial: Mapping[Index, np.ndarray], cov: np.ndarray) -> Coefficients:
    """Coefficients of ``E f(x + e) - f(x)``, e ~ N(0, cov), a polynomial in x.

    Nothing is subtracted: it consists of the even moments of e of positive degree.
    """
    splits = [s for s in _splits(polynomial) if any(s[1]) and sum(s[1]) % 2 == 0]
    means = monomial_means({beta: None for _, beta, _ in splits}, np.zeros(len(cov)), cov)
    result: Coefficients = {}
    for alpha, beta, rest in splits:
        weight = prod(map(comb, alpha, beta)) * means[beta]
        result[rest] = result.get(rest, 0.0) + weight * polynomial[alpha]
    return result


def taylor_coefficients(polynomial: Mapping[Index, np.ndarray], point: np.ndarray) -> Coefficients:
    """Coefficients (p, *batch) of a polynomial map in the step from points (n, *batch)."""
    derivatives = mean_derivatives(polynomial, point, np.zeros((len(point),) * 2))
    return {beta: value / factorial_of(beta) for beta, value in derivatives.items()}


def polynomial_value(
    polynomial: Mapping[Index, np.ndarray], point: np.ndarray, size: int
) -> np.ndarray:
    """Values of a polynomial map, shape (p, *batch), at points of shape (n, *batch)."""
    batch = point.shape[1:]
    if not polynomial:
        return np.zeros((size, *batch))
    # the recursion of the means without its covariance is the one of the powers
    powers: dict[Index, object] = {(0,) * len(point): 1.0}
    for step in _plan(tuple(polynomial)):
        powers[step.target] = point[step.axis] * powers[step.source]
    return polynomial_mean(polynomial, powers, batch)


FAR = 1e100  # a switching function this many standard deviations away; its square is finite


class HalfSpace(NamedTuple):
    """``normal . x + offset > 0``; its indicator is `edge` on the boundary.

    `blur` is the deviation of a normal number of its own that moves the boundary.
    """

    normal: np.ndarray
    offset: float
    edge: float
    blur: float = 0.0


class Group(NamedTuple):
    """``factor Re[p(x) exp(-x'Mx/2 + a'x)] 1{half-space}`` with a polynomial p of p values.

    ``quadratic`` is M (n, n) or None, ``linear`` is a (n,) or None; either may be complex.
    """

    polynomial: Coefficients
    quadratic: MaybeArray = None
    linear: MaybeArray = None
    plane: HalfSpace | None = None


def times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Product of matrices (n, m) or (n, m, *batch) and vectors (m, *batch)."""
    if matrix.ndim == 2:
        return np.tensordot(matrix, vector, axes=1)
    return np.einsum("ij...,j...->i...", matrix, vector)


def inner_product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Sum over the first axis of left times right (no conjugation), batch axes last."""
    if left.ndim == 1:
        return np.tensordot(left, right, axes=1)
    return np.einsum("i...,i...->...", left, right)


def group_mean(
    group: Group, mean: np.ndarray, cov: np.ndarray, batch: tuple[int, ...]
) -> np.ndarray:
    """Mean of one group under N(mean, cov), shape (p, *batch), real.

    Raises
    ------
    ValueError
        The mean is infinite: ``I + cov Re(M)`` has an eigenvalue that is not positive.
    """
    # the square is completed: an exponential times a normal density is one again, with a mass
    exponent = None
    if group.quadratic is not None:
        mean, cov, exponent = tilted(group.quadratic, group.linear, mean, cov)
    elif group.linear is not None:
        shift = times(cov, group.linear)
        exponent = inner_product(group.linear, mean) + 0.5 * inner_product(group.linear, shift)
        mean = mean + align(shift, 1, mean.ndim - 1)
    if group.plane is None:
        means = monomial_means(tuple(group.polynomial), mean, cov)
    else:
        means, log_scale = half_space_means(tuple(group.polynomial), group.plane, mean, cov)
        # logarithms are added: a small tail and a large exponential leave the range one by one
        exponent = log_scale if exponent is None else exponent + log_scale
    value = polynomial_mean(group.polynomial, means, batch)
    if exponent is None:
        return value.real
    if not np.iscomplexobj(exponent):
        return (np.exp(exponent) * value).real
    # Re(v exp(r + i t)) in real arithmetic, without the sine or cosine that v does not need
    total = np.zeros(value.shape)
    if value.real.any():
        total += value.real * np.cos(exponent.imag)
    if np.iscomplexobj(value) and value.imag.any():
        total -= value.imag * np.sin(exponent.imag)
    return np.exp(exponent.real) * total


def tilted(
    quadratic: np.ndarray, linear: np.ndarray | None, mean: np.ndarray, cov: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, covariance and log-mass of ``exp(-x'Mx/2 + a'x) N(x; mean, cov)``.

    With ``K = I + P M``: covariance ``K^-1 P``, mean ``K^-1 (m + P a)`` and log-mass
    ``-m' M K^-1 m / 2 + a' K^-1 m + a' K^-1 P a / 2 - log|K| / 2``.
    """
    block, identity = np.moveaxis(cov, (0, 1), (-2, -1)), np.eye(len(quadratic))
    # eigenvalues alone: nothing about them is free
    convergent = np.linalg.eigvals(identity + block @ quadratic.real).real
    if not (convergent > 0).all():
        raise ValueError(
            "the mean of the exponential is infinite: wanted positive eigenvalues of I + P M, "
            f"got {convergent.min():.6g}"
        )
    kernel = identity + block @ quadratic
    inverse = np.moveaxis(np.linalg.inv(kernel), (-2, -1), (0, 1))
    new_cov = np.einsum("ij...,jk...->ik...", inverse, cov)
    new_mean = times(inverse, mean)
    log_mass = -0.5 * inner_product(mean, times(quadratic, new_mean)) - 0.5 * _log_det(kernel)
    if linear is not None:
        shift = times(new_cov, linear)
        log_mass = log_mass + inner_product(linear, new_mean) + 0.5 * inner_product(linear, shift)
        new_mean = new_mean + align(shift, 1, mean.ndim - 1)
    return new_mean, new_cov, log_mass


def _log_det(kernel: np.ndarray) -> np.ndarray:
    """Logarithm of the determinant on the branch that is continuous from the identity.

    For complex M the eigenvalues of K have positive real part where the mean is finite, so the
    arguments of the eigenvalues choose the branch and the LU factors give the digits.
    """
    sign, log_modulus = np.linalg.slogdet(kernel)
    if not np.iscomplexobj(kernel):
        return log_modulus
    turns = np.angle(np.linalg.eigvals(kernel)).sum(axis=-1) - np.angle(sign)
    return log_modulus + 1j * (np.angle(sign) + 2 * np.pi * np.round(turns / (2 * np.pi)))


def half_space_means(
    indices: tuple[Any, ...], plane: HalfSpace, mean: np.ndarray, cov: np.ndarray
) -> tuple[dict[Any, Any], np.ndarray]:
    """``E x^alpha 1{u > 0}``, u = normal . x + offset, for the wanted and visited indices.

    The Stein recursion gains a boundary term ``cov(x_i, u) E x^beta delta(u)``, a polynomial
    mean of x given that it is on the plane. Where u does not vary its indicator is a constant.

    Returns
    -------
    means : dict
        To be multiplied by ``exp(log_scale)``, which keeps the tail from underflowing beside a
        large exponential.
    log_scale : ndarray
    """
    direction = times(cov, plane.normal)
    location = inner_product(plane.normal, mean) + plane.offset
    # a blurred plane is a sharp one in one more dimension, along which nothing else varies
    variance = inner_product(plane.normal, direction) + plane.blur**2
    varies = variance.real > 0
    deviation = np.sqrt(np.where(varies, variance, 1.0))
    ratio = location / deviation
    if not np.iscomplexobj(ratio):
        ratio = np.clip(ratio, -FAR, FAR)
    log_height = -0.5 * ratio * ratio
    # beyond the plane both mass and height are of the size of the density there
    log_scale = np.where(varies & (ratio.real < 0), log_height.real, 0.0)
    fixed = np.where(location.real > 0, 1.0, np.where(location.real < 0, 0.0, plane.edge))
    mass = np.where(varies, _scaled_tail(ratio, log_scale), fixed)
    height = np.exp(log_height - log_scale) / (deviation * np.sqrt(2 * np.pi))
    touched = varies & (height != 0)
    height = np.where(touched, height, 0.0)
    # x given u = 0; far from the plane the boundary mass is zero and its mean is not needed
    gain = direction / (deviation * deviation)
    gain = np.where(varies, gain, 0.0)
    on_mean = mean - align(gain, 1, mean.ndim - 1) * np.where(touched, location, 0.0)
    on_cov = cov - align(gain, 1, direction.ndim - 1)[:, None] * direction[None]
    visited = predecessors(indices)
    on_plane = monomial_means(visited, on_mean, on_cov)
    boundary = (direction, {alpha: height * value for alpha, value in on_plane.items()})
    return monomial_means(indices, mean, cov, zeroth=mass, boundary=boundary), log_scale


def _scaled_tail(ratio: np.ndarray, log_scale: np.ndarray) -> np.ndarray:
    """``Phi(ratio) exp(-log_scale)``, where the scale is the density's on the negative side."""
    if np.iscomplexobj(ratio):
        return np.exp(log_ndtr(ratio) - log_scale)
    negative = np.minimum(ratio, 0.0)
    return np.where(ratio < 0, 0.5 * erfcx(-negative / np.sqrt(2)), ndtr(ratio))


def indicator(plane: HalfSpace, point: np.ndarray) -> np.ndarray:
    """Value of the indicator at points (n, *batch), on average over its blur."""
    u = inner_product(plane.normal, point) + plane.offset
    if plane.blur:  # the mean of the indicator is smooth
        return ndtr(u / plane.blur)
    return np.where(u > 0, 1.0, np.where(u < 0, 0.0, plane.edge))


def group_value(group: Group, point: np.ndarray, size: int) -> np.ndarray:
    """Value (p, *batch) of a group at points (n, *batch)."""
    value = polynomial_value(group.polynomial, point, size)
    exponent = 0.0
    if group.quadratic is not None:
        exponent = -0.5 * inner_product(point, times(group.quadratic, point))
    if group.linear is not None:
        exponent = exponent + inner_product(group.linear, point)
    value = (value * np.exp(exponent)).real
    return value if group.plane is None else value * indicator(group.plane, point)


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
