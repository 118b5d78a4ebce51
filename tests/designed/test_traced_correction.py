"""Straight-line code for one path, against the general correction."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base import correct
from seedslib.designed.traced import mean_velocity, traced_correction
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import Noise, StochasticMap


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian()])
@pytest.mark.parametrize("system", [zoo.van_der_pol(), zoo.van_der_pol("D"), zoo.kicked_duffing()])
@pytest.mark.parametrize("rows", [1, 2])
def test_traced_lines_are_the_general_correction(rule, system, rows):
    rng = np.random.default_rng(0)
    traced = traced_correction(system.sensor, rule, rows)
    for _ in range(5):
        mean, root, y = (
            rng.normal(size=2),
            rng.normal(size=(2, 2)),
            rng.normal(size=system.sensor.size),
        )
        cov = root @ root.T
        expected = correct(mean, cov, y, rule.moments(system.sensor)(0.3, mean, cov), rows)
        for spread in (False, True):
            found = traced(0.3, mean, cov, y, spread)
            np.testing.assert_allclose(found[0], expected[0], rtol=1e-9, atol=1e-12)
            assert found[2] == pytest.approx(float(expected[2]), rel=1e-9)
            if spread:
                np.testing.assert_allclose(found[1], expected[1], rtol=1e-8, atol=1e-12)


def test_missing_and_redundant_measurements_are_left_to_the_general_correction():
    x, v = sympy.symbols("x v")
    double = StochasticMap((x,), [x + v, x + v], Noise((v,)))
    exact = StochasticMap((x,), [x], Noise(()))
    one = np.ones(1)
    traced = traced_correction(double, Taylor(), 1)
    assert traced(0.0, one, np.eye(1), np.array([1.0, 1.0]), True) is None
    assert traced(0.0, one, np.eye(1), np.array([1.0, np.nan]), True) is None
    assert traced_correction(exact, Taylor(), 1)(0.0, one, np.zeros((1, 1)), one, True) is None


def test_only_small_models_with_formulas_are_traced():
    x = sympy.symbols("x:5")
    large = StochasticMap(x, [x[0]], Noise(()))
    assert traced_correction(large, Taylor(), 1) is None
    assert traced_correction(zoo.van_der_pol().sensor, Cubature(), 2) is None


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian(), Cubature()])
def test_mean_velocity(rule):
    system = zoo.kicked_duffing()
    mean = np.random.default_rng(1).normal(size=(2, 6))
    cov = np.array([[0.3, 0.1], [0.1, 0.5]])
    expected = rule.moments(system.drift_map, spread=False)(0.0, mean, cov).mean
    found = mean_velocity(system, rule)(0.0, list(mean), cov)
    np.testing.assert_allclose(np.stack(found), expected, rtol=1e-12)
