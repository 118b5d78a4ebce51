"""References: mean-square errors of the optimal and the plug-in estimate of a function.

Given the measurements x is N(xhat, P) with xhat ~ N(mean, C - P). The optimal estimate of f(x) is
its mean given xhat, the plug-in estimate is f(xhat).
"""

from __future__ import annotations

from typing import Any

import mpmath as mp

from references.high import about, density, family, integral, matrix, moment
from references.means import NEARLY, larger, modulus_moments

HALF = [[0.5, 0.1], [0.1, 0.25]]


def averaged(f: Any, mean: Any, var: Any, kink: Any) -> Any:
    """E f(u), u ~ N(mean, var), where f changes about zero over the width `kink`."""
    if var == 0:
        return f(mean)
    s = mp.sqrt(var)
    return integral(lambda u: density((u - mean) / s) / s * f(u), about(mean, s, (mp.mpf(0), kink)))


@family(
    "maximum error",
    "quadrature",
    sensitive=False,
    ordinary={"mean": [0.3, -0.2], "cov": [[1.0, 0.4], [0.4, 2.0]], "error_cov": HALF},
    equal={"mean": [0.0, 0.0], "cov": [[1.0, 0.0], [0.0, 1.0]], "error_cov": HALF},
    nearly_singular={"mean": [1.0, 1.0001], "cov": [[2.0, 1.9], [1.9, 2.0]], "error_cov": NEARLY},
    five={"mean": [5.0, 0.0], "cov": [[1.0, 0.0], [0.0, 1.0]], "error_cov": HALF},
    small={
        "mean": [1.0, 0.5],
        "cov": [[1.0, 0.4], [0.4, 2.0]],
        "error_cov": [[1e-8, 2e-9], [2e-9, 3e-8]],
    },
    large={"mean": [1e6, 1e6 + 1], "cov": [[1.0, 0.0], [0.0, 1.0]], "error_cov": HALF},
)
def maximum_error(mean: Any, cov: Any, error_cov: Any) -> dict[str, Any]:
    c, p = (m[0][0] + m[1][1] - 2 * m[0][1] for m in (cov, error_cov))
    gap, kink = mean[0] - mean[1], mp.sqrt(p)

    def variance(u: Any) -> Any:
        return larger([u, mp.mpf(0)], error_cov)[1]

    def square(u: Any) -> Any:
        return (larger([u, mp.mpf(0)], error_cov)[0] - max(u, 0)) ** 2

    optimal = averaged(variance, gap, c - p, kink)
    return {"optimal": optimal, "plugin": optimal + averaged(square, gap, c - p, kink)}


@family(
    "modulus error",
    "quadrature",
    sensitive=False,
    ordinary={"mean": 0.7, "var": 2.0, "error_var": 0.5},
    centred={"mean": 0.0, "var": 1.0, "error_var": 0.25},
    known={"mean": 0.5, "var": 1.0, "error_var": 1e-10},
    unseen={"mean": 1.0, "var": 2.0, "error_var": 2.0},
    five={"mean": 5.0, "var": 1.0, "error_var": 0.5},
    twenty={"mean": -20.0, "var": 1.0, "error_var": 0.125},
)
def modulus_error(mean: Any, var: Any, error_var: Any) -> dict[str, Any]:
    rest, kink = var - error_var, mp.sqrt(error_var)
    optimal = averaged(lambda u: modulus_moments(u, error_var)[1], mean, rest, kink)
    loss = averaged(lambda u: (modulus_moments(u, error_var)[0] - abs(u)) ** 2, mean, rest, kink)
    return {"optimal": optimal, "plugin": optimal + loss}


@family(
    "sine error",
    "closed form",
    ordinary={"mean": 0.7, "var": 0.5, "error_var": 0.125},
    known={"mean": 0.7, "var": 0.5, "error_var": 1e-12},
    flat={"mean": 1.5, "var": 1e-6, "error_var": 1e-8},
    unseen={"mean": 1.0, "var": 2.0, "error_var": 2.0},
    wide={"mean": 2.0, "var": 60.0, "error_var": 1.0},
    large={"mean": 1e4, "var": 0.25, "error_var": 0.0625},
)
def sine_error(mean: Any, var: Any, error_var: Any) -> dict[str, Any]:
    with mp.workdps(140):
        whole, seen = ((1 - mp.exp(-2 * v) * mp.cos(2 * mean)) / 2 for v in (var, var - error_var))
        return {
            "optimal": whole - mp.exp(-error_var) * seen,
            "plugin": whole + seen - 2 * mp.exp(-error_var / 2) * seen,
        }


@family(
    "polynomial error",
    "exact sum over pairings",
    ordinary={
        "mean": [0.5, -1.0],
        "cov": [[1.0, 0.4], [0.4, 2.0]],
        "error_cov": HALF,
        "powers": [[1, 1], [3, 0], [2, 2]],
    },
    known={
        "mean": [0.5, -1.0],
        "cov": [[1.0, 0.4], [0.4, 2.0]],
        "error_cov": [[1e-10, 2e-11], [2e-11, 3e-10]],
        "powers": [[1, 1], [3, 0], [2, 2]],
    },
    large={
        "mean": [1e6, 3e5],
        "cov": [[1.0, 0.4], [0.4, 2.0]],
        "error_cov": HALF,
        "powers": [[1, 1], [3, 0], [2, 2]],
    },
    unseen={"mean": [1.0, 0.0], "cov": HALF, "error_cov": HALF, "powers": [[1, 1], [3, 0], [2, 2]]},
)
def polynomial_error(mean: Any, cov: Any, error_cov: Any, powers: Any) -> dict[str, Any]:
    """From moments of x beside another x of the same estimate, and of x beside the estimate."""
    with mp.workdps(120):
        n, cov, seen = len(mean), matrix(cov), matrix(cov) - matrix(error_cov)

        def joint(last: Any) -> Any:
            whole = mp.zeros(2 * n)
            whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:] = cov, seen, seen, last
            return whole

        found = {}
        for p in powers:
            name, twice = "x^{}y^{}".format(*p), [2 * k for k in p]
            square = moment(twice, mean, cov)
            found[f"optimal {name}"] = square - moment([*p, *p], [*mean, *mean], joint(cov))
            found[f"Hermite {name}"] = found[f"optimal {name}"]  # of the estimators of all degrees
            both = moment([*p, *p], [*mean, *mean], joint(seen))
            found[f"plugin {name}"] = square + moment(twice, mean, seen) - 2 * both
        return found
