import numpy as np
import pytest
import sympy as sp

from seedslib.two_step import (
    AugmentedDiffusion,
    KalmanBucyFilter,
    LinearDiffusion,
    TwoStepEstimator,
    augmented_extended_kalman,
)

X, Z = sp.symbols("x z", real=True)
SIGNAL = LinearDiffusion(-1, 0.5, 1, 0.1, [0], 4)


def squared_errors(paths, until, rate=500):
    times = np.linspace(0, until, until * rate + 1)
    sample = SIGNAL.simulate(times, paths, 0)
    truth = sample.states[:, 0] ** 2
    power = AugmentedDiffusion(SIGNAL, X**2, [X], Z)
    values = {
        "two-step": TwoStepEstimator(SIGNAL, X**2, variables=[X]).run(times, sample.increments),
        "through z": augmented_extended_kalman(power.rewritten(), times, sample.increments),
        "through x": augmented_extended_kalman(power, times, sample.increments),
    }
    return times, {name: (value.mean - truth) ** 2 for name, value in values.items()}


def test_the_representation_of_the_drift_decides():
    """Section 2.3 with example 6: one drift is 5 % worse than the optimum, the other fails."""
    times, squares = squared_errors(1000, 8)
    steady = {name: value[times >= 5].mean() for name, value in squares.items()}
    early = {name: value[250].mean() for name, value in squares.items()}
    # paired on the same paths: the difference of means over blocks of paths has this error
    difference = (squares["through z"] - squares["two-step"])[times >= 5].mean(axis=0)
    assert difference.mean() > 2 * difference.std() / np.sqrt(difference.size)
    assert steady["through z"] / steady["two-step"] == pytest.approx(1.05, abs=0.03)
    assert early["through z"] > 2.5 * early["two-step"]
    assert steady["through x"] > 15


def test_a_static_parameter_gives_the_best_linear_estimator():
    """Example 3: dz = 0, and the variance that the filter claims is the linear one, exactly."""
    theta = LinearDiffusion(0, 0, 1, 1, [0], 2)
    times = np.linspace(0, 2, 4001)
    sample = theta.simulate(times, 400, 1)
    sine = AugmentedDiffusion(theta, sp.sin(X), [X], Z)
    ours = augmented_extended_kalman(sine, times, sample.increments)
    error_var = KalmanBucyFilter(theta).moments(times).error_cov[:, 0, 0]
    linear = 0.5 * (1 - np.exp(-4)) - np.exp(-2) * (2 - error_var)
    np.testing.assert_allclose(ours.variance, np.tile(linear[:, None], (1, 400)), atol=4e-4)
    assert linear[-1] == pytest.approx(0.27431, abs=5e-6)
    # the estimate is the linear one, E f + D1 (x̂ - m)
    state = KalmanBucyFilter(theta).run(times, sample.increments).mean[-1, 0]
    np.testing.assert_allclose(ours.mean[-1], np.exp(-1) * state, atol=5e-3)


def test_a_linear_function_is_filtered_exactly():
    linear = AugmentedDiffusion(SIGNAL, 3 * X + 1, [X], Z)
    times = np.linspace(0, 1, 4001)
    sample = SIGNAL.simulate(times, 5, 3)
    state = KalmanBucyFilter(SIGNAL).run(times, sample.increments)
    for system in (linear, linear.rewritten()):
        ours = augmented_extended_kalman(system, times, sample.increments)
        np.testing.assert_allclose(ours.mean[-1], 3 * state.mean[-1, 0] + 1, atol=0.02)
        np.testing.assert_allclose(ours.variance[-1], 9 * state.cov[-1, 0, 0], rtol=0.01)


def test_bad_input():
    power = AugmentedDiffusion(SIGNAL, X**2, [X], Z)
    with pytest.raises(ValueError, match="grid from time 0"):
        augmented_extended_kalman(power, [0.1, 0.2], np.zeros((1, 1, 3)))
    with pytest.raises(ValueError, match="increments: wanted shape"):
        augmented_extended_kalman(power, [0.0, 0.2], np.zeros((1, 3)))
