"""The optimal filter of a system with delays, stacked and by its fast recursion."""

import numpy as np
import pytest

from oracles.delay import Regression, general_system
from seedslib import zoo
from seedslib.delay import apply_gains, error_covariance, optimal_gains, repaired_gains
from seedslib.filters import KalmanFilter

STEPS = 12
SYSTEMS = {
    "no delay": general_system((0,)),
    "pure delay": general_system((3,)),
    "several delays": general_system((0, 2, 5)),
    "known history": general_system((0, 2), history_cov=0.0),
    "one component": zoo.delayed_scalar(0.5, -0.6, 4.0, 3),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_stacked_filter_equals_regression_on_all_data(name):
    """Means, covariances and log densities with missing values; block s smooths with lag s."""
    system = SYSTEMS[name]
    y, n = system.simulate(STEPS, 4, 5).measurements, system.state_size
    y[1:, 0, 1] = np.where(np.random.default_rng(1).random(STEPS) < 0.3, np.nan, y[1:, 0, 1])
    y[[4, 7, 8], :, 3] = np.nan
    run = KalmanFilter(system.stacked()).run(np.arange(STEPS + 1), y)
    truth = Regression(system, STEPS)
    for path in range(4):
        for k in range(STEPS + 1):
            for lag in range(min(system.max_delay, k) + 1):
                mean, cov, loglik, _ = truth.estimate(y[..., path], k - lag, k)
                block = slice(lag * n, (lag + 1) * n)
                np.testing.assert_allclose(run.mean[k, block, path], mean, atol=1e-11)
                np.testing.assert_allclose(run.cov[k, block, block, path], cov, atol=1e-11)
            assert run.loglik[: k + 1, path].sum() == pytest.approx(loglik, abs=1e-10)


@pytest.mark.parametrize("name", SYSTEMS)
def test_optimal_gains_are_the_weights_of_the_newest_measurement(name):
    system = SYSTEMS[name]
    table, truth = optimal_gains(system, STEPS), Regression(system, STEPS)
    y = np.zeros((STEPS + 1, system.measurement_size))
    np.testing.assert_array_equal(table.cov[0], system.cov0)
    np.testing.assert_array_equal(table.gain[0], np.zeros(table.gain.shape[1:]))
    for k in range(1, STEPS + 1):
        predicted = truth.estimate(y, k, k - 1)[1]
        inner = system.sensor @ predicted @ system.sensor.T + system.sensor_cov
        np.testing.assert_allclose(table.innovation_cov[k], inner, atol=1e-11)
        np.testing.assert_allclose(table.cov[k], truth.estimate(y, k, k)[1], atol=1e-11)
        for s in range(system.max_delay + 1):
            weights = truth.estimate(y, k - s, k)[3]
            np.testing.assert_allclose(table.gain[k, s], weights, atol=1e-11)


@pytest.mark.parametrize("name", SYSTEMS)
def test_repaired_gains_give_the_estimates_and_errors_of_the_stacked_filter(name):
    system = SYSTEMS[name]
    y, n = system.simulate(STEPS, 6, 5).measurements, system.state_size
    run = KalmanFilter(system.stacked()).run(np.arange(STEPS + 1), y)
    gains = repaired_gains(system, STEPS)
    mean = apply_gains(system, gains, y.reshape(STEPS + 1, -1, 2, 3))
    np.testing.assert_allclose(mean.reshape(STEPS + 1, n, 6), run.mean[:, :n], atol=1e-12)
    errors = error_covariance(system, gains)
    np.testing.assert_allclose(errors, optimal_gains(system, STEPS).cov, atol=1e-11)
    np.testing.assert_allclose(errors, run.cov[:, :n, :n], atol=1e-11)


@pytest.mark.parametrize("damping", [0.7, 0.8])
def test_long_runs_of_stable_and_unstable_systems_settle_as_the_plain_recursion(damping):
    """Against the textbook's recursion of the stack; a short table is the head of a long one."""
    system = zoo.delayed_oscillator(damping, 4)
    stack = system.stacked()
    transition, noise = stack.dynamics.slope_at(0.0), stack.dynamics.cov_at(0.0)
    sensor, cov = stack.sensor.slope_at(0.0), stack.cov0
    for _ in range(200):
        cov = transition @ cov @ transition.T + noise
        inner = sensor @ cov @ sensor.T + system.sensor_cov
        gain = np.linalg.solve(inner, sensor @ cov).T
        cov = cov - gain @ inner @ gain.T
    table = optimal_gains(system, 200)
    np.testing.assert_allclose(table.gain[-1].reshape(gain.shape), gain, atol=1e-11)
    np.testing.assert_allclose(table.cov[-1], cov[:2, :2], rtol=1e-10)
    np.testing.assert_array_equal(optimal_gains(system, 7).gain, table.gain[:8])


def test_optimal_gains_with_nearly_parallel_precise_sensors_keep_their_digits():
    """Sensors that differ by 1e-4, variance 1e-8, a wide start; against 60 digits."""
    import mpmath

    turn = 0.7 * np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    system = general_system(
        (0, 2),
        dynamics={0: turn, 2: [[0.1, 0.3], [-0.2, 0.1]]},
        sensor=[[1, 0], [1, 1e-4]],
        sensor_cov=1e-8 * np.eye(2),
        cov0=np.eye(2),
        history_cov=1.0,
        mean0=0.0,
        noise_cov=1.0,
        noise_input=[[0.0], [1.0]],
    )
    stack = system.stacked()
    parts = stack.dynamics.slope_at(0), stack.dynamics.cov_at(0), stack.sensor.slope_at(0)
    with mpmath.workdps(60):
        f, q, h, r, cov = (
            mpmath.matrix(part.tolist()) for part in (*parts, system.sensor_cov, stack.cov0)
        )
        for _ in range(30):
            cov = f * cov * f.T + q
            cov = cov - cov * h.T * (h * cov * h.T + r) ** -1 * (h * cov)
        exact = [float(cov[i, i]) for i in range(2)]
    variances = np.diag(optimal_gains(system, 30).cov[-1])
    np.testing.assert_allclose(variances, exact, rtol=1e-6)


def test_errors_on_simulated_paths_have_the_claimed_covariance():
    system, paths = SYSTEMS["several delays"], 4000
    run = system.simulate(STEPS, paths, 42)
    estimates = apply_gains(system, repaired_gains(system, STEPS), run.measurements)
    error = run.states[-1] - estimates[-1]
    products = error[:, None] * error
    deviation = products.std(axis=2) / np.sqrt(paths)
    claimed = optimal_gains(system, STEPS).cov[-1]
    assert (np.abs(products.mean(axis=2) - claimed) <= 4 * deviation).all()
