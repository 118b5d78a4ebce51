"""Linearizations that evaluate the map at points: sigma points and Gauss-Hermite nodes."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose

from seedslib import zoo
from seedslib.linearization import Cubature, GaussHermite, Unscented
from seedslib.models import Noise, StochasticMap

x, y, v, w = sympy.symbols("x y v w", real=True)
RULES = [Unscented(0.5, 2, 0), Unscented(), Cubature(), GaussHermite(3)]


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("size", [1, 2, 4])
def test_points_have_the_first_two_moments(rule, size):
    points, weights, centred = rule.rule(size)
    assert weights.sum() == pytest.approx(1)
    assert_allclose(points @ weights, 0, atol=1e-13)
    assert_allclose(np.einsum("is,js,s->ij", points, points, centred), np.eye(size), atol=1e-12)


@pytest.mark.parametrize(
    ("alpha", "beta", "kappa"), [(0.5, 2, 0), (1, 0, 2), (1e-2, 2, 0), (2, 0, -0.5), (0.7, -1, 3)]
)
def test_unscented_moments_of_a_square(alpha, beta, kappa):
    """Y = X²: E Y = m² + D and F = 4 m² D + (alpha² kappa + beta) D² for all parameters.

    With r = alpha² (1 + kappa) the points are m and m ± sqrt(r D), their values less the mean
    -D and ± 2 m sqrt(r D) + (r - 1) D; weights of squares 1 - 1/r + 1 - alpha² + beta and
    1 / (2 r) twice. Then F = (2 - 1/r - alpha² + beta) D² + 4 m² D + (r - 1)² D² / r.
    """
    mean, cov = np.array([[1.7, -0.2]]), np.array([[[0.6, 1.1]]])
    found = Unscented(alpha, beta, kappa).moments(StochasticMap((x,), [x**2]))(0.0, mean, cov)
    m, d = mean[0], cov[0, 0]
    close = {"rtol": 1e-13 / alpha**2, "atol": 1e-14}
    assert_allclose(found.mean[0], m**2 + d, **close)
    assert_allclose(found.cross[0, 0], 2 * m * d, **close)
    assert_allclose(found.cov[0, 0], 4 * m**2 * d + (alpha**2 * kappa + beta) * d**2, **close)


def test_nodes_take_maps_without_a_closed_form():
    rational = StochasticMap((x,), [1 / (1 + x**2) + v], Noise((v,)))
    dist = np.array([0.0]), np.array([[0.01]])
    found = GaussHermite(30).moments(rational)(0, *dist)
    assert_allclose(found.mean, [1 - 0.01 + 3e-4], atol=2e-5)


@pytest.mark.parametrize("rule", [Unscented(1, 0, 0), Cubature(), GaussHermite(7)])
def test_array_functions_with_known_conditional_moments_need_no_nodes_for_the_noise(rule):
    symbolic = zoo.kicked_duffing().sensor
    dist = np.array([0.4, -1.0]), np.array([[0.8, 0.3], [0.3, 0.5]])
    known = StochasticMap.from_functions(
        2,
        1,
        symbolic.value,
        symbolic.noise,
        mean=lambda t, x: symbolic.conditional_moments(t, x)[0],
        cov=lambda t, x: symbolic.conditional_moments(t, x)[1],
    )
    pairs = zip(rule.moments(known)(0, *dist), rule.moments(symbolic)(0, *dist), strict=True)
    for found, exact in pairs:
        assert_allclose(found, exact, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("rule", RULES)
def test_angle_on_the_seam_of_the_circle_is_averaged_about_its_first_point(rule):
    """Beside a component on a line; both as a formula and as an array function."""
    value = [sympy.atan2(sympy.sin(x), sympy.cos(x)) + v, 2 * x + w]
    noise = Noise((v, w), mean=[0.1, -0.2], cov=[[0.02, 0.01], [0.01, 0.05]])
    wrapped = StochasticMap((x,), value, noise, period={0: 2 * np.pi})
    straight = StochasticMap((x,), [x + v, 2 * x + w], noise)
    mean, cov = np.array([[np.pi - 0.05, -np.pi + 0.1]]), np.array([[[0.04, 0.02]]])
    exact = rule.moments(straight)(0.0, mean, cov)
    for map in (
        wrapped,
        StochasticMap.from_functions(1, 2, wrapped.value, noise, period={0: 2 * np.pi}),
    ):
        found = rule.moments(map)(0.0, mean, cov)
        turns = (found.mean - exact.mean) / (2 * np.pi)
        assert_allclose(turns, np.round(turns), atol=1e-12)
        assert_allclose(*np.broadcast_arrays(found.cross, exact.cross), atol=1e-12)
        assert_allclose(*np.broadcast_arrays(found.cov, exact.cov), atol=1e-12)
