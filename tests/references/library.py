"""What the library gives for the arguments of a reference: a function for each family.

Each takes the arguments of a case, and returns numbers under the names of the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import sympy

from references import library_filters
from references.record import INF
from seedslib.filters.weights import normalised
from seedslib.gaussian import (
    abs_errors,
    abs_moments,
    bivariate_normal_cdf,
    elevation_moments,
    expectation_function,
    hermite_expansion,
    interval,
    max_errors,
    max_moments,
    mean_square_errors,
    norm_errors,
    norm_mean,
    polygon,
    quadrature,
    sine_errors,
    sine_moments,
)
from seedslib.linearization import ExactGaussian
from seedslib.models.maps import Noise, StochasticMap

x, y, z = sympy.symbols("x y z", real=True)
NAMES = (x, y, z)
dist_values = library_filters.dist_values


def pair(first: str, second: str, found: Any) -> dict[str, float]:
    return {first: found[0], second: found[1]}


def product(powers: Iterable[int]) -> Any:
    return sympy.prod(s**k for s, k in zip(NAMES, powers, strict=False))


def named(powers: Iterable[int]) -> str:
    return "".join(f"{s}^{k}" for s, k in zip("xyz", powers, strict=False))


def norm(mean, cov):
    return {"mean": norm_mean(mean, cov), "var of error": norm_errors(cov)[0]}


def polynomial(mean, cov, powers):
    made = expectation_function([product(p) for p in powers], NAMES)
    return dict(zip(map(named, powers), made(mean, cov), strict=True))


RULES = {
    "hermite": lambda n: quadrature.gauss_hermite(n, 5),
    "cubature": quadrature.cubature,
    "unscented": lambda n: quadrature.unscented(n, 1.0),
    "fifth": quadrature.fifth_degree,
}


def rules(mean, cov, powers, rule):
    def values(points):
        return np.array([np.prod(points ** np.array(p)[:, None], axis=0) for p in powers])

    found = quadrature.mean_of(values, mean, cov, RULES[rule](len(mean)))
    return dict(zip(map(named, powers), found, strict=True))


def half_space(mean, cov, normal, offset, powers):
    side = sympy.Heaviside(normal[0] * x + normal[1] * y + offset)
    made = expectation_function([product(p) * side for p in powers], (x, y))
    return dict(zip(map(named, powers), made(mean, cov), strict=True))


EXPONENTIALS = {
    "exp(x/2-y/4)": sympy.exp(x / 2 - y / 4),
    "x sin y": x * sympy.sin(y),
    "cos(x+y)": sympy.cos(x + y),
    "exp(-x^2)": sympy.exp(-(x**2)),
    "x exp(-x^2)": x * sympy.exp(-(x**2)),
    "erf(x)": sympy.erf(x),
}


def exponential(mean, cov):
    size = np.abs([*mean, *np.sqrt(np.diagonal(cov))]).max()
    size = 2.0 ** np.ceil(np.log2(size))
    made = expectation_function(list(EXPONENTIALS.values()), (x, y))
    found = made(np.array(mean) / size, np.array(cov) / size / size)
    return dict(zip(EXPONENTIALS, found, strict=True))


COVARIANCES = {
    "sin x": sympy.sin(x),
    "cos 2x": sympy.cos(2 * x),
    "exp x/2": sympy.exp(x / 2),
    "x exp -x": x * sympy.exp(-x),
    "exp -x/2 sin x": sympy.exp(-x / 2) * sympy.sin(x),
    "exp -x^2": sympy.exp(-(x**2)),
}


def covariance(mean, var):
    map = StochasticMap((x,), list(COVARIANCES.values()), Noise())
    found = ExactGaussian().moments(map)(0.0, np.array([mean]), np.array([[var]])).cov
    names = list(enumerate(COVARIANCES))
    return {f"{g}, {f}": found[i, j] for i, f in names for j, g in names[: i + 1]}


def elevation(mean, across=None, along=None, cov=None):
    whole = np.diag([across, across, along]) if cov is None else np.zeros((3, 3))
    if cov is not None:
        whole[np.ix_([0, 2], [0, 2])] = cov
    return pair("mean", "var", elevation_moments(mean, whole))


def polynomial_error(mean, cov, error_cov, powers):
    found = {}
    for p in powers:
        errors = mean_square_errors(product(p), (x, y))(mean, cov, error_cov)
        found |= pair(f"optimal {named(p)}", f"plugin {named(p)}", errors)
        expansion = hermite_expansion(product(p), (x, y), mean, cov, error_cov)
        found[f"Hermite {named(p)}"] = expansion.degree_errors()[-1, 0, 0]
    return found


def interval_values(mean, var, lower, upper):
    ends = [np.copysign(np.inf, e) if abs(e) >= INF / 2 else e for e in (lower, upper)]
    found = interval(mean, var, *ends)
    return {"log mass": found.log_mass, "mean": found.mean, "var": found.cov}


def region_values(found):
    return {"log mass": found.log_mass, **dist_values(found.mean, found.cov)}


def half_plane(mean, cov, normal, offset):
    """With its boundary through a point that is exact: the offset divided by one of the normal."""
    a, b = normal
    corner = [0.0, -offset / b] if np.log2(abs(b)) % 1 == 0 else [-offset / a, 0.0]
    along = np.array([b, -a], dtype=float)
    return region_values(polygon(mean, cov, [corner], rays=[-along, along][:: side(a, b, along)]))


def side(a, b, along):
    """The region lies on the left of a boundary that comes in along the first ray."""
    return 1 if along[0] * b - along[1] * a > 0 else -1


def quadrant(rho):
    found = polygon([0, 0], [[1, rho], [rho, 1]], [[0, 0]], rays=[[0, 1], [1, 0]])
    return {
        "probability": found.mass,
        "mean": found.mean[0],
        "var": found.cov[0, 0],
        "cov": found.cov[0, 1],
    }


def weights(score):
    logs, total = normalised(np.array(score), 0)
    return {"log sum": total, **{f"log weight {k}": v for k, v in enumerate(logs)}}


CALLS: dict[str, Callable[..., dict[str, Any]]] = {
    "maximum": lambda mean, cov: pair("mean", "var", max_moments(mean, cov)),
    "modulus": lambda mean, var: pair("mean", "var", abs_moments(mean, var)),
    "sine": lambda mean, var: pair("mean", "var", sine_moments(mean, var)),
    "covariance": covariance,
    "norm": norm,
    "polynomial": polynomial,
    "quadrature rules": rules,
    "half space": half_space,
    "exponential": exponential,
    "elevation": elevation,
    "maximum error": lambda **told: pair("optimal", "plugin", max_errors(**told)),
    "modulus error": lambda **told: pair("optimal", "plugin", abs_errors(**told)),
    "sine error": lambda **told: pair("optimal", "plugin", sine_errors(**told)),
    "polynomial error": polynomial_error,
    "interval": interval_values,
    "half-plane": half_plane,
    "polygon": lambda **told: region_values(polygon(**told)),
    "bivariate normal": lambda **told: {"probability": bivariate_normal_cdf(**told)},
    "quadrant": quadrant,
    "log weights": weights,
    **library_filters.CALLS,
}
