"""Linear diffusions: simulated paths with their exact distribution, moments and steady state."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

from oracles.diffusion import constant_diffusion, filtered, start_dist, transition
from seedslib.two_step import LinearDiffusion


def close(value, exact, tolerance=1e-9):
    np.testing.assert_allclose(value, exact, rtol=tolerance, atol=tolerance)


def joint_dist(system, times):
    """Mean and covariance of (x_0, x_1, y_1 - y_0, x_2, ...) by the system of (x, y) together.

    The noise enters at the middle of 400 parts of each step.
    """
    n, m = system.state_size, len(system.sensor)
    size = n + m
    first, spread = transition(system, 0.0, times[0])
    rows, blocks = [np.eye(n)], [first @ system.cov0 @ first.T + spread]
    for a, b in pairwise(times):
        move, noise = np.eye(size), np.zeros((size, size))
        h = (b - a) / 400
        drift, drive = np.zeros((2, size, size))
        drift[:n, :n], drift[n:, :n] = system.drift, system.sensor
        drive[:n, :n], drive[n:, n:] = system.diffusion, system.sensor_intensity
        part, half = expm(h * drift), expm(0.5 * h * drift)
        for _ in range(400):
            move, noise = part @ move, part @ noise @ part.T + h * half @ drive @ half.T
        width = sum(len(block) for block in blocks)
        last = rows[-1] if len(rows) == 1 else rows[-1][:n]
        row = np.zeros((size, width + size))
        row[:, : last.shape[1]] = move[:, :n] @ last
        row[:, width:] = np.eye(size)
        rows.append(row)
        blocks.append(noise)
    width = sum(len(block) for block in blocks)
    table = np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1]))) for row in rows])
    cov, at = np.zeros((width, width)), 0
    for block in blocks:
        cov[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return table[:, :n] @ first @ system.mean0, table @ cov @ table.T


def test_states_and_increments_have_their_joint_distribution():
    """On a late and uneven grid."""
    system, times, paths = constant_diffusion(), [0.4, 0.9, 1.6], 60_000
    run = system.simulate(times, paths, 11)
    assert (run.states.shape, run.increments.shape) == ((3, 2, paths), (2, 2, paths))
    np.testing.assert_array_equal(run.times, times)
    drawn = [run.states[0]]
    for k in range(2):
        drawn += [run.states[k + 1], run.increments[k]]
    drawn = np.concatenate(drawn)
    mean, cov = joint_dist(system, times)
    spread = np.sqrt(np.diag(cov) / paths)
    assert (np.abs(drawn.mean(axis=1) - mean) < 4.5 * spread).all()
    error = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / paths)
    assert (np.abs(np.cov(drawn) - cov) < 4.5 * error).all()


def test_paths_are_those_of_their_seed_and_of_their_block():
    system = constant_diffusion()
    root = np.random.SeedSequence(3)
    one, two = (system.simulate([0.0, 0.5], 4, seed) for seed in (3, root))
    np.testing.assert_array_equal(one.increments, two.increments)
    few, many = (system.simulate([0.0, 0.1], paths, 2).states for paths in (8192, 8200))
    np.testing.assert_array_equal(few, many[..., :8192])
    still = LinearDiffusion(0, 0, 1, 1, [2.0], 0)
    np.testing.assert_array_equal(still.simulate([0.0, 1.0, 2.0], 7, 0).states, 2.0)


def test_moments_against_their_differential_equations():
    system, times = constant_diffusion(), [0.05, 0.4, 1.3]
    moments = system.moments(times)
    for k, t in enumerate(times):
        mean, cov = start_dist(system, t)
        close(moments.mean[k], mean)
        close(moments.cov[k], cov)
        close(moments.error_cov[k], filtered(system, [0.0, t])[1][-1])
    np.testing.assert_array_equal(system.moments([0.0]).error_cov[0], system.cov0)


@pytest.mark.parametrize("a", [-1.0, 0.7])
@pytest.mark.parametrize("r", [1e-4, 30.0])
def test_scalar_moments_in_closed_form(a, r):
    q, s0, times = 0.5, 4.0, np.array([0.0, 1e-5, 0.1, 1.1, 50.0])
    moments = LinearDiffusion(a, q, 1, r, [2.0], s0).moments(times)
    g = np.sqrt(a * a + q / r)
    high, low = r * (a + g), r * (a - g)
    decay = (s0 - high) / (s0 - low) * np.exp(-2 * g * times)
    np.testing.assert_allclose(
        moments.error_cov[:, 0, 0], (high - low * decay) / (1 - decay), rtol=1e-12
    )
    growth = np.exp(2 * a * times)
    np.testing.assert_allclose(
        moments.cov[:, 0, 0], s0 * growth + q / (2 * a) * (growth - 1), rtol=1e-12
    )
    np.testing.assert_allclose(moments.mean[:, 0], 2.0 * np.exp(a * times), rtol=1e-12)


def test_a_parameter_without_dynamics():
    system = LinearDiffusion(0.0, 0.0, 1, 0.2, [0.0], 1.5)
    moments = system.moments([0.0, 0.5, 1e4])
    exact = 1.5 / (1 + np.array([0.0, 0.5, 1e4]) * 1.5 / 0.2)
    np.testing.assert_allclose(moments.error_cov[:, 0, 0], exact, rtol=1e-12)
    assert (moments.cov == 1.5).all()
    with pytest.raises(ValueError, match="not damped"):
        system.steady_error_cov()


@pytest.mark.parametrize("unit", [1.0, 1e20])
def test_a_very_long_step_of_a_stable_system_reaches_the_stationary_distribution(unit):
    system = LinearDiffusion(-3.0, 2.0 * unit**2, 1.0, 1.0, [unit], unit**2)
    moments = system.moments([1e4])
    assert moments.mean[0, 0] == 0.0
    assert moments.cov[0, 0, 0] == pytest.approx(unit**2 / 3, rel=1e-14)


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
        square = d[:, None] * d
        wanted = own.moments([60.0])
        close(system.moments([60.0]).error_cov / square, wanted.error_cov)
        close(system.steady_error_cov() / square, wanted.error_cov[0])
    steady = system.steady_moments()  # of the second, stable drift
    assert not steady.mean.any()
    close(steady.cov / square, wanted.cov, 1e-8)
    close(steady.error_cov / square, wanted.error_cov, 1e-8)


def test_one_huge_step_with_a_precise_sensor_is_the_steady_covariance():
    system = constant_diffusion(sensor_intensity=1e-8 * np.eye(2))
    cov = system.moments([0.0, 100.0]).error_cov[1]
    np.testing.assert_allclose(cov, system.steady_error_cov(), rtol=1e-7)
    assert np.array_equal(cov, cov.T)
