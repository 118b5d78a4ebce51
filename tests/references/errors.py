"""References: mean-square errors of the optimal and the plug-in estimate of a function.

Given the measurements x is N(xhat, P) with xhat ~ N(mean, C - P). The optimal estimate of f(x) is
its mean given xhat, the plug-in estimate is f(xhat).
"""

import mpmath as mp

from references.high import about, density, family, integral, matrix, moment
from references.means import larger, modulus_moments


def averaged(f, mean, var, kink):
    """E f(u), u ~ N(mean, var), where f changes about zero over the width `kink`."""
    if var == 0:
        return f(mean)
    s = mp.sqrt(var)
    return integral(lambda u: density((u - mean) / s) / s * f(u), about(mean, s, (mp.mpf(0), kink)))


@family("maximum error", "quadrature", sensitive=False)
def maximum_error(mean, cov, error_cov):
    c, p = (m[0][0] + m[1][1] - 2 * m[0][1] for m in (cov, error_cov))
    gap, kink = mean[0] - mean[1], mp.sqrt(p)

    def variance(u):
        return larger([u, mp.mpf(0)], error_cov)[1]

    def square(u):
        return (larger([u, mp.mpf(0)], error_cov)[0] - max(u, 0)) ** 2

    optimal = averaged(variance, gap, c - p, kink)
    return {"optimal": optimal, "plugin": optimal + averaged(square, gap, c - p, kink)}


@family("modulus error", "quadrature", sensitive=False)
def modulus_error(mean, var, error_var):
    rest, kink = var - error_var, mp.sqrt(error_var)
    optimal = averaged(lambda u: modulus_moments(u, error_var)[1], mean, rest, kink)
    loss = averaged(lambda u: (modulus_moments(u, error_var)[0] - abs(u)) ** 2, mean, rest, kink)
    return {"optimal": optimal, "plugin": optimal + loss}


@family("sine error", "closed form")
def sine_error(mean, var, error_var):
    with mp.workdps(140):
        whole, seen = ((1 - mp.exp(-2 * v) * mp.cos(2 * mean)) / 2 for v in (var, var - error_var))
        return {
            "optimal": whole - mp.exp(-error_var) * seen,
            "plugin": whole + seen - 2 * mp.exp(-error_var / 2) * seen,
        }


@family("polynomial error", "exact sum over pairings")
def polynomial_error(mean, cov, error_cov, powers):
    """From moments of x beside another x of the same estimate, and of x beside the estimate."""
    with mp.workdps(120):
        n, cov, seen = len(mean), matrix(cov), matrix(cov) - matrix(error_cov)

        def joint(last):
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
