"""Moments of a scalar Gaussian law over an interval, accurate in tails and narrow intervals.

Under both the interval and the polygon lies a rule of few nodes around the peak of the density.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erfc

from seedslib.base.checks import as_real
from seedslib.gaussian.arguments import blockwise, variance_argument
from seedslib.gaussian.regions import RegionMoments

_NATS = 40.0  # what lies more than this below the peak of the density is left out
# Nodes that give full accuracy while the density falls over the interval by less than the limit,
# in nats. Beyond the last but one the formula of an interval takes over near the mean.
_RULES = ((6, 0.05), (10, 1.0), (16, 10.0), (32, np.inf))
_WIDE, _NEAR = 10.0, 1.5  # nats and deviations: there the formula cancels no more than two digits
_HALF_LOG_TWO_PI = 0.5 * np.log(2.0 * np.pi)
_POINTS = 12_000  # evaluations at a time: small arrays are reused and not fetched anew
_BLOCK = 16384  # intervals at a time


def interval(
    mean: ArrayLike, var: ArrayLike, lower: ArrayLike, upper: ArrayLike, about: ArrayLike = 0.0
) -> RegionMoments:
    """Mass, mean and variance of a scalar Gaussian law over the interval (lower, upper).

    The literal formulas (Kolessa, lemma 2) subtract nearly equal numbers in tails and narrow
    intervals; here positive sums around the peak of the density are taken instead. Errors, in
    tails down to ``ln P = -1e8``, in intervals of any width: ``ln P`` to 1e-15 ``max(1, |ln P|)``,
    mean to 2e-14 standard deviations of the conditioned law (or to the last bits of the number
    itself), variance to 2e-14 relative.

    Parameters
    ----------
    mean, var : array_like
        Mean and variance of the law; ``var = 0`` (a point) is legal.
    lower, upper : array_like
        Ends of the interval, ``lower <= upper``; infinite ends are legal. The interval is
        half-open, ``lower <= x < upper``, which matters only where ``var = 0``.
    about : array_like
        Reference point of the second moment `RegionMoments.second`.

    All arguments are broadcast against each other.

    Returns
    -------
    RegionMoments
        Arrays of the broadcast shape. An interval of zero mass has ``log_mass = -inf`` and NaN
        mean and variance.

    Raises
    ------
    TypeError
        An argument is not made of real numbers.
    ValueError
        A NaN, an infinite `mean`, `var` or `about`, a negative `var`, ``lower > upper``, or
        shapes that do not broadcast.
    """
    mean, var = as_real("mean", mean), variance_argument("var", var)
    lower, upper = as_real("lower", lower, infinite=True), as_real("upper", upper, infinite=True)
    try:
        flat = np.broadcast_arrays(mean, var, lower, upper)
    except ValueError as error:
        raise ValueError(
            "mean, var, lower, upper: wanted shapes that broadcast, got "
            f"{mean.shape}, {var.shape}, {lower.shape}, {upper.shape}"
        ) from error
    if (lower > upper).any():
        raise ValueError("lower: wanted lower <= upper, got an interval with lower > upper")
    shape, flat = flat[0].shape, [item.ravel() for item in flat]
    found = blockwise(
        lambda block: flat_interval(*(item[block] for item in flat)), flat[0].size, _BLOCK
    )
    return RegionMoments(*(part.reshape(shape)[()] for part in found)).referred_to(about)


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
    have positive terms only: no cancellation, whatever the interval; where the literal formulas
    do not cancel either, they are faster.

    Parameters
    ----------
    peak, left, width : ndarray, shape (N,)

    Returns
    -------
    integral, mean, variance : ndarray, shape (N,)
        Mean and variance of the offset t.
    """
    fall = width * (peak + 0.5 * width)
    out = np.empty((3, width.size))
    wide = (fall >= _WIDE) & (peak <= _NEAR)
    rules = np.where(wide, -1, np.searchsorted([limit for _, limit in _RULES[:-1]], fall, "right"))
    chosen = np.flatnonzero(wide)
    out[:, chosen] = _wide_interval(peak[chosen], left[chosen], width[chosen])
    for k, (count, _) in enumerate(_RULES):
        chosen = np.flatnonzero(rules == k)
        for start in range(0, chosen.size, _POINTS // count):
            part = chosen[start : start + _POINTS // count]
            out[:, part] = _fixed_rule(peak[part], left[part], width[part], count)
    return out[0], out[1], out[2]


def _wide_interval(
    peak: np.ndarray, left: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The literal formulas, for intervals near the mean over which the density falls by far."""
    low, high = peak + left, peak + left + width
    total = np.sqrt(0.5 * np.pi) * (erfc(np.sqrt(0.5) * low) - erfc(np.sqrt(0.5) * high))
    total *= np.exp(0.5 * peak * peak)
    at_low = np.exp(-0.5 * left * (left + 2.0 * peak)) / total
    at_high = np.exp(-0.5 * (left + width) * (left + width + 2.0 * peak)) / total
    mean = at_low - at_high
    return total, mean - peak, 1.0 + (low * at_low - high * at_high) - mean * mean


def _fixed_rule(
    peak: np.ndarray, left: np.ndarray, width: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    powers, weights = _powers(count)
    # the exponent is a quadratic in the node, and the moments are sums over the nodes
    terms = np.stack([left * (0.5 * left + peak), width * (left + peak), 0.5 * width * width])
    mass, first, second = weights @ np.exp(-(powers @ terms))
    first, second = first / mass, second / mass
    return mass * width, left + width * first, width * width * (second - first * first)


@cache
def _powers(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Powers 0, 1, 2 of the nodes (count, 3), and the same times the weights (3, count)."""
    nodes, weights = unit_nodes(count)
    powers = nodes[:, None] ** np.arange(3)
    return powers, (weights[:, None] * powers).T.copy()


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
        alive = (var > 0.0) & (decay < np.inf) & (width > 0.0)
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
