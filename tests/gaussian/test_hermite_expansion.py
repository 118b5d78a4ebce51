"""Hermite expansions: the hierarchy of polynomial estimators and its bounds."""

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from oracles.gaussian import random_dist
from seedslib.gaussian import hermite_expansion, mean_square_errors

x, y, z = sp.symbols("x y z", real=True)


def random_case(rng, n):
    mean, known = random_dist(rng, n)
    error_cov = 0.4 * random_dist(rng, n)[1]
    return mean, known + error_cov, error_cov


def test_hierarchy_of_the_sine_goes_down_to_the_exact_error():
    expansion = hermite_expansion(sp.sin(x), [x], [0.0], [[2.0]], [[0.4]], degree=40)
    errors = expansion.degree_errors()[:, 0, 0]
    assert_allclose(errors[0], 0.5 * (1 - np.exp(-4)), rtol=1e-14)
    assert_allclose(errors[1], errors[0] - np.exp(-2) * 1.6, rtol=1e-13)
    assert np.all(np.diff(errors) <= 1e-15)
    exact = mean_square_errors(sp.sin(x), [x])([0.0], [[2.0]], [[0.4]]).optimal
    assert_allclose(
        [expansion.optimal_error()[0, 0], expansion.degree_errors()[-1][0, 0]], exact, rtol=1e-13
    )
    assert_allclose(errors[-1], exact, rtol=1e-3)


def test_last_estimator_of_a_polynomial_is_the_optimal_one():
    mean, cov, error_cov = random_case(np.random.default_rng(1), 3)
    f = x * y * z - x**2 + z
    expansion = hermite_expansion(f, [x, y, z], mean, cov, error_cov)
    exact = mean_square_errors(f, [x, y, z])(mean, cov, error_cov).optimal
    assert expansion.degree_errors().shape == (4, 1, 1)
    assert_allclose(expansion.degree_errors()[-1, 0, 0], exact, rtol=1e-12)


def test_linear_estimator_is_the_regression_and_ends_are_exact():
    mean, cov, error_cov = random_case(np.random.default_rng(7), 2)
    expansion = hermite_expansion(x**3 + y, [x, y], mean, cov, error_cov)
    slope = np.array([3 * (mean[0] ** 2 + cov[0, 0]), 1.0])
    gained = slope @ (cov - error_cov) @ slope
    first = expansion.degree_errors()[:2, 0, 0]
    assert_allclose(first[0] - first[1], gained, rtol=1e-12)
    silent = hermite_expansion(x**2 * y, [x, y], mean, cov, cov)
    assert_allclose(silent.degree_errors(), silent.degree_errors()[:1].repeat(4, 0))
    known = hermite_expansion(x**2 * y, [x, y], mean, cov, np.zeros((2, 2)))
    assert_allclose(known.optimal_error(), 0, atol=1e-15)


@pytest.mark.parametrize("f", [sp.sin(x), sp.exp(-(x**2) / 2), [sp.erf(x), y]], ids=str)
def test_bounds_of_smooth_functions_hold_the_error_of_nested_quadrature(f):
    dist = [0.3, 0.1], np.eye(2), 0.2 * np.eye(2)
    expansion = hermite_expansion(f, [x, y], *dist, degree=24, nodes=50)
    grid, weights = np.polynomial.hermite_e.hermegauss(120)
    weights = weights / weights.sum()
    xhat = 0.3 + np.sqrt(0.8) * grid
    values = sp.lambdify(x, f[0] if isinstance(f, list) else f, ["scipy", "numpy"])(
        xhat[:, None] + np.sqrt(0.2) * grid
    )
    exact = weights @ ((values**2) @ weights - (values @ weights) ** 2)
    assert expansion.optimal_error()[0, 0] <= exact * (1 + 1e-4)
    assert exact <= expansion.degree_errors()[-1][0, 0] * (1 + 1e-4)
    if isinstance(f, list):
        assert_allclose(expansion.optimal_error()[1, 1], 0.2, rtol=1e-12)
