"""Covariances of exact Gaussian means keep their relative digits however small the variances."""

import numpy as np
import pytest
import sympy

from seedslib.extra import to_c
from seedslib.filters import assumed_density
from seedslib.linearization import ExactGaussian
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.maps import StochasticMap
from seedslib.models.noise import Noise

x, y, v = sympy.symbols("x y v", real=True)
MEAN = np.array([0.4, -0.7])
UNIT = np.array([[0.3, 0.1], [0.1, 0.2]])


def covariance(values, cov, noise=None, mean=MEAN):
    state = (x, y)[: len(mean)]
    map = StochasticMap(state, values, noise or Noise())
    return ExactGaussian().moments(map)(0.0, mean, cov).cov


@pytest.mark.parametrize("size", [1e-17, 1e-30, 1e-100])
def test_small_covariances_are_those_of_the_slopes(size):
    """To first order of the variance, which is all there is: cov = J P J'."""
    values = [
        sympy.sin(x + 2 * y),
        x * sympy.exp(y / 3) * sympy.cos(x),
        sympy.exp(-(x**2) / 2),
    ]
    slope = sympy.Matrix(values).jacobian((x, y)).subs({x: MEAN[0], y: MEAN[1]})
    slope = np.array(slope.evalf(25).tolist(), dtype=float)
    want = slope @ (size * UNIT) @ slope.T
    scale = np.sqrt(np.outer(want.diagonal(), want.diagonal()))
    assert (abs(covariance(values, size * UNIT) - want) <= 2e-15 * scale).all()


@pytest.mark.parametrize("value", [abs(x), sympy.Max(x, 0.25)])
def test_far_from_its_edge_a_kink_has_the_variance_of_its_side(value):
    for var in (1e-8, 1e-20):
        found = covariance([value], np.array([[var]]), mean=MEAN[:1])
        assert found[0, 0] == pytest.approx(var, rel=1e-15, abs=0)


def test_small_noise_inside_a_sine_keeps_its_digits():
    found = covariance(
        [sympy.sin(x + v) * sympy.exp(v)], np.zeros((1, 1)), Noise((v,), cov=[[1e-17]]), MEAN[:1]
    )
    want = 1e-17 * (np.cos(0.4) + np.sin(0.4)) ** 2
    assert found[0, 0] == pytest.approx(want, rel=2e-15, abs=0)


@pytest.mark.parametrize("mean", [0.0, 1e-9, 2.0])
def test_nothing_overflows_where_the_variance_is_large(mean):
    for value in (sympy.sin(x), sympy.cos(3 * x)):
        found = covariance([value], np.array([[1e200]]), mean=np.array([mean]))
        assert found[0, 0] == pytest.approx(0.5, rel=1e-15)


def test_exported_code_takes_the_difference_as_well():
    map = StochasticMap((x,), [sympy.sin(x)], Noise())
    sensor = StochasticMap((x,), [x + v], Noise((v,), cov=[[1.0]]))
    filter = assumed_density(DiscreteSystem(map, sensor, [0.5], [[1e-17]]))
    assert "expm1(" in to_c(filter)
