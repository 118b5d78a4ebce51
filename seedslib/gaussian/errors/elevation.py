"""Mean and variance of the elevation angle of a Gaussian vector in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erfcx

from seedslib.base.semidefinite import square_root
from seedslib.gaussian.arguments import gaussian_arguments
from seedslib.gaussian.errors.functions import FunctionMoments
from seedslib.gaussian.quadrature import gauss_hermite

CONCENTRATED = 8.0
REACH = 10.0
MASS_ERROR = 1e-9
REFINEMENTS = (100, 200, 400)


def elevation_moments(mean: ArrayLike, cov: ArrayLike) -> FunctionMoments:
    """Mean and variance of ``arctan(x₃ / √(x₁² + x₂²))`` for x ~ N(mean, cov), in radians.

    A law that stays at least eight standard deviations from the vertical axis is integrated by a
    tensor Gauss-Hermite rule; a wider one over the sphere against the density of the direction,
    by Gauss-Legendre in elevation and the trapezoidal rule in azimuth.

    Parameters
    ----------
    mean : array_like
        Shape (3, ...), batch axes last.
    cov : array_like
        Shape (3, 3). It may be singular if the law stays away from the vertical axis, or zero.

    Returns
    -------
    FunctionMoments
        Arrays of shape (...).

    Raises
    ------
    TypeError, ValueError
        Not three components, not real, not finite, not a covariance; the mean lies on the origin
        of a law without spread; or the law comes near the vertical axis and its covariance is
        singular or so ill-conditioned that the density of the direction does not integrate to
        one within 1e-9.
    """
    mean, cov = gaussian_arguments(mean, cov)
    if mean.shape[0] != 3 or cov.ndim != 2:
        raise ValueError(
            f"mean, cov: wanted shapes (3, ...) and (3, 3), got {mean.shape} and {cov.shape}"
        )
    points = mean.reshape(3, -1)
    spread = np.sqrt(max(np.linalg.eigvalsh(cov[:2, :2])[-1], 0.0))
    distance = np.hypot(points[0], points[1])
    far = distance >= CONCENTRATED * spread
    values = np.empty((2, points.shape[1]))
    values[:, far] = _concentrated(points[:, far], cov)
    for k in np.flatnonzero(~far):
        values[:, k] = _wide(points[:, k], cov)
    shape = mean.shape[1:]
    return FunctionMoments(values[0].reshape(shape)[()], values[1].reshape(shape)[()])


def _angle(x: np.ndarray) -> np.ndarray:
    return np.arctan2(x[2], np.hypot(x[0], x[1]))


def _concentrated(mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Moments (2, N) by 20³ Gauss-Hermite points about each mean (3, N)."""
    if (np.abs(mean).max(axis=0) == 0).any():
        raise ValueError("mean: the elevation of the origin is not defined")
    rule = gauss_hermite(3, 20)
    offsets = square_root(cov) @ rule.points
    moments = np.empty((2, mean.shape[1]))
    for k, centre in enumerate(mean.T):
        base = _angle(centre)
        turn = _angle(centre[:, None] + offsets) - base
        shift = rule.weights @ turn
        moments[:, k] = base + shift, rule.weights @ (turn - shift) ** 2
    return moments


def _wide(mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    # any whitening basis will do: below only lengths and products of whitened vectors are used
    values, vectors = np.linalg.eigh(cov)
    if values[0] <= 1e-14 * values[-1]:
        raise ValueError(
            "cov: wanted a nonsingular covariance for a law that comes near the vertical axis, "
            f"got eigenvalues {values[0]:.3g} to {values[-1]:.3g}"
        )
    # the angle does not depend on the unit of length
    unit = np.sqrt(values[-1])
    mean, white = mean / unit, vectors / (np.sqrt(values) / unit)
    for count in REFINEMENTS:
        angle, weight = _sphere(mean, white, count)
        mass = weight.sum()
        if abs(mass - 1) <= MASS_ERROR:
            centre = (weight * angle).sum() / mass
            return np.array([centre, (weight * (angle - centre) ** 2).sum() / mass])
    raise ValueError(
        "cov: the density of the direction integrates to "
        f"{mass:.12g} instead of 1; the law is too narrow near the vertical axis"
    )


def _sphere(mean: np.ndarray, white: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Elevations of the nodes and their probabilities; `white` whitens: cov⁻¹ = white whiteᵀ."""
    low, high = _band(mean, white)
    nodes, weights = np.polynomial.legendre.leggauss(count)
    angle = 0.5 * (low + high) + 0.5 * (high - low) * nodes
    azimuth = 2 * np.pi * np.arange(count) / count
    weight = 0.5 * (high - low) * weights * np.cos(angle) * 2 * np.pi / count
    level = np.broadcast_to(np.sin(angle), (count, count))
    direction = np.stack(
        [np.outer(np.cos(azimuth), np.cos(angle)), np.outer(np.sin(azimuth), np.cos(angle)), level]
    )
    turned = np.einsum("ji,jab->iab", white, direction)
    length = np.sqrt(np.square(turned).sum(axis=0))
    centre = white.T @ mean
    along = np.einsum("i,iab->ab", centre, turned) / length
    # c - D² is the squared distance of the mean from the ray's line: never negative.
    across = np.square(centre[:, None, None] - along * turned / length).sum(axis=0)
    root = np.sqrt(np.pi / 2)
    # sqrt(2π) Φ(D) exp(D²/2) = sqrt(π/2) erfcx(-D/√2): for D > 0 the Gaussian factor is split off.
    tail = root * erfcx(np.abs(along) / np.sqrt(2))
    gauss = np.exp(-0.5 * np.square(along))
    behind = gauss * ((1 + along**2) * tail + along)
    ahead = np.sqrt(2 * np.pi) * (1 + along**2) - gauss * ((1 + along**2) * tail - along)
    radial = np.where(along < 0, np.maximum(behind, 0.0), ahead)
    scale = abs(np.linalg.det(white)) / ((2 * np.pi) ** 1.5)
    density = scale * np.exp(-0.5 * across) * radial / length**3
    return np.broadcast_to(angle, density.shape), weight * density


def _band(mean: np.ndarray, white: np.ndarray) -> tuple[float, float]:
    """Elevations between which the direction lies but for a probability of about 1e-22."""
    widest = 1.0 / np.linalg.svd(white, compute_uv=False)[-1]
    size = np.linalg.norm(mean)
    if size <= REACH * widest:
        return -0.5 * np.pi, 0.5 * np.pi
    reach = np.arcsin(REACH * widest / size)
    centre = _angle(mean)
    return max(centre - reach, -0.5 * np.pi), min(centre + reach, 0.5 * np.pi)
