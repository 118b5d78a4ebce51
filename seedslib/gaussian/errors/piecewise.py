"""Exact mean-square errors of polynomials switched on one plane.

The conditional variance and the plug-in's excess are averaged over the estimate: across the
plane by composite Gauss-Legendre panels split at the kink and graded at the scales of the
estimate and of its error, along the plane, where both are polynomials, by a Gauss-Hermite rule
that is exact.
"""

from __future__ import annotations

import numpy as np
from scipy.special import roots_legendre

from seedslib.base.semidefinite import square_root
from seedslib.gaussian.errors.centred import CentredMoments
from seedslib.gaussian.errors.joint import joint_factor
from seedslib.gaussian.quadrature import rule_of_rank

# breakpoints in standard deviations of the estimate and of its error
ESTIMATE_SCALE = np.array([0.0, 2.0, 4.0, 6.5, 9.0, 12.0, 20.0, 38.0])
ERROR_SCALE = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 40.0])
PANEL_NODES = 24
LARGEST_RULE = 200_000
NEGLIGIBLE = 4e-16


def piecewise_errors(
    moments: CentredMoments, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Optimal and plug-in error matrices (p, p) of a switched polynomial.

    Raises
    ------
    ValueError
        The rule along the plane needs too many points (high degree in many dimensions).
    """
    plane = moments.function.plane
    factor, shares = joint_factor(cov, error_cov)
    known = (factor * (1.0 - shares)) @ factor.T
    direction = known @ plane.normal
    spread = plane.normal @ direction
    total = plane.normal @ cov @ plane.normal
    location = plane.normal @ mean + plane.offset
    if spread <= NEGLIGIBLE * total:
        across, weights = np.zeros(1), np.ones(1)
        gain, residual = np.zeros_like(direction), known
    else:
        error = np.sqrt(max(plane.normal @ error_cov @ plane.normal, 0.0))
        across, weights = _panels(location, np.sqrt(spread), error)
        gain = direction / spread
        residual = known - np.outer(gain, direction)
    along, along_weights = _exact_rule(moments, residual)
    points = mean[:, None, None] + gain[:, None, None] * across[:, None] + along[:, None, :]
    weights = weights[:, None] * along_weights
    variance, excess = moments.moments(points, error_cov)
    optimal = np.tensordot(variance, weights, axes=2)
    gap = np.tensordot(excess[:, None] * excess[None], weights, axes=2)
    return optimal, optimal + gap


def _panels(centre: float, deviation: float, error: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of ``u - centre`` and weights for the mean of a function of u ~ N(centre, deviation^2).

    Distances from the centre keep their digits however far it lies from the kink at zero.
    """
    reach = deviation * ESTIMATE_SCALE
    kink = np.concatenate([-error * ERROR_SCALE, error * ERROR_SCALE]) - centre
    breaks = np.unique(np.clip(np.concatenate([-reach, reach, kink]), -reach[-1], reach[-1]))
    nodes, weights = roots_legendre(PANEL_NODES)
    half = 0.5 * np.diff(breaks)[:, None]
    points = (breaks[:-1, None] + half + half * nodes).ravel()
    density = np.exp(-0.5 * (points / deviation) ** 2)
    return points, (half * weights).ravel() * density / (deviation * np.sqrt(2 * np.pi))


def _exact_rule(moments: CentredMoments, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Hermite rule along the plane, exact for the squares of the function's degree."""
    degree = max(sum(alpha) for alpha in moments.indices)
    root = square_root(residual)
    scale = np.abs(root).max(axis=0)
    root = root[:, scale > 1e-12 * scale.max(initial=0.0)]
    rank = root.shape[1] if degree else 0
    if (degree + 1) ** rank > LARGEST_RULE:
        raise ValueError(
            f"f: wanted at most {LARGEST_RULE} points along the plane, "
            f"got degree {degree} in {rank} directions"
        )
    grid, weights = rule_of_rank(rank, degree + 1)
    return root[:, :rank] @ grid, weights
