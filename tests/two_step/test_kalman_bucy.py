"""The Kalman-Bucy filter along paths against its equations, integrated."""

import numpy as np

from oracles.diffusion import constant_diffusion, filtered
from seedslib.two_step import kalman_bucy, kalman_bucy_gains

SYSTEM = constant_diffusion()
LATE = np.array([0.3, 0.35, 0.42, 0.5, 0.62])  # late, uneven


def close(value, exact, tolerance=1e-9):
    np.testing.assert_allclose(value, exact, rtol=tolerance, atol=tolerance)


def increments_with_gaps(paths):
    """Increments (K, m, paths): one step and one component of another are missing in all."""
    increments = SYSTEM.simulate(LATE, paths, 5).increments.copy()
    increments[1] = increments[2, 0] = np.nan
    return increments


def test_estimates_are_those_of_constant_rates():
    """On a late and uneven grid, with a component and a whole step missing."""
    increments = increments_with_gaps(6).reshape(4, 2, 2, 3)
    estimates = kalman_bucy(SYSTEM, LATE, increments)
    assert estimates.mean.shape == (5, 2, 2, 3)
    for path in ((0, 1), (1, 2)):
        mean, cov = filtered(SYSTEM, LATE, increments[(..., *path)])
        close(estimates.mean[(..., *path)], mean)
        close(estimates.cov, cov)
    alone = kalman_bucy(SYSTEM, LATE, increments[..., 1, 2])
    np.testing.assert_allclose(alone.mean, estimates.mean[..., 1, 2], rtol=1e-12)
    whole = kalman_bucy(SYSTEM, LATE - 0.3, np.nan_to_num(increments)).cov
    close(whole, SYSTEM.moments(LATE - 0.3).error_cov, 1e-11)


def test_gains_give_the_estimates():
    increments = increments_with_gaps(1)[..., 0]
    observed = ~np.isnan(increments)
    gains, estimates = (
        kalman_bucy_gains(SYSTEM, LATE, observed),
        kalman_bucy(SYSTEM, LATE, increments),
    )
    assert not gains.gain[1].any()
    assert not gains.gain[2, :, 0].any()
    mean = gains.mean0
    for k, increment in enumerate(np.nan_to_num(increments)):
        mean = gains.transition[k] @ mean + gains.gain[k] @ increment
        np.testing.assert_allclose(estimates.mean[k + 1], mean, rtol=1e-14)
    np.testing.assert_array_equal(estimates.cov, gains.cov)


def test_errors_on_simulated_paths_have_the_claimed_covariance():
    paths, times = 4000, np.linspace(0.2, 1.0, 81)
    sample = SYSTEM.simulate(times, paths, 4)
    estimates = kalman_bucy(SYSTEM, times, sample.increments)
    for k in (10, 80):
        cov, error = estimates.cov[k], sample.states[k] - estimates.mean[k]
        spread = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / paths)
        assert (np.abs(error @ error.T / paths - cov) < 4 * spread).all()


def test_no_paths_and_no_steps_are_legal():
    assert kalman_bucy(SYSTEM, [0.0, 0.01], np.zeros((1, 2, 0))).mean.shape == (2, 2, 0)
    start = kalman_bucy(SYSTEM, [0.0], np.zeros((0, 2, 5)))
    np.testing.assert_array_equal(start.mean, np.broadcast_to([[[1.0], [-1.0]]], (1, 2, 5)))


def test_a_step_longer_than_an_oscillation_is_exact_too():
    """Such a step is put together of several."""
    system = constant_diffusion(drift=[[-0.5, 8.0], [-8.0, -0.5]])
    times, increments = np.array([0.0, 0.7, 1.4]), np.array([[0.1, -0.5], [0.3, 0.2]])
    mean, cov = filtered(system, times, increments)
    estimates = kalman_bucy(system, times, increments)
    close(estimates.mean, mean)
    close(estimates.cov, cov)
