"""The one-dimensional rule under both the interval and the polygon: few nodes around a peak."""

from __future__ import annotations

from functools import cache

import numpy as np

_NATS = 40.0  # what lies more than this below the peak of the density is left out
# Nodes that give full accuracy while width * (peak + width / 2) stays below the limit. The widest
# window, 18 standard deviations around the peak, needs all 48.
_RULES = ((16, 8.0), (24, 30.0), (48, np.inf))
_HALF_LOG_TWO_PI = 0.5 * np.log(2.0 * np.pi)
_POINTS = 200_000  # evaluations at a time: they stay in the cache


@cache
def unit_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on (0, 1), *relatively* accurate near both ends.

    `numpy.polynomial.legendre.leggauss` knows a node near -1 to an absolute 1e-16 only, which
    spoils means that sit close to an end of the interval. Here Newton's iteration runs in the
    distance from the end, with the Legendre recurrence written in differences.

    Parameters
    ----------
    count : int
        Number of nodes, even.

    Returns
    -------
    nodes, weights : ndarray, shape (count,)
        Nodes in increasing order; the weights sum to one.
    """
    half = count // 2
    distance = 2.0 * np.sin(np.pi * (np.arange(half) + 0.75) / (2.0 * count + 1.0)) ** 2
    slope = np.ones(half)
    for _ in range(6):
        value, step = np.ones(half), np.zeros(half)
        for k in range(count):
            below = value
            step = (k * step - (2 * k + 1) * distance * value) / (k + 1)
            value = value + step
        # (1 - x^2) P_n' = n (P_{n-1} - x P_n), and 1 - x^2 = d (2 - d)
        slope = count * (below - (1.0 - distance) * value) / (distance * (2.0 - distance))
        distance = distance + value / slope
    weights = 1.0 / (distance * (2.0 - distance) * slope**2)
    nodes = 0.5 * distance
    nodes = np.concatenate([nodes, 1.0 - nodes[::-1]])
    weights = np.concatenate([weights, weights[::-1]])
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights


def peak_rule(
    peak: np.ndarray, left: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Integral, mean and central variance of ``exp(-t (t + 2 peak) / 2)`` over an interval.

    This is the standard normal density at ``peak + t`` relative to its value at ``peak``. The
    interval is ``left <= t <= left + width`` with ``left <= 0``; ``peak >= 0`` is the point of
    the interval nearest to the origin, so that either ``peak = 0`` or ``left = 0``. The sums
    have positive terms only: no cancellation, whatever the interval.

    Parameters
    ----------
    peak, left, width : ndarray, shape (N,)

    Returns
    -------
    integral, mean, variance : ndarray, shape (N,)
        Mean and variance of the offset t.
    """
    demand = width * (peak + 0.5 * width)
    out = np.full((3, width.size), np.nan)
    least = -np.inf
    for count, limit in _RULES:
        chosen = np.flatnonzero((demand >= least) & (demand < limit))
        least = limit
        for start in range(0, chosen.size, _POINTS // count):
            part = chosen[start : start + _POINTS // count]
            out[:, part] = _fixed_rule(peak[part], left[part], width[part], count)
    return out[0], out[1], out[2]


def _fixed_rule(
    peak: np.ndarray, left: np.ndarray, width: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    nodes, weights = unit_nodes(count)
    t = nodes[:, None] * width + left
    density = np.exp(t * (t + 2.0 * peak) * -0.5)
    density *= weights[:, None]
    total = density.sum(axis=0)
    density /= total
    mean = np.einsum("ij,ij->j", density, t)
    t -= mean
    np.square(t, out=t)
    variance = np.einsum("ij,ij->j", density, t)
    return total * width, mean, variance


def reach_of(peak: np.ndarray) -> np.ndarray:
    """Distance beyond `peak` >= 0 at which the normal density has fallen by 40 nats."""
    # sqrt(peak^2 + 2 nats) - peak without the cancellation
    return 2.0 * _NATS / (peak + np.hypot(peak, np.sqrt(2.0 * _NATS)))


def flat_interval(
    mean: np.ndarray, var: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Logarithm of the mass, mean and variance of scalar laws over intervals, all of shape (N,).

    See `interval`, which checks and broadcasts its arguments.
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        below, above = lower - mean, upper - mean
        # mirror so that the point nearest to the mean is interior or the left end
        mirrored = above <= 0.0
        near, far = np.where(mirrored, -above, below), np.where(mirrored, -below, above)
        end, sign = np.where(mirrored, upper, lower), np.where(mirrored, -1.0, 1.0)
        sigma = np.sqrt(var)
        tail = near >= 0.0
        distance = np.where(tail, near, 0.0)
        peak = distance / sigma
        decay = distance * (distance / var)
        reach = reach_of(peak)
        left = np.where(tail, 0.0, np.maximum(near / sigma, -reach))
        right = np.where(tail, (upper - lower) / sigma, far / sigma)
        width = np.minimum(right, reach) - left
        alive = (var > 0.0) & (lower < upper) & (decay < np.inf) & (width > 0.0)
    # harmless numbers stand in for the intervals of no mass
    peak, left, decay = (np.where(alive, item, 0.0) for item in (peak, left, decay))
    total, offset, spread = peak_rule(peak, left, np.where(alive, width, 1.0))
    log_mass = np.minimum(np.log(total) - _HALF_LOG_TWO_PI - 0.5 * decay, 0.0)
    anchor = np.where(alive & tail, end, mean)
    point = (var == 0.0) & (lower <= mean) & (mean < upper)
    log_mass = np.where(alive, log_mass, np.where(point, 0.0, -np.inf))
    conditioned = np.where(alive, anchor + sign * (sigma * offset), np.where(point, mean, np.nan))
    variance = np.where(alive, var * spread, np.where(point, 0.0, np.nan))
    return log_mass, conditioned, variance
