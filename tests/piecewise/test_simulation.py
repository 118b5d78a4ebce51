"""Simulation of piecewise-linear systems, and the partitions of the falling body."""

import numpy as np
import pytest
import sympy as sp

from oracles import piecewise_routes as routes
from seedslib.piecewise import examples

INF = np.inf


def test_nothing_is_measured_at_the_first_time_whatever_is_asked():
    system = routes.tent()
    for measured in (None, np.ones(4, bool), [0, 1, 2, 3]):
        y = system.simulate(3, 5, 1, measured=measured).measurements
        assert np.isnan(y).any(axis=(1, 2)).tolist() == [True, False, False, False]
    found = system.simulate(3, 5, 1, measured=[0, 2]).measurements
    assert np.isfinite(found).all(axis=(1, 2)).tolist() == [False, False, True, False]
    every = system.simulate(3, 5, 1).measurements
    assert (found[2] == every[2]).all()
    pair = routes.tent(
        sensor=([[0.0, 0.0]] * 2, [[[1.0, 1.0]], [[2.0, 2.0]]]), sensor_noise=0.1 * np.eye(2)
    )
    mask = np.array([[True, True], [True, False], [False, True]])
    shown = np.isfinite(pair.simulate(2, 4, 1, measured=mask).measurements)
    assert shown[..., 0].tolist() == [[False, False], [True, False], [False, True]]
    some = system.simulate(200, 5, 1, availability=0.25).measurements
    assert np.isfinite(some[1:]).mean() == pytest.approx(0.25, abs=0.06)


def test_paths_of_a_start_and_a_grid_of_times():
    """A deterministic map with a coefficient that grows with the time it leaves."""
    system = routes.tent(
        dynamics=lambda t: ({1.0: [1.0], 4.0: [4.0]}[t], [[2.0]]),
        sensor_noise=lambda t: {7.0: [[0.0]]}[t],
    )
    found = system.simulate([1.0, 4.0, 7.0], 3, 5, start=[0.5], measured=[2])
    assert found.states[:, 0].tolist() == [[0.5] * 3, [2.0] * 3, [8.0] * 3]
    assert found.measurements[2].tolist() == [[8.0] * 3]
    assert found.times.tolist() == [1.0, 4.0, 7.0]
    with pytest.raises(ValueError, match=r"start: wanted shape \(1\), got \(2,\)$"):
        system.simulate([1.0, 7.0], 3, 5, start=[0.5, 0.5])


def test_paths_do_not_depend_on_the_number_of_workers():
    one, two = (routes.noisy_block().simulate(5, 700, 3, workers=w) for w in (1, 2))
    assert (one.states == two.states).all()
    np.testing.assert_array_equal(one.measurements, two.measurements)


@pytest.mark.parametrize(("partition", "power"), [("gradient", -2.0), ("curvature", -0.5)])
@pytest.mark.parametrize("span", [(2.0, 32.0), (0.5, 0.75)])
def test_edges_of_the_falling_body_are_equidistant_in_a_power(partition, power, span):
    edges = examples.falling_body(4, partition=partition, span=span).regions.edges
    assert edges[[0, -1]].tolist() == [-INF, INF]
    first, last = span[0] ** power, span[1] ** power
    wanted = [(first + k / 4 * (last - first)) ** (1 / power) for k in (1, 2, 3)]
    np.testing.assert_allclose(edges[1:-1], wanted, rtol=1e-13)


def test_the_falling_body_as_it_is_asked_for():
    system = examples.falling_body(2, span=(10.0, 40.0), sensor_noise=0.5, deviation=3.0, speed=1.5)
    assert system.mean0.tolist() == [27.5, 0.1]
    np.testing.assert_allclose(system.cov0, np.diag([9.0, 1e-12]), rtol=1e-15)
    t, x = 3.0, np.array([[20.0, 30.0], [0.2, 0.3]])
    moved = system.functions.transition.value(t, x, np.zeros((0, 2)))
    np.testing.assert_allclose(moved, [x[0], x[1] - 0.01 * (3.5 + 1.5) / x[0]], rtol=1e-14)
    seen = system.functions.sensor_map.value(t, x, np.array([[1.0, -2.0]]))
    np.testing.assert_allclose(seen, [[0.7, -0.7]], rtol=1e-14)
    r = (0.5 * (10.0**-2 + 40.0**-2)) ** -0.5
    p = np.array([10.0 + r, r + 40.0]) / 2
    c = system.dynamics_at(t)
    np.testing.assert_allclose(c.matrix[1, 0, :, 0], 0.05 / p**2, rtol=1e-13)
    np.testing.assert_allclose(c.offset[1, :, 0], -0.1 / p, rtol=1e-13)
    near = examples.falling_body(2, span=(10.0, 40.0), support=[11.0, 30.0]).dynamics_at(0.0)
    np.testing.assert_allclose(near.matrix[1, 0, :, 0], 0.005 / np.array([11.0, 30.0]) ** 2)
    still = examples.falling_body(1)
    assert still.regions.edges.tolist() == [-INF, INF]
    assert still.functions.adaptive is False
    assert examples.falling_body(1, support="estimate").functions.adaptive is True
    assert sp.Symbol("g") not in set().union(*(e.free_symbols for e in
                                               still.functions.transition.expressions))  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"span": (5.0, 5.0)}, r"span: wanted 0 < low < high, got \(5.0, 5.0\)$"),
        ({"span": (0.0, 5.0)}, "span: wanted 0 < low < high, got"),
        ({"span": (6.0, 5.0)}, "span: wanted 0 < low < high, got"),
        ({"partition": "even"}, 'partition: wanted "gradient" or "curvature", got \'even\'$'),
        ({"cells": 0}, "cells: wanted at least 1, got 0$"),
    ],
)
def test_bodies_that_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        examples.falling_body(**changes)
