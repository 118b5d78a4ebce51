import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from seedslib.base import Axis, interpolate
from seedslib.base.tables import as_axes


def test_interpolation_against_scipy_in_three_dimensions():
    rng = np.random.default_rng(1)
    axes = (Axis(-1.0, 2.0, 7), Axis(0.0, 1.0, 4), Axis(-5.0, -3.0, 11))
    table = rng.standard_normal((2, 7, 4, 11))
    points = np.array([rng.uniform(a.low, a.high, 200) for a in axes])
    for row, found in zip(table, interpolate(table, axes, points), strict=True):
        other = RegularGridInterpolator([a.nodes for a in axes], row)(points.T)
        assert np.allclose(found, other, rtol=1e-13, atol=1e-13)


def test_multilinear_functions_are_exact_and_constant_beyond_the_ends():
    axes = (Axis(0.0, 1.0, 5), Axis(-2.0, 2.0, 9))
    a, b = np.meshgrid(axes[0].nodes, axes[1].nodes, indexing="ij")
    table = (1.0 + 2.0 * a - b + 3.0 * a * b)[None]
    inside = interpolate(table, axes, [np.array(0.37), np.array(-1.21)])
    assert inside == pytest.approx(1.0 + 0.74 + 1.21 - 3.0 * 0.37 * 1.21, rel=1e-13)
    outside = interpolate(table, axes, [np.array([-9.0, 9.0]), np.array([-9.0, 9.0])])
    assert np.allclose(outside[0], [3.0, 1.0 + 2.0 - 2.0 + 6.0])


def test_points_broadcast_and_a_table_of_one_function_of_nothing():
    axes = (Axis(0.0, 1.0, 3), Axis(0.0, 1.0, 3))
    table = np.arange(9.0).reshape(1, 3, 3)
    wide = interpolate(table, axes, [np.linspace(0, 1, 4)[:, None], np.linspace(0, 1, 5)[None]])
    assert wide.shape == (1, 4, 5)
    assert np.allclose(wide[0], 6.0 * np.linspace(0, 1, 4)[:, None] + 2.0 * np.linspace(0, 1, 5))


def test_place_keeps_the_mean():
    axis = Axis(-3.0, 3.0, 13)
    values = np.random.default_rng(2).uniform(-3, 3, 100)
    index, share = axis.place(np.append(values, [-3.0, 3.0]))
    assert index.min() >= 0
    assert index.max() <= 11
    assert ((share >= 0) & (share <= 1)).all()
    mean = (1 - share) * axis.nodes[index] + share * axis.nodes[index + 1]
    assert np.allclose(mean, np.append(values, [-3.0, 3.0]), atol=1e-14)


def test_trapezoid_weights_integrate_a_gaussian():
    axis = Axis(-8.0, 8.0, 81)
    density = np.exp(-0.5 * axis.nodes**2) / np.sqrt(2 * np.pi)
    assert axis.weights @ density == pytest.approx(1.0, abs=1e-13)
    assert axis.weights.sum() == pytest.approx(16.0)


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ((0, 1, 1), ValueError, "count: wanted at least 2, got 1"),
        ((0, 1, 2.5), TypeError, "count: wanted a whole number"),
        ((0, 1, True), TypeError, "count: wanted a whole number"),
        ((1, 0, 5), ValueError, "in order, got 1, 0"),
        ((0, np.inf, 5), ValueError, "finite numbers"),
        (("a", 1, 5), TypeError, "wanted numbers"),
    ],
)
def test_bad_axes(arguments, kind, message):
    with pytest.raises(kind, match=message):
        Axis(*arguments)
    with pytest.raises(kind, match="z: "):
        Axis.of("z", arguments)


def test_one_axis_or_several():
    one = Axis(0.0, 1.0, 5)
    assert as_axes("y", one, 1) == as_axes("y", (0, 1, 5), 1) == as_axes("y", [one], 1)
    assert as_axes("y", [one] * 3, 3) == (one,) * 3
    with pytest.raises(ValueError, match="y: wanted 2 axes, got 1"):
        as_axes("y", (0, 1, 5), 2)
    with pytest.raises(TypeError, match="y: wanted an Axis or"):
        as_axes("y", [3.0, one], 2)
