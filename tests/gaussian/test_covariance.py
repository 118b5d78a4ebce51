"""Covariances of two functions, as the exact Gaussian linearization takes them."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose

from seedslib.gaussian import expectation
from seedslib.linearization import ExactGaussian
from seedslib.models import StochasticMap

x, y = sympy.symbols("x y", real=True)
exp, sin, cos, Abs = sympy.exp, sympy.sin, sympy.cos, sympy.Abs
HALF = sympy.S.Half
MEAN = np.array([0.4, -0.7])
COV = np.array([[0.6, -0.25], [-0.25, 0.9]])


def moments(values, mean, cov):
    return ExactGaussian().moments(StochasticMap((x, y), values))(0.0, mean, cov)


PAIRS = {
    "polynomials": (x**2 * y - x, x * y - y**3),
    "sines that swing against each other": (sin(x + 2 * y), cos(x - 3 * y)),
    "sines beside powers": (x * sin(y), y * cos(x) + sin(x)),
    "sums": (sin(x) + cos(2 * y) * x + exp(x / 3), cos(x - y) - sin(x)),
    "exponentials of unlike sign": (exp(x / 3), x * exp(-y / 2)),
    "two growing sines": (exp(x / 3) * cos(2 * y), y * exp(y / 4) * sin(x)),
    "a swinging bell and a sine": (exp(-(x**2)) * cos(x - y), sin(y) * x),
    "two swinging bells": (x * exp(-(x**2) / 2) * sin(x), exp(-(x**2) / 3 + x / 2) * cos(2 * x)),
    "a step and a power": (sympy.Heaviside(x - HALF, HALF), x * y),
    "a larger one and a step": (sympy.Max(x, y), sympy.Heaviside(x - y, HALF)),
    "both sides of a plane": (x + Abs(x), x * y * sympy.Heaviside(x, HALF)),
}


@pytest.mark.parametrize("pair", PAIRS)
def test_moments_of_pairs_against_sixty_digits(pair):
    """E f g - E f E g, and cov(x, f), from formulas of single means."""
    f, g = PAIRS[pair]
    dist = list(map(sympy.nsimplify, MEAN)), sympy.Matrix(COV).applyfunc(sympy.nsimplify)

    def mean(h):
        return sympy.re(expectation(sympy.expand(h), [x, y], *dist).evalf(60))

    found = moments([f, g], MEAN, COV)
    singles = [mean(f), mean(g)]
    for i, j in ((0, 0), (0, 1), (1, 1)):
        exact = float(mean((f, g)[i] * (f, g)[j]) - singles[i] * singles[j])
        assert found.cov[i, j] == pytest.approx(exact, rel=1e-12, abs=1e-14)
    for i, s in enumerate((x, y)):
        exact = [float(mean((s - dist[0][i]) * h)) for h in (f, g)]
        assert_allclose(found.cross[i], exact, rtol=1e-12, atol=1e-14)
    assert_allclose(found.mean, [float(s) for s in singles], rtol=1e-13)


@pytest.mark.parametrize(
    "values",
    [
        [sin(x + 2 * y), x * exp(y / 3) * cos(x), exp(-(x**2) / 2)],
        [Abs(x), y * sympy.Max(x, 0) + x, y**2],
    ],
)
def test_small_covariances_are_those_of_the_slopes(values):
    """To first order of the variance, which is all there is: cov = J P J'."""
    slope = sympy.Matrix(values).jacobian((x, y)).subs({x: MEAN[0], y: MEAN[1]})
    slope = np.array(slope.evalf(25).tolist(), dtype=float)
    for size, accuracy in ((1e-10, 1e-8), (1e-17, 1e-14), (1e-30, 1e-14)):
        exact = slope @ (size * COV) @ slope.T
        scale = np.sqrt(np.outer(exact.diagonal(), exact.diagonal()))
        assert (abs(moments(values, MEAN, size * COV).cov - exact) <= accuracy * scale).all()


def test_coefficients_that_depend_on_time_are_numbers_of_the_moment():
    t = sympy.Symbol("t")
    values = [sin(t * x) * y, exp(t * y / 3) * x, exp(-(x**2) / t)]
    found = ExactGaussian().moments(StochasticMap((x, y), values))(1.7, MEAN, COV)
    exact = moments([part.subs(t, 1.7) for part in values], MEAN, COV)
    for part, wanted in zip(found, exact, strict=True):
        assert_allclose(part, wanted, rtol=1e-13, atol=1e-15)
