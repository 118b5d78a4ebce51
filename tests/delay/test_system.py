"""System with delays: coefficients, start law, simulation, refusals."""

import re

import numpy as np
import pytest

from seedslib.delay import DelaySystem, examples

GIVEN = {
    "dynamics": {0: [[0.5, 0.1], [0.0, 0.4]], 2: [[0.1, 0.0], [0.2, 0.1]]},
    "sensor": [[1.0, 0.0]],
    "noise_cov": [[1.0]],
    "sensor_cov": [[0.5]],
    "cov0": np.eye(2),
    "history_cov": 0.3 * np.eye(2),
    "noise_input": [[0.0], [1.0]],
}


def moments_by_stacking(system, steps):
    """Mean and covariance of x_k from the augmented matrices."""
    mean, cov = system.mean0, system.start_cov()
    for k in range(1, steps + 1):
        step = system.augmented(k)
        mean = step.transition @ mean
        cov = step.transition @ cov @ step.transition.T + step.noise
    return mean[: system.state_size], cov[: system.state_size, : system.state_size]


def test_augmented_matrices_by_hand():
    system = DelaySystem(**GIVEN)
    stacked = system.augmented()
    a, b = (np.array(GIVEN["dynamics"][d]) for d in (0, 2))
    zero, eye = np.zeros((2, 2)), np.eye(2)
    wanted = np.block([[a, zero, b], [eye, zero, zero], [zero, eye, zero]])
    np.testing.assert_array_equal(stacked.transition, wanted)
    np.testing.assert_array_equal(stacked.sensor, [[1.0, 0, 0, 0, 0, 0]])
    assert stacked.noise[1, 1] == 1.0
    assert np.count_nonzero(stacked.noise) == 1
    np.testing.assert_array_equal(system.start_cov(), np.diag([1.0, 1.0, 0.3, 0.3, 0.3, 0.3]))
    assert (system.delays, system.max_delay, system.state_size, system.measurement_size) == (
        (0, 2),
        2,
        2,
        1,
    )


def test_numbers_stand_for_one_by_one_matrices():
    system = DelaySystem({0: 0.6, 1: 0.3}, 1.0, 1.0, 2.0, 1.5, 0.5)
    np.testing.assert_array_equal(system.augmented().transition, [[0.6, 0.3], [1.0, 0.0]])
    np.testing.assert_array_equal(system.start_cov(), [[1.5, 0.0], [0.0, 0.5]])


def test_array_function_and_constant_coefficients_say_the_same():
    rng = np.random.default_rng(0)
    near, sensor = rng.standard_normal((6, 2, 2)), rng.standard_normal((7, 1, 2))
    q = np.exp(rng.standard_normal((6, 1, 1)))
    r = np.exp(rng.standard_normal((7, 1, 1)))
    varying = GIVEN | {"sensor": sensor, "noise_cov": q, "sensor_cov": r}
    varying["dynamics"] = {0: near, 2: GIVEN["dynamics"][2]}
    functions = varying | {
        "sensor": lambda k: sensor[k],
        "noise_cov": lambda k: q[k],
        "sensor_cov": lambda k: r[k],
        "dynamics": {0: lambda k: near[k], 2: GIVEN["dynamics"][2]},
    }
    one, other = DelaySystem(**varying), DelaySystem(**functions)
    assert not one.constant
    assert (one.horizon, other.horizon) == (6, None)
    for k in range(1, 7):
        for a, b in zip(one.augmented(k), other.augmented(k), strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(one.augmented(k).transition[:2, :2], near[k - 1])
        np.testing.assert_array_equal(one.step(k).sensor, sensor[k])
        assert one.step(k).state_noise[1, 1] == q[k - 1, 0, 0]
    with pytest.raises(ValueError, match="at most 6"):
        one.step(7)


def test_start_law_in_its_three_forms():
    blocks = np.array([[[1.0]], [[0.4]], [[0.2]]])
    apart = DelaySystem({2: 0.5}, 1.0, 1.0, 1.0, blocks[0], blocks[1:])
    joint = DelaySystem({2: 0.5}, 1.0, 1.0, 1.0, np.diag([1.0, 0.4, 0.2]))
    np.testing.assert_array_equal(apart.start_cov(), joint.start_cov())
    np.testing.assert_array_equal(apart.start_blocks(), joint.start_blocks())
    known = DelaySystem({2: 0.5}, 1.0, 1.0, 1.0, 1.0)
    np.testing.assert_array_equal(known.start_cov(), np.diag([1.0, 0.0, 0.0]))
    correlated = np.eye(3) + 0.5
    linked = DelaySystem({2: 0.5}, 1.0, 1.0, 1.0, correlated)
    assert linked.start_blocks() is None
    np.testing.assert_array_equal(linked.start_cov(), correlated)


@pytest.mark.parametrize("correlated", [False, True])
def test_simulated_moments(correlated):
    rng = np.random.default_rng(5)
    given = dict(GIVEN, mean0=[1.0, -2.0, 0.5, 0.0, 0.0, 3.0])
    if correlated:
        root = rng.standard_normal((6, 6))
        given |= {"cov0": root @ root.T / 6.0, "history_cov": None}
    system = DelaySystem(**given)
    paths = 20_000
    run = system.simulate(6, paths, 1)
    assert run.states.shape == (7, 2, paths)
    assert run.measurements.shape == (7, 1, paths)
    assert run.history.shape == (2, 2, paths)
    assert np.isnan(run.measurements[0]).all()
    start = np.concatenate([run.states[0], *run.history])
    cases = [(start, system.mean0, system.start_cov())]
    cases.append((run.states[6], *moments_by_stacking(system, 6)))
    for drawn, mean, cov in cases:
        spread = np.sqrt(np.diag(cov))
        assert (np.abs(drawn.mean(axis=1) - mean) <= 4.0 * spread / np.sqrt(paths)).all()
        centred = drawn - mean[:, None]
        products = centred[:, None] * centred[None]
        error = products.std(axis=2) / np.sqrt(paths)
        assert (np.abs(products.mean(axis=2) - cov) <= 4.0 * error + 1e-15).all()
    noise = run.measurements[6] - run.states[6, :1]
    assert abs(noise.var() - 0.5) <= 4.0 * 0.5 * np.sqrt(2.0 / paths)


def test_simulated_paths_obey_the_equation_without_noise():
    system = DelaySystem(**(GIVEN | {"noise_cov": 0.0}))
    run = system.simulate(5, 3, 2)
    chain = np.concatenate([run.history[::-1], run.states])
    a, b = (np.array(GIVEN["dynamics"][d]) for d in (0, 2))
    for now in range(3, 8):
        wanted = a @ chain[now - 1] + b @ chain[now - 3]
        np.testing.assert_allclose(chain[now], wanted, rtol=1e-14, atol=1e-15)


def test_simulation_is_repeatable_and_takes_every_kind_of_seed():
    system = DelaySystem(**GIVEN)
    runs = [
        system.simulate(3, 10, seed).states
        for seed in (7, 7, np.random.SeedSequence(7), np.random.default_rng(7))
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_array_equal(runs[0], runs[2])
    assert not np.array_equal(runs[0], runs[3])
    alone = system.simulate(3, None, 7)
    assert alone.states.shape == (4, 2)
    assert alone.measurements.shape == (4, 1)


def test_examples_have_the_radii_that_are_said_of_them():
    radius = examples.spectral_radius
    assert radius(examples.precise_sensor()) == pytest.approx(0.9459, abs=5e-5)
    assert radius(examples.two_noises()) == pytest.approx(0.9545, abs=5e-5)
    assert radius(examples.rotation(0.7, 3)) == pytest.approx(0.972, abs=5e-4)
    assert radius(examples.rotation(0.8, 3)) > 1.0
    assert examples.scalar(0.6, 0.3, delay=0).augmented().transition[0, 0] == pytest.approx(0.9)
    radii = [radius(plant) for plant in examples.random_plants(20)]
    assert 0.6 <= min(radii) <= max(radii) <= 0.98


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"dynamics": {}}, ValueError, "dynamics: wanted at least one delay"),
        ({"dynamics": [np.eye(2)]}, TypeError, "dynamics: wanted a mapping"),
        ({"dynamics": {-1: np.eye(2)}}, ValueError, "dynamics: wanted delays >= 0, got -1"),
        ({"dynamics": {1.5: np.eye(2)}}, TypeError, "dynamics: wanted integer delays, got 1.5"),
        ({"dynamics": {True: np.eye(2)}}, TypeError, "dynamics: wanted integer delays, got True"),
        ({"dynamics": {0: np.ones((2, 3))}}, ValueError, "dynamics[0]: wanted shape (3, 3)"),
        ({"dynamics": {0: np.eye(2), 2: np.eye(3)}}, ValueError, "dynamics[2]: wanted shape"),
        ({"dynamics": {0: [[np.nan, 0], [0, 1]], 2: np.eye(2)}}, ValueError, "dynamics[0]"),
        ({"dynamics": {0: np.eye(2) * 1j, 2: np.eye(2)}}, TypeError, "dynamics[0]"),
        ({"dynamics": {0: np.zeros((0, 2, 2)), 2: np.eye(2)}}, ValueError, "dynamics[0]"),
        ({"sensor": [[1.0, 0.0, 0.0]]}, ValueError, "sensor: wanted shape (any, 2)"),
        ({"sensor": np.ones((0, 2))}, ValueError, "sensor: wanted at least one measurement"),
        ({"sensor": np.ones((1, 1, 2))}, ValueError, "sensor: wanted entries up to k = 1"),
        ({"sensor_cov": [[0.0]]}, ValueError, "sensor_cov: wanted a positive definite"),
        ({"sensor_cov": np.eye(2)}, ValueError, "sensor_cov: wanted shape (1, 1)"),
        ({"noise_cov": [[-1.0]]}, ValueError, "noise_cov: wanted a positive semidefinite"),
        ({"noise_cov": np.eye(2)}, ValueError, "noise_input: wanted shape (2, 2)"),
        ({"noise_input": [[np.inf], [1.0]]}, ValueError, "noise_input: wanted finite"),
        ({"cov0": [[1.0, 0.5], [0.0, 1.0]]}, ValueError, "cov0: wanted a symmetric"),
        ({"cov0": np.eye(3)}, ValueError, "cov0: wanted shape (2, 2) or (6, 6)"),
        ({"cov0": np.eye(6)}, ValueError, "history_cov: wanted only beside"),
        ({"history_cov": -np.eye(2)}, ValueError, "history_cov[0]: wanted a positive"),
        ({"history_cov": np.ones((3, 2, 2))}, ValueError, "history_cov: wanted shape (2, 2, 2)"),
        ({"mean0": [1.0, 2.0, 3.0]}, ValueError, "mean0: wanted shape (2,) or (6,)"),
        ({"mean0": "zero"}, TypeError, "mean0"),
    ],
)
def test_bad_input_is_named(change, error, message):
    with pytest.raises(error, match=re.escape(message)):
        DelaySystem(**(GIVEN | change))


def test_a_function_is_checked_when_it_is_used():
    sensor = GIVEN | {"sensor": lambda k: np.ones((1 if k < 3 else 2, 2))}
    noise = GIVEN | {"sensor_cov": lambda k: [[2.0 - k]]}
    for given, k, name in ((sensor, 3, "sensor"), (noise, 2, "sensor_cov")):
        system = DelaySystem(**given)
        with pytest.raises(ValueError, match=f"{name} at k = {k}"):
            system.step(k)


@pytest.mark.parametrize(("steps", "paths"), [(0, 1), (2, 0), (2.0, 1), (2, True)])
def test_simulation_refuses_bad_counts(steps, paths):
    with pytest.raises((TypeError, ValueError), match=r"times|paths"):
        DelaySystem(**GIVEN).simulate(steps, paths, 1)


def test_ragged_huge_and_nearly_singular_input_is_named():
    with pytest.raises(TypeError, match="dynamics"):
        DelaySystem(**(GIVEN | {"dynamics": {0: [[1.0, 2.0], [3.0]]}}))
    with pytest.raises(ValueError, match="dynamics: wanted delays up to"):
        DelaySystem(**(GIVEN | {"dynamics": {10**30: np.eye(2)}}))
    with pytest.raises(ValueError, match=r"noise_input and noise_cov.*overflow"):
        DelaySystem(**(GIVEN | {"noise_input": [[0.0], [1e200]]}))
    for seed in range(60):  # rank one: the smallest eigenvalue is rounding of either sign
        row = np.random.default_rng(seed).standard_normal((3, 1))
        change = {"sensor": np.ones((3, 2)), "sensor_cov": row @ row.T}
        try:
            np.linalg.cholesky(row @ row.T)
        except np.linalg.LinAlgError:
            with pytest.raises(ValueError, match="sensor_cov: wanted a positive"):
                DelaySystem(**(GIVEN | change))


def test_paths_that_overflow_are_refused():
    system = DelaySystem({0: 3.0}, 1.0, 1.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="system: wanted paths"):
        system.simulate(1000, 2, 1)
