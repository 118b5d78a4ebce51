"""Hermite expansions: the hierarchy of polynomial estimators and its bounds."""

import warnings

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from oracles.gaussian import random_law
from seedslib.gaussian import approximate_errors, hermite_expansion, mean_square_errors

x, y, z = sp.symbols("x y z", real=True)


def random_case(rng, n):
    mean, known = random_law(rng, n)
    error_cov = 0.4 * random_law(rng, n)[1]
    return mean, known + error_cov, error_cov


def test_hierarchy_of_the_sine_goes_down_to_the_exact_error():
    expansion = hermite_expansion(sp.sin(x), [x], [0.0], [[2.0]], [[0.4]], degree=40)
    errors = expansion.degree_errors()[:, 0, 0]
    assert_allclose(errors[0], 0.5 * (1 - np.exp(-4)), rtol=1e-14)
    assert_allclose(errors[1], errors[0] - np.exp(-2) * 1.6, rtol=1e-13)
    assert np.all(np.diff(errors) <= 1e-15)
    exact = mean_square_errors(sp.sin(x), [x])([0.0], [[2.0]], [[0.4]]).optimal
    assert_allclose([expansion.lower()[0, 0], expansion.upper()[0, 0]], exact, rtol=1e-13)
    assert_allclose(errors[-1], exact, rtol=1e-3)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_estimators_of_a_polynomial_attain_their_predicted_errors(degree):
    """By simulation; the last one is the optimal estimator."""
    rng = np.random.default_rng(degree)
    mean, cov, error_cov = random_case(rng, 3)
    f = x * y * z - x**2 + z
    expansion = hermite_expansion(f, [x, y, z], mean, cov, error_cov)
    draws = 200_000
    xhat = mean[:, None] + np.linalg.cholesky(cov - error_cov) @ rng.normal(size=(3, draws))
    state = xhat + np.linalg.cholesky(error_cov) @ rng.normal(size=(3, draws))
    squares = (sp.lambdify((x, y, z), f)(*state) - expansion.estimate(xhat, degree)[0]) ** 2
    predicted = expansion.degree_errors()[degree, 0, 0]
    assert abs(squares.mean() - predicted) < 4 * squares.std() / np.sqrt(draws)
    exact = mean_square_errors(f, [x, y, z])(mean, cov, error_cov).optimal
    assert_allclose(expansion.degree_errors()[-1, 0, 0], exact, rtol=1e-12)


def test_linear_estimator_is_the_regression_and_ends_are_exact():
    mean, cov, error_cov = random_case(np.random.default_rng(7), 2)
    expansion = hermite_expansion(x**3 + y, [x, y], mean, cov, error_cov)
    slope = np.array([3 * (mean[0] ** 2 + cov[0, 0]), 1.0])
    level = mean[0] ** 3 + 3 * mean[0] * cov[0, 0] + mean[1]
    xhat = np.array([[0.3, -1.0], [2.0, 0.5]])
    regression = level + slope @ (xhat - mean[:, None])
    assert_allclose(expansion.estimate(xhat, 1)[0], regression, rtol=1e-12)
    silent = hermite_expansion(x**2 * y, [x, y], mean, cov, cov)
    assert_allclose(silent.degree_errors(), silent.degree_errors()[:1].repeat(4, 0))
    assert_allclose(silent.estimate(mean, 3), silent.estimate(mean, 0))
    known = hermite_expansion(x**2 * y, [x, y], mean, cov, np.zeros((2, 2)))
    assert_allclose(known.lower(), 0, atol=1e-15)
    assert_allclose(known.estimate([0.7, -0.4], 3), [0.49 * -0.4], rtol=1e-10)


@pytest.mark.parametrize(
    ("f", "symbols"),
    [(abs(x), [x]), (sp.exp(-8 * x**2), [x]), (sp.sin(9 * x), [x]), (sp.Max(x, y), [x, y])],
    ids=str,
)
def test_exact_error_lies_within_the_bounds_and_the_error_of_the_rule(f, symbols):
    law = [0.3] * len(symbols), 2 * np.eye(len(symbols)), 0.5 * np.eye(len(symbols))
    exact = mean_square_errors(f, symbols)(*law)
    with pytest.warns(UserWarning, match="quadrature rule"):
        expansion = hermite_expansion(f, symbols, *law)
    lower, upper = expansion.lower()[0, 0], expansion.upper()[0, 0]
    rule = expansion.rule_error[0, 0]
    assert lower - rule <= exact.optimal <= upper + rule
    with pytest.warns(UserWarning, match="quadrature rule"):
        bounds = approximate_errors(f, symbols)(*law)
    assert_allclose(bounds.plugin, exact.plugin, rtol=0.2)


@pytest.mark.filterwarnings("ignore:f. the quadrature rule of 30:UserWarning")
def test_approximate_errors_of_smooth_functions():
    law = [0.3], [[1.0]], [[0.2]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bounds = approximate_errors(sp.sin(x), [x], degree=30)(*law)
        exact = mean_square_errors(sp.sin(x), [x])(*law)
        assert_allclose(bounds, [exact.optimal, exact.optimal, exact.plugin], rtol=1e-12)
        arctan = approximate_errors(sp.atan(x), [x])(*law)
    assert arctan.lower < arctan.upper < arctan.plugin
    rng = np.random.default_rng(1)
    xhat = 0.3 + np.sqrt(0.8) * rng.normal(size=400_000)
    squares = (np.arctan(xhat + np.sqrt(0.2) * rng.normal(size=xhat.size)) - np.arctan(xhat)) ** 2
    assert abs(squares.mean() - arctan.plugin) < 4 * squares.std() / np.sqrt(xhat.size) + 1e-5
    vector = approximate_errors([sp.atan(x), y], [x, y], degree=8, nodes=30)
    found = vector([0.3, 0.1], np.eye(2), 0.2 * np.eye(2))
    assert_allclose(found.lower[1, 1], 0.2, rtol=1e-12)
    known = hermite_expansion(abs(x), [x], [1.0], [[0.0]], [[0.0]])
    assert not known.rule_error.any()
