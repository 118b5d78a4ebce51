"""Simulation: what the numbers depend on, and which measurements are read and arrive."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem, inputs_of
from systems import INPUTS, TIMES, discrete_system

GRID = np.arange(6.0)
MASK = np.array([[1, 0], [0, 1], [0, 0], [1, 1], [0, 1], [1, 0]], dtype=bool)
MANY = 8192 + 300
"""More than a block of paths."""


def pair():
    x, v, w = (sympy.symbols(f"{name}1:3", real=True) for name in "xvw")
    return DiscreteSystem(
        StochasticMap(x, [0.9 * x[0] + v[0], 0.5 * x[1] + v[1]], Noise(v)),
        StochasticMap(x, [x[0] + w[0], x[1] + w[1]], Noise(w)),
        [0.0, 0.0],
        np.eye(2),
    )


SYSTEMS = {
    "diffusion": (zoo.van_der_pol, [0.0, 0.1, 0.3], {}),
    "jumps": (zoo.kicked_duffing, [0.0, 0.1, 0.3], {"scheme": "heun"}),
    "discrete": (discrete_system, TIMES[:3], {}),
    "modes": (zoo.manoeuvring_target, GRID[:3], {}),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_numbers_depend_neither_on_threads_nor_on_how_many_paths_follow(name):
    make, times, options = SYSTEMS[name]
    system = make()

    def made(paths, seed=7, workers=1):
        own = np.linspace(-1, 1, MANY)[:paths]
        inputs = {u: INPUTS[u][:3, None] * own for u in inputs_of(system)}
        return system.simulate(
            times, paths, seed, availability=0.7, workers=workers, inputs=inputs, **options
        )

    whole = made(MANY)
    for paths, workers in ((MANY, 2), (8200, 1), (3, 1), (1, 1)):
        part = made(paths, workers=workers)
        for one, two in zip(part[1:5], whole[1:5], strict=True):
            assert (one is None) == (two is None)
            if one is not None:
                np.testing.assert_array_equal(one, two[..., :paths])
    blocks = whole.states[..., :300], whole.states[..., 8192:]
    assert not np.isclose(*blocks).any(axis=(0, 1)).all()
    assert not np.array_equal(made(3, seed=8).states, whole.states[..., :3])


def test_a_full_initial_covariance_gives_equal_bits_in_runs_of_any_size():
    x, v, w = (sympy.symbols(f"{name}1:4", real=True) for name in "xvw")
    root = np.array([[1.1, 0, 0], [0.7, 1.3, 0], [-0.4, 0.9, 0.8]])
    start = [(0.5, [0.1, 0.2, 0.3], root @ root.T)] * 2
    system = SwitchingSystem(
        x,
        [[a + b for a, b in zip(x, v, strict=True)]] * 2,
        Noise(v, cov=root @ root.T),
        [[0.5, 0.5]] * 2,
        [[a + b for a, b in zip(x, w, strict=True)]] * 2,
        Noise(w),
        start,
    )
    whole = system.simulate(range(2), 1000, 3)
    for paths in (1, 2, 3, 17, 300):
        part = system.simulate(range(2), paths, 3)
        np.testing.assert_array_equal(part.states, whole.states[..., :paths])
        np.testing.assert_array_equal(part.measurements, whole.measurements[..., :paths])


def test_a_seed_may_be_a_number_a_sequence_or_a_generator():
    def start(seed):
        return pair().simulate([0.0], 2, seed).states

    used = np.random.SeedSequence(5)
    used.spawn(3)  # equal seeds give equal runs, whatever was spawned of them
    for seed in (5, np.int64(5), np.random.SeedSequence(5), used):
        np.testing.assert_array_equal(start(seed), start(5))
    generator = np.random.default_rng(1)
    assert not np.array_equal(start(generator), start(generator))
    np.testing.assert_array_equal(start(np.random.default_rng(1)), start(np.random.default_rng(1)))


def test_advance_keeps_the_shape_of_the_batch_and_its_argument():
    system, states = zoo.kicked_duffing(), np.ones((2, 4, 3))
    moved = system.advance(states, 0.0, 0.1, np.random.default_rng(0))
    assert (states == 1).all()
    flat = system.advance(states.reshape(2, 12), 0.0, 0.1, np.random.default_rng(0))
    np.testing.assert_array_equal(moved, flat.reshape(2, 4, 3))
    target = zoo.manoeuvring_target().hybrid
    states = target.initial_sample(np.random.default_rng(0), 12)
    moved = target.advance(states.reshape(3, 4, 3), 0.0, 1.0, np.random.default_rng(0))
    flat = target.advance(states, 0.0, 1.0, np.random.default_rng(0))
    np.testing.assert_array_equal(moved, flat.reshape(3, 4, 3))


def test_components_are_read_when_the_mask_says_so():
    whole = pair().simulate(GRID, 50, 1)
    made = pair().simulate(GRID, 50, 1, measured=MASK)
    np.testing.assert_array_equal(made.states, whole.states)
    wanted = np.where(MASK[..., None], whole.measurements, np.nan)
    np.testing.assert_array_equal(made.measurements, wanted)
    rows = np.array([True, False, False, True, False, True])
    for measured in ([0, 3, -1], rows, np.repeat(rows[:, None], 2, axis=1)):
        made = pair().simulate(GRID, 50, 1, measured=measured)
        wanted = np.where(rows[:, None, None], whole.measurements, np.nan)
        np.testing.assert_array_equal(made.measurements, wanted)


def test_what_arrives_is_independent_and_moves_no_number():
    """Parts .7 and .2 within four standard errors, between components, times, paths and blocks."""
    whole = pair().simulate(GRID[:3], MANY, 1)
    made = pair().simulate(GRID[:3], MANY, 1, availability=[0.7, 0.2])
    np.testing.assert_array_equal(made.states, whole.states)
    there = ~np.isnan(made.measurements)
    np.testing.assert_array_equal(made.measurements[there], whole.measurements[there])
    for arrived, p in (
        (there[:, 0], 0.7),
        (there[:, 1], 0.2),
        (there[:, 0] & there[:, 1], 0.14),
        (there[1:, 0] & there[:-1, 0], 0.49),
        (there[:, 0, 1:] & there[:, 0, :-1], 0.49),
        (there[:, 0, :300] & there[:, 0, 8192:], 0.49),
    ):
        assert abs(arrived.mean() - p) < 4 * np.sqrt(p * (1 - p) / arrived.size)
    for certain, wanted in (
        (1.0, whole.measurements),
        (0, np.full_like(whole.measurements, np.nan)),
    ):
        got = pair().simulate(GRID[:3], MANY, 1, availability=certain).measurements
        np.testing.assert_array_equal(got, wanted)


def test_an_indicator_is_a_component_of_its_own():
    target = zoo.manoeuvring_target("noisy")
    whole = target.simulate(GRID, 200, 1)
    made = target.simulate(GRID, 200, 1, measured=MASK)
    np.testing.assert_array_equal(made.indicators, np.where(MASK[:, 1:], whole.indicators, -1))
    wanted = np.where(MASK[:, :1, None], whole.measurements, np.nan)
    np.testing.assert_array_equal(made.measurements, wanted)
    never = target.simulate(GRID, 200, 1, availability=[1.0, 0.0])
    assert (never.indicators == -1).all()
    np.testing.assert_array_equal(never.measurements, whole.measurements)


def test_paths_that_explode_show_it_without_a_warning():
    run = zoo.van_der_pol().simulate([0.0, 60.0], 50, 1, step=1.5)
    assert not np.isfinite(run.states[1]).all()
    assert np.isfinite(run.states[0]).all()
