"""Norm, modulus, sine, maximum and elevation of a Gaussian vector; a bivariate probability.

Every formula is arranged as a sum of terms of one sign, so that an error keeps its relative
accuracy when it is many orders of magnitude smaller than the function.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erfcx, ndtr, owens_t

from seedslib.base.arrays import align
from seedslib.base.checks import as_covariance, as_real
from seedslib.base.linalg import cholesky
from seedslib.gaussian.arguments import (
    blockwise,
    estimate_arguments,
    gaussian_arguments,
    variance_argument,
)
from seedslib.gaussian.quadrature import gauss_hermite

ROOT_TWO_PI = np.sqrt(2 * np.pi)
CERTAIN = 100.0  # deviations beyond which no normal probability changes
# Panels on either side of a kink, with breaks in deviations of the estimate and of its error
PANEL, REACH = np.polynomial.legendre.leggauss(18), 9.5
WIDE = np.array([0.0, 2.0, 4.0, 6.5, REACH])
NARROW = np.array([0.0, 1.0, 2.5, 5.0, 9.5, 16.0])


class FunctionMoments(NamedTuple):
    """Mean and variance of a function of a Gaussian vector."""

    mean: np.ndarray
    var: np.ndarray


class MeanSquareErrors(NamedTuple):
    """Mean-square errors of the optimal estimate and of the plug-in estimate."""

    optimal: np.ndarray
    plugin: np.ndarray


@cache
def sinh_rule(step: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes s^2 and weights for ``2 / sqrt(pi) int_0^inf g(s^2) ds``, trapezoidal in arsinh s."""
    v = step * np.arange(round(19.0 / step) + 1)
    weight = step * np.cosh(v)
    weight[0] *= 0.5
    return np.sinh(v) ** 2, weight * 2 / np.sqrt(np.pi)


def norm_mean(mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
    """Mean of the Euclidean norm of x ~ N(mean, cov).

    In the eigenvectors of the covariance, with eigenvalues λ and mean b, the mean is

        2/√π ∫₀^∞ ψ(s²) Σᵢ [λᵢ/(1+2λᵢs²) + bᵢ²/(1+2λᵢs²)²] ds,
        ψ(t) = ∏ᵢ (1+2λᵢt)^(-1/2) exp(-t bᵢ²/(1+2λᵢt)).

    The substitution s = c sinh v makes the integrand analytic and bounded in a strip whose width
    does not depend on the eigenvalues, so 153 nodes of the trapezoidal rule give full precision
    for every covariance, singular ones included. For two and three dimensions and zero mean
    compare equations (2.6) and (3.3) of Choi, Song, Shin (2019).

    Parameters
    ----------
    mean : array_like
        Shape (n, ...), batch axes last.
    cov : array_like
        Positive semidefinite, shape (n, n), or (n, n, ...) with batch axes that broadcast.

    Returns
    -------
    ndarray
        Shape (...); a scalar without batch axes. Relative error about 2e-15.

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, shapes that do not fit, or not a covariance.
    """
    mean, cov = gaussian_arguments(mean, cov)
    batch = np.broadcast_shapes(mean.shape[1:], cov.shape[2:])
    # any basis will do: of equal eigenvalues only the length of the mean in their space counts
    values, vectors = np.linalg.eigh(np.moveaxis(cov, (0, 1), (-2, -1)))
    centre = np.moveaxis(np.swapaxes(vectors, -1, -2) @ np.moveaxis(mean, 0, -1)[..., None], -2, 0)
    # an eigenvalue of minus a rounding counts as zero
    parts = align(np.moveaxis(np.maximum(values, 0.0), -1, 0), 1, len(batch)), centre[..., 0]
    variances, centre = (
        np.broadcast_to(p, (len(mean), *batch)).reshape(len(mean), -1) for p in parts
    )
    (lengths,) = blockwise(
        lambda block: (_norm_mean(variances[:, block], centre[:, block]),),
        variances.shape[1],
        64,  # arrays that stay in the cache
    )
    return lengths.reshape(batch)[()]


def _norm_mean(variances: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Mean norm from eigenvalues and mean in the eigenvectors, both (n, N)."""
    # two units: squares of the first stay in range, the second is the c of the substitution
    largest = np.maximum(np.sqrt(variances.max(axis=0)), np.abs(centre).max(axis=0))
    unit = np.where(largest > 0, largest, 1.0)
    variances, square = (variances / unit) / unit, (centre / unit) ** 2
    scale = np.sqrt(2 * variances.max(axis=0) + square.sum(axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    nodes, weights = sinh_rule(0.125)
    exponent = sums = 0.0
    for λ, bb in zip(variances / scale**2, square / scale**2, strict=True):
        stretch = 1.0 + 2.0 * np.multiply.outer(nodes, λ)
        shrunk = bb / stretch
        exponent = exponent + 0.5 * np.log(stretch) + nodes[:, None] * shrunk
        sums = sums + (λ + shrunk) / stretch
    return largest * scale * (weights @ (np.exp(-exponent) * sums))


def norm_errors(cov: ArrayLike) -> tuple[float, float]:
    """Mean-square errors of two estimates of the length of the estimation error e ~ N(0, cov).

    Both estimates are constants: the optimal one is the mean length, the other the root of the
    trace of the covariance (equation (3.4) of Choi, Song, Shin 2019).

    Parameters
    ----------
    cov : array_like
        Shape (n, n).

    Returns
    -------
    optimal, root_mean_square : float

    Raises
    ------
    TypeError, ValueError
        Not a covariance.
    """
    cov = as_covariance("cov", cov)
    length = norm_mean(np.zeros(cov.shape[0]), cov)
    gap = np.sqrt(np.trace(cov)) - length
    # tr P - z² as a product: no cancellation of squares.
    optimal = gap * (np.sqrt(np.trace(cov)) + length)
    return float(optimal), float(optimal + gap**2)


def ratio(numerator: ArrayLike, denominator: ArrayLike) -> np.ndarray:
    """Quotient; x/0 is infinite, and 0/0 zero."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(numerator == 0, 0.0, np.divide(numerator, denominator))


def abs_moments(mean: ArrayLike, var: ArrayLike, origin: float = 0.0) -> FunctionMoments:
    """Mean and variance of ``|x - origin|`` for x ~ N(mean, var).

    Parameters
    ----------
    mean, var : array_like
        Any shapes that broadcast; the variance may be zero.
    origin : float
        Where the modulus vanishes.

    Returns
    -------
    FunctionMoments
        Arrays of the broadcast shape.

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, or a negative variance.
    """
    distance = np.abs(as_real("mean", mean) - as_real("origin", origin))
    var = variance_argument("var", var)
    root = np.sqrt(var)
    scaled = ratio(distance, root)
    gap = 2 * mean_excess(scaled)
    shrunk = 1.0 - gap * (2 * np.minimum(scaled, 40.0) + gap)
    return FunctionMoments(distance + root * gap, var * shrunk)


def mean_excess(distance: np.ndarray) -> np.ndarray:
    """Mean of ``max(u, 0)`` for ``u ~ N(-distance, 1)``, distance >= 0; positive to underflow."""
    distance = np.minimum(distance, 40.0)
    mills = np.sqrt(np.pi / 2) * erfcx(distance / np.sqrt(2))
    return np.exp(-0.5 * distance * distance) / ROOT_TWO_PI * (1.0 - distance * mills)


def _scalar_arguments(
    mean: ArrayLike, var: ArrayLike, error_var: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    mean = as_real("mean", mean)
    var, error_var = variance_argument("var", var), variance_argument("error_var", error_var)
    mean, var, error_var = np.broadcast_arrays(mean, var, error_var)
    if (error_var > var * (1 + 1e-8)).any():
        where = np.argmax(error_var - var)
        raise ValueError(
            f"error_var: wanted at most the variance, got {error_var.flat[where]:.6g} "
            f"above {var.flat[where]:.6g}"
        )
    return mean, var, np.minimum(error_var, var)


def abs_errors(mean: ArrayLike, var: ArrayLike, error_var: ArrayLike) -> MeanSquareErrors:
    """Exact mean-square errors of the estimates of ``|θ|`` (example 4).

    The paper simulates them. They are one-dimensional means of smooth functions of the estimate,
    and are integrated on either side of the kink to a relative error of about 1e-14.

    Parameters
    ----------
    mean, var : array_like
        Unconditional mean and variance of θ.
    error_var : array_like
        Variance of the error of its estimate, at most `var`.

    Returns
    -------
    MeanSquareErrors

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, a negative variance, or an error variance above the variance.
    """
    mean, var, error_var = _scalar_arguments(mean, var, error_var)
    mean, deviation = np.abs(mean), np.sqrt(var - error_var)
    z, weight = split_rule(mean, deviation, np.sqrt(error_var))
    estimate = mean + deviation * z
    modulus, variance = abs_moments(estimate, error_var)
    bias = modulus - np.abs(estimate)
    optimal = (weight * variance).sum(axis=0)
    return MeanSquareErrors(optimal, optimal + (weight * bias * bias).sum(axis=0))


def sine_moments(mean: ArrayLike, var: ArrayLike) -> FunctionMoments:
    """Mean and variance of ``sin x`` for x ~ N(mean, var) (equation (2.9)).

    Parameters
    ----------
    mean, var : array_like
        Any shapes that broadcast, radians.

    Returns
    -------
    FunctionMoments

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, or a negative variance.
    """
    mean, var = as_real("mean", mean), variance_argument("var", var)
    return FunctionMoments(np.exp(-0.5 * var) * np.sin(mean), sine_errors(mean, var, var).optimal)


def sine_errors(mean: ArrayLike, var: ArrayLike, error_var: ArrayLike) -> MeanSquareErrors:
    """Exact mean-square errors of the estimates of ``sin θ`` (example 3).

    Parameters
    ----------
    mean, var : array_like
        Unconditional mean and variance of θ.
    error_var : array_like
        Variance of the error of its estimate, at most `var`.

    Returns
    -------
    MeanSquareErrors

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, a negative variance, or an error variance above the variance.
    """
    mean, var, error_var = _scalar_arguments(mean, var, error_var)
    rest = 2 * var - error_var
    inner = -np.expm1(-rest) + 2 * np.exp(-rest) * np.cos(mean) ** 2
    optimal = -0.5 * np.expm1(-error_var) * inner
    estimate_var = var - error_var
    square = -0.5 * np.expm1(-2 * estimate_var) + np.exp(-2 * estimate_var) * np.sin(mean) ** 2
    return MeanSquareErrors(optimal, optimal + np.expm1(-0.5 * error_var) ** 2 * square)


def max_moments(mean: ArrayLike, cov: ArrayLike) -> FunctionMoments:
    """Mean and variance of the larger of two correlated Gaussian variables (Clark's formulas).

    Parameters
    ----------
    mean : array_like
        Shape (2, ...).
    cov : array_like
        Shape (2, 2) or (2, 2, ...). Variables with a constant difference are allowed.

    Returns
    -------
    FunctionMoments
        Arrays of shape (...).

    Raises
    ------
    TypeError, ValueError
        Not two components, not real, not finite, or not a covariance.
    """
    mean, cov = gaussian_arguments(mean, cov, 2)
    root, gap = np.sqrt(_gap_variance(cov)), mean[0] - mean[1]
    scaled = np.minimum(np.abs(ratio(gap, root)), 40.0)
    excess = mean_excess(scaled)
    shared = excess * (scaled + excess)
    tail = ndtr(-scaled)
    shares = 1.0 - tail - shared, np.maximum(tail - shared, 0.0)
    weights = np.where(gap >= 0, *shares), np.where(gap >= 0, *shares[::-1])
    # a singular covariance may leave a negative rounding error
    var = weights[0] * cov[0, 0] + weights[1] * cov[1, 1] + 2 * shared * cov[0, 1]
    return FunctionMoments(np.maximum(*mean) + root * excess, np.maximum(var, 0.0))


def max_errors(mean: ArrayLike, cov: ArrayLike, error_cov: ArrayLike) -> MeanSquareErrors:
    """Exact mean-square errors of the estimates of ``max(x₁, x₂)`` (example 2).

    The optimal error is the mean of the conditional variance over the estimate of the difference,
    integrated on either side of the kink.

    Parameters
    ----------
    mean : array_like
        Unconditional mean μ, shape (2,).
    cov, error_cov : array_like
        C and P, shape (2, 2), P not above C.

    Returns
    -------
    MeanSquareErrors

    Raises
    ------
    TypeError, ValueError
        Not two components, not real, not finite, not covariances, or P above C.
    """
    mean, cov, error_cov = estimate_arguments(mean, cov, error_cov, 2)
    error_var = _gap_variance(error_cov)
    deviation = np.sqrt(np.maximum(_gap_variance(cov) - error_var, 0.0))
    z, weight = split_rule(mean[0] - mean[1], deviation, np.sqrt(error_var))
    gap = mean[0] - mean[1] + deviation * z
    # the maximum is x₂ plus the positive part of the gap: errors depend on the gap alone
    top, var = max_moments(np.stack([gap, 0.0 * gap]), error_cov)
    optimal, bias = weight @ var, top - np.maximum(gap, 0.0)
    return MeanSquareErrors(optimal, optimal + weight @ bias**2)


def _gap_variance(cov: np.ndarray) -> np.ndarray:
    """Variance of the difference."""
    return np.maximum(cov[0, 0] + cov[1, 1] - 2 * cov[0, 1], 0.0)


def split_rule(mean: np.ndarray, deviation: np.ndarray, error: np.ndarray) -> tuple:
    """Nodes z and weights (S, ...) for ``mean + deviation z``, z normal, split where that is zero.

    They are graded on the scale of the estimate and, about the kink, on that of its error.
    """
    safe = np.where(deviation > 0, deviation, 1.0)
    kink, narrow = -mean / safe, error / safe
    steps = np.concatenate([-NARROW[::-1], NARROW])
    edges = [*(w + 0 * kink for w in (*-WIDE, *WIDE)), *(kink + s * narrow for s in steps)]
    edges = np.sort(np.clip(np.stack(edges), -REACH, REACH), axis=0)
    half = 0.5 * np.diff(edges, axis=0)
    nodes = PANEL[0].reshape(-1, 1, *[1] * np.ndim(kink))
    weights = PANEL[1].reshape(nodes.shape)
    z = (edges[:-1] + half * (1.0 + nodes)).reshape(-1, *np.shape(kink))
    weights = (half * weights).reshape(z.shape) * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    return z, weights


def bivariate_normal_cdf(h: ArrayLike, k: ArrayLike, rho: ArrayLike) -> np.ndarray:
    """Probability that X <= h and Y <= k for standard normals with correlation rho.

    By Owen's function T; absolute error below 1e-15. Infinite limits and ``rho = ±1`` are allowed.

    Parameters
    ----------
    h, k, rho : array_like
        Broadcast together; ``-1 <= rho <= 1``.

    Returns
    -------
    ndarray
        The broadcast shape; a scalar for scalars.

    Raises
    ------
    TypeError, ValueError
        Not real, NaN, or a correlation outside [-1, 1].
    """
    h, k = as_real("h", h, infinite=True), as_real("k", k, infinite=True)
    h, k, rho = np.broadcast_arrays(h, k, _correlation(rho))
    h, k = np.clip(h, -CERTAIN, CERTAIN), np.clip(k, -CERTAIN, CERTAIN)
    value = 0.5 * (ndtr(h) + ndtr(k)) - _owen(h, k, rho) - _owen(k, h, rho)
    value -= 0.5 * ((np.minimum(h, k) < 0) & (np.maximum(h, k) >= 0))
    value = np.where((h == 0) & (k == 0), 0.25 + np.arcsin(rho) / (2 * np.pi), value)
    return np.clip(value, 0.0, 1.0)[()]


def _owen(h: np.ndarray, k: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Owen's ``T(h, (k - rho h) / (h sqrt(1 - rho^2)))`` and its limits."""
    # near one of the ends k - rho h cancels, but what it is made of is exact
    end = np.copysign(1.0, rho)
    gap = np.where(np.abs(rho) > 0.99, (k - end * h) + (end - rho) * h, k - rho * h)
    slope = ratio(gap, h * np.sqrt((1.0 - rho) * (1.0 + rho)))
    return owens_t(h, np.where(h == 0, np.copysign(np.inf, k), slope))


def _correlation(rho: ArrayLike) -> np.ndarray:
    rho = as_real("rho", rho)
    if (np.abs(rho) > 1).any():
        raise ValueError(f"rho: wanted a correlation in [-1, 1], got {rho[np.abs(rho) > 1][0]:g}")
    return rho


def elevation_moments(mean: ArrayLike, cov: ArrayLike) -> FunctionMoments:
    """Mean and variance of ``arctan(x₃ / √(x₁² + x₂²))`` for x ~ N(mean, cov), in radians.

    A vector that stays at least eight standard deviations from the vertical axis is integrated by a
    tensor Gauss-Hermite rule; a wider one over the sphere against the density of the direction,
    by Gauss-Legendre in elevation and the trapezoidal rule in azimuth.

    Parameters
    ----------
    mean : array_like
        Shape (3, ...), batch axes last.
    cov : array_like
        Shape (3, 3). It may be singular if the vector stays away from the vertical axis, or zero.

    Returns
    -------
    FunctionMoments
        Arrays of shape (...).

    Raises
    ------
    TypeError, ValueError
        Not three components, not real, not finite, not a covariance; the origin as a certain
        place; or the vector comes near the vertical axis and its covariance is singular or so
        ill-conditioned that the density of the direction does not integrate to one within 1e-9.
    """
    mean, cov = gaussian_arguments(mean, cov)
    if mean.shape[0] != 3 or cov.ndim != 2:
        raise ValueError(
            f"mean, cov: wanted shapes (3, ...) and (3, 3), got {mean.shape} and {cov.shape}"
        )
    points = mean.reshape(3, -1)
    deviation = np.sqrt(max(np.linalg.eigvalsh(cov[:2, :2])[-1], 0.0))
    far = np.hypot(points[0], points[1]) >= 8.0 * deviation
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
    offsets = cholesky(cov) @ rule.points
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
            "cov: wanted a nonsingular covariance where the vector comes near the vertical axis, "
            f"got eigenvalues {values[0]:.3g} to {values[-1]:.3g}"
        )
    # the angle does not depend on the unit of length
    unit = np.sqrt(values[-1])
    mean, white = mean / unit, vectors / (np.sqrt(values) / unit)
    for count in (100, 200, 400):
        angle, weight = _sphere(mean, white, count)
        mass = weight.sum()
        if abs(mass - 1) <= 1e-9:
            centre = (weight * angle).sum() / mass
            return np.array([centre, (weight * (angle - centre) ** 2).sum() / mass])
    raise ValueError(
        "cov: the density of the direction integrates to "
        f"{mass:.12g} instead of 1; it is too narrow near the vertical axis"
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
    # behind the origin, D < 0, the terms cancel, but to an error that is small beside those ahead
    radial = ROOT_TWO_PI * (1 + along**2) * ndtr(along) + along * np.exp(-0.5 * along**2)
    scale = abs(np.linalg.det(white)) / ((2 * np.pi) ** 1.5)
    density = scale * np.exp(-0.5 * across) * np.maximum(radial, 0.0) / length**3
    return np.broadcast_to(angle, density.shape), weight * density


def _band(mean: np.ndarray, white: np.ndarray) -> tuple[float, float]:
    """Elevations between which the direction lies but for a probability of about 1e-22."""
    widest = 1.0 / np.linalg.svd(white, compute_uv=False)[-1]
    size = np.linalg.norm(mean)
    if size <= 10.0 * widest:
        return -0.5 * np.pi, 0.5 * np.pi
    reach = np.arcsin(10.0 * widest / size)
    centre = _angle(mean)
    return max(centre - reach, -0.5 * np.pi), min(centre + reach, 0.5 * np.pi)
