"""Branches of a scalar state written down by hand, and their density by SciPy."""

import numpy as np
from scipy.stats import norm

from seedslib.piecewise.branches import Branches
from seedslib.piecewise.geometry import IntervalRegions

INF = np.inf


def branches(ends, mean, var, weight, cell=0, slope=1.0, shift=0.0):
    """Branches on intervals and their log-weights; means, variances and weights (B,) or (B, N)."""
    lower, upper = np.array(ends, dtype=float).T
    count = len(lower)
    mean, var, weight = (
        np.reshape(part, (count, -1)).astype(float)
        for part in np.broadcast_arrays(mean, var, weight)
    )
    mass = np.diff(norm.cdf(np.stack([lower, upper])[:, :, None], mean, var**0.5), axis=0)[0]
    with np.errstate(divide="ignore"):
        log_weight = np.log(weight)
    every = np.ones(count)
    found = Branches(
        np.array(cell * every, dtype=int), IntervalRegions(lower, upper),
        (slope * every)[None, None], (shift * every)[None], mean[None], var[None, None],
        log_weight - np.log(mass),
    )  # fmt: skip
    return found, log_weight


def density(found, points, dataset=0):
    """Density of all branches together at some points."""
    regions, total = found.regions, np.zeros(len(points))
    for k in np.flatnonzero(found.log_unit[:, dataset] > -INF):
        inside = (regions.lower[k] <= points) & (points < regions.upper[k])
        law = norm(found.mean[0, k, dataset], np.sqrt(found.cov[0, 0, k, dataset]))
        total += inside * np.exp(found.log_unit[k, dataset]) * law.pdf(points)
    return total
