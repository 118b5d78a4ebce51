"""Corners that nobody visits: six digits against a route in many, never NaN, never a wrong sign."""

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
    dist = [0.7], [[ratio]], [[1.0]]
    square = mean_square_errors(x**2, [x])(*dist)
    close(square.optimal, float(2 * mp.mpf(1) * (2 * mp.mpf(ratio) - 1 + 2 * mp.mpf("0.49"))))
    with mp.workdps(30):  # the density of the estimate is the same wherever the kink matters

        def lost(a):
            gap = 2 * (mp.npdf(a) - a * mp.ncdf(-a))
            return gap * (2 * a + gap)

        rare = 2 * mp.quad(lost, [0, 1, 3, 10]) / mp.sqrt(2 * mp.pi * (mp.mpf(ratio) - 1))
    for modulus in (abs_errors(0.7, ratio, 1.0), mean_square_errors(abs(x), [x])(*dist)):
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
