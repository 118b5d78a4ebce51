"""The two-step estimator: functions of a linear state, exact errors, steady errors."""

import numpy as np
import pytest
import sympy as sp

from oracles.diffusion import constant_diffusion
from seedslib.gaussian import gauss_hermite, mean_of, norm_mean
from seedslib.two_step import LinearDiffusion, TwoStepEstimator, kalman_bucy

X, Y, A, B = sp.symbols("x y a b", real=True)
SIGNAL = LinearDiffusion(-1, 0.5, 1, 0.1, [0.7], 4)
PLANAR = constant_diffusion()
GRID = np.linspace(0.1, 0.6, 26)

FUNCTIONS = {
    "polynomial": (X**2 * Y + Y**3 - X, 1e-11),
    "exponential-polynomial": (sp.sin(X) * sp.exp(Y / 2), 1e-11),
    "tilt": (sp.exp(-(X**2) - Y**2 / 3), 1e-7),
    "piecewise": (sp.Max(X, Y), 3e-2),
    "norm": (sp.sqrt(X**2 + Y**2), 3e-2),
}
"""Functions with the accuracy that a rule of 32 nodes has for them: at a kink it is poor."""


def estimator(f, **options):
    return TwoStepEstimator(PLANAR, f, variables=[X, Y], **options)


def test_the_power_of_a_signal_in_closed_form():
    """x² under N(x̂, P): mean x̂² + P, variance 2 P² + 4 x̂² P; on average over x̂ ~ N(m, C - P)."""
    power = TwoStepEstimator(SIGNAL, X**2, variables=[X])
    times = [0.0, 0.1, 1.1, 4.0]
    mean, c, p = (part.ravel() for part in SIGNAL.moments(times))
    optimal, plugin = power.errors(times)
    np.testing.assert_allclose(optimal, 2 * p**2 + 4 * p * (mean**2 + c - p), rtol=1e-12)
    np.testing.assert_allclose(plugin - optimal, p**2, rtol=1e-9)
    assert power.estimate([0.3], [[0.2]]) == pytest.approx(0.29, rel=1e-14)
    assert power.variance([0.3], [[0.2]]) == pytest.approx(0.08 + 4 * 0.09 * 0.2, rel=1e-14)
    assert power.plugin([0.3]) == pytest.approx(0.09, rel=1e-14)
    steady, late = power.steady_errors(), power.errors([40.0])
    np.testing.assert_allclose(np.ravel(steady), np.ravel(late), rtol=1e-9)
    loss = steady.plugin / steady.optimal - 1  # it depends on q / (r a²) alone
    assert loss == pytest.approx(0.5 / np.sqrt(1 + 0.5 / 0.1), rel=1e-11)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_closed_forms_against_quadrature_and_draws(name):
    f, accuracy = FUNCTIONS[name]
    ours, function, rule = estimator(f), sp.lambdify([X, Y], f), gauss_hermite(2, 32)
    mean, cov = np.array([[0.4, -1.0], [0.2, 0.5]]), np.array([[0.4, 0.1], [0.1, 0.2]])
    first, second = (mean_of(lambda p, k=k: function(*p) ** k, mean, cov, rule) for k in (1, 2))
    np.testing.assert_allclose(ours.estimate(mean, cov), first, rtol=accuracy)
    np.testing.assert_allclose(ours.variance(mean, cov), second - first**2, rtol=accuracy)
    np.testing.assert_allclose(ours.plugin(mean), function(*mean), rtol=1e-14)
    mean, cov, error_cov = (part[0] for part in PLANAR.moments([0.4]))
    rng = np.random.default_rng(4)
    guess = rng.multivariate_normal(mean, cov - error_cov, 50_000).T
    truth = function(*(guess + rng.multivariate_normal([0, 0], error_cov, 50_000).T))
    estimates = ours.estimate(guess, error_cov), ours.plugin(guess)
    for exact, estimate in zip(ours.errors([0.4]), estimates, strict=True):
        squares = (truth - estimate) ** 2
        assert abs(squares.mean() - exact[0]) < 4 * squares.std() / np.sqrt(squares.size)
    point = np.array([0.3, -0.8])  # no error of the state, no error of the function
    assert ours.estimate(point, np.zeros((2, 2))) == pytest.approx(float(ours.plugin(point)))
    assert ours.variance(point, np.zeros((2, 2))) == pytest.approx(0.0, abs=1e-14)


def test_vector_functions_by_closed_forms():
    f, cov = [X * Y, X**2], np.array([[0.4, 0.1], [0.1, 0.2]])
    both, mean = estimator(f), np.array([[0.4, -1.0], [0.2, 0.5]])
    np.testing.assert_allclose(
        both.estimate(mean, cov), [mean[0] * mean[1] + 0.1, mean[0] ** 2 + 0.4], rtol=1e-13
    )
    exact = np.zeros((2, 2, 2))
    for j, (m, n) in enumerate(mean.T):  # products of Gaussian variables, by Isserlis
        exact[0, 0, j] = m * m * 0.2 + n * n * 0.4 + 2 * m * n * 0.1 + 0.08 + 0.01
        exact[0, 1, j] = exact[1, 0, j] = 2 * m * n * 0.4 + 2 * m * m * 0.1 + 2 * 0.4 * 0.1
        exact[1, 1, j] = 4 * m * m * 0.4 + 2 * 0.16
    np.testing.assert_allclose(both.variance(mean, cov), exact, rtol=1e-12)
    np.testing.assert_allclose(both.plugin(mean), [mean[0] * mean[1], mean[0] ** 2], rtol=1e-14)
    together = both.errors([0.0, 0.5])
    assert together.optimal.shape == together.plugin.shape == (2, 2, 2)
    for k, single in enumerate((estimator(X * Y), estimator(X**2))):
        for one, two in zip(together, single.errors([0.0, 0.5]), strict=True):
            np.testing.assert_allclose(one[:, k, k], two, rtol=1e-13)


def test_functions_of_state_and_estimate():
    """The length of the error has one optimal estimate, whatever the data; and a product."""
    length = estimator(sp.sqrt((X - A) ** 2 + (Y - B) ** 2), estimate_variables=[A, B])
    times = [0.0, 0.5]
    optimal, plugin = length.errors(times)
    for k, p in enumerate(PLANAR.moments(times).error_cov):
        assert optimal[k] == pytest.approx(np.trace(p) - norm_mean([0, 0], p) ** 2, rel=1e-11)
        assert plugin[k] == pytest.approx(np.trace(p), rel=1e-12)
    cov = np.array([[0.4, 0.1], [0.1, 0.2]])
    np.testing.assert_allclose(
        length.estimate(np.ones((2, 3)), cov), norm_mean([0, 0], cov), rtol=1e-13
    )
    np.testing.assert_array_equal(length.plugin(np.ones((2, 3))), 0.0)
    product = estimator((X - A) * (Y - B) + A * Y, estimate_variables=[A, B])
    assert product.estimate([0.7, 0.3], cov) == pytest.approx(0.1 + 0.21, rel=1e-12)
    wanted = 0.4 * 0.2 + 0.1**2 + 0.7**2 * 0.2
    assert product.variance([0.7, 0.3], cov) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("f", [X**2 * Y + Y**3, sp.sin(X) + Y, [X * Y, X**2 - Y]])
def test_a_run_is_the_two_steps_one_after_the_other(f):
    ours = estimator(f)
    increments = PLANAR.simulate(GRID, 6, 1).increments.reshape(25, 2, 3, 2)
    run, first = ours.run(GRID, increments), kalman_bucy(PLANAR, GRID, increments)
    for k in range(26):
        dist = first.mean[k], first.cov[k]
        np.testing.assert_allclose(run.mean[k], ours.estimate(*dist), rtol=1e-11, atol=1e-13)
        np.testing.assert_allclose(run.variance[k], ours.variance(*dist), rtol=1e-10)
        np.testing.assert_allclose(run.plugin[k], ours.plugin(dist[0]), rtol=1e-11, atol=1e-13)
    alone = ours.run(GRID, increments[..., 1, 1])
    np.testing.assert_allclose(alone.mean, run.mean[..., 1, 1], rtol=1e-10)
