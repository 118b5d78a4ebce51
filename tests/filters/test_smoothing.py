"""Smoothing against regression on all data, and published errors of a pendulum."""

import json
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from oracles.linear import Linear, Regression, discretised, kalman, moments
from seedslib.base import ELAPSED, Input
from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    smooth,
    unscented_kalman,
)
from seedslib.linearization import GaussHermite
from seedslib.models import DiscreteSystem, JumpDiffusion, LinearSystem, Noise, StochasticMap
from systems import (
    EVEN,
    INPUTS,
    TIMES,
    U,
    continuous_numbers,
    continuous_system,
    discrete_system,
    linear_numbers,
    linear_system,
    record,
)

DATA = Path(__file__).resolve().parents[1] / "data"
CASES = {
    "Kalman": lambda: (KalmanFilter(linear_system()), linear_numbers(means=False)),
    "Kalman, functions, even": lambda: (
        KalmanFilter(linear_system("functions")),
        linear_numbers(EVEN, means=False),
    ),
    "extended": lambda: (extended_kalman(discrete_system()), linear_numbers()),
    "unscented": lambda: (unscented_kalman(discrete_system()), linear_numbers()),
}


@pytest.mark.parametrize("name", CASES)
def test_smoothing_equals_regression(name):
    """Fixed interval and fixed lag, in blocks; the likelihood is that of the filter."""
    filter, model = CASES[name]()
    times = EVEN if "even" in name else TIMES
    exact, y = Regression(model), record(model)[1]
    for lag in (None, 1, 3):
        smoothed = smooth(filter, times, y, inputs=INPUTS, lag=lag)
        for k in range(7):
            mean, cov = exact.estimate(y, k, 6 if lag is None else min(k + lag, 6))
            np.testing.assert_allclose(smoothed.mean[k], mean, atol=1e-12)
            np.testing.assert_allclose(smoothed.cov[k], cov, atol=1e-12)
    run = filter.run(times, y, inputs=INPUTS)
    np.testing.assert_allclose(smoothed.loglik, run.loglik, rtol=1e-13)
    assert not smoothed.diverged
    # records with inputs and gaps of their own, in blocks
    many = np.stack([y, np.nan_to_num(y), y - 1.0], axis=-1)
    inputs = {u: values[:, None] * [1.0, -0.5, 2.0] for u, values in INPUTS.items()}
    whole = smooth(filter, times, many, inputs=inputs)
    filter.block = lambda *_: 2
    for i, lag in ((0, None), (2, None)):
        given = {u: values[:, i] for u, values in inputs.items()}
        alone = smooth(filter, times, many[..., i], inputs=given, lag=lag)
        np.testing.assert_allclose(whole.mean[..., i], alone.mean, atol=1e-12)
        np.testing.assert_allclose(whole.cov[..., i], alone.cov, atol=1e-12)
    folded = smooth(
        filter,
        times,
        many.reshape(7, 2, 1, 3),
        inputs={u: values.reshape(7, 1, 3) for u, values in inputs.items()},
    )
    for a, b in zip(folded, whole, strict=True):
        if b is not None:
            np.testing.assert_allclose(a, b.reshape(a.shape), atol=1e-12)


def test_steps_of_one_record_have_their_own_inputs_and_lengths():
    """All at once, as one by one in a batch, where each step differs by them alone."""
    u, dt = Input("u"), ELAPSED
    system = LinearSystem(
        [[1, dt], [0, sp.exp(-dt / 3)]],
        [[dt / 5, 0], [0, dt]],
        [[1, 0]],
        [[0.3]],
        [0.5, -1.0],
        np.eye(2),
        b=[u * dt, u],
    )
    assert system.dynamics.timeless
    times, rng = np.array([0.0, 0.3, 1.5, 1.7, 3.2, 3.3]), np.random.default_rng(3)
    y, pushes = rng.standard_normal((6, 1)), rng.standard_normal(6)
    y[2] = np.nan
    filter = KalmanFilter(system)
    one = smooth(filter, times, y, inputs={u: pushes})
    two = smooth(filter, times, np.stack([y, y], axis=-1), inputs={u: pushes})
    np.testing.assert_allclose(one.mean, two.mean[..., 0], atol=1e-12)
    np.testing.assert_allclose(one.cov, two.cov, atol=1e-12)


def test_smoothed_covariance_common_to_all_records_is_given_once():
    filter, y = extended_kalman(discrete_system()), record(linear_numbers())[1]
    many = np.stack([y, y + 1.0], axis=-1)
    one, two = (smooth(filter, TIMES, part, inputs=INPUTS) for part in (many, y))
    assert one.cov.shape == (7, 3, 3)
    np.testing.assert_allclose(one.cov, two.cov, atol=1e-14)


@pytest.mark.parametrize("make", [extended_kalman, unscented_kalman])
def test_smoothing_between_measurements_equals_the_exact_discretisation(make):
    model = discretised(continuous_numbers(jumps=False), TIMES, INPUTS[U])
    y, filter = record(model)[1], make(continuous_system(jumps=False))
    many = np.stack([y, y + 0.5], axis=-1)
    many[4, 1, 1] = np.nan  # until then the covariance is common to both records
    smoothed = smooth(filter, TIMES, many, inputs={U: INPUTS[U]})
    for i in range(2):
        mean, cov = Regression(model).smoothed(many[..., i])
        np.testing.assert_allclose(smoothed.mean[..., i], mean, atol=1e-7)
        np.testing.assert_allclose(smoothed.cov[..., i], cov, atol=1e-7)
    one = smooth(filter, TIMES, y, inputs={U: INPUTS[U]})
    np.testing.assert_allclose(one.mean, smoothed.mean[..., 0], atol=1e-12)


def test_smoothing_with_jumps_equals_the_backward_recursion():
    """The covariance with the next state is P Fᵀ, F the slope of the mean of the next state."""
    model, push, y = continuous_numbers(), INPUTS[U], record(linear_numbers())[1]
    sensor = Linear(None, None, None, *model.sensor(TIMES, push), model.mean0, model.cov0)
    forward = kalman(sensor, y, lambda k, m, P: moments(model, *TIMES[k : k + 2], m, P, push[k]))
    F = discretised(model, TIMES, push).F
    smoothed = smooth(assumed_density(continuous_system(step=0.025)), TIMES, y, inputs={U: push})
    mean, cov = forward.mean[-1], forward.cov[-1]
    for k in range(5, -1, -1):
        gain = np.linalg.solve(forward.predicted_cov[k + 1], F[k] @ forward.cov[k]).T
        mean = forward.mean[k] + gain @ (mean - forward.predicted_mean[k + 1])
        cov = forward.cov[k] + gain @ (cov - forward.predicted_cov[k + 1]) @ gain.T
        np.testing.assert_allclose(smoothed.mean[k], mean, rtol=1e-5)
        np.testing.assert_allclose(smoothed.cov[k], cov, rtol=1e-5)


@pytest.mark.parametrize(
    ("make", "filtered", "smoothed"),
    [
        (extended_kalman, 0.16830859061153763, 0.057446202494837),
        (cubature_kalman, 0.1141966031380275, 0.04064624229594188),
        (lambda s: unscented_kalman(s, kappa=1), 0.09524392125923083, 0.036617555415464256),
        (lambda s: CovarianceFilter(s, GaussHermite(5)), 0.0998062421916222, 0.03710181978632009),
    ],
)
def test_published_errors_of_the_pendulum(make, filtered, smoothed):
    """Of Särkkä and Svensson, to all their digits."""
    data = json.loads((DATA / "pendulum.json").read_text())
    dt, g = 0.01, 9.81
    x1, x2, q1, q2, r = sp.symbols("x1 x2 q1 q2 r")
    noise = Noise((q1, q2), cov=0.01 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
    move = StochasticMap((x1, x2), [x1 + dt * x2 + q1, x2 - g * dt * sp.sin(x1) + q2], noise)
    see = StochasticMap((x1, x2), [sp.sin(x1) + r], Noise((r,), cov=[[0.1]]))
    filter = make(DiscreteSystem(move, see, [0, 0], np.eye(2)))
    times, y = np.arange(501.0), np.concatenate([[np.nan], data["Y"]])[:, None]
    for part, wanted in ((filter.run(times, y), filtered), (smooth(filter, times, y), smoothed)):
        error = np.sqrt(np.mean((part.mean[1:, 0] - np.array(data["X"])[0]) ** 2))
        assert error == pytest.approx(wanted, rel=1e-11)


@pytest.mark.parametrize(
    ("make", "system"), [(extended_kalman, discrete_system), (KalmanFilter, linear_system)]
)
def test_record_beyond_the_bound_has_diverged_when_smoothed(make, system):
    y = record(linear_numbers())[1]
    many = np.stack([y, y + 3.0, y - 3.0, 2 * y], axis=-1)
    run = make(system()).run(TIMES, many, inputs=INPUTS)
    largest = np.abs(run.mean).max(axis=(0, 1))
    filter = make(system(), bound=np.sort(largest)[1:3].mean())
    smoothed = smooth(filter, TIMES, many, inputs=INPUTS)
    np.testing.assert_array_equal(smoothed.diverged, largest > filter.bound)
    assert smoothed.diverged.sum() == 2


def test_unscented_smoothing_of_an_oscillator_equals_the_extended_one():
    """Linear dynamics, of which one component has no noise of its own."""
    x1, x2, w = sp.symbols("x1 x2 w", real=True)
    drift, sensor_noise = [x2, -x1 - 0.4 * x2], Noise((w,), cov=[[0.25]])
    system = JumpDiffusion(
        (x1, x2), drift, [[0], [1]], [x1 + w], sensor_noise, [1, -0.5], np.eye(2), step=0.05
    )
    times = np.arange(11) * 0.5
    y = system.simulate(times, 3, 1).measurements
    one, other = (smooth(make(system), times, y) for make in (extended_kalman, unscented_kalman))
    np.testing.assert_allclose(other.mean, one.mean, atol=1e-9)
    np.testing.assert_allclose(np.broadcast_to(other.cov, one.cov.shape), one.cov, atol=1e-9)
