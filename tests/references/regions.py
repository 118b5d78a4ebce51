"""References: Gaussian distributions restricted to intervals, half-planes, quadrants and
polygons."""

import mpmath as mp

from oracles.polygon_reference import reference
from references.high import (
    Value,
    about,
    below,
    column,
    density,
    dist_values,
    family,
    integral,
    matrix,
    relative,
)
from references.record import INF


def mass_between(a, b):
    return below(b) - below(a) if b < 0 else below(-a) - below(-b)


@family("interval", "closed form")
def interval(mean, var, lower, upper):
    with mp.workdps(200):
        s = mp.sqrt(var)
        ends = [mp.sign(e) * mp.inf if abs(e) >= INF / 2 else e for e in (lower, upper)]
        a, b = ((e - mean) / s for e in ends)
        mass = mass_between(a, b)
        fa, fb = (0 if mp.isinf(z) else density(z) for z in (a, b))
        first = (fa - fb) / mass
        slope = (0 if mp.isinf(a) else a * fa) - (0 if mp.isinf(b) else b * fb)
        second = var * (1 + slope / mass - first * first)
        return {
            "log mass": relative(mp.log(mass), 1),
            "mean": relative(mean + s * first, mp.sqrt(second)),
            "var": second,
        }


@family("half-plane", "closed form")
def half_plane(mean, cov, normal, offset):
    """The distribution where ``normal . x + offset > 0``; the normal is made of whole numbers."""
    with mp.workdps(120):
        cov = matrix(cov)
        lean = cov * column(normal)
        var = sum(c * lean[i] for i, c in enumerate(normal))
        s = mp.sqrt(var)
        z = (sum(c * m for c, m in zip(normal, mean, strict=True)) + offset) / s
        ratio = density(z) / below(z)
        first = column(mean) + lean * (ratio / s)
        second = cov - lean * lean.T * (ratio * (ratio + z) / var)
        return {"log mass": relative(mp.log(below(z)), 1), **dist_values(first, second)}


@family("polygon", "quadrature", sensitive=False)
def polygon(mean, cov, vertices):
    """By the program of the polygon tests: Green's theorem with 90 digits."""
    log_mass, first, (a, b, c) = reference(mean, cov, vertices)
    return {"log mass": relative(log_mass, 1), **dist_values(first, matrix([[a, b], [b, c]]))}


@family("bivariate normal", "quadrature")
def bivariate(h, k, rho):
    """Error relative to one, as the function promises it."""
    root = mp.sqrt((1 - rho) * (1 + rho))
    kink = [] if rho == 0 else [(k / rho, root / abs(rho))]
    marks = [mark for mark in about(mp.mpf(0), mp.mpf(1), *kink) if mark < h]
    mass = integral(lambda x: density(x) * below((k - rho * x) / root), [*marks, h])
    return {"probability": Value(mass, mp.mpf(1))}


@family("quadrant", "closed form")
def quadrant(rho):
    """Of the tetrachoric distribution: both components positive, of deviation one and correlation
    rho."""
    with mp.workdps(90):
        mass = mp.acos(-rho) / (2 * mp.pi)
        first = (1 + rho) / (2 * mp.sqrt(2 * mp.pi) * mass)
        edge = mp.sqrt((1 - rho) * (1 + rho)) / (2 * mp.pi * mass)
        square, cross = 1 + rho * edge, rho + edge
        var, cov = square - first * first, cross - first * first
        return {"probability": mass, "mean": first, "var": var, "cov": Value(cov, var)}
