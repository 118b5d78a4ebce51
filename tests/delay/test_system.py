"""Systems with delays: coefficients, start law, simulation, examples."""

import numpy as np
import pytest

from oracles.delay import Regression, varying_system
from seedslib.delay import DelayKalmanFilter, DelaySystem, examples

GIVEN = {
    "dynamics": {0: [[0.5, 0.1], [0.0, 0.4]], 2: [[0.1, 0.0], [0.2, 0.1]]},
    "sensor": [[1.0, 0.0]],
    "noise_cov": [[1.0]],
    "sensor_cov": [[0.5]],
    "cov0": [[1.0, 0.2], [0.2, 0.7]],
    "history_cov": [[[0.3, 0.0], [0.0, 0.2]], [[0.4, 0.1], [0.1, 0.6]]],
    "noise_input": [[0.3], [1.0]],
}


def test_augmented_matrices_by_hand():
    system = DelaySystem(**GIVEN)
    stacked = system.augmented()
    a, b = (np.array(GIVEN["dynamics"][d]) for d in (0, 2))
    zero, eye = np.zeros((2, 2)), np.eye(2)
    wanted = np.block([[a, zero, b], [eye, zero, zero], [zero, eye, zero]])
    np.testing.assert_array_equal(stacked.transition, wanted)
    np.testing.assert_array_equal(stacked.sensor, [[1.0, 0, 0, 0, 0, 0]])
    noise = np.zeros((6, 6))
    noise[:2, :2] = np.outer([0.3, 1.0], [0.3, 1.0])
    np.testing.assert_allclose(stacked.noise, noise, atol=1e-16)
    blocks = [GIVEN["cov0"], *GIVEN["history_cov"]]
    for j, block in enumerate(blocks):
        found = system.start_cov()[2 * j : 2 * j + 2]
        np.testing.assert_array_equal(found[:, 2 * j : 2 * j + 2], block)
        assert np.count_nonzero(found) == np.count_nonzero(block)
    np.testing.assert_array_equal(system.start_blocks(), blocks)
    assert (system.delays, system.max_delay) == ((0, 2), 2)
    assert (system.state_size, system.measurement_size, system.constant) == (2, 1, True)


def test_numbers_stand_for_one_by_one_matrices():
    system = DelaySystem({0: 0.6, 1: 0.3}, 1.0, 1.0, 2.0, 1.5, 0.5)
    np.testing.assert_array_equal(system.augmented().transition, [[0.6, 0.3], [1.0, 0.0]])
    np.testing.assert_array_equal(system.start_cov(), [[1.5, 0.0], [0.0, 0.5]])


def test_coefficients_as_arrays_and_as_functions_of_the_instant_agree():
    rng = np.random.default_rng(0)
    near, sensor = rng.standard_normal((6, 2, 2)), rng.standard_normal((7, 1, 2))
    gain = rng.standard_normal((6, 2, 1))
    q, r = np.exp(rng.standard_normal((6, 1, 1))), np.exp(rng.standard_normal((7, 1, 1)))
    parts = {"sensor": sensor, "noise_cov": q, "sensor_cov": r, "noise_input": gain}
    functions = {name: lambda k, a=array: a[k] for name, array in parts.items()}
    late = GIVEN["dynamics"][2]
    one = DelaySystem(**(GIVEN | parts | {"dynamics": {0: near, 2: late}}))
    two = DelaySystem(**(GIVEN | functions | {"dynamics": {0: lambda k: near[k], 2: late}}))
    assert (one.constant, one.horizon, two.constant, two.horizon) == (False, 6, False, None)
    for k in range(1, 7):
        for a, b in zip(one.augmented(k), two.augmented(k), strict=True):
            np.testing.assert_array_equal(a, b)
        step = one.step(k)
        np.testing.assert_array_equal(one.augmented(k).transition[:2, :2], near[k - 1])
        np.testing.assert_array_equal(step.sensor, sensor[k])
        np.testing.assert_array_equal(step.sensor_cov, r[k])
        drive = gain[k - 1] @ q[k - 1] @ gain[k - 1].T
        np.testing.assert_allclose(step.state_noise, drive, rtol=1e-14)


def test_a_start_law_of_the_whole_stack():
    apart = DelaySystem({2: 0.5}, 1.0, 1.0, 1.0, 1.0, [[[0.4]], [[0.2]]])
    joint = DelaySystem({2: 0.5}, 1.0, 1.0, 1.0, np.diag([1.0, 0.4, 0.2]))
    np.testing.assert_array_equal(apart.start_cov(), joint.start_cov())
    np.testing.assert_array_equal(apart.start_blocks(), joint.start_blocks())
    known = DelaySystem({2: 0.5}, 1.0, 1.0, 1.0, 1.0)
    np.testing.assert_array_equal(known.start_cov(), np.diag([1.0, 0.0, 0.0]))
    linked = DelaySystem({2: 0.5}, 1.0, 1.0, 1.0, np.eye(3) + 0.5)
    assert linked.start_blocks() is None
    np.testing.assert_array_equal(linked.start_cov(), np.eye(3) + 0.5)


@pytest.mark.parametrize("independent", [True, False])
def test_simulated_paths_have_the_moments_of_the_linear_expansion(independent):
    """History, states and measurements of time-varying and of constant coefficients together."""
    given = GIVEN | {"mean0": [1.0, -2.0, 0.5, 0.0, 0.0, 3.0]}
    system = DelaySystem(**given) if independent else varying_system((0, 2), 4)
    paths, n, truth = 20_000, system.state_size, Regression(system, 4)
    run = system.simulate(4, paths, 1)
    assert run.history.shape == (2, n, paths)
    assert np.isnan(run.measurements[0]).all()
    drawn = np.concatenate([*run.history[::-1], *run.states, *run.measurements[1:]])
    rows = np.concatenate([*truth.states, *truth.outputs[1:]])
    mean = np.concatenate([*truth.means, *truth.output_means[1:]])
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
    alone = system.simulate([0, 1, 2, 3], None, 7)
    assert (alone.states.shape, alone.measurements.shape) == ((4, 2), (4, 1))
    many, few = (system.simulate(3, paths, 7, workers=2) for paths in (8200, 8192))
    np.testing.assert_array_equal(many.states[..., :8192], few.states)
    shown = system.simulate(5, 200, 7, measured=[2, 4], availability=0.5).measurements[:, 0]
    assert np.isnan(shown[[0, 1, 3, 5]]).all()
    assert np.isfinite(shown[[2, 4]]).mean() == pytest.approx(0.5, abs=0.12)


def test_examples_have_their_spectral_radii_and_optimal_errors():
    def root(near, far):
        return np.abs(np.roots([1.0, -near, 0.0, 0.0, -far])).max()

    for system, radius, steps, trace in (
        (examples.precise_sensor(), 0.9459, 50, 1.584208),
        (examples.two_noises(), 0.9545, 100, 71.44573),
        (examples.rotation(0.7, 3), 0.9717, 60, 1.917649),
        (examples.scalar(0.5, -0.6, 4.0, 3), root(0.5, -0.6), 60, 1.252144),
        (examples.scalar(0.9, 0.0, delay=0), 0.9, 60, 0.597407),
        (examples.scalar(1.2, -1.2, 10.0, 3), root(1.2, -1.2), 60, 6.334987),
    ):
        assert examples.spectral_radius(system) == pytest.approx(radius, abs=5e-5)
        cov = DelayKalmanFilter(system).gains(steps).cov[-1]
        assert np.trace(cov) == pytest.approx(trace, rel=1e-6)


def test_random_plants_are_stable_and_as_they_are_described():
    plants = list(examples.random_plants(20, seed=3))
    assert {p.state_size for p in plants} == {1, 2, 3}
    assert {p.max_delay for p in plants} == {1, 2, 3, 4, 5, 6}
    radii = [examples.spectral_radius(p) for p in plants]
    assert 0.6 <= min(radii) <= max(radii) <= 0.98
    for p in plants:
        m, n, step = p.measurement_size, p.state_size, p.step(1)
        assert m <= n
        assert step.noise_input.shape == (n, 1)
        assert 0.1 <= step.sensor_cov[0, 0] <= 10.0
        np.testing.assert_array_equal(step.sensor_cov, step.sensor_cov[0, 0] * np.eye(m))
        np.testing.assert_array_equal(p.start_blocks()[:2], [np.eye(n), 0.3 * np.eye(n)])
    again = examples.random_plants(20, seed=3)
    assert all(
        (p.step(1).sensor == q.step(1).sensor).all() for p, q in zip(plants, again, strict=True)
    )
