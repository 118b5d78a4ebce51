"""What each function refuses: the type of the error and the argument that it names."""

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import (
    abs_errors,
    abs_moments,
    bivariate_normal_cdf,
    cubature,
    elevation_moments,
    expectation,
    expectation_function,
    forms,
    gauss_hermite,
    hermite_expansion,
    interval,
    lift,
    max_errors,
    mean_of,
    mean_square_errors,
    norm_mean,
    pad_regions,
    polygon,
    posterior_variance_function,
    sine_errors,
    sine_moments,
    unscented,
)

x, y = sp.symbols("x y", real=True)
a = sp.Symbol("a")
EYE, ZERO, NAN = np.eye(2), np.zeros(2), np.nan
LEANING = [[1.0, 0.5], [0.4, 1.0]]
TRIANGLE = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
product = expectation_function(x * y, [x, y])
errors = mean_square_errors(x * y, [x, y])
variance = posterior_variance_function(x * y, [x, y])
growth = sp.exp(x)


def over(**change):
    return polygon(**{"mean": ZERO, "cov": EYE, "vertices": TRIANGLE, **change})


def lifted(mean=ZERO, cov=EYE):
    return lift(interval(0.0, 1.0, 0.0, 1.0), mean, cov)


REFUSALS = [
    # expressions and symbols
    (lambda: expectation(x, [x], [0, 1], sp.eye(1)), ValueError, "mean"),
    (lambda: expectation(x, [x], ["m"], sp.eye(1)), TypeError, "mean"),
    (lambda: expectation(x, [x], [0], sp.eye(2)), ValueError, "cov"),
    (lambda: expectation(x, [x, y], [0, 0], [[1, a], [2, 1]]), ValueError, "cov"),
    (lambda: expectation(x, [x], [0], sp.eye(1), parameters=[3]), TypeError, "parameters"),
    (lambda: expectation_function(a * x, [x]), ValueError, "f"),
    (lambda: expectation_function(sp.I * x, [x]), ValueError, "f"),
    (lambda: expectation_function([x, sp.oo], [x]), ValueError, "f"),
    (lambda: expectation_function((-2) ** x, [x]), ValueError, "f"),
    (lambda: expectation_function(sp.exp(sp.acos(2) * x), [x]), ValueError, "f"),
    (lambda: expectation_function(sp.acos(2) * x, [x]), ValueError, "f"),
    (lambda: expectation_function(sp.exp(1000) * x, [x]), ValueError, "f"),
    (lambda: expectation_function(sp.Heaviside(x - 10**400), [x]), ValueError, "f"),
    (lambda: expectation_function(0**x, [x]), ValueError, "f"),
    (lambda: expectation_function(sp.Function("g")(2) * x, [x]), ValueError, "f"),
    (lambda: expectation_function(x * sp.eye(2), [x]), ValueError, "f"),
    (lambda: expectation_function([], [x]), ValueError, "f"),
    (lambda: expectation_function("x", [x]), TypeError, "f"),
    (lambda: expectation_function(x > 0, [x]), TypeError, "f"),
    (lambda: expectation_function(x, x), TypeError, "variables"),
    # distributions
    (lambda: product([0, 0, 0], np.eye(3)), ValueError, "mean"),
    (lambda: product([0, NAN], EYE), ValueError, "mean"),
    (lambda: product([0, 1j], EYE), TypeError, "mean"),
    (lambda: product(ZERO, LEANING), ValueError, "cov"),
    (lambda: product(ZERO, -EYE), ValueError, "cov"),
    (lambda: product(np.zeros((2, 4)), np.zeros((2, 2, 3))), ValueError, "cov"),
    (lambda: product(np.zeros((2, 2)), np.stack([EYE, -EYE], axis=-1)), ValueError, "cov"),
    (lambda: product(np.zeros((2, 2)), np.stack([EYE, LEANING], axis=-1)), ValueError, "cov"),
    (lambda: expectation_function(growth, [x])([800.0], [[1.0]]), ValueError, "mean, cov"),
    (lambda: posterior_variance_function(growth, [x])([800.0], [[1.0]]), ValueError, "mean, cov"),
    (lambda: mean_square_errors(growth, [x])([800.0], [[1]], [[0.5]]), ValueError, "mean, cov"),
    (lambda: errors([0.0], EYE, EYE), ValueError, "mean"),
    (lambda: errors(ZERO, EYE, np.eye(3)), ValueError, "error_cov"),
    (lambda: errors(ZERO, EYE, 1.001 * EYE), ValueError, "error_cov"),
    (lambda: errors(ZERO, np.ones((2, 2)), 0.5 * EYE), ValueError, "error_cov"),
    (lambda: norm_mean([0, 0, 0], EYE), ValueError, "cov"),
    (lambda: norm_mean(0.0, [[1.0]]), ValueError, "mean"),
    (lambda: abs_moments(0.0, -1.0), ValueError, "var"),
    (lambda: abs_errors(0.0, 1.0, 1.1), ValueError, "error_var"),
    (lambda: sine_errors(0.0, [1.0, 2.0], [0.5, 2.5]), ValueError, "error_var"),
    (lambda: sine_moments(np.inf, 1.0), ValueError, "mean"),
    (lambda: max_errors(ZERO, EYE, 2 * EYE), ValueError, "error_cov"),
    (lambda: elevation_moments(np.zeros(3), np.zeros((3, 3))), ValueError, "mean"),
    (lambda: elevation_moments([0, 0, 1], np.diag([1, 1, 0])), ValueError, "cov"),
    (lambda: elevation_moments(np.zeros(3), np.diag([1, 1, 1e-12])), ValueError, "cov"),
    (lambda: bivariate_normal_cdf(NAN, 0, 0), ValueError, "h"),
    (lambda: bivariate_normal_cdf(0, 1j, 0), TypeError, "k"),
    (lambda: bivariate_normal_cdf(0, 0, 1.1), ValueError, "rho"),
    (lambda: forms.linear_mean(np.ones((2, 3)), ZERO, EYE), ValueError, "A"),
    (lambda: forms.quadratic_mean(np.eye(3), ZERO, EYE), ValueError, "A"),
    (lambda: hermite_expansion(sp.sin(x), [x], [0], [[1]], [[1]], degree=80), ValueError, "degree"),
    # rules
    (lambda: gauss_hermite(True, 3), TypeError, "n"),
    (lambda: gauss_hermite(2, 0), ValueError, "order"),
    (lambda: gauss_hermite(2, 1415), ValueError, "order"),
    (lambda: cubature(0), ValueError, "n"),
    (lambda: cubature([1]), TypeError, "n"),
    (lambda: unscented(2, -2.0), ValueError, "kappa"),
    (lambda: mean_of(lambda p: p[0], ZERO, -EYE, cubature(2)), ValueError, "cov"),
    (lambda: mean_of(lambda p: p[0], ZERO, EYE, cubature(3)), ValueError, "rule"),
    (lambda: mean_of(lambda p: p[:, :3], ZERO, EYE, cubature(2)), ValueError, "f"),
    # regions
    (lambda: interval(NAN, 1, 0, 1), ValueError, "mean"),
    (lambda: interval(0, -1, 0, 1), ValueError, "var"),
    (lambda: interval(0, 1, NAN, 1), ValueError, "lower"),
    (lambda: interval(0, 1, 0, NAN), ValueError, "upper"),
    (lambda: interval([0, 1, 2], 1, [0, 0], 1), ValueError, "mean"),
    (lambda: interval(0, 1, 0, 1).second([0.0, NAN]), ValueError, "about"),
    (lambda: over(mean=[0.0, NAN]), ValueError, "mean"),
    (lambda: over(cov=np.eye(3)), ValueError, "cov"),
    (lambda: over(cov=LEANING), ValueError, "cov"),
    (lambda: over(cov=[[1.0, 1.1], [1.1, 1.0]]), ValueError, "cov"),
    (lambda: over(cov=[[-1.0, 0.0], [0.0, 1.0]]), ValueError, "cov"),
    (lambda: over(vertices=[[0.0, 0.0], [1.0, NAN], [0.0, 1.0]]), ValueError, "vertices"),
    (lambda: over(vertices=[[0.0, 0.0, 0.0]]), ValueError, "vertices"),
    (lambda: over(vertices=np.ones((3, 2, 4)), mean=np.zeros((2, 3))), ValueError, "vertices"),
    (lambda: over(rays=[[1.0, 0.0]]), ValueError, "rays"),
    (lambda: over(rays=[[1.0, 0.0], [0.0, 0.0]]), ValueError, "rays"),
    (lambda: over().second(np.zeros(3)), ValueError, "about"),
    (lambda: pad_regions([TRIANGLE, [[1.0, 2.0, 3.0]]]), ValueError, "regions[1]"),
    (lambda: lifted(mean=[0.0, NAN]), ValueError, "mean"),
    (lambda: lifted(cov=np.eye(3)), ValueError, "cov"),
    (lambda: lifted(cov=[[1.0, 2.0], [2.0, 1.0]]), ValueError, "cov"),
    (lambda: lifted(np.zeros((2, 3)), np.zeros((2, 2, 4))), ValueError, "cov"),
    (lambda: lifted().second([1.0, 2.0, 3.0]), ValueError, "about"),
]


@pytest.mark.parametrize(("call", "error", "argument"), REFUSALS)
def test_refusal_names_the_argument(call, error, argument):
    with pytest.raises(error) as caught:
        call()
    message = str(caught.value)
    assert argument in (message.split("wanted")[0] or message)
