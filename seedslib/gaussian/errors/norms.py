"""Exact mean-square errors of the estimates of a norm, in any dimension.

``|y| = (2 / sqrt(pi)) int_0^inf |y|^2 exp(-s^2 |y|^2) ds`` makes the mean product of the norms of
two correlated Gaussian vectors a double integral of Gaussian tilts. With ``s = c sinh v`` in both
variables the integrand is analytic and bounded in a strip that does not depend on the
covariances, so the trapezoidal rule converges geometrically for all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_covariance
from seedslib.base.semidefinite import square_root
from seedslib.gaussian.arguments import align
from seedslib.gaussian.errors.hermite import quadrature_expansion
from seedslib.gaussian.errors.joint import joint_factor
from seedslib.gaussian.means.norm import norm_mean
from seedslib.gaussian.quadrature import fifth_degree, rule_of_rank

STEP = 0.14
REACH = 19.0
BLOCK = 4096
# up to this rank: standard deviations from the origin beyond which a rule of so many nodes along
# each direction is more accurate than the difference of second moments
SMOOTH = ((3, 10.0, 24), (6, 100.0, 7), (7, 1e3, 5), (12, 1e4, 3), (np.inf, np.inf, 1))
DEGREE = 16
ROUNDING = 1e-15
ALMOST_LINEAR = 1e-6


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


def estimate_errors(
    mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
) -> tuple[float, float]:
    """Optimal and plug-in mean-square error of the estimates of ``|y|``.

    Where the law stays ten standard deviations away from the origin (more in over three dimensions)
    the norm is smooth, and its Hermite expansion gives the error as a sum of squares; elsewhere the
    error is the difference of second moments, accurate to about 1e-15 of ``E |y|^2``.
    """
    factor, shares = joint_factor(cov, error_cov)
    if factor.shape[1] == 0:
        return 0.0, 0.0
    known = (factor * (1.0 - shares)) @ factor.T
    deviation = np.sqrt(np.linalg.eigvalsh(cov)[-1])
    far, nodes = next(rule[1:] for rule in SMOOTH if factor.shape[1] <= rule[0])
    if np.linalg.norm(mean) >= far * deviation:
        expansion = quadrature_expansion(
            lambda step: _lengthening(mean[:, None], step),
            np.zeros_like(mean),
            cov,
            error_cov,
            degree=min(DEGREE, nodes - 1),
            nodes=nodes,
        )
        optimal = float(expansion.lower()[0, 0])
        points, weights = _rule(mean, known, nodes)
        excess = norm_mean(points, error_cov) - np.linalg.norm(points, axis=0)
        return optimal, optimal + float(weights @ excess**2)
    second = float(np.trace(cov) + mean @ mean)
    estimate = norm_product((mean, mean), (cov, cov), known)
    mixed = norm_product((mean, mean), (cov, known), known)
    plugin = second - 2 * mixed + float(np.trace(known) + mean @ mean)
    optimal = max(second - estimate, 0.0)
    return optimal, max(plugin, optimal)


def norm_variance(mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Variance of ``|y|``, shape (*batch), for y ~ N(mean, cov), mean (n, *batch).

    ``E |y|^2 - (E |y|)^2`` or, a thousand standard deviations from the origin, the variance of
    ``|y| - |mean|`` by a rule of the fifth degree: the norm is then almost linear.
    """
    square = np.square(mean).sum(axis=0)
    width = np.einsum("ii...->...", cov)
    variance = np.maximum(width + square - norm_mean(mean, cov) ** 2, 0.0)
    narrow = np.broadcast_to(width < ALMOST_LINEAR * square, variance.shape)
    if not narrow.any():
        return variance
    batch = mean.shape[1:]
    centre = mean[:, narrow]
    part = np.broadcast_to(align(cov, 2, len(batch)), (*cov.shape[:2], *batch))[..., narrow]
    root = square_root(np.moveaxis(part, -1, 0))
    rule = fifth_degree(len(mean))
    gap = _lengthening(centre[..., None], np.einsum("kij,jq->ikq", root, rule.points))
    weights = rule.weights
    average = gap @ weights
    refined = np.array(variance)
    refined[narrow] = np.square(gap - average[:, None]) @ weights
    return refined


def _lengthening(mean: np.ndarray, step: np.ndarray) -> np.ndarray:
    """``|mean + step| - |mean|`` along the first axis, without a subtraction of lengths."""
    gap = (2 * mean * step + step**2).sum(axis=0)
    return gap / (np.linalg.norm(mean + step, axis=0) + np.linalg.norm(mean, axis=0))


def _rule(mean: np.ndarray, cov: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Hermite rule of N(mean, cov), points (n, N)."""
    root = square_root(cov)
    root = root[:, np.abs(root).max(axis=0) > 0]
    grid, weights = rule_of_rank(root.shape[1], nodes)
    return mean[:, None] + root @ grid, weights


def norm_product(
    means: tuple[np.ndarray, np.ndarray], covs: tuple[np.ndarray, np.ndarray], cross: np.ndarray
) -> float:
    """``E |y| |y'|`` for jointly Gaussian y, y' of shape (n,).

    Parameters
    ----------
    means, covs : pairs of ndarray (n,) and (n, n)
        Laws of y and y'.
    cross : ndarray (n, n)
        cov(y, y').
    """
    scales = [
        np.sqrt(2 * np.linalg.eigvalsh(c)[-1] + m @ m) for m, c in zip(means, covs, strict=True)
    ]
    if min(scales) == 0.0:
        return 0.0
    v = STEP * np.arange(round(REACH / STEP) + 1)
    weight = (2 / np.sqrt(np.pi)) * STEP * np.cosh(v)
    weight[0] *= 0.5
    # lengths in units of the scales; the two tilts are then sinh^2 of the two nodes
    n = means[0].size
    mean = np.concatenate([means[0] / scales[0], means[1] / scales[1]])
    cov = np.block(
        [
            [covs[0] / scales[0] ** 2, cross / (scales[0] * scales[1])],
            [cross.T / (scales[0] * scales[1]), covs[1] / scales[1] ** 2],
        ]
    )
    tilt = np.sinh(v) ** 2
    first, second = (grid.ravel() for grid in np.meshgrid(tilt, tilt, indexing="ij"))
    total = 0.0
    weights = np.outer(weight, weight).ravel()
    for start in range(0, weights.size, BLOCK):
        block = slice(start, start + BLOCK)
        total += weights[block] @ _tilted_squares(mean, cov, first[block], second[block], n)
    return float(scales[0] * scales[1] * total)


def _tilted_squares(
    mean: np.ndarray, cov: np.ndarray, first: np.ndarray, second: np.ndarray, n: int
) -> np.ndarray:
    """``E |y|^2 |y'|^2 exp(-a |y|^2 - b |y'|^2)`` for arrays a, b of shape (N,)."""
    weight = 2 * np.repeat(np.stack([first, second], axis=1), n, axis=1)
    # K = I + P M with M = diag(weight); symmetrised by the root of M it is I + R P R
    root = np.sqrt(weight)
    kernel = root[:, :, None] * cov * root[:, None, :]
    # singular laws need the rounding of the product covered; where it exceeds one (huge tilts)
    # the integrand is below the rounding of the total
    kernel += (1.0 + ROUNDING * weight.max(axis=1))[:, None, None] * np.eye(2 * n)
    lower = np.linalg.cholesky(kernel)
    scaled = root * mean
    half = np.linalg.solve(lower, np.concatenate([scaled[..., None], root[:, :, None] * cov], -1))
    log_mass = -0.5 * np.square(half[..., 0]).sum(1) - np.log(
        np.diagonal(lower, axis1=1, axis2=2)
    ).sum(1)
    new_cov = cov - np.swapaxes(half[..., 1:], 1, 2) @ half[..., 1:]
    new_mean = mean - np.einsum("kij,ki->kj", half[..., 1:], half[..., 0])
    a, b = new_mean[:, :n], new_mean[:, n:]
    block = new_cov[:, :n, n:]
    own = [
        np.einsum("kii->k", new_cov[:, s, s]) + np.square(m).sum(1)
        for s, m in ((slice(n), a), (slice(n, None), b))
    ]
    # E |y|^2 |y'|^2 = E|y|^2 E|y'|^2 + 2 tr(XX') + 4 a'Xb
    joint = 2 * np.square(block).sum((1, 2)) + 4 * np.einsum("ki,kij,kj->k", a, block, b)
    return np.exp(log_mass) * (own[0] * own[1] + joint)
