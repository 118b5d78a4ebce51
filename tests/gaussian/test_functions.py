"""Modulus, maximum and sine: moments and exact errors against integrals in many digits."""

import mpmath as mp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from oracles.gaussian import panels
from seedslib.gaussian import (
    abs_errors,
    abs_moments,
    max_errors,
    max_moments,
    sine_errors,
    sine_moments,
)

MU = np.array([0.3, -0.2])
P = np.array([[0.5, 0.1], [0.1, 0.3]])
SIGMA = np.array([[1.0, -0.4], [-0.4, 0.8]])


def split_rule(kink, mean, deviation):
    """Points and weights under N(mean, deviation²), split at a kink."""
    edges = np.unique(np.clip([-11.0, -4.0, (kink - mean) / deviation, 4.0, 11.0], -11, 11))
    z, weights = panels(edges)
    return mean + deviation * z, weights * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)


def clark(mean, cov, digits=30):
    """Mean and variance of the larger of two, as printed by Clark, where nothing cancels."""
    with mp.workdps(digits):
        m1, m2 = map(mp.mpf, mean)
        a, b, c = (mp.mpf(float(cov[i])) for i in ((0, 0), (1, 1), (0, 1)))
        s = mp.sqrt(a + b - 2 * c)
        p, q, phi = mp.ncdf((m1 - m2) / s), mp.ncdf((m2 - m1) / s), mp.npdf((m1 - m2) / s)
        first = m1 * p + m2 * q + s * phi
        second = (m1**2 + a) * p + (m2**2 + b) * q + (m1 + m2) * s * phi
        return float(first), float(second - first**2)


def errors_by_simulation(state, optimal, plugin, found):
    """Whether two mean squares are those of the draws, within four standard errors."""
    for exact, guess in ((found.optimal, optimal), (found.plugin, plugin)):
        squares = (state - guess) ** 2
        assert abs(squares.mean() - exact) < 4 * squares.std() / np.sqrt(squares.size)


def test_modulus_of_degenerate_dists_and_without_information():
    ends = abs_moments([0.0, -2.0, 0.0, 1e9], [0.0, 0.0, 1.0, 1.0])
    assert_allclose(ends.mean, [0, 2, np.sqrt(2 / np.pi), 1e9], rtol=1e-15)
    assert_allclose(ends.var, [0, 0, 1 - 2 / np.pi, 1], rtol=1e-14)
    found = abs_errors([1.0, 1.0, 0.0, 0.0], [1.0, 1.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0])
    first = abs_moments(1.0, 1.0)
    assert_allclose(found.optimal, [0, first.var, 0, 1 - 2 / np.pi], rtol=1e-14)
    assert_allclose(found.plugin, [0, 3.0 - 2 * first.mean, 0, 1.0], rtol=1e-14)
    moved = abs_errors(3.0, 1.0, 0.3, origin=2.0)
    assert moved.optimal == pytest.approx(float(abs_errors(1.0, 1.0, 0.3).optimal), rel=1e-15)


@pytest.mark.parametrize("seed", range(4))
def test_maximum_against_clark_and_quadrature(seed):
    rng = np.random.default_rng(seed)
    mean, factor = rng.normal(size=2), rng.normal(size=(2, 2))
    cov = factor @ factor.T
    found = max_moments(mean, cov)
    assert found == pytest.approx(clark(mean, cov), rel=1e-11)
    # max = x2 + (x1 - x2)+, integrated over the difference
    root = np.sqrt(cov[0, 0] + cov[1, 1] - 2 * cov[0, 1])
    u, w = split_rule(0.0, mean[0] - mean[1], root)
    slope = (cov[0, 1] - cov[1, 1]) / root**2
    level = mean[1] + slope * (u - mean[0] + mean[1]) + np.maximum(u, 0)
    rest = cov[1, 1] - slope**2 * root**2
    assert found.mean == pytest.approx(w @ level, rel=1e-12, abs=1e-13)
    assert found.var == pytest.approx(rest + w @ (level - w @ level) ** 2, rel=1e-11)


def test_variance_of_the_maximum_of_unlike_scales():
    rng = np.random.default_rng(7)
    for _ in range(100):
        deviations = 10 ** rng.uniform(-4, 4, 2)
        cross = rng.choice([0.0, rng.uniform(-1, 1), 1 - 1e-6]) * deviations.prod()
        cov = np.array([[deviations[0] ** 2, cross], [cross, deviations[1] ** 2]])
        wide = np.sqrt(cov[0, 0] + cov[1, 1] - 2 * cross)
        mean = [0.0, rng.choice([rng.uniform(-12, 12) * wide, 10 ** rng.uniform(-4, 4)])]
        found = max_moments(mean, cov).var
        assert found == pytest.approx(clark(mean, cov, 400)[1], rel=1e-13), (mean, cov)


@pytest.mark.parametrize(
    ("mean", "cov", "variance"),
    [
        ([-1e6, 0.0], np.diag([1e9, 1e-9]), 1e-9),
        ([50.0, 0.0], np.array([[4.0, 1.0], [1.0, 9.0]]), 4.0),
        ([0.0, 0.0], np.eye(2), 1 - 1 / np.pi),
        ([3.0, 3.0], np.ones((2, 2)), 1.0),
        ([2.0, 2.0], np.zeros((2, 2)), 0.0),
    ],
)
def test_maximum_at_the_ends(mean, cov, variance):
    for dist in ((mean, cov), (mean[::-1], cov[::-1, ::-1])):
        assert max_moments(*dist).var == pytest.approx(variance, rel=1e-14)
        assert max_errors(*dist, dist[1]).optimal == pytest.approx(variance, rel=1e-14)
        assert max_errors(*dist, np.zeros((2, 2))) == (0.0, 0.0)
    assert max_moments([1.0, 2.0], np.ones((2, 2))).mean == 2.0
    assert max_moments(np.ones((2, 3, 4)), np.eye(2)).var.shape == (3, 4)


def test_errors_of_the_maximum_with_a_difference_that_is_nearly_known():
    """The limit of an estimate that does not vary: the conditional moments themselves."""
    error_cov = np.array([[2.0, 0.3], [0.3, 1.0]])
    for small in (1e-9, 1e-12, 0.0):
        cov = error_cov + small * np.diag([1.0, 0.0])
        found = max_errors([1.0, -2.0], cov, error_cov).optimal
        assert found == pytest.approx(max_moments([1.0, -2.0], error_cov).var, rel=1e-8)


def test_errors_of_the_maximum_against_simulation():
    rng = np.random.default_rng(2)
    estimate = rng.multivariate_normal(MU, SIGMA, 300_000).T
    state = estimate + rng.multivariate_normal([0, 0], P, 300_000).T
    found = max_errors(MU, P + SIGMA, P)
    guesses = max_moments(estimate, P).mean, estimate.max(axis=0)
    errors_by_simulation(state.max(axis=0), *guesses, found)
    nothing = max_errors(MU, P + SIGMA, P + SIGMA)
    first, variance = clark(MU, P + SIGMA)
    assert nothing.plugin == pytest.approx(variance + (first - MU[0]) ** 2, rel=1e-13)


@pytest.mark.parametrize(
    ("mean", "var", "error_var"), [(0, 2, 0.7), (0.4, 1.5, 1.2), (2.0, 0.3, 0.3)]
)
def test_sine_against_the_printed_constants(mean, var, error_var):
    k1 = 0.5 * (1 - np.exp(-2 * var) * np.cos(2 * mean))
    k2 = np.exp(-error_var / 2) - np.exp(-(4 * var - 3 * error_var) / 2) * np.cos(2 * mean)
    k3 = 0.5 * (1 - np.exp(-2 * (var - error_var)) * np.cos(2 * mean))
    shrink = np.exp(-error_var / 2)
    found = sine_errors(mean, var, error_var)
    assert found.optimal == pytest.approx(k1 - shrink * k2 + shrink**2 * k3, rel=1e-13)
    assert found.plugin == pytest.approx(k1 - k2 + k3, rel=1e-13)


def test_sine_errors_at_the_ends():
    """A small variance at the crest, where the slope is zero; no and all information."""
    with mp.workdps(50):
        p, v, m = mp.mpf(1e-9), mp.mpf(1e-8), mp.mpf(np.pi / 2)
        exact = (-mp.expm1(-p) + mp.expm1(p) * mp.exp(-2 * v) * mp.cos(2 * m)) / 2
    assert sine_errors(np.pi / 2, 1e-8, 1e-9).optimal == pytest.approx(float(exact), rel=1e-14)
    assert sine_errors(0.3, 1e4, 1e4).optimal == 0.5
    assert sine_errors(0.3, 2.0, 0.0) == (0.0, 0.0)
    assert sine_moments(0.5, 0.0) == (np.sin(0.5), 0.0)
