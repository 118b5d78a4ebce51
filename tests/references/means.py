"""References: means and variances of functions of a Gaussian vector."""

from __future__ import annotations

from typing import Any

import mpmath as mp

from references.high import (
    Value,
    about,
    below,
    column,
    density,
    family,
    integral,
    matrix,
    moment,
    relative,
)

UNIT = [[1.0, 0.0], [0.0, 1.0]]
NEARLY = [[1.0, 1 - 1e-8], [1 - 1e-8, 1.0]]
LAWS = {
    "ordinary": {"mean": [0.3, -0.2], "cov": [[1.0, 0.4], [0.4, 2.0]]},
    "nearly_singular": {"mean": [1.0, 1.0001], "cov": NEARLY},
    "five": {"mean": [5.0, 0.0], "cov": UNIT},
    "thirty": {"mean": [30.0, 0.5], "cov": [[0.5, 0.1], [0.1, 0.5]]},
    "small": {"mean": [2e-4, -1e-4], "cov": [[1e-8, 2e-9], [2e-9, 3e-8]]},
    "units": {"mean": [-1e6, 0.0], "cov": [[1e9, 0.0], [0.0, 1e-9]]},
}
FAR = {"mean": [1e9, 1e9 + 1], "cov": [[1.0, 0.5], [0.5, 1.0]]}


def larger(mean: Any, cov: Any) -> tuple[Any, Any]:
    """Mean and variance of the larger of two normals by their raw moments (Clark)."""
    with mp.workdps(110):
        s = mp.sqrt(cov[0][0] + cov[1][1] - 2 * cov[0][1])
        a, b = mean
        z = (a - b) / s
        first = a * below(z) + b * below(-z) + s * density(z)
        second = (a * a + cov[0][0]) * below(z) + (b * b + cov[1][1]) * below(-z)
        second += (a + b) * s * density(z)
        return first, second - first * first


@family("maximum", "closed form", **LAWS, large=FAR)
def maximum(mean: Any, cov: Any) -> dict[str, Any]:
    first, var = larger(mean, cov)
    return {"mean": relative(first, mp.sqrt(var)), "var": var}


def modulus_moments(mean: Any, var: Any) -> tuple[Any, Any]:
    with mp.workdps(110):
        s = mp.sqrt(var)
        z = mean / s
        first = s * 2 * density(z) + mean * (1 - 2 * below(-z))
        return first, mean * mean + var - first * first


@family(
    "modulus",
    "closed form",
    ordinary={"mean": 0.7, "var": 2.0},
    centred={"mean": 0.0, "var": 3.0},
    near={"mean": 1e-6, "var": 0.5},
    five={"mean": 5.0, "var": 1.0},
    thirty={"mean": -30.0, "var": 1.0},
    small={"mean": 3e-7, "var": 1e-14},
    large={"mean": 1e9, "var": 1e-4},
)
def modulus(mean: Any, var: Any) -> dict[str, Any]:
    return dict(zip(("mean", "var"), modulus_moments(mean, var), strict=True))


@family(
    "sine",
    "closed form",
    ordinary={"mean": 0.7, "var": 0.5},
    small={"mean": 0.7, "var": 1e-12},
    flat={"mean": 1.5, "var": 1e-6},
    wide={"mean": 2.0, "var": 60.0},
    zero={"mean": 1e-9, "var": 1e-10},
    large={"mean": 1e4, "var": 0.25},
)
def sine(mean: Any, var: Any) -> dict[str, Any]:
    with mp.workdps(140):
        first = mp.exp(-var / 2) * mp.sin(mean)
        return {"mean": first, "var": (1 - mp.exp(-2 * var) * mp.cos(2 * mean)) / 2 - first**2}


def length(mean: Any, cov: Any) -> Any:
    """E |x| = (1 / sqrt pi) int (1 - E exp(-t² |x|²)) / t² dt, in the axes of the covariance."""
    with mp.workdps(90):
        values, axes = mp.eigsy(matrix(cov))
        turned = axes.T * column(mean)
    floor = mp.mpf(10) ** -60 * max(abs(v) for v in values)
    pairs = [(v if abs(v) > floor else mp.mpf(0), b) for v, b in zip(values, turned, strict=True)]
    reach = mp.sqrt(sum(v + b * b for v, b in pairs))

    def rest(t: Any) -> Any:
        s = t * t
        logs = sum(mp.log1p(2 * v * s) / 2 + s * b * b / (1 + 2 * v * s) for v, b in pairs)
        return -mp.expm1(-logs) / s

    marks = {1 / (mp.sqrt(v) * k) for v, _ in pairs if v > 0 for k in (4, 1)}
    marks |= {k / reach for k in (mp.mpf(1) / 4, 1, 4)}
    return integral(rest, [0, *marks, mp.inf]) / mp.sqrt(mp.pi)


@family(
    "norm",
    "quadrature",
    plane={"mean": [0.3, -0.2], "cov": [[1.0, 0.4], [0.4, 2.0]]},
    centred={"mean": [0.0, 0.0, 0.0], "cov": [[1.0, 0.2, 0.0], [0.2, 0.5, 0.1], [0.0, 0.1, 3.0]]},
    nearly_singular={"mean": [1.0, 1.0001], "cov": NEARLY},
    five={"mean": [3.0, 4.0], "cov": UNIT},
    thirty={"mean": [10.0, 20.0, 20.0], "cov": [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.5]]},
    small={"mean": [2e-4, -1e-4], "cov": [[1e-8, 2e-9], [2e-9, 3e-8]]},
    units={"mean": [1.0, 0.0], "cov": [[1e6, 0.0], [0.0, 1e-6]]},
)
def norm(mean: Any, cov: Any) -> dict[str, Any]:
    centred = length([mp.mpf(0)] * len(mean), cov)
    trace = sum(cov[i][i] for i in range(len(mean)))
    return {"mean": length(mean, cov), "var of error": trace - centred * centred}


SPACE = [[1.0, 0.2, 0.1], [0.2, 0.5, -0.1], [0.1, -0.1, 2.0]]
POWERS = [[1, 1, 0], [3, 0, 0], [2, 2, 0], [1, 2, 1], [4, 0, 2]]


@family(
    "polynomial",
    "exact sum over pairings",
    ordinary={"mean": [0.5, -1.0, 2.0], "cov": SPACE, "powers": POWERS},
    small={
        "mean": [1e-3, 2e-3, -3e-3],
        "cov": [[v * 1e-6 for v in row] for row in SPACE],
        "powers": POWERS,
    },
    large={"mean": [1e6, 1e6, -1e6], "cov": SPACE, "powers": POWERS},
    singular={
        "mean": [0.25, 0.5, 1.0],
        "powers": POWERS,
        "cov": [[1.0, 2.0, 0.5], [2.0, 4.0, 1.0], [0.5, 1.0, 0.25]],
    },
)
def polynomial(mean: Any, cov: Any, powers: Any) -> dict[str, Any]:
    cov = matrix(cov)
    return {
        "x^{}y^{}z^{}".format(*p): relative(
            moment(p, mean, cov), moment(p, [abs(m) for m in mean], cov.apply(abs))
        )
        for p in powers
    }


@family(
    "quadrature rules",
    "exact sum over pairings",
    hermite={
        "rule": "hermite",
        "mean": [0.5, -1.0],
        "cov": [[1.0, 0.4], [0.4, 2.0]],
        "powers": [[2, 0], [3, 1], [4, 4]],
    },
    cubature={
        "rule": "cubature",
        "mean": [0.5, -1.0, 2.0],
        "cov": SPACE,
        "powers": [[1, 0, 0], [1, 1, 0], [1, 1, 1], [0, 2, 1]],
    },
    unscented={
        "rule": "unscented",
        "mean": [0.5, -1.0, 2.0],
        "cov": SPACE,
        "powers": [[1, 0, 0], [1, 1, 0], [1, 1, 1], [0, 2, 1]],
    },
    fifth={
        "rule": "fifth",
        "mean": [0.5, -1.0, 2.0],
        "cov": SPACE,
        "powers": [[1, 1, 0], [1, 1, 1], [2, 2, 1], [0, 4, 1]],
    },
    nearly_singular={
        "rule": "hermite",
        "mean": [1.0, 1.0],
        "cov": NEARLY,
        "powers": [[2, 0], [3, 1], [4, 4]],
    },
    small={
        "rule": "fifth",
        "mean": [1e-4, 2e-4],
        "cov": [[1e-8, 2e-9], [2e-9, 3e-8]],
        "powers": [[1, 1], [2, 1], [4, 1]],
    },
)
def quadrature_rules(mean: Any, cov: Any, powers: Any, rule: Any) -> dict[str, Any]:
    """True means, which rules of enough degree must give."""
    cov, bare = matrix(cov), [abs(m) for m in mean]
    return {
        "".join(f"{s}^{k}" for s, k in zip("xyz", p, strict=False)): relative(
            moment(p, mean, cov), moment(p, bare, cov.apply(abs))
        )
        for p in powers
    }


PLANES = [[0, 0], [1, 0], [2, 1], [3, 2]]


@family(
    "half space",
    "quadrature",
    sensitive=False,
    ordinary={
        "mean": [0.3, 0.6],
        "cov": [[1.0, 0.4], [0.4, 2.0]],
        "normal": [1.0, 0.5],
        "offset": 0.25,
        "powers": PLANES,
    },
    nearly_singular={
        "mean": [1.0, 1.5],
        "cov": NEARLY,
        "normal": [1.0, 0.25],
        "offset": -1.0,
        "powers": PLANES,
    },
    five={"mean": [0.5, 1.0], "cov": UNIT, "normal": [1.0, 0.0], "offset": -5.5, "powers": PLANES},
    thirty={
        "mean": [0.0, 1.0],
        "cov": UNIT,
        "normal": [3.0, 4.0],
        "offset": -154.0,
        "powers": PLANES,
    },
    small={
        "mean": [1e-4, 2e-4],
        "cov": [[1e-8, 2e-9], [2e-9, 3e-8]],
        "normal": [1.0, 1.0],
        "offset": 0.0,
        "powers": PLANES,
    },
    large={
        "mean": [1e6, 1.0],
        "cov": [[1.0, 0.3], [0.3, 1.0]],
        "normal": [1.0, 1.0],
        "offset": -1e6,
        "powers": PLANES,
    },
)
def half_space(mean: Any, cov: Any, normal: Any, offset: Any, powers: Any) -> dict[str, Any]:
    cov = matrix(cov)
    lean = cov * column(normal)
    centre = sum(c * m for c, m in zip(normal, mean, strict=True)) + offset
    var = sum(c * lean[i] for i, c in enumerate(normal))
    s, rest = mp.sqrt(var), cov - lean * lean.T / var
    depth = s / (1 + abs(centre) / s)
    ends = [mp.mpf(0), centre + mp.sqrt(min(centre, 0) ** 2 + 300 * var)]
    marks = [*about(centre, s), *(depth * k for k in (1, 4, 16, 64))]
    points = [*ends, *(mark for mark in marks if ends[0] < mark < ends[1])]

    def weighed(u: Any, p: Any) -> Any:
        here = [mean[i] + lean[i] / var * (u - centre) for i in range(2)]
        return density((u - centre) / s) / s * moment(p, here, rest)

    found = {}
    for p in powers:
        found["x^{}y^{}".format(*p)] = integral(lambda u, p=p: weighed(u, p), points)
    return found


@family("exponential", "closed form", **LAWS)
def exponential(mean: Any, cov: Any) -> dict[str, Any]:
    """With x and y in units of a power of two next to their largest size."""
    size = max(*(abs(m) for m in mean), *(mp.sqrt(cov[i][i]) for i in range(2)))
    size = mp.mpf(2) ** mp.ceil(mp.log(size, 2))
    a, b = (m / size for m in mean)
    p, q, r = (c / size / size for c in (cov[0][0], cov[0][1], cov[1][1]))
    blunt = mp.exp(-r / 2)
    tilt = 1 / (1 + 2 * p)
    bell = mp.sqrt(tilt) * mp.exp(-tilt * a * a)
    return {
        "exp(x/2-y/4)": mp.exp(a / 2 - b / 4 + (p / 4 + r / 16 - q / 4) / 2),
        "x sin y": Value(blunt * (a * mp.sin(b) + q * mp.cos(b)), blunt * (abs(a) + mp.sqrt(p))),
        "cos(x+y)": mp.cos(a + b) * mp.exp(-(p + 2 * q + r) / 2),
        "exp(-x^2)": bell,
        "x exp(-x^2)": Value(a * tilt * bell, bell * (abs(a) + mp.sqrt(p * tilt)) * tilt),
        "erf(x)": relative(mp.erf(a * mp.sqrt(tilt)), mp.sqrt(p)),
    }


def axial(mean: Any, across: Any, along: Any) -> Any:
    """Density of the elevation of N((0, 0, mean), diag(across, across, along))."""

    def f(angle: Any) -> Any:
        c, s = mp.cos(angle), mp.sin(angle)
        a, b = c * c / across + s * s / along, mean * s / along
        inner = mp.exp(b * b / (2 * a) - mean * mean / (2 * along)) * below(b / mp.sqrt(a))
        inner *= mp.sqrt(2 * mp.pi / a) * (b * b / a + 1) / a
        inner += b / a / a * mp.exp(-mean * mean / (2 * along))
        return c * inner / (across * mp.sqrt(2 * mp.pi * along))

    return f


def planar(mean: Any, cov: Any) -> Any:
    """Density of the polar angle of a Gaussian vector in the plane."""
    inverse = matrix(cov) ** -1
    determinant = cov[0][0] * cov[1][1] - cov[0][1] * cov[1][0]
    whole = (column(mean).T * inverse * column(mean))[0]

    def f(angle: Any) -> Any:
        e = column([mp.cos(angle), mp.sin(angle)])
        a, b = (e.T * inverse * e)[0], (e.T * inverse * column(mean))[0]
        inner = mp.exp(-whole / 2) / a
        bump = mp.sqrt(2 * mp.pi) * b / a / mp.sqrt(a) * below(b / mp.sqrt(a))
        return (inner + bump * mp.exp((b * b / a - whole) / 2)) / (2 * mp.pi * mp.sqrt(determinant))

    return f


@family(
    "elevation",
    "quadrature",
    upright={"mean": [0.0, 0.0, 1.0], "across": 1.0, "along": 1.0},
    five={"mean": [0.0, 0.0, 5.0], "across": 0.25, "along": 1.0},
    flat={"mean": [0.0, 0.0, -0.5], "across": 4.0, "along": 0.25},
    narrow={"mean": [0.0, 0.0, 30.0], "across": 1.0, "along": 0.5},
    sheet={"mean": [10.0, 0.0, 1.0], "cov": [[0.25, 0.1], [0.1, 0.5]]},
    low={"mean": [1.0, 0.0, 1.0], "cov": [[0.0025, 0.001], [0.001, 0.0025]]},
    far={"mean": [1000.0, 0.0, 0.5], "cov": [[1.0, 0.0], [0.0, 1.0]]},
)
def elevation(mean: Any, across: Any = None, along: Any = None, cov: Any = None) -> dict[str, Any]:
    half = mp.pi / 2
    if cov is None:
        f, marks = axial(mean[2], across, along), [-half, 0, half]
        width = mp.sqrt(across) / (abs(mean[2]) + mp.sqrt(across))
        marks += [sign * (half - width * k) for k in (1, 3, 9) for sign in (-1, 1)]
        marks = [mark for mark in marks if abs(mark) <= half]
    else:
        f = planar([mean[0], mean[2]], cov)
        centre = mp.atan2(mean[2], mean[0])
        width = mp.sqrt(cov[0][0] + cov[1][1]) / mp.hypot(mean[0], mean[2])
        marks = [-half, half, 3 * half, centre]
        marks += [centre + sign * width * k for k in (1, 4, 16) for sign in (-1, 1)]
        marks = [mark for mark in marks if -half <= mark <= 3 * half]

    def folded(angle: Any) -> Any:
        return angle if angle <= half else mp.pi - angle

    first = integral(lambda t: folded(t) * f(t), marks)
    var = integral(lambda t: (folded(t) - first) ** 2 * f(t), marks)
    return {"mean": relative(first, mp.sqrt(var)), "var": var}
