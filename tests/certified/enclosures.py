"""Balls of arithmetic that hold the exact values of the library's functions.

Written from the definitions alone, with Arb's balls and rational numbers: the library is not
imported. Integrals are Arb's own, with proved errors; what lies beyond their ends is bounded here.
Arguments are what the rows of ``enclosures.csv`` hold: floats, taken as the dyadic numbers that
they are, and strings for fractions such as ``"1/10"``.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
from flint import acb, arb, ctx, fmpq, fmpq_mat, fmpq_poly

ctx.dps = 60
END = 24  # deviations; the integrals below leave out less than 1e-120 of a normal probability
Values = dict[str, tuple[list, list]]
"""For each quantity its values and the units in which errors of them are measured."""


def exact(value: Any) -> Any:
    """Balls without a radius for floats, or arrays of them for lists."""
    if isinstance(value, list):
        return np.array([exact(part) for part in value], dtype=object)
    return arb(rational(value))


def rational(value: float | str | Fraction) -> fmpq:
    return fmpq(*Fraction(value).as_integer_ratio())


def phi(z: Any) -> Any:
    return (-z * z / 2).exp() / (2 * arb.pi()).sqrt()


def cdf(z: Any) -> Any:
    return (1 + (z / arb(2).sqrt()).erf()) / 2


def integral(f: Callable, low: arb, high: arb) -> arb:
    """Arb's integral of an entire function of a complex argument."""
    tolerance = arb(10) ** -55
    return acb.integral(
        lambda z, _: f(z), acb(low), acb(high), rel_tol=tolerance, abs_tol=tolerance
    ).real


def own(values: list) -> tuple[list, list]:
    """Positive values: their errors are relative."""
    return values, values


def polygon(mean: list, cov: list, vertices: list) -> Values:
    """Mass, conditional mean and covariance by Green's theorem on whitened coordinates."""
    mean, cov, vertices = exact(mean), exact(cov), exact(vertices)
    a = cov[0, 0].sqrt()
    b = cov[1, 0] / a
    root = np.array([[a, arb(0)], [b, (cov[1, 1] - b * b).sqrt()]], dtype=object)
    white = []
    for x, y in vertices - mean:
        u = x / root[0, 0]
        white.append((u, (y - root[1, 0] * u) / root[1, 1]))
    # for each monomial g a function G with dG/dy = g phi(y): the integral is that of -G phi(x) dx
    inner = (
        lambda x, y: cdf(y),
        lambda x, y: x * cdf(y),
        lambda x, y: -phi(y),
        lambda x, y: x * x * cdf(y),
        lambda x, y: -x * phi(y),
        lambda x, y: cdf(y) - y * phi(y),
    )
    sums = [arb(0)] * len(inner)
    for (x0, y0), (x1, y1) in zip(white, [*white[1:], white[0]], strict=True):
        width, height = x1 - x0, y1 - y0
        for k, G in enumerate(inner):

            def along(t, G=G, x0=x0, y0=y0, width=width, height=height):
                x = x0 + t * width
                return -G(x, y0 + t * height) * phi(x) * width

            sums[k] += integral(along, arb(0), arb(1))
    mass, *moments = sums  # negative in clockwise order, and so are the moments
    first = np.array(moments[:2], dtype=object) / mass
    xx, xy, yy = (part / mass for part in moments[2:])
    second = np.array([[xx, xy], [xy, yy]], dtype=object) - np.outer(first, first)
    inside = root @ second @ root.T
    sd = inside[0, 0].sqrt(), inside[1, 1].sqrt()
    units = [inside[0, 0], sd[0] * sd[1], inside[1, 1]]
    found = {"mass": own([abs(mass)]), "mean": ([*(mean + root @ first)], [*sd])}
    return found | {"covariance": ([inside[0, 0], inside[0, 1], inside[1, 1]], units)}


def bivariate_normal_cdf(h: list, k: list, rho: list) -> Values:
    """Plackett's integral over the correlation: Owen's function without its branches."""
    found = []
    for a, b, r in zip(exact(h), exact(k), exact(rho), strict=True):
        # the correlation is sin t, so that the integrand has no root in its denominator
        def along(t, a=a, b=b):
            square = t.cos() ** 2
            return (-(a * a + b * b - 2 * a * b * t.sin()) / (2 * square)).exp()

        part = integral(along, arb(0), r.asin()) / (2 * arb.pi())
        found.append(cdf(a) * cdf(b) + part)
    return {"probability": (found, [arb(1)] * len(found))}


def sine(mean: list, var: list, error_var: list) -> Values:
    """From E exp(i x); the errors by E sin² of the estimate and of the angle."""
    moments, errors = [], []
    for m, s, p in zip(exact(mean), exact(var), exact(error_var), strict=True):

        def square(v, m=m):
            return (1 - (-2 * v).exp() * (2 * m).cos()) / 2

        first = (-s / 2).exp() * m.sin()
        optimal = square(s) - (-p).exp() * square(s - p)
        plugin = square(s) + square(s - p) * (1 - 2 * (-p / 2).exp())
        moments.append((first, square(s) - first**2))
        errors.append((optimal, plugin))
    return _functions(moments, errors)


def modulus(mean: list, var: list, error_var: list) -> Values:
    """From E|x| of a normal variable, and integrals over its estimate."""
    moments, errors = [], []
    for m, s, p in zip(exact(mean), exact(var), exact(error_var), strict=True):
        first = _mean_modulus(m, s)
        moments.append((first, s + m * m - first**2))
        errors.append(_modulus_errors(m, s, p))
    return _functions(moments, errors)


def maximum(mean: list, cov: list, error_cov: list) -> Values:
    """max = (x1 + x2 + |d|) / 2 with d = x1 - x2; the errors are those of the modulus of d.

    To them comes the error ε of the sum, which does not depend on the estimate and has, by Stein's
    lemma, E ε|d| = cov(ε, d) E sign d.
    """
    moments, errors = [], []
    for m, C, P in zip(exact(mean), exact(cov), exact(error_cov), strict=True):
        # variances of sum and difference, and their covariance
        (S, D, SD), (s, d, sd) = (
            (trace + 2 * M[0, 1], trace - 2 * M[0, 1], M[0, 0] - M[1, 1])
            for M, trace in ((C, np.trace(C)), (P, np.trace(P)))
        )
        gap = m[0] - m[1]
        first = (m[0] + m[1] + _mean_modulus(gap, D)) / 2
        side = 2 * cdf(gap / D.sqrt()) - 1
        total = m[0] + m[1]
        product = total * _mean_modulus(gap, D) + SD * side
        second = (S + total**2 + 2 * product + D + gap**2) / 4
        best, rough = _modulus_errors(gap, D, d)
        errors.append(tuple((s + 2 * sd * side + part) / 4 for part in (best, rough)))
        moments.append((first, second - first**2))
    return _functions(moments, errors)


def _mean_modulus(m: Any, s: Any) -> Any:
    """E|x| for x ~ N(m, s)."""
    deviation = s.sqrt()
    return m * (2 * cdf(m / deviation) - 1) + 2 * deviation * phi(m / deviation)


def _modulus_errors(m: arb, s: arb, p: arb) -> tuple[arb, arb]:
    """Mean squares of |x| - E(|x| | x̂) and of |x| - |x̂| for x̂ ~ N(m, s - p), x ~ N(x̂, p)."""
    deviation, end = (s - p).sqrt(), arb(END)
    kink = -m / deviation

    def estimate(z):
        return m + deviation * z

    squares = integral(lambda z: _mean_modulus(estimate(z), p) ** 2 * phi(z), -end, end)
    cross = integral(lambda z: _mean_modulus(estimate(z), p) * estimate(z) * phi(z), kink, end)
    cross -= integral(lambda z: _mean_modulus(estimate(z), p) * estimate(z) * phi(z), -end, kink)
    # beyond the ends E|x| <= |z| (|m| + deviation + root p), and z² phi integrates to this
    beyond = (abs(m) + deviation + p.sqrt()) ** 2 * 2 * (end * phi(end) + cdf(-end))
    squares, cross = (part + arb(0, beyond.upper()) for part in (squares, cross))
    return s + m * m - squares, s + m * m + (s - p) + m * m - 2 * cross


def _functions(moments: list, errors: list) -> Values:
    first, variance = (list(part) for part in zip(*moments, strict=True))
    optimal, plugin = (list(part) for part in zip(*errors, strict=True))
    return {
        "mean": (first, [v.sqrt() for v in variance]),
        "variance": own(variance),
        "optimal error": own(optimal),
        "plug-in error": own(plugin),
    }


def steady_power(drift: str, noise: str, sensor_noise: str) -> Values:
    """Steady errors of x² for a scalar signal: the Riccati root is quadratic."""
    a, q, r = (exact(part) for part in (drift, noise, sensor_noise))
    P, C = r * (a + (a * a + q / r).sqrt()), -q / (2 * a)
    optimal = 4 * P * C - 2 * P * P
    return {"optimal error": own([optimal]), "plug-in error": own([optimal + P * P])}


def steady_energy(drift: list, noise: str, sensor_noise: str, weights: list) -> Values:
    """Steady errors of a quadratic form of two components, the second measured.

    The Riccati equation leaves one quartic with rational coefficients for the variance of the
    second component; the root whose covariance is positive definite is the only one.
    """
    (f, b), (c, d) = ([rational(part) for part in row] for row in drift)
    q, r, u = rational(noise), rational(sensor_noise), fmpq_poly([0, 1])
    s = (u * u / r - q - 2 * d * u) / (2 * c)
    p = (s * u / r - (f + d) * s - b * u) / c
    quartic = (2 * (f * p + b * s) + q - s * s / r).numer()
    covariances = []
    for root in (root.real for root, _ in quartic.complex_roots() if root.imag.contains(0)):
        first, cross = (
            sum((arb(part) * root**k for k, part in enumerate(poly.coeffs())), arb(0))
            for poly in (p, s)
        )
        if root > 0 and first * root - cross**2 > 0:
            covariances.append(np.array([[first, cross], [cross, root]], dtype=object))
    (P,) = covariances
    # the state itself: a linear equation for its covariance
    rates = fmpq_mat([[2 * f, 2 * b, 0], [c, f + d, b], [0, 2 * c, 2 * d]])
    xx, xy, yy = map(arb, rates.solve(fmpq_mat([[-q], [0], [-q]])).entries())
    C = np.array([[xx, xy], [xy, yy]], dtype=object)
    M = exact(weights) @ P
    optimal = 2 * np.trace(M @ M) + 4 * np.trace(M @ exact(weights) @ (C - P))
    plugin = optimal + np.trace(M) ** 2
    return {"optimal error": own([optimal]), "plug-in error": own([plugin])}


def delay_gains(dynamics: dict, sensor_var: float, steps: int) -> Values:
    """Optimal gains in fractions: the textbook's recursion of the stacked state.

    The first component is measured; noises and start have unit covariances.
    """
    size = 2 * (max(map(int, dynamics)) + 1)
    P = np.array([[Fraction(int(i == j)) for j in range(size)] for i in range(size)])
    F, Q = np.roll(P, 2, axis=0), P.copy()  # each state becomes the one before
    F[:2], Q[2:] = 0, 0
    for d, matrix in dynamics.items():
        F[:2, 2 * int(d) : 2 * int(d) + 2] = [[Fraction(part) for part in row] for row in matrix]
    gains, errors = [], []
    for _ in range(steps):
        P = F @ P @ F.T + Q
        gain = P[:, 0] / (P[0, 0] + Fraction(sensor_var))
        P = P - np.outer(gain, P[0])
        gains += [exact(part) for part in gain]
        errors += [exact(P[0, 0]), exact(P[1, 1])]
    return {
        "gain": (gains, [arb(float(max(map(abs, gains)).upper()))] * len(gains)),
        "variance": own(errors),
    }


def kalman(F: list, Q: list, H: list, R: list, mean0: list, cov0: list, y: list) -> Values:
    """A whole run: means, variances and log densities after each measurement."""
    F, Q = exact(F), exact(Q)
    return _run([mean0, cov0], lambda k, m, P: (F @ m, F @ P @ F.T + Q), H, R, y)


def designed(fits: list, start: list, H: list, R: list, y: list) -> Values:
    """A run of a filter that remembers its last estimate, with the numbers of its design."""

    def ahead(k, mean, _):
        gain, offset, cov = (exact(part) for part in fits[k - 1])
        return gain @ mean + offset, cov

    return _run(start, ahead, H, R, y)


def _run(dist: list, ahead: Callable, H: list, R: list, y: list) -> Values:
    H, R, dist, track = exact(H), exact(R), [exact(part) for part in dist], []
    for k, value in enumerate(exact(y)):
        *dist, loglik = _corrected(*(ahead(k, *dist) if k else dist), value[0], H[0], R[0, 0])
        track.append((*dist, loglik))
    return _track(track)


def imm(chain: list, F: list, Q: list, H: list, R: list, starts: list, y: list) -> Values:
    """A run of the interacting multiple model filter: the mode changes, then moves the state."""
    chain, F, Q, H, R = (exact(part) for part in (chain, F, Q, H, R))
    dists = [tuple(exact(part) for part in dist) for dist in starts]
    track, shares = [], []
    for k, value in enumerate(exact(y)):
        if k:
            moved = []
            for new in range(len(dists)):
                parts = [(chain[i, new] * p, m, P) for i, (p, m, P) in enumerate(dists)]
                mass, mean, cov = _merged(parts)
                moved.append((mass, F[new] @ mean, F[new] @ cov @ F[new].T + Q[new]))
            dists = moved
        likely = []
        for p, mean, cov in dists:
            *dist, loglik = _corrected(mean, cov, value[0], H[0], R[0, 0])
            likely.append((p * loglik.exp(), *dist))
        total, mean, cov = _merged(likely)
        dists = [(p / total, m, P) for p, m, P in likely]
        track.append((mean, cov, total.log()))
        shares.append(dists[1][0])
    return _track(track) | {"probability": (shares, [arb(1)] * len(shares))}


def _corrected(m: Any, P: Any, y: arb, h: Any, r: arb) -> tuple[Any, Any, arb]:
    """Mean, covariance and log density given one number y = h x + N(0, r)."""
    spread = h @ P @ h + r
    gain, error = P @ h / spread, y - h @ m
    loglik = -(error * error / spread + (2 * arb.pi() * spread).log()) / 2
    return m + gain * error, P - np.outer(gain, gain) * spread, loglik


def _merged(dists: list) -> tuple[arb, Any, Any]:
    """Mass, mean and covariance of a mixture of (mass, mean, cov)."""
    mass = sum((p for p, *_ in dists), arb(0))
    mean = sum(p * m for p, m, _ in dists) / mass
    cov = sum(p * (P + np.outer(m - mean, m - mean)) for p, m, P in dists) / mass
    return mass, mean, cov


def _track(track: list) -> Values:
    variances = [P[i, i] for _, P, _ in track for i in range(len(P))]
    return {
        "mean": ([x for m, *_ in track for x in m], [v.sqrt() for v in variances]),
        "variance": own(variances),
        "log density": ([part for *_, part in track], [arb(1)] * len(track)),
    }
