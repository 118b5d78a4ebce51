"""References: covariances of functions of a normal number, down to the smallest variances."""

import mpmath as mp

from references.high import family

HALF = mp.mpf(1) / 2
FUNCTIONS = {
    "sin x": [(-0.5j, 0, 1j, 0), (0.5j, 0, -1j, 0)],
    "cos 2x": [(HALF, 0, 2j, 0), (HALF, 0, -2j, 0)],
    "exp x/2": [(1, 0, HALF, 0)],
    "x exp -x": [(1, 1, -1, 0)],
    "exp -x/2 sin x": [(-0.5j, 0, -0.5 + 1j, 0), (0.5j, 0, -0.5 - 1j, 0)],
    "exp -x^2": [(1, 0, 0, 2)],
}
"""Sums of c x^k exp(a x - q x^2 / 2), as (c, k, a, q)."""


def whole(terms, mean, var):
    """Mean of a sum, by completing the square."""
    total = mp.mpf(0)
    for c, k, a, q in terms:
        s = 1 + q * var
        centre, rest = (mean + a * var) / s, var / s
        power = (1, centre, centre * centre + rest)[k]
        height = mp.exp((a * mean + a * a * var / 2 - q * mean * mean / 2) / s)
        total += c * power * height / mp.sqrt(s)
    return mp.re(total)


@family("covariance", "closed form")
def covariance(mean, var):
    found = {}
    with mp.workdps(700):
        for i, (name, f) in enumerate(FUNCTIONS.items()):
            for other, g in list(FUNCTIONS.items())[: i + 1]:
                product = [(c * d, k + l, a + b, q + r) for c, k, a, q in f for d, l, b, r in g]
                both = whole(product, mean, var)
                found[f"{other}, {name}"] = both - whole(f, mean, var) * whole(g, mean, var)
    return found
