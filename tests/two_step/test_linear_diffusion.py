"""Linear diffusions: transitions and simulated paths with their exact law."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

from oracles.diffusion import constant_diffusion, transition, varying_diffusion
from seedslib.two_step import LinearDiffusion


@pytest.mark.parametrize("system", [constant_diffusion(), varying_diffusion()])
@pytest.mark.parametrize("interval", [(0.2, 0.2001), (0.5, 2.0)])
def test_transition_against_its_differential_equation(system, interval):
    for found, exact in zip(
        system.transition(*interval), transition(system, *interval), strict=True
    ):
        np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-11)
    move, noise = system.transition(0.7, 0.7)
    np.testing.assert_array_equal(move, np.eye(2))
    assert not noise.any()


@pytest.mark.parametrize("unit", [1.0, 1e20])
def test_a_very_long_step_of_a_stable_system_reaches_the_stationary_law(unit):
    system = LinearDiffusion(-3.0, 2.0 * unit**2, 1.0, 1.0, [0.0], 1.0)
    move, noise = system.transition(0.0, 1e4)
    assert move[0, 0] == 0.0
    assert noise[0, 0] == pytest.approx(unit**2 / 3, rel=1e-14)


def joint_law(system, times):
    """Mean and covariance of (x_0, x_1, y_1 - y_0, x_2, ...) by the system of (x, y) together.

    Coefficients are taken as constant over 400 parts of each step.
    """
    n, m = system.state_size, system.measurement_size
    size = n + m
    first, spread = transition(system, 0.0, times[0])
    rows, blocks = [np.eye(n)], [first @ system.cov0 @ first.T + spread]
    for a, b in pairwise(times):
        move, noise = np.eye(size), np.zeros((size, size))
        h = (b - a) / 400
        for i in range(400):
            f, w, sensor, r = system.matrices(a + (i + 0.5) * h)
            drift = np.zeros((size, size))
            drift[:n, :n], drift[n:, :n] = f, sensor
            part, half = expm(h * drift), expm(0.5 * h * drift)
            drive = np.zeros((size, size))
            drive[:n, :n], drive[n:, n:] = w, r
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


@pytest.mark.parametrize("system", [constant_diffusion(), varying_diffusion()])
def test_states_and_increments_have_their_joint_law(system):
    """On a late and uneven grid."""
    times, paths = [0.4, 0.9, 1.6], 60_000
    run = system.simulate(times, paths, 11)
    assert (run.states.shape, run.increments.shape) == ((3, 2, paths), (2, 2, paths))
    np.testing.assert_array_equal(run.times, times)
    drawn = [run.states[0]]
    for k in range(2):
        drawn += [run.states[k + 1], run.increments[k]]
    drawn = np.concatenate(drawn)
    mean, cov = joint_law(system, times)
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
