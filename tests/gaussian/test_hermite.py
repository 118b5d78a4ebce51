"""Hermite expansions: the hierarchy of polynomial estimators and its bounds."""

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from seedslib.gaussian import hermite_expansion, mean_square_errors
from seedslib.gaussian.errors.hermite import quadrature_expansion

x, y, z = sp.symbols("x y z")


def random_case(rng, n):
    root, error = rng.normal(size=(2, n, n))
    P = 0.4 * error @ error.T
    return rng.normal(size=n), root @ root.T + P, P


def test_hierarchy_of_the_sine():
    # variance 2, unit measurement intensity, time 2
    expansion = hermite_expansion(sp.sin(x), [x], [0.0], [[2.0]], [[0.4]], degree=40)
    errors = expansion.degree_errors()[:, 0, 0]
    assert_allclose(errors[[1, 3, 5]], [0.2743, 0.1819, 0.1701], atol=5e-5)
    assert_allclose(errors[-1], 0.16934, atol=5e-6)
    assert_allclose(errors[0], 0.5 * (1 - np.exp(-4)), rtol=1e-14)
    assert_allclose(errors[1], errors[0] - np.exp(-2) * 1.6, rtol=1e-13)
    assert np.all(np.diff(errors) <= 1e-15)
    exact = mean_square_errors(sp.sin(x), [x])([0.0], [[2.0]], [[0.4]]).optimal
    assert_allclose([expansion.lower()[0, 0], expansion.upper()[0, 0]], exact, rtol=1e-13)


def test_hierarchy_ends_in_the_optimal_estimator_of_a_polynomial():
    rng = np.random.default_rng(0)
    mean, cov, error_cov = random_case(rng, 2)
    f = [x**2 * y - y, x + x * y]
    expansion = hermite_expansion(f, [x, y], mean, cov, error_cov)
    errors = expansion.degree_errors()
    assert_allclose(errors[-1], mean_square_errors(f, [x, y])(mean, cov, error_cov).optimal)
    for higher, lower in zip(errors[1:], errors, strict=False):
        assert np.linalg.eigvalsh(lower - higher)[0] > -1e-12 * np.abs(lower).max()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_estimators_attain_their_predicted_errors(degree):
    rng = np.random.default_rng(degree)
    mean, cov, error_cov = random_case(rng, 3)
    f = x * y * z - x**2 + z
    expansion = hermite_expansion(f, [x, y, z], mean, cov, error_cov)
    draws = 200_000
    xhat = mean[:, None] + np.linalg.cholesky(cov - error_cov) @ rng.normal(size=(3, draws))
    state = xhat + np.linalg.cholesky(error_cov) @ rng.normal(size=(3, draws))
    value = sp.lambdify((x, y, z), f)(*state)
    squares = (value - expansion.estimate(xhat, degree)[0]) ** 2
    predicted = expansion.degree_errors()[degree, 0, 0]
    assert abs(squares.mean() - predicted) < 4 * squares.std() / np.sqrt(draws)


def test_linear_estimator_is_the_regression():
    mean, cov, error_cov = random_case(np.random.default_rng(7), 2)
    expansion = hermite_expansion(x**3 + y, [x, y], mean, cov, error_cov)
    slope = np.array([3 * (mean[0] ** 2 + cov[0, 0]), 1.0])
    level = mean[0] ** 3 + 3 * mean[0] * cov[0, 0] + mean[1]
    xhat = np.array([[0.3, -1.0], [2.0, 0.5]])
    expected = level + slope @ (xhat - mean[:, None])
    assert_allclose(expansion.estimate(xhat, 1)[0], expected, rtol=1e-12)


def test_no_information_and_full_information():
    mean, cov, _ = random_case(np.random.default_rng(3), 2)
    f = x**2 * y
    silent = hermite_expansion(f, [x, y], mean, cov, cov)
    assert_allclose(silent.degree_errors(), silent.degree_errors()[:1].repeat(4, 0))
    assert_allclose(silent.estimate(mean, 3), silent.estimate(mean, 0))
    exact = hermite_expansion(f, [x, y], mean, cov, np.zeros((2, 2)))
    assert_allclose(exact.lower(), 0, atol=1e-15)
    point = np.array([0.7, -0.4])
    assert_allclose(exact.estimate(point, 3), [0.49 * -0.4], rtol=1e-10)


def test_bounds_enclose_the_error_of_a_smooth_function():
    # arctan, whose error is found here by nested quadrature over the estimate and its error
    mean, cov, error_cov = 0.2, 1.0, 0.3
    points, weights = np.polynomial.legendre.leggauss(400)
    points, weights = 9 * points, 9 * weights * np.exp(-0.5 * (9 * points) ** 2)
    weights = weights / weights.sum()
    xhat = mean + np.sqrt(cov - error_cov) * points
    values = np.arctan(xhat[:, None] + np.sqrt(error_cov) * points)
    variance = values**2 @ weights - (values @ weights) ** 2
    exact = weights @ variance
    law = ([mean], [[cov]], [[error_cov]])
    widths = []
    for degree in (2, 6, 12, 20):
        expansion = hermite_expansion(sp.atan(x), [x], *law, degree=degree, nodes=150)
        lower, upper = expansion.lower()[0, 0], expansion.upper()[0, 0]
        assert lower < exact < upper
        widths.append(upper - lower)
    assert widths == sorted(widths, reverse=True)
    assert widths[-1] < 1e-4 * exact


@pytest.mark.filterwarnings("ignore:f. the quadrature rule:UserWarning")
def test_a_kink_costs_the_accuracy_of_the_rule():
    law = ([0.2], [[1.0]], [[0.3]])
    exact = mean_square_errors(abs(x), [x])(*law).optimal
    expansion = hermite_expansion(abs(x), [x], *law, degree=30, nodes=2000)
    assert_allclose([expansion.lower()[0, 0], expansion.upper()[0, 0]], exact, rtol=0.02)


def test_only_the_coordinates_of_the_function_count():
    rng = np.random.default_rng(1)
    mean, cov, error_cov = random_case(rng, 6)
    symbols = sp.symbols("u0:6")
    f = sp.sin(symbols[4]) * symbols[1]
    expansion = hermite_expansion(f, symbols, mean, cov, error_cov, degree=12, nodes=40)
    assert expansion.coordinates == (1, 4)
    exact = mean_square_errors(f, symbols)(mean, cov, error_cov).optimal
    assert expansion.lower()[0, 0] <= exact * (1 + 1e-12)
    assert expansion.upper()[0, 0] >= exact * (1 - 1e-12)
    assert expansion.estimate(rng.normal(size=(6, 3)), 2).shape == (1, 3)


def test_bad_input_is_refused():
    law = np.zeros(1), np.eye(1), 0.5 * np.eye(1)
    with pytest.raises(ValueError, match="degree"):
        quadrature_expansion(np.sin, *law, degree=20, nodes=20)
    with pytest.raises(ValueError, match="finite"), np.errstate(divide="ignore"):
        quadrature_expansion(lambda u: 1 / u, *law, degree=2, nodes=3)
    with pytest.raises(ValueError, match="points"):
        quadrature_expansion(np.sin, np.zeros(4), np.eye(4), np.eye(4))
    with pytest.raises(ValueError, match="exceeds"):
        hermite_expansion(x, [x], [0.0], [[1.0]], [[1.1]])
    many = sp.symbols("w:30")
    with pytest.raises(ValueError, match="at most"):
        hermite_expansion(sum(many) + x**5, [*many, x], np.zeros(31), np.eye(31), np.eye(31))
