"""Rows of branches, rates and moments that ask for no more than they need."""

import numpy as np
import pytest
import sympy
from scipy.special import ndtr

from seedslib import zoo
from seedslib.base import Parameter, assigned
from seedslib.gaussian import NoClosedForm
from seedslib.linearization import (
    Cubature,
    ExactGaussian,
    GaussHermite,
    Linearization,
    Matrices,
    Taylor,
    Unscented,
)
from seedslib.models import JumpDiffusion, LinearSystem, Noise, StochasticMap

x, v, w = sympy.symbols("x v w", real=True)
LAW = np.array([[0.3, -1.1]]), np.array([[[0.7, 0.2]]])


@pytest.mark.parametrize("rule", [Unscented(), Cubature(), GaussHermite(6)])
def test_branches_that_share_a_value_have_weights_of_their_own(rule):
    """Given the branch the mean of y depends on its weight, where the weight mentions the noise."""
    readings = [branch.map for branch in zoo.dependent_switching().readings[1]]
    for maps in (readings, readings[::-1]):
        for got, map in zip(rule.row(maps)(0.0, *LAW), maps, strict=True):
            (want,) = rule.row([map])(0.0, *LAW)
            for a, b in zip((got.mass, *got.state, *got.value), (want.mass, *want.state,
                            *want.value), strict=True):  # fmt: skip
                np.testing.assert_allclose(a, b, rtol=1e-13)
    one, two = rule.row(readings)(0.0, *LAW)
    assert np.abs(one.value.mean - two.value.mean).min() > 0.01
    np.testing.assert_allclose(one.mass + two.mass, 1.0)


STEP = sympy.erf(x / sympy.sqrt(2))


def test_rates_need_no_squares_of_drift_and_spread():
    """dX = erf dt + sqrt(2 + erf) dB: the means have closed forms, those of squares have none."""
    system = JumpDiffusion((x,), [STEP], [[sympy.sqrt(2 + STEP)]], [x + w], Noise((w,)),
                           [0.0], [[1.0]])  # fmt: skip
    with pytest.raises(NoClosedForm):
        ExactGaussian().moments(system.drift_map)
    with pytest.raises(NoClosedForm):
        ExactGaussian().moments(system.spread_map)
    (m,), ((p,),) = LAW
    far = m / np.sqrt(1 + p)
    mean, density = 2 * ndtr(far) - 1, np.exp(-(far**2) / 2) / np.sqrt(2 * np.pi * (1 + p))
    want = [mean, 2 * p * 2 * density + 2 + mean]
    for found in (
        ExactGaussian().rate(system)(0.0, [m, p]),
        Linearization.rate(ExactGaussian(), system)(0.0, [m, p]),
    ):
        np.testing.assert_allclose(found, want, rtol=1e-12)


def test_moments_of_matrices():
    F, Q = np.array([[0.9, 0.2, -0.4], [0.3, 0.7, 0.5]]), np.array([[1.0, 0.3], [0.3, 0.5]])
    G, R = np.array([[0.5, -0.2], [0.1, 0.8]]), np.array([[0.4, 0.1, 0], [0.1, 0.3, 0], [0, 0, 2]])
    system = LinearSystem(G, Q, F.T, R, [0, 0], np.eye(2))
    rng = np.random.default_rng(2)
    mean, root = rng.standard_normal((2, 5)), rng.standard_normal((2, 2, 5))
    cov = np.einsum("ik...,jk...->ij...", root, root)
    rule = Matrices()
    for map, slope, noise in ((system.dynamics, G, Q), (system.sensor, F.T, R)):
        for law in ((mean, cov), (mean, cov[..., 2]), (mean[:, 1], cov[..., 2])):
            y, cross, spread = rule.moments(map)(0.0, *law)
            np.testing.assert_allclose(y, slope @ law[0], rtol=1e-13)
            np.testing.assert_allclose(
                cross, np.einsum("ij...,kj->ik...", law[1], slope), atol=1e-14
            )
            square = np.einsum("ij,jk...,lk->il...", slope, law[1], slope)
            tail = (1,) * (square.ndim - 2)
            np.testing.assert_allclose(
                spread, square + noise.reshape(*noise.shape, *tail), rtol=1e-13
            )
            np.testing.assert_array_equal(spread, np.swapaxes(spread, 0, 1))
            without = rule.moments(map, spread=False)(0.0, *law)
            assert without.cov is None
            np.testing.assert_array_equal(without.mean, y)
            np.testing.assert_array_equal(without.cross, cross)
    with pytest.raises(TypeError, match="map: wanted one of a LinearSystem"):
        rule.moments(StochasticMap((x,), [x]))


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian(), Unscented(), GaussHermite(4)])
def test_a_forecast_is_the_mean_and_covariance_of_the_moments(rule):
    map = StochasticMap((x,), [x + v * x / 3 + x**2 / 5], Noise((v,), [0.4], [[0.6]]))
    y = rule.moments(map)(0.0, *LAW)
    for forecast in (rule.transition(map), Linearization.transition(rule, map)):
        found = forecast(0.0, *LAW)
        np.testing.assert_allclose(found.mean, y.mean, rtol=1e-13)
        np.testing.assert_allclose(found.cov, y.cov, rtol=1e-13)
    branch = StochasticMap((x,), [x], weight=sympy.Rational(1, 3))
    for ask in (rule.transition, rule.moments):
        with pytest.raises(ValueError, match="wanted a map that always applies, got a branch"):
            ask(branch)


def test_a_derived_formula_sees_the_parameter_of_the_moment():

    a = Parameter("a", 2.0)
    found = ExactGaussian().moments(StochasticMap((x,), [a * x**2 + v], Noise((v,))))
    (m,), ((p,),) = LAW
    np.testing.assert_allclose(found(0.0, *LAW).mean[0], 2 * (m**2 + p))
    with assigned({a: -0.5}):
        np.testing.assert_allclose(found(0.0, *LAW).mean[0], -0.5 * (m**2 + p))
        np.testing.assert_allclose(found(0.0, *LAW).cov[0, 0], 1 + 0.25 * (4 * m**2 * p + 2 * p**2))
