"""Systems with delays: matrices of the stack, simulation, examples."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from oracles.delay import Regression
from seedslib import zoo
from seedslib.delay import DelaySystem, optimal_gains

GIVEN = {
    "dynamics": {0: [[0.5, 0.1], [0.0, 0.4]], 2: [[0.1, 0.0], [0.2, 0.1]]},
    "sensor": [[1.0, 0.0]],
    "noise_cov": [[1.0]],
    "sensor_cov": [[0.5]],
    "cov0": [[1.0, 0.2], [0.2, 0.7]],
    "history_cov": [[[0.3, 0.0], [0.0, 0.2]], [[0.4, 0.1], [0.1, 0.6]]],
    "noise_input": [[0.3], [1.0]],
}


def test_stacked_matrices_by_hand():
    system = DelaySystem(**GIVEN, mean0=[0.7, -0.2])
    stacked = system.stacked()
    a, b = (np.array(GIVEN["dynamics"][d]) for d in (0, 2))
    zero, eye = np.zeros((2, 2)), np.eye(2)
    wanted = np.block([[a, zero, b], [eye, zero, zero], [zero, eye, zero]])
    np.testing.assert_array_equal(stacked.dynamics.slope_at(0.0), wanted)
    np.testing.assert_array_equal(stacked.sensor.slope_at(0.0), [[1.0, 0, 0, 0, 0, 0]])
    np.testing.assert_array_equal(stacked.sensor.cov_at(0.0), [[0.5]])
    noise = np.zeros((6, 6))
    noise[:2, :2] = np.outer([0.3, 1.0], [0.3, 1.0])
    np.testing.assert_allclose(stacked.dynamics.cov_at(0.0), noise, atol=1e-16)
    blocks = [GIVEN["cov0"], *GIVEN["history_cov"]]
    np.testing.assert_array_equal(stacked.cov0, block_diag(*blocks))
    np.testing.assert_array_equal(stacked.mean0, [0.7, -0.2, 0, 0, 0, 0])
    np.testing.assert_array_equal(system.start_blocks(), blocks)
    assert (system.state_size, system.measurement_size, system.max_delay) == (2, 1, 2)


def test_numbers_stand_for_one_by_one_matrices_and_for_multiples_of_the_identity():
    system = DelaySystem({1: 0.3, 0: 0.6}, 1.0, 1.0, 2.0, 1.5, 0.5)
    np.testing.assert_array_equal(system.stacked().dynamics.slope_at(0), [[0.6, 0.3], [1.0, 0.0]])
    np.testing.assert_array_equal(system.stacked().cov0, [[1.5, 0.0], [0.0, 0.5]])
    given = GIVEN | {"history_cov": 0.5, "noise_input": 2.0, "noise_cov": np.eye(2), "mean0": 3.0}
    plane = DelaySystem(**given)
    np.testing.assert_array_equal(plane.history_cov, [0.5 * np.eye(2)] * 2)
    np.testing.assert_array_equal(plane.state_noise, 4.0 * np.eye(2))
    np.testing.assert_array_equal(plane.mean0, [3.0, 3.0])


def test_simulated_paths_have_the_moments_of_the_linear_expansion():
    """States and measurements together."""
    system = DelaySystem(**GIVEN, mean0=[1.0, -2.0])
    paths, truth = 20_000, Regression(system, 4)
    run = system.simulate(4, paths, 1)
    assert np.isnan(run.measurements[0]).all()
    np.testing.assert_array_equal(run.times, [0, 1, 2, 3, 4])
    drawn = np.concatenate([*run.states, *run.measurements[1:]])
    rows = np.concatenate([*truth.states[2:], *truth.outputs[1:]])
    mean = np.concatenate([*truth.means[2:], *truth.output_means[1:]])
    cov = rows @ truth.spread @ rows.T
    spread = np.sqrt(np.diag(cov))
    assert (np.abs(drawn.mean(axis=1) - mean) <= 4.5 * spread / np.sqrt(paths)).all()
    error = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / paths)
    assert (np.abs(np.cov(drawn) - cov) <= 4.5 * error).all()


def test_simulated_paths_are_those_of_their_seed():
    system = DelaySystem(**GIVEN)
    seeds = (7, 7, np.random.SeedSequence(7), np.random.default_rng(7))
    runs = [system.simulate(3, 10, seed) for seed in seeds]
    for other, same in zip(runs[1:], (True, True, False), strict=True):
        assert np.array_equal(runs[0].states, other.states) == same
    many, few = (system.simulate(3, paths, 7, workers=2) for paths in (8200, 8192))
    np.testing.assert_array_equal(many.states[..., :8192], few.states)


def test_examples_have_their_spectral_radii_and_optimal_errors():
    def root(near, far):
        return np.abs(np.roots([1.0, -near, 0.0, 0.0, -far])).max()

    for system, radius, steps, trace in (
        (zoo.precise_sensor(), 0.9459, 50, 1.584208),
        (zoo.two_noises(), 0.9545, 100, 71.44573),
        (zoo.delayed_oscillator(0.7, 3), 0.9717, 60, 1.917649),
        (zoo.delayed_scalar(0.5, -0.6, 4.0, 3), root(0.5, -0.6), 60, 1.252144),
        (zoo.delayed_scalar(0.9, 0.0, delay=0), 0.9, 60, 0.597407),
        (zoo.delayed_scalar(1.2, -1.2, 10.0, 3), root(1.2, -1.2), 60, 6.334987),
    ):
        stacked = system.stacked().dynamics.slope_at(0.0)
        assert np.abs(np.linalg.eigvals(stacked)).max() == pytest.approx(radius, abs=5e-5)
        cov = optimal_gains(system, steps).cov[-1]
        assert np.trace(cov) == pytest.approx(trace, rel=1e-6)
