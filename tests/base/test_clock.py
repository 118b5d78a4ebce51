"""Which times are the same: in every unit, from every zero, and never two neighbours of a grid."""

import numpy as np
import pytest

from seedslib.base.clock import Clock, lengths_alike, slack, when

GRIDS = [(0.0, 1.0), (1.7e9, 1.0), (1.7e9, 1e-3), (0.0, 1e-9), (0.0, 1e-300), (3e15, 64.0)]


@pytest.mark.parametrize(("start", "unit"), GRIDS)
def test_rows_of_a_finer_grid_that_is_rounded_otherwise(start, unit):
    times = start + unit * np.arange(5)
    finer = np.array([start + unit * k / 4 for k in range(17)])  # products, not sums
    clock = Clock(times)
    assert clock.rows(finer).tolist() == [0, 4, 8, 12, 16]
    assert clock.rows(np.nextafter(finer, np.inf)).tolist() == [0, 4, 8, 12, 16]
    assert clock.rows(finer[1:]).tolist() == [-1, 3, 7, 11, 15]
    assert clock.rows(finer[1:4]).tolist() == [-1] * 5
    assert clock.rows(np.empty(0)).tolist() == [-1] * 5
    assert clock.same(times[2], np.nextafter(times[2], 0))
    assert not clock.same(times[2], finer[9])


def test_neighbours_are_two_times_however_near():
    times = [1.7e9]
    for _ in range(5):
        times.append(np.nextafter(times[-1], np.inf))
    clock = Clock(np.array(times))
    assert clock.rows(np.array(times)).tolist() == list(range(6))
    assert clock.rows(np.array(times[1::2])).tolist() == [-1, 0, -1, 1, -1, 2]


def test_a_time_alone_is_known_by_its_rounding_and_an_end_gives_it_an_interval():
    assert Clock(np.array([0.3])).same(0.1 * 3, 0.3)
    assert not Clock(np.array([1.7e9])).same(1.7e9 + 1e-3, 1.7e9)
    assert Clock(np.zeros(1)).tolerance == 0.0
    assert Clock(np.zeros(1), end=2e-9).tolerance == pytest.approx(2e-18)
    assert Clock(np.arange(2.0), end=1e9).tolerance == pytest.approx(2.0**-50 * 1e9)


def test_beyond_the_grid_rounding_counts_by_the_size_of_the_time():
    clock = Clock(0.1 * np.arange(3))
    t = 0.0
    for _ in range(10**6):
        t += 0.1
    late = 1e9 + 0.1
    assert clock.same(late, np.nextafter(late, np.inf))
    assert not clock.same(late, late + 0.01)
    assert not clock.same(t, 1e5)  # a sum of a million steps is truly elsewhere


@pytest.mark.parametrize("unit", [1.0, 1e-13, 1e-200, 1e13])
def test_lengths_lose_their_rounding_and_nothing_else(unit):
    steps = unit * np.diff(np.linspace(0.0, 1.0, 101))
    assert len(set(steps.tolist())) > 5
    assert len(set(lengths_alike(steps).tolist())) == 1
    np.testing.assert_allclose(lengths_alike(steps), steps, rtol=1e-11)
    assert lengths_alike(unit) != lengths_alike(unit * (1 + 1e-10))


def test_slack_is_never_more_than_a_quarter():
    assert slack(1.0, 0.0) == 1e-9
    assert slack(1e-7, 1.7e9) == 2.5e-8
    assert slack(1.0, 1.7e9) == 2.0**-50 * 1.7e9


def test_neighbouring_times_are_told_apart_in_messages():
    assert [when(t) for t in (0.0, 1 / 3, 12.5, 1.7e9, 1.7e9 + 0.25, np.inf, -2e5)] == [
        "0", "0.333333", "12.5", "1700000000", "1700000000.25", "inf", "-200000",
    ]  # fmt: skip
