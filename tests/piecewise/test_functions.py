"""Tangents of nonlinear functions: support points, noise, and what is refused with which words."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from seedslib.models import Noise
from seedslib.piecewise import PiecewiseLinearSystem
from seedslib.piecewise.cells import Intervals, line_cells
from seedslib.piecewise.clipping import HalfPlanes
from seedslib.piecewise.functions import _cells

INF = np.inf
X, Z, V, W, T, U = sp.symbols("x z v w t u")


def line(**changes):
    parts = {
        "state": (X,), "dynamics": [sp.sin(X) + W / 2], "sensor": [X**2 + V],
        "noise": (V, W), "breakpoints": [-1.0, 0.0, 2.0], "initial": ([0.5], [[1.0]]),
    }  # fmt: skip
    return PiecewiseLinearSystem.from_functions(**(parts | changes))


def plane(**changes):
    parts = {
        "state": (X, Z), "dynamics": [X * Z, X - Z**2], "sensor": [sp.cos(X) * Z + V], "noise": V,
        "breakpoints": line_cells([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0]),
        "support": [[-1.0, -2.0, 3.0, 4.0], [-5.0, 6.0, -7.0, 8.0]],
        "initial": ([0.5, 0.25], np.eye(2)),
    }  # fmt: skip
    return PiecewiseLinearSystem.from_functions(**(parts | changes))


def test_bounded_cells_have_middles_and_unbounded_ones_have_none():
    cells, middle = _cells(Intervals([-INF, -1.0, 2.0, 3.0, INF]))
    assert cells.edges.tolist() == [-INF, -1.0, 2.0, 3.0, INF]
    assert middle.tolist() == [[INF, 0.5, 2.5, INF]]
    cells, middle = _cells([-1.0, 2.0, 3.0])  # finite edges: the outer cells as they were given
    assert cells.edges.tolist() == [-INF, 2.0, INF]
    assert middle.tolist() == [[0.5, 2.5]]
    _, middle = _cells(line_cells([[1, 0, 1], [0, 1, 1]], [0, 0, 3.0]))
    bounded = np.isfinite(middle).all(axis=0)
    assert bounded.sum() == 1
    np.testing.assert_allclose(middle[:, bounded][:, 0], [1.0, 1.0], rtol=1e-14)


def test_tangents_of_a_line_are_taken_in_the_middles_of_the_cells_as_given():
    c, d = line().dynamics_at(0.0), line().sensor_at(1.0)
    p = np.array([-0.5, 1.0])
    np.testing.assert_allclose(c.matrix[0, 0, :, 0], np.cos(p), rtol=1e-15)
    np.testing.assert_allclose(c.offset[0, :, 0], np.sin(p) - np.cos(p) * p, rtol=1e-14)
    np.testing.assert_allclose(d.matrix[0, 0, :, 0], 2 * p, rtol=1e-15)
    np.testing.assert_allclose(d.offset[0, :, 0], -(p**2), rtol=1e-14)
    assert c.noise[0, 0].tolist() == [[0.5], [0.5]]
    assert d.noise[0, 0].tolist() == [[1.0], [1.0]]


@pytest.mark.parametrize("estimate", [None, [[1.5, -2.5, np.nan], [0.5, 0.25, 1.0]]])
def test_tangents_of_a_plane_agree_with_those_of_sympy(estimate):
    """Support points, or estimates in the cells that hold them, one for each data set."""
    points = np.array([[-1.0, -2.0, 3.0, 4.0], [-5.0, 6.0, -7.0, 8.0]])
    system = plane()
    f, h = sp.Matrix([X * Z, X - Z**2]), sp.Matrix([sp.cos(X) * Z])
    where = np.repeat(points[:, :, None], 1 if estimate is None else 3, axis=2)
    if estimate is not None:
        estimate = np.array(estimate)
        follow = replace(system.functions, adaptive=True)
        system = replace(system, functions=follow)
        where[:, 3, 0], where[:, 1, 1] = estimate[:, 0], estimate[:, 1]
    found = system.dynamics_at(0.0, estimate), system.sensor_at(1.0, estimate)
    for map_, c in zip((f, h), found, strict=True):
        for i in range(4):
            for n in range(where.shape[2]):
                at = dict(zip((X, Z), where[:, i, n].tolist(), strict=True))
                slope = np.array(map_.jacobian([X, Z]).subs(at).tolist(), float)
                value = np.array(map_.subs(at).tolist(), float)[:, 0] - slope @ where[:, i, n]
                np.testing.assert_allclose(c.matrix[:, :, i, n], slope, rtol=1e-13, atol=1e-14)
                np.testing.assert_allclose(c.offset[:, i, n], value, rtol=1e-13, atol=1e-13)


def test_components_that_are_not_restricted_are_supported_where_they_are_said_to_be():
    parts = {
        "state": (X, Z), "dynamics": [X, X * Z], "sensor": [Z + V], "noise": V,
        "breakpoints": [0.0, 1.0, 2.0], "initial": ([1.0, 7.0], np.eye(2)),
    }  # fmt: skip
    for support, slopes in (
        ([0.5, 1.5], [7.0, 7.0]), ([[0.5, 1.5]], [7.0, 7.0]),
        ([[0.5, 1.5], [3.0, 4.0]], [3.0, 4.0]),
    ):  # fmt: skip
        system = PiecewiseLinearSystem.from_functions(**parts, support=support)
        assert system.dynamics_at(0.0).matrix[1, :, :, 0].tolist() == [slopes, [0.5, 1.5]]
    follow = PiecewiseLinearSystem.from_functions(**parts, support="estimate")
    found = follow.dynamics_at(0.0, np.array([[1.25, np.nan], [3.0, 5.0]])).matrix[1]
    assert found[..., 0].tolist() == [[3.0, 3.0], [0.5, 1.25]]
    assert found[..., 1].tolist() == [[7.0, 7.0], [0.5, 1.5]]
    assert follow.dynamics_at(0.0).matrix[1, :, :, 0].tolist() == [[7.0, 7.0], [0.5, 1.5]]


def test_time_and_parameters_enter_the_coefficients():
    system = line(dynamics=[T * X + W], sensor=[U * X + T * V], time=T, parameters={U: 3})
    assert system.dynamics_at(2.5).matrix[0, 0, :, 0].tolist() == [2.5, 2.5]
    assert system.sensor_at(4.0).matrix[0, 0, :, 0].tolist() == [3.0, 3.0]
    assert system.sensor_at(4.0).noise[0, 0, :, 0].tolist() == [4.0, 4.0]


def test_a_map_without_noise_has_none():
    system = line(dynamics=[sp.sin(X)], noise=V)
    assert system.dynamics_at(0.0).noise.shape == (1, 0, 2, 1)
    assert system.sensor_at(0.0).noise.shape == (1, 1, 2, 1)
    silent = line(dynamics=[X], sensor=[X], noise=None)
    assert silent.sensor_at(0.0).noise.shape == (1, 0, 2, 1)


@pytest.mark.parametrize("noise", [V, (V,), [V], Noise((V,))])
def test_noise_may_be_named_in_several_ways(noise):
    found = line(dynamics=[X], noise=noise).sensor_at(0.0).noise
    assert found.tolist() == [[[[1.0], [1.0]]]]


def test_correlated_noises_with_means_enter_by_mean_and_covariance():
    cov = np.array([[0.5, 0.2, 0.0], [0.2, 0.4, 0.0], [0.0, 0.0, 0.09]])
    noise = Noise((W, U, V), mean=[0.1, 0.2, 0.3], cov=cov)
    system = line(dynamics=[X + W + 2 * X * U], sensor=[X + 3 * V], noise=noise)
    c, d, p = system.dynamics_at(0.0), system.sensor_at(0.0), np.array([-0.5, 1.0])
    np.testing.assert_allclose(c.matrix[0, 0, :, 0], 1 + 2 * 0.2, rtol=1e-15)
    np.testing.assert_allclose(c.offset[0, :, 0], 0.1, rtol=1e-14)
    for i in range(2):
        turn = np.array([1.0, 2 * p[i]])
        root = c.noise[0, :, i, 0]
        np.testing.assert_allclose(root @ root, turn @ cov[:2, :2] @ turn, rtol=1e-13)
    np.testing.assert_allclose(d.offset[0, :, 0], 0.9, rtol=1e-14)
    np.testing.assert_allclose(np.abs(d.noise[0, 0, :, 0]), 0.9, rtol=1e-14)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dynamics": [sp.sin(Z)]}, "dynamics: wanted known symbols, got z"),
        ({"sensor": [Z]}, "sensor: wanted known symbols, got z"),
        ({"sensor": []}, "sensor: wanted at least one expression, got none$"),
        ({"sensor": [X + V + W]}, "noise: wanted independent noises in the dynamics and in the s"),
        ({"sensor": [X + V**2]}, r"sensor: wanted noise that enters linearly, got \[v\*\*2 \+ x"),
        ({"dynamics": [W * W]}, r"dynamics: wanted noise that enters linearly, got \[w\*\*2\]$"),
        ({"noise": Noise(2)}, "noise: wanted Gaussian noise with named components$"),
        (
            {"noise": Noise((V, W), cov=[[1.0, 0.5], [0.5, 1.0]])},
            "noise: wanted independent noises in the dynamics and in the sensor$",
        ),
        ({"noise": None}, "(dynamics|sensor|noise): wanted"),
        ({"breakpoints": [1.0]}, "breakpoints: wanted at least two strictly increasing edges$"),
        ({"breakpoints": [0.0, 1.0, 1.0]}, "breakpoints: wanted at least two strictly increasing"),
        ({"breakpoints": [0.0, INF]}, "breakpoints: wanted finite numbers"),
        ({"support": "middle"}, 'support: wanted "centroid", "estimate" or points, got "middle"$'),
        ({"support": [0.0, 1.0]}, "support: wanted one point in each cell, in the order of the c"),
        ({"support": [-0.5]}, r"support: wanted shape \(1, 2\), got \(1, 1\)$"),
        ({"support": [np.nan, 1.0]}, "support: wanted finite numbers"),
        (
            {"breakpoints": Intervals([-INF, 0.0, INF])},
            "support: an unbounded cell has no centroid; pass support points$",
        ),
        (
            {"breakpoints": Intervals([-INF, 0.0, INF]), "support": "estimate"},
            "support: an unbounded cell has no centroid; pass support points$",
        ),
        ({"initial": ([[0.5]], [[1.0]])}, r"initial\[0\]: wanted 1 axes, got shape \(1, 1\)$"),
        ({"initial": ([0.5, 1.0], np.eye(2))}, r"initial\[0\]: wanted shape \(1\), got \(2,\)$"),
    ],
)  # fmt: skip
def test_models_that_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        line(**changes)


def test_points_of_a_plane_lie_each_in_its_cell():
    told = "support: wanted one point in each cell, in the order of the cells$"
    with pytest.raises(ValueError, match=told):
        plane(support=[[-1.0, -2.0, 3.0, 4.0], [-5.0, -6.0, -7.0, 8.0]])
    with pytest.raises(ValueError, match=r"support: wanted shape \(2, 4\), got \(1, 4\)$"):
        plane(support=[-1.0, -2.0, 3.0, 4.0])
    with pytest.raises(ValueError, match="support: an unbounded cell has no centroid"):
        plane(support="centroid")


def test_plane_cells_may_be_given_as_half_planes_or_as_their_partition():
    cells = line_cells([[1.0, 0.3], [0.0, 1.0]], [0.2, -0.1])
    listed = [(cell.normals, cell.offsets) for cell in cells.cells]
    middle = np.array([[0.7, 0.7, -0.3, -0.3], [-0.6, 0.4, -0.6, 0.4]])
    support = middle[:, np.argsort(cells.locate(middle))]
    one, other = (
        plane(breakpoints=given, support=support)
        for given in (cells, [HalfPlanes(*pair) for pair in listed])
    )
    for a, b in zip(one.dynamics_at(0.0), other.dynamics_at(0.0), strict=True):
        np.testing.assert_array_equal(a, b)
