"""Numeric Gaussian means of terms ``polynomial x exp(quadratic) x half-space``, in batches.

Means are arrays (n, *batch), covariances (n, n) or (n, n, *batch). No SymPy here.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.special import erfcx, log_ndtr, ndtr

from seedslib.base.arrays import MaybeArray, align
from seedslib.gaussian.polynomial import (
    Coefficients,
    monomial_means,
    polynomial_mean,
    polynomial_value,
    predecessors,
)

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
