"""The Kalman-Bucy filter against its equations, integrated; its smoother and its steady state."""

import numpy as np
import pytest

from oracles.diffusion import (
    constant_diffusion,
    filtered,
    smoothed,
    start_law,
    transition,
    varying_diffusion,
)
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion

SYSTEMS = {"constant": constant_diffusion(), "varying": varying_diffusion()}
LATE = np.array([0.3, 0.35, 0.42, 0.5, 0.62])  # late, uneven


def close(found, exact, tolerance=1e-9):
    np.testing.assert_allclose(found, exact, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("lead", [0.0, 0.4])
def test_moments_against_their_differential_equations(name, lead):
    system = SYSTEMS[name]
    times = [0.05, 0.4, 1.3]
    found = KalmanBucyFilter(system).moments(times, lead)
    for k, t in enumerate(times):
        move, noise = transition(system, t, t + lead)
        mean, cov = start_law(system, t + lead)
        close(found.mean[k], mean)
        close(found.cov[k], cov)
        error_cov = filtered(system, [0.0, t])[1][-1]
        close(found.error_cov[k], move @ error_cov @ move.T + noise)
    start = KalmanBucyFilter(system).moments([0.0])
    np.testing.assert_array_equal(start.error_cov[0], system.cov0)


@pytest.mark.parametrize("a", [-1.0, 0.7])
@pytest.mark.parametrize("r", [1e-4, 30.0])
def test_scalar_moments_in_closed_form(a, r):
    q, s0, times = 0.5, 4.0, np.array([0.0, 1e-5, 0.1, 1.1, 50.0])
    found = KalmanBucyFilter(LinearDiffusion(a, q, 1, r, [2.0], s0)).moments(times)
    g = np.sqrt(a * a + q / r)
    high, low = r * (a + g), r * (a - g)
    decay = (s0 - high) / (s0 - low) * np.exp(-2 * g * times)
    np.testing.assert_allclose(
        found.error_cov[:, 0, 0], (high - low * decay) / (1 - decay), rtol=1e-12
    )
    growth = np.exp(2 * a * times)
    np.testing.assert_allclose(
        found.cov[:, 0, 0], s0 * growth + q / (2 * a) * (growth - 1), rtol=1e-12
    )
    np.testing.assert_allclose(found.mean[:, 0], 2.0 * np.exp(a * times), rtol=1e-12)


def test_a_parameter_without_dynamics():
    system = LinearDiffusion(0.0, 0.0, 1, 0.2, [0.0], 1.5)
    found = KalmanBucyFilter(system).moments([0.0, 0.5, 1e4])
    exact = 1.5 / (1 + np.array([0.0, 0.5, 1e4]) * 1.5 / 0.2)
    np.testing.assert_allclose(found.error_cov[:, 0, 0], exact, rtol=1e-12)
    assert (found.cov == 1.5).all()
    with pytest.raises(ValueError, match="undamped"):
        KalmanBucyFilter(system).steady_error_cov()


@pytest.mark.parametrize("name", SYSTEMS)
def test_prediction_of_a_law(name):
    system = SYSTEMS[name]
    mean, cov = np.ones((2, 3, 4)) * [[[1.0]], [[-2.0]]], np.array([[0.5, 0.2], [0.2, 0.3]])
    found = KalmanBucyFilter(system).predict(mean, cov, 0.3, 0.8)
    move, noise = transition(system, 0.3, 0.8)
    close(found[0][:, 1, 2], move @ [1.0, -2.0])
    assert found[0].shape == (2, 3, 4)
    close(found[1], move @ cov @ move.T + noise)


def record(system, paths=3):
    """Increments (K, m, paths) with gaps common to all paths."""
    dy = system.simulate(LATE, paths, 5).increments.copy()
    dy[1] = dy[2, 0] = np.nan
    return dy


@pytest.mark.parametrize("name", SYSTEMS)
def test_run_equals_the_filter_of_constant_rates(name):
    """On a late and uneven grid, with a component and a whole step missing."""
    system = SYSTEMS[name]
    dy = record(system, 6).reshape(4, 2, 2, 3)
    found = KalmanBucyFilter(system).run(LATE, dy)
    assert found.mean.shape == (5, 2, 2, 3)
    for path in ((0, 1), (1, 2)):
        mean, cov, _ = filtered(system, LATE, dy[(..., *path)])
        close(found.mean[(..., *path)], mean)
        close(found.cov, cov)
    alone = KalmanBucyFilter(system).run(LATE, dy[..., 1, 2])
    np.testing.assert_allclose(alone.mean, found.mean[..., 1, 2], rtol=1e-12)
    if name == "constant":  # nothing is frozen
        whole = KalmanBucyFilter(system).run(LATE - 0.3, np.nan_to_num(dy)).cov
        close(whole, KalmanBucyFilter(system).moments(LATE - 0.3).error_cov, 1e-11)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("lag", [None, 2])
def test_smoothing_obeys_the_equations_of_rauch(name, lag):
    system = SYSTEMS[name]
    kalman, dy = KalmanBucyFilter(system), record(system)
    found = kalman.smooth(LATE, dy, lag=lag)
    law = kalman.smoothed_moments(LATE, lag=lag)
    ends = [5] * 5 if lag is None else [3, 4, 5, 5, 5]
    for end in set(ends):
        mean, cov = smoothed(system, LATE[:end], dy[: end - 1, :, 1])
        error_cov = smoothed(system, [0.0, *LATE[:end]])[1][1:]  # measured from 0 on
        for k in (k for k in range(5) if ends[k] == end):
            close(found.mean[k, :, 1], mean[k], 1e-8)
            close(found.cov[k], cov[k], 1e-8)
            close(law.error_cov[k], error_cov[k], 1e-8)
    plain = kalman.moments(LATE)
    np.testing.assert_array_equal(law.cov, plain.cov)
    np.testing.assert_array_equal(law.mean, plain.mean)


def test_errors_on_simulated_paths_have_the_claimed_covariance():
    system, paths, times = constant_diffusion(), 4000, np.linspace(0.2, 1.0, 81)
    sample = system.simulate(times, paths, 4)
    found = KalmanBucyFilter(system).run(times, sample.increments)
    for k in (10, 80):
        cov, error = found.cov[k], sample.states[k] - found.mean[k]
        spread = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / paths)
        assert (np.abs(error @ error.T / paths - cov) < 4 * spread).all()


@pytest.mark.parametrize("units", [(1.0, 1.0), (1e3, 1e-1)])
def test_steady_state_is_the_limit_of_long_times_in_any_unit(units):
    d = np.array(units)
    for drift in ([[0.2, 1.0], [-2.0, -0.3]], [[-0.5, 1.0], [-2.0, -0.3]]):
        own = constant_diffusion(drift=drift)
        system = constant_diffusion(
            drift=own.drift * d[:, None] / d,
            noise_intensity=own.noise_intensity * d[:, None] * d,
            sensor=own.sensor / d,
            cov0=own.cov0 * d[:, None] * d,
        )
        kalman, square = KalmanBucyFilter(system), d[:, None] * d
        wanted = KalmanBucyFilter(own).moments([60.0])
        close(kalman.moments([60.0]).error_cov / square, wanted.error_cov)
        close(kalman.steady_error_cov() / square, wanted.error_cov[0])
    steady = kalman.steady_moments()  # of the second, stable drift
    assert not steady.mean.any()
    close(steady.cov / square, wanted.cov, 1e-8)
    close(steady.error_cov / square, wanted.error_cov, 1e-8)


def test_one_huge_step_with_a_precise_sensor_is_the_steady_covariance():
    kalman = KalmanBucyFilter(constant_diffusion(sensor_intensity=1e-8 * np.eye(2)))
    cov = kalman.moments([0.0, 100.0]).error_cov[1]
    np.testing.assert_allclose(cov, kalman.steady_error_cov(), rtol=1e-7)
    assert np.array_equal(cov, cov.T)


def test_no_paths_and_no_steps_are_legal():
    kalman = KalmanBucyFilter(constant_diffusion())
    assert kalman.run([0.0, 0.01], np.zeros((1, 2, 0))).mean.shape == (2, 2, 0)
    start = kalman.run([0.0], np.zeros((0, 2, 5)))
    np.testing.assert_array_equal(start.mean, np.broadcast_to([[[1.0], [-1.0]]], (1, 2, 5)))
