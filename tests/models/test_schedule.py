"""Sensors with schedules of their own: masks by component, and what arrives."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base.blocks import BLOCK
from seedslib.delay.examples import nearly_parallel_sensors
from seedslib.models import DiscreteSystem, Noise, StochasticMap
from seedslib.piecewise.examples import falling_body

TIMES = np.arange(6.0)
PATHS = 400


@pytest.fixture(scope="module")
def pair():
    """A state of two components, each with a sensor."""
    x, v, w = (sympy.symbols(f"{name}1:3", real=True) for name in "xvw")
    return DiscreteSystem(
        StochasticMap(x, [0.9 * x[0] + v[0], 0.5 * x[1] + v[1]], Noise(v)),
        StochasticMap(x, [x[0] + w[0], x[1] + w[1]], Noise(w)),
        [0.0, 0.0], np.eye(2),
    )  # fmt: skip


MASK = np.array([[1, 0], [0, 1], [0, 0], [1, 1], [0, 1], [1, 0]], dtype=bool)


def test_each_component_is_read_when_the_mask_says_so(pair):
    whole = pair.simulate(TIMES, PATHS, 1)
    made = pair.simulate(TIMES, PATHS, 1, measured=MASK)
    np.testing.assert_array_equal(made.states, whole.states)
    wanted = np.where(MASK[..., None], whole.measurements, np.nan)
    np.testing.assert_array_equal(made.measurements, wanted)
    rows = pair.simulate(TIMES, PATHS, 1, measured=[0, 3])
    both = np.repeat(np.isin(np.arange(6), [0, 3])[:, None], 2, axis=1)
    again = pair.simulate(TIMES, PATHS, 1, measured=both)
    np.testing.assert_array_equal(rows.measurements, again.measurements)


def test_what_arrives_moves_no_number(pair):
    """Parts .7 and .2 of 2400 numbers each, within four standard errors; nothing else changes."""
    whole = pair.simulate(TIMES, PATHS, 1)
    made = pair.simulate(TIMES, PATHS, 1, availability=[0.7, 0.2])
    np.testing.assert_array_equal(made.states, whole.states)
    there = ~np.isnan(made.measurements)
    np.testing.assert_array_equal(made.measurements[there], whole.measurements[there])
    share, count = there.mean(axis=(0, 2)), 6 * PATHS
    assert (np.abs(share - [0.7, 0.2]) < 4 * np.sqrt([0.21 / count, 0.16 / count])).all()
    # independent between components, times and paths: pairs arrive with the product
    for one, other, p in (
        (there[:, 0], there[:, 1], 0.14),
        (there[1:, 0], there[:-1, 0], 0.49),
        (there[:, 0, 1:], there[:, 0, :-1], 0.49),
    ):
        both = one & other
        assert abs(both.mean() - p) < 4 * np.sqrt(p * (1 - p) / both.size)
    few = pair.simulate(TIMES, 50, 1, availability=[0.7, 0.2])
    np.testing.assert_array_equal(few.measurements, made.measurements[..., :50])
    for certain, wanted in ((1.0, whole.measurements), (0, np.full((6, 2, PATHS), np.nan))):
        got = pair.simulate(TIMES, PATHS, 1, availability=certain).measurements
        np.testing.assert_array_equal(got, wanted)


def test_blocks_of_paths_lose_measurements_of_their_own(pair):
    made = pair.simulate(TIMES[:2], BLOCK + 300, 1, availability=0.5)
    gone = np.isnan(made.measurements)
    assert 0.4 < (gone[..., :300] == gone[..., BLOCK:]).mean() < 0.6
    two = pair.simulate(TIMES[:2], BLOCK + 300, 1, availability=0.5, workers=2)
    np.testing.assert_array_equal(two.measurements, made.measurements)


def test_an_indicator_is_a_component_of_its_own():
    target = zoo.manoeuvring_target("noisy")
    whole = target.simulate(TIMES, PATHS, 1)
    made = target.simulate(TIMES, PATHS, 1, measured=MASK)
    np.testing.assert_array_equal(made.indicators, np.where(MASK[:, 1:], whole.indicators, -1))
    wanted = np.where(MASK[:, :1, None], whole.measurements, np.nan)
    np.testing.assert_array_equal(made.measurements, wanted)
    never = target.simulate(TIMES, PATHS, 1, availability=[1.0, 0.0])
    assert (never.indicators == -1).all()
    np.testing.assert_array_equal(never.measurements, whole.measurements)


def test_systems_of_the_wings_have_schedules_too():
    plant, body = nearly_parallel_sensors(), falling_body()
    for system, size in ((plant, plant.measurement_size), (body, 1)):
        times = np.arange(4.0)
        whole = system.simulate(times, 50, 1)
        mask = np.zeros((4, size), dtype=bool)
        mask[[0, 2], 0] = True
        made = system.simulate(times, 50, 1, measured=mask)
        np.testing.assert_array_equal(made.states, whole.states)
        assert np.isnan(made.measurements[[0, 1, 3]]).all()
        np.testing.assert_array_equal(made.measurements[2, 0], whole.measurements[2, 0])
        some = system.simulate(times, 50, 1, availability=0.5).measurements[1:]
        assert 0.2 < np.isnan(some).mean() < 0.8


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"measured": MASK[:5]}, ValueError, r"measured: wanted .* \(6, 2\), got bool .* \(5, 2\)"),
        ({"measured": MASK.astype(int)}, ValueError, r"measured: wanted a mask .* got int64"),
        ({"availability": 1.5}, ValueError, "availability: wanted a probability, or 2 of them"),
        ({"availability": [0.5] * 3}, ValueError, "availability: wanted"),
        ({"availability": np.nan}, ValueError, "availability"),
        ({"availability": "often"}, TypeError, "availability"),
    ],
)
def test_bad_schedules_are_named(pair, options, error, message):
    with pytest.raises(error, match=message):
        pair.simulate(TIMES, 10, 1, **options)
