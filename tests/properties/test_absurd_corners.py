"""Corners that nobody visits: six digits against a route in many, never NaN, never a wrong sign."""

from functools import cache

import mpmath as mp
import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import (
    abs_errors,
    expectation_function,
    interval,
    lift,
    mean_square_errors,
    polygon,
)

x, y = sp.symbols("x y", real=True)
DIGITS = 1e-6


def close(found, exact, scale=None):
    """To six digits of itself, or of a scale that it is a part of."""
    assert np.isfinite(found)
    assert abs(float(found) - exact) <= DIGITS * abs(scale if scale is not None else exact)


def strip_moments(rho, low, high, left, right):
    """ln P, means and covariance of x, y in a box, by one integral over x in many digits."""
    with mp.workdps(40):
        rho, low, high = mp.mpf(rho), mp.mpf(low), mp.mpf(high)
        root = mp.sqrt((1 - rho) * (1 + rho))

        @cache  # the integrals share their nodes
        def inner(s):
            a, b = (low - rho * s) / root, (high - rho * s) / root
            # the smaller of the two tails keeps its digits
            a, b, sign = (a, b, 1) if a + b > 0 else (-b, -a, -1)
            mass = (mp.erfc(a / mp.sqrt(2)) - mp.erfc(b / mp.sqrt(2))) / 2
            first = mp.npdf(a) - mp.npdf(b)
            second = mass + a * mp.npdf(a) - b * mp.npdf(b)
            level = rho * s
            return (
                mass,
                level * mass + sign * root * first,
                level**2 * mass + 2 * level * sign * root * first + root**2 * second,
            )

        cuts = sorted(
            {mp.mpf(left), mp.mpf(right)}
            | {
                c
                for k in (-9, -4, 0, 4, 9)
                for e in (low, high)
                if left < (c := (e + k * root) / (rho or 1)) < right
            }
        )

        def integral(i, power):
            return mp.quad(lambda s: inner(s)[i] * s**power * mp.npdf(s), cuts)

        places = {"m": (0, 0), "x": (0, 1), "y": (1, 0), "xx": (0, 2), "xy": (1, 1), "yy": (2, 0)}
        sums = {name: integral(*place) for name, place in places.items()}
        mass = sums["m"]
        mx, my = sums["x"] / mass, sums["y"] / mass
        cov = sums["xx"] / mass - mx**2, sums["xy"] / mass - mx * my, sums["yy"] / mass - my**2
        return (*map(float, (mp.log(mass), mx, my, *cov)),)


@pytest.mark.parametrize(
    ("rho", "low", "high", "left", "right"),
    [
        (0.3, 0.5, 0.5 + 1e-10, -1.0, 2.0),  # strips 1e-10 wide
        (-0.9, 3.0, 3.0 + 1e-10, -6.0, 1.0),
        (0.0, -(2.0**-34), 2.0**-34, 4.0, 5.0),
        (1 - 2.0**-34, -1.0, 2.0, -0.5, 0.25),  # correlations beyond 1 - 1e-10
        (1 - 2.0**-40, 0.5, 2.0, -0.5, 0.5 + 2.0**-20),
        (2.0**-40 - 1, -1.0, 1.0, 0.5, 3.0),
        (1 - 2.0**-44, 1.0, 2.0, -3.0, 1.0),
        (0.5, 30.0, 30.0 + 1e-8, 14.0, 16.0),
    ],
)
def test_thin_strips_and_laws_that_are_nearly_a_line(rho, low, high, left, right):
    log_mass, mx, my, xx, xy, yy = strip_moments(rho, low, high, left, right)
    box = np.array([[left, low], [right, low], [right, high], [left, high]])
    found = polygon([0, 0], [[1, rho], [rho, 1]], box)
    close(found.log_mass, log_mass, max(1, abs(log_mass)))
    sx, sy = np.sqrt([xx, yy])
    close(found.mean[0], mx, sx / DIGITS * max(DIGITS, 4 * np.spacing(abs(mx)) / sx))
    close(found.mean[1], my, sy / DIGITS * max(DIGITS, 4 * np.spacing(abs(my)) / sy))
    close(found.cov[0, 0], xx)
    close(found.cov[1, 1], yy)
    close(found.cov[0, 1], xy, sx * sy)
    assert found.cov[0, 1] ** 2 <= found.cov[0, 0] * found.cov[1, 1] * (1 + DIGITS)


@pytest.mark.parametrize("ratio", [1e-12, 1e-14, 1e12])
def test_variances_of_unlike_neighbours(ratio):
    """A component far quieter than its neighbour: in a region, lifted, and in a mean."""
    deviation = np.sqrt(ratio)
    box = np.array([[-0.5, -0.2], [1.0, -0.2], [1.0, 0.7], [-0.5, 0.7]]) * [1.0, deviation]
    cov = np.array([[1.0, 0.6 * deviation], [0.6 * deviation, ratio]])
    plain = polygon([0, 0], [[1, 0.6], [0.6, 1]], box / [1.0, deviation])
    found = polygon([0, 0], cov, box)
    close(found.log_mass, float(plain.log_mass))
    close(found.cov[1, 1] / ratio, float(plain.cov[1, 1]))
    close(found.cov[0, 1] / deviation, float(plain.cov[0, 1]), float(plain.cov[1, 1]))
    lifted = lift(interval(0.0, 1.0, -0.5, 1.0), [0.0, 0.0], cov)
    part = interval(0.0, 1.0, -0.5, 1.0)
    close(lifted.cov[1, 1] / ratio, 0.64 + 0.36 * float(part.cov))
    close(lifted.mean[1] / deviation, 0.6 * float(part.mean))
    mean = expectation_function(x**2 * y**2, [x, y])([0.0, 0.0], cov)
    close(mean / ratio, 1 + 2 * 0.36)


@pytest.mark.parametrize("ratio", [1e10, 1e12, 1e15])
def test_errors_under_priors_far_wider_than_the_noise(ratio):
    """Optimal errors of a square, a modulus and a sine of a state known ten digits better."""
    law = [0.7], [[ratio]], [[1.0]]
    square = mean_square_errors(x**2, [x])(*law)
    close(square.optimal, float(2 * mp.mpf(1) * (2 * mp.mpf(ratio) - 1 + 2 * mp.mpf("0.49"))))
    with mp.workdps(30):  # the density of the estimate is the same wherever the kink matters

        def lost(a):
            gap = 2 * (mp.npdf(a) - a * mp.ncdf(-a))
            return gap * (2 * a + gap)

        rare = 2 * mp.quad(lost, [0, 1, 3, 10]) / mp.sqrt(2 * mp.pi * (mp.mpf(ratio) - 1))
    for modulus in (abs_errors(0.7, ratio, 1.0), mean_square_errors(abs(x), [x])(*law)):
        close(modulus.optimal, float(1 - rare))
        assert modulus.plugin >= modulus.optimal * (1 - DIGITS)
    small = mean_square_errors(sp.sin(x), [x])([0.7], [[2.0]], [[2.0 / ratio]])
    with mp.workdps(40):
        p = mp.mpf(2.0 / ratio)
        exact = (-mp.expm1(-p) + mp.expm1(p) * mp.exp(-4) * mp.cos(2 * mp.mpf(0.7))) / 2
    close(small.optimal, float(exact))
    assert small.plugin >= small.optimal * (1 - DIGITS)


@pytest.mark.parametrize("var", [1e-8, 1e-12, 1e-20])
def test_variances_of_functions_of_quiet_states(var):
    for f, slope in ((sp.sin(x), np.cos(0.7)), (abs(x), 1.0), (x**3, 3 * 0.49)):
        found = mean_square_errors(f, [x])([0.7], [[var]], [[var]])
        close(found.optimal, slope**2 * var)
