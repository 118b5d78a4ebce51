"""Steady errors of a function that does not see what has no steady law; means blamed as means."""

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import expectation_function, max_moments, norm_mean
from seedslib.models import JumpDiffusion, Noise, StochasticMap
from seedslib.piecewise import PiecewiseLinearSystem
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion, TwoStepEstimator

X, Y, Z = sp.symbols("x y z")


def alone():
    return LinearDiffusion(
        drift=-1, noise_intensity=0.5, sensor=1, sensor_intensity=0.1, mean0=0, cov0=4
    )


def beside(sensor, drift=None, intensity=None):
    """The same first component beside one that wanders (or grows)."""
    return LinearDiffusion(
        drift=np.diag([-1.0, 0.0]) if drift is None else drift,
        noise_intensity=np.diag([0.5, 0.3]),
        sensor=sensor,
        sensor_intensity=0.1 * np.eye(len(sensor)),
        mean0=[0.0, 0.0],
        cov0=np.diag([4.0, 1.0]),
    )


@pytest.mark.parametrize("lead", [0.0, 0.4])
@pytest.mark.parametrize(
    "sensor", [[[1.0, 0.0], [0.0, 1.0]], [[1.0, 0.0]]], ids=["detectable", "unseen"]
)
@pytest.mark.parametrize("growth", [0.0, 0.7])
def test_a_component_of_its_own_changes_nothing(sensor, lead, growth):
    system = beside(sensor, drift=np.diag([-1.0, growth]))
    for f in (X**2, sp.sin(X), [X, X**3]):
        got = TwoStepEstimator(system, f, variables=[X, Y], lead=lead).steady_errors()
        wanted = TwoStepEstimator(alone(), f, variables=[X], lead=lead).steady_errors()
        np.testing.assert_allclose(got.optimal, wanted.optimal, rtol=1e-10)
        np.testing.assert_allclose(got.plugin, wanted.plugin, rtol=1e-10)


def test_a_shared_sensor_is_a_limit_of_long_times():
    """The sensor sees the sum: the wandering part disturbs, and stays in the error."""
    system = beside([[1.0, 1.0]])
    estimator = TwoStepEstimator(system, X**2, variables=[X, Y])
    steady, late = estimator.steady_errors(), estimator.errors([40.0])
    assert steady.optimal == pytest.approx(late.optimal[0], rel=1e-8)
    assert steady.plugin == pytest.approx(late.plugin[0], rel=1e-8)
    assert steady.optimal > 1.1 * TwoStepEstimator(alone(), X**2, variables=[X]).steady_errors()[0]


def test_what_moves_the_used_component_must_be_steady_too():
    driven = beside([[1.0, 0.0], [0.0, 1.0]], drift=np.array([[-1.0, 1.0], [0.0, 0.0]]))
    for system, f in ((driven, X), (beside(np.eye(2)), Y), (beside(np.eye(2)), X * Y)):
        with pytest.raises(ValueError, match="Hurwitz"):
            TwoStepEstimator(system, f, variables=[X, Y]).steady_errors()
    with pytest.raises(ValueError, match="Hurwitz"):
        KalmanBucyFilter(beside(np.eye(2))).steady_moments()


WRONG_MEANS = {
    "linear diffusion": (
        lambda: LinearDiffusion(
            -np.eye(2), np.eye(2), np.eye(2), np.eye(2), mean0=[0, 0, 0], cov0=np.eye(2)
        ),
        r"mean0, cov0: .* got \(3,\) and \(2, 2\)",
    ),
    "piecewise": (
        lambda: PiecewiseLinearSystem(
            [-np.inf, 0, np.inf], (np.zeros(2), np.eye(2)), (np.zeros(1), np.ones((1, 2))),
            np.eye(1), [0.0, 0.0, 0.0], np.eye(2),
        ),
        r"mean0, cov0: .* got \(3,\) and \(2, 2\)",
    ),
    "functions": (
        lambda: JumpDiffusion.from_functions(
            lambda t, x: x, lambda t, x: x[:, None], StochasticMap((X, Y), [X]), [0.0], np.eye(2)
        ),
        r"mean0: wanted shape \(2\), got \(1,\)",
    ),
    "noise": (lambda: Noise((X, Y), [0.0] * 3), r"mean: wanted a number or shape \(2,\)"),
    "mean of a function": (
        lambda: expectation_function(X * Y, [X, Y])([0.0], np.eye(2)),
        r"mean: wanted 2 components, got shape \(1,\)",
    ),
    "maximum": (lambda: max_moments([0.0], np.eye(2)), "mean: wanted 2 components"),
    "norm": (lambda: norm_mean([0.0] * 3, np.eye(2)), r"mean, cov: .* got \(3,\) and \(2, 2\)"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_MEANS)
def test_a_wrong_mean_is_not_blamed_on_the_covariance(name):
    call, message = WRONG_MEANS[name]
    with pytest.raises(ValueError, match=message):
        call()
