"""The state augmented by a function of it, and its extended Kalman-Bucy filter."""

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import expectation_function
from seedslib.two_step import (
    AugmentedDiffusion,
    KalmanBucyFilter,
    LinearDiffusion,
    augmented_extended_kalman,
)

X, Y, Z = sp.symbols("x y z", real=True)
SCALAR = LinearDiffusion(-1, 0.5, 1, 0.1, [0.3], 4)
PLANAR = LinearDiffusion(
    [[0.0, 1.0], [-2.0, -0.5]], [[0.4]], [[1, 0]], 0.2, [1, 0], np.eye(2), [[0.7], [1.5]]
)


def test_both_drifts_of_the_power():
    power = AugmentedDiffusion(SCALAR, X**2, [X], Z)
    assert sp.expand(power.drift - (-2 * X**2 + sp.Rational(1, 2))) == 0
    assert sp.expand(power.rewritten().drift - (-2 * Z + sp.Rational(1, 2))) == 0
    assert power.noise == sp.Matrix([[X]])
    first, mixed, spread = power.initial_moments()
    assert first == pytest.approx(4.09)
    np.testing.assert_allclose(mixed, [2 * 0.3 * 4])
    assert spread == pytest.approx(2 * 16 + 4 * 4 * 0.09)


@pytest.mark.parametrize("f", [X**2 * Y, sp.sin(X) * Y, sp.exp(X - Y)])
def test_drift_is_the_derivative_of_the_mean(f):
    """E f(x(h)) from one point, to first order in h, by the exact Gaussian mean."""
    augmented = AugmentedDiffusion(PLANAR, f, [X, Y], Z)
    point, mean = np.array([0.7, -0.4]), expectation_function(f, [X, Y])
    slopes = []
    for step in (1e-3, 5e-4):
        move, noise = PLANAR.transition(0.0, step)
        slopes.append((mean(move @ point, noise) - mean(point, np.zeros((2, 2)))) / step)
    exact = float(augmented.drift.subs({X: 0.7, Y: -0.4}))
    assert 2 * slopes[1] - slopes[0] == pytest.approx(exact, rel=1e-5)


def test_numeric_functions_of_a_drift_through_the_value():
    augmented = AugmentedDiffusion(PLANAR, X * Y, [X, Y], Z).rewritten()
    assert sp.expand(augmented.drift.subs(Z, X * Y) - augmented.ito_drift) == 0
    drift, by_state, by_value, noise, power = augmented.functions(
        np.array([[0.3, 1.0], [0.5, -2.0]]), np.array([0.1, 4.0])
    )
    x, y, z = np.array([0.3, 1.0]), np.array([0.5, -2.0]), np.array([0.1, 4.0])
    rates = 0.4 * np.outer([0.7, 1.5], [0.7, 1.5])
    np.testing.assert_allclose(drift, y * y - 2 * x * x - 0.5 * z + rates[0, 1])
    np.testing.assert_allclose(by_state, [-4 * x, 2 * y])
    np.testing.assert_allclose(by_value, -0.5)
    np.testing.assert_allclose(noise, rates @ [y, x])
    np.testing.assert_allclose(power, np.einsum("ik,ij,jk->k", [y, x], rates, [y, x]))


@pytest.mark.parametrize("rewritten", [False, True])
def test_one_step_of_the_filter_by_hand(rewritten):
    """A correction of (x, z) by the increment, then Euler's step of mean, covariance, variance."""
    augmented = AugmentedDiffusion(PLANAR, X * Y + X, [X, Y], Z)
    augmented = augmented.rewritten() if rewritten else augmented
    h, dy = 0.01, np.array([[[0.02, -0.05]]])
    found = augmented_extended_kalman(augmented, [0.0, h], dy)
    state = KalmanBucyFilter(PLANAR).run([0.0, h], dy)
    value, cross, spread = augmented.initial_moments()
    np.testing.assert_allclose(found.mean[0], value)
    np.testing.assert_allclose(found.variance[0], spread)
    gain = cross[0] / (1.0 + 0.2 / h)
    for path in range(2):
        z = value + gain * (dy[0, 0, path] / h - 1.0)
        left, moved = spread - gain * cross[0], cross - np.array([1.0, 0.0]) * gain
        at = np.array([state.mean[1][:, [path]], np.array([[z], [0.0]])])
        drift, by_state, by_value, _, power = (
            part[..., 0] for part in augmented.functions(at[0], at[1][0])
        )
        assert found.mean[1, path] == pytest.approx(z + h * drift, rel=1e-12)
        growth = 2 * (by_state @ moved + by_value * left) + power
        assert found.variance[1, path] == pytest.approx(left + h * growth, rel=1e-12)


def test_a_linear_function_is_filtered_exactly():
    times = np.linspace(0, 0.5, 2001)
    dy = PLANAR.simulate(times, 5, 3).increments
    state = KalmanBucyFilter(PLANAR).run(times, dy)
    linear = AugmentedDiffusion(PLANAR, 3 * X - 2 * Y + 1, [X, Y], Z)
    for system in (linear, linear.rewritten()):
        ours = augmented_extended_kalman(system, times, dy)
        wanted = 3 * state.mean[-1, 0] - 2 * state.mean[-1, 1] + 1
        np.testing.assert_allclose(ours.mean[-1], wanted, atol=0.02)
        variance = np.array([3, -2]) @ state.cov[-1] @ [3, -2]
        np.testing.assert_allclose(ours.variance[-1], variance, rtol=0.01)


def test_a_static_parameter_gives_the_best_linear_estimator():
    """With dz = 0 the variance that the filter claims is the linear one, exactly."""
    theta = LinearDiffusion(0, 0, 1, 1, [0], 2)
    times = np.linspace(0, 2, 2001)
    sample = theta.simulate(times, 20, 1)
    ours = augmented_extended_kalman(
        AugmentedDiffusion(theta, sp.sin(X), [X], Z), times, sample.increments
    )
    error_var = KalmanBucyFilter(theta).moments(times).error_cov[:, 0, 0]
    linear = 0.5 * (1 - np.exp(-4)) - np.exp(-2) * (2 - error_var)
    np.testing.assert_allclose(ours.variance, np.tile(linear[:, None], (1, 20)), atol=8e-4)
