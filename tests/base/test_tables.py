"""Axes, nodes and tables, and which times of two grids are the same."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from seedslib import zoo
from seedslib.base import Axis, Nodes, interpolate
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.linearization import Taylor


def test_interpolation_is_that_of_scipy_and_constant_beyond_the_ends():
    rng = np.random.default_rng(1)
    axes = (Axis(-1.0, 2.0, 7), Axis(0.0, 1.0, 4), Axis(-5.0, -3.0, 11))
    table = rng.standard_normal((2, 7, 4, 11))
    points = np.array([rng.uniform(a.low - 0.3, a.high + 0.3, 200) for a in axes])
    points[:, :3] = [[a.low, a.high, a.nodes[1]] for a in axes]
    inside = [np.clip(row, a.low, a.high) for a, row in zip(axes, points, strict=True)]
    for row, found in zip(table, interpolate(table, axes, points), strict=True):
        other = RegularGridInterpolator([a.nodes for a in axes], row)(np.transpose(inside))
        np.testing.assert_allclose(found, other, rtol=1e-12, atol=1e-12)
    wide = interpolate(table[:1, :, :, 0], axes[:2], [np.ones((4, 1)), np.ones((1, 5))])
    assert wide.shape == (1, 4, 5)


def test_axes_place_values_and_integrate():
    axis = Axis(-8.0, 8.0, 81)
    density = np.exp(-0.5 * axis.nodes**2) / np.sqrt(2 * np.pi)
    assert axis.weights @ density == pytest.approx(1.0, abs=1e-13)
    assert axis.weights.sum() == pytest.approx(16.0)
    assert axis.step == pytest.approx(0.2)
    values = np.append(np.random.default_rng(2).uniform(-8, 8, 100), [-8.0, 8.0])
    nodes = Nodes(np.sinh(np.linspace(-3, 3, 41)))
    for grid in (axis, nodes):
        index, share = grid.place(values)
        assert index.min() >= 0
        assert index.max() <= grid.count - 2
        assert ((share >= 0) & (share <= 1)).all()
        mean = (1 - share) * grid.nodes[index] + share * grid.nodes[index + 1]
        np.testing.assert_allclose(mean, values, atol=1e-12)
    u = np.linspace(-3, 3, 41)
    even = Nodes(np.sinh(u), 0.15 * np.cosh(u))
    for grid in (nodes, even):
        density = np.exp(-0.5 * grid.nodes**2) / np.sqrt(2 * np.pi)
        assert grid.weights @ density == pytest.approx(1.0, abs=2e-2 if grid is nodes else 1e-3)
    assert (even.low, even.high) == (even.nodes[0], even.nodes[-1])


@pytest.mark.parametrize(
    ("start", "unit"), [(0.0, 1.0), (1.7e9, 1e-3), (0.0, 1e-9), (3e15, 64.0), (7.0, 1e13)]
)
def test_times_that_differ_by_rounding_are_the_same_in_every_unit_and_from_every_zero(start, unit):
    """A design knows its times among those of a finer record; the others are times between."""
    system = zoo.steady_target()
    times = start + unit * np.arange(4)
    made = synthesize(system, Memory(1), Taylor(), times, paths=200, seed=1)
    y = np.random.default_rng(0).normal(size=(4, 1))
    wanted = made.run(times, y)
    for near in (np.nextafter(times, np.inf), np.nextafter(times, 0), times):
        np.testing.assert_allclose(made.run(near, y).mean, wanted.mean, rtol=1e-12)
    with pytest.raises(ValueError, match=r"^times: "):
        made.run(times + np.array([0, 0, 0.2 * unit, 0]), y)
