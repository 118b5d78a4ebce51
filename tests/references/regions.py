"""References: Gaussian laws restricted to intervals, half-planes, quadrants and polygons."""

from __future__ import annotations

from typing import Any

import mpmath as mp

from oracles.polygon_reference import reference
from references.high import (
    Value,
    about,
    below,
    column,
    density,
    family,
    integral,
    law_values,
    matrix,
    relative,
)
from references.record import INF


def mass_between(a: Any, b: Any) -> Any:
    return below(b) - below(a) if b < 0 else below(-a) - below(-b)


@family(
    "interval",
    "closed form",
    ordinary={"mean": 0.3, "var": 2.0, "lower": -1.0, "upper": 1.5},
    half={"mean": 0.3, "var": 2.0, "lower": 1.0, "upper": INF},
    five={"mean": 0.0, "var": 1.0, "lower": 5.0, "upper": 6.0},
    thirty={"mean": 0.0, "var": 1.0, "lower": -INF, "upper": -30.0},
    deep={"mean": 1.0, "var": 0.25, "lower": 7000.0, "upper": INF},
    narrow={"mean": 0.0, "var": 1.0, "lower": 0.5, "upper": 0.5 + 2.0**-34},
    small={"mean": 1e-5, "var": 1e-12, "lower": 8e-6, "upper": 1.1e-5},
    large={"mean": 1e9, "var": 4.0, "lower": 1e9 - 1, "upper": 1e9 + 7},
)
def interval(mean: Any, var: Any, lower: Any, upper: Any) -> dict[str, Any]:
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


@family(
    "half-plane",
    "closed form",
    ordinary={
        "mean": [0.3, 0.6],
        "cov": [[1.0, 0.4], [0.4, 2.0]],
        "normal": [2, -1],
        "offset": 0.5,
    },
    nearly_singular={
        "mean": [1.0, 1.5],
        "cov": [[1.0, 1 - 1e-8], [1 - 1e-8, 1.0]],
        "normal": [1, 2],
        "offset": -1.0,
    },
    ten={"mean": [0.0, 0.0], "cov": [[1.0, 0.0], [0.0, 1.0]], "normal": [3, 4], "offset": -50.0},
    thirty={
        "mean": [1.0, -1.0],
        "cov": [[1.0, 0.5], [0.5, 1.0]],
        "normal": [1, 1],
        "offset": -52.0,
    },
    large={"mean": [1e6, 2e6], "cov": [[4.0, 0.5], [0.5, 1.0]], "normal": [2, -1], "offset": 0.5},
)
def half_plane(mean: Any, cov: Any, normal: Any, offset: Any) -> dict[str, Any]:
    """The law where ``normal . x + offset > 0``; the normal is made of whole numbers."""
    with mp.workdps(120):
        cov = matrix(cov)
        lean = cov * column(normal)
        var = sum(c * lean[i] for i, c in enumerate(normal))
        s = mp.sqrt(var)
        z = (sum(c * m for c, m in zip(normal, mean, strict=True)) + offset) / s
        ratio = density(z) / below(z)
        first = column(mean) + lean * (ratio / s)
        second = cov - lean * lean.T * (ratio * (ratio + z) / var)
        return {"log mass": relative(mp.log(below(z)), 1), **law_values(first, second)}


SQUARE = [[0.1, 0.9], [-0.7, 0.1], [0.2, -0.8], [1.0, 0.0]]


@family(
    "polygon",
    "quadrature",
    sensitive=False,
    square={"mean": [0.03, 0.07], "cov": [[1.0, 0.3], [0.3, 1.0]], "vertices": SQUARE},
    notched={
        "mean": [0.0, 0.5],
        "cov": [[2.0, 0.3], [0.3, 0.5]],
        "vertices": [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 0.5], [0.0, 2.0]],
    },
    nearly_singular={
        "mean": [0.0, 0.0],
        "cov": [[1.0, 1 - 1e-8], [1 - 1e-8, 1.0]],
        "vertices": SQUARE,
    },
    far={
        "mean": [0.0, 0.0],
        "cov": [[1.0, 0.2], [0.2, 1.0]],
        "vertices": [[8.0, 9.0], [9.0, 8.0], [10.0, 12.0]],
    },
    strip={
        "mean": [0.5, 0.2],
        "cov": [[1.0, 0.0], [0.0, 1.0]],
        "vertices": [[-3.0, 0.0], [4.0, 0.0], [4.0, 2.0**-30], [-3.0, 2.0**-30]],
    },
    large={
        "mean": [1e6, 1e6],
        "cov": [[4.0, 1.0], [1.0, 9.0]],
        "vertices": [[1e6, 1e6], [1e6 + 2, 1e6 - 1], [1e6 + 5, 1e6 + 3]],
    },
)
def polygon(mean: Any, cov: Any, vertices: Any) -> dict[str, Any]:
    """By the program of the polygon tests: Green's theorem with 90 digits."""
    log_mass, first, (a, b, c) = reference(mean, cov, vertices)
    return {"log mass": relative(log_mass, 1), **law_values(first, matrix([[a, b], [b, c]]))}


@family(
    "bivariate normal",
    "quadrature",
    **{
        f"{h:g} {k:g} {name}": {"h": h, "k": k, "rho": rho}
        for h, k, rho, name in (
            (0.0, 0.0, 0.5, "half"),
            (0.3, -0.7, 0.25, "quarter"),
            (1.0, 2.0, -0.75, "opposite"),
            (-1.0, -1.0, 0.5, "half"),
            (-5.0, -5.0, 0.5, "half"),
            (-5.0, -4.0, 0.9375, "strong"),
            (-3.0, -3.0, -0.5, "opposite"),
            (2.0, -6.0, 0.0, "none"),
            (-8.0, 1.0, 0.5, "half"),
            (0.5, 0.5001, 1 - 1e-8, "nearly one"),
            (-0.5, 0.5001, 1e-8 - 1, "nearly minus one"),
            (5.0, 6.0, 0.25, "quarter"),
            (-1e-9, 1e-9, 0.75, "strong"),
            (-2.0, 9.0, 0.5, "half"),
        )
    },
)
def bivariate(h: Any, k: Any, rho: Any) -> dict[str, Any]:
    """Error relative to one, as the function promises it."""
    root = mp.sqrt((1 - rho) * (1 + rho))
    kink = [] if rho == 0 else [(k / rho, root / abs(rho))]
    marks = [mark for mark in about(mp.mpf(0), mp.mpf(1), *kink) if mark < h]
    mass = integral(lambda x: density(x) * below((k - rho * x) / root), [*marks, h])
    return {"probability": Value(mass, mp.mpf(1))}


@family(
    "quadrant",
    "closed form",
    **{
        name: {"rho": rho}
        for name, rho in (
            ("none", 0.0),
            ("weak", 1e-9),
            ("quarter", 0.25),
            ("half", 0.5),
            ("strong", 0.9375),
            ("nearly one", 1 - 1e-8),
            ("negative", -0.25),
            ("opposite", -0.75),
            ("nearly minus one", 1e-4 - 1),
        )
    },
)
def quadrant(rho: Any) -> dict[str, Any]:
    """Of the tetrachoric law: both components positive, of deviation one and correlation rho."""
    with mp.workdps(90):
        mass = mp.acos(-rho) / (2 * mp.pi)
        first = (1 + rho) / (2 * mp.sqrt(2 * mp.pi) * mass)
        edge = mp.sqrt((1 - rho) * (1 + rho)) / (2 * mp.pi * mass)
        square, cross = 1 + rho * edge, rho + edge
        var, cov = square - first * first, cross - first * first
        return {"probability": mass, "mean": first, "var": var, "cov": Value(cov, var)}
