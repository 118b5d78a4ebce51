import numpy as np
import pytest
import sympy as sp

from seedslib.models import Noise
from seedslib.piecewise import PiecewiseLinearSystem, examples
from seedslib.piecewise.cells import Intervals, Polygons, as_cells, line_cells
from seedslib.piecewise.clipping import HalfPlanes, area, box, centroid, clip, clip_all

INF = np.inf
X, Z, V, W, T = sp.symbols("x z v w t")


def tent(**changes):
    parts = {
        "regions": [-INF, 0.0, INF],
        "dynamics": ([[1.0, 1.0]], [[[1.8, -1.8]]]),
        "sensor": ([[0.0, 0.0]], [[[-1.0, 1.0]]]),
        "sensor_noise": [[0.2]],
        "mean0": [0.1],
        "cov0": [[0.25]],
    }
    return PiecewiseLinearSystem(**(parts | changes))


def scalar(**changes):
    parts = {
        "state": (X,),
        "dynamics": [2 * sp.sin(X) + W / 2],
        "sensor": [X**2 / 5 + 3 * V / 10],
        "noise": (V, W),
        "breakpoints": np.linspace(-4.0, 4.0, 9),
        "initial": ([1.0], [[1.0]]),
    }
    return PiecewiseLinearSystem.from_functions(**(parts | changes))


@pytest.mark.parametrize(
    ("regions", "message"),
    [
        ([-INF, 1.0, 0.0, INF], "strictly increasing edges, got 1 then 0 at index 1"),
        ([-INF, 0.0, 0.0, INF], "strictly increasing"),
        ([0.0, 1.0, INF], "cover the line from -inf to inf, got edges from 0"),
        ([-INF, 1.0], "cover the line"),
        ([-INF, np.nan, INF], "NaN"),
        ([1.0], "at least two edges"),
        ([(-INF, 0.0), (0.5, INF)], "a gap between cells 0 and 1"),
        ([(-INF, 0.5), (0.0, INF)], "overlapping cells 0 and 1"),
        ([(0.0, INF), (-INF, 0.0)], "out of order cells 0 and 1"),
        ([(0.0, 1.0), (1.0, 2.0)], "cover the line"),
        ([], "at least two edges"),
        ([HalfPlanes(np.array([[1.0], [0.0]]), np.array([0.0]))], "cover the plane"),
    ],
)
def test_bad_partition_is_refused(regions, message):
    with pytest.raises(ValueError, match=f"regions: .*{message}"):
        as_cells(regions)


def test_regions_of_a_wrong_kind_are_refused():
    with pytest.raises(TypeError, match="regions: wanted edges"):
        as_cells(lambda x: x)
    with pytest.raises(TypeError, match="regions"):
        as_cells(["a", "b"])


def test_intervals_are_half_open():
    cells = as_cells([(-INF, -1.0), (-1.0, 2.0), (2.0, INF)])
    points = np.array([[-5.0, -1.0, 1.999, 2.0, 9.0]])
    assert cells.locate(points).tolist() == [0, 1, 1, 2, 2]
    assert cells.count == 3


UPPER = HalfPlanes(np.array([[0.0], [-1.0]]), np.array([0.0]))
LOWER = HalfPlanes(np.array([[0.0], [1.0]]), np.array([0.0]))
RIGHT = HalfPlanes(np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([0.0, 0.0]))


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ((UPPER, RIGHT), "cover the plane, got 0.25"),
        ((UPPER, LOWER, RIGHT), "cells 1 and 2 share an area"),
        ((UPPER, LOWER, HalfPlanes(np.eye(2), np.array([0.0, INF]))), "finite"),
        ((UPPER, LOWER._replace(normals=np.zeros((2, 1)))), "nonzero normals"),
        ((UPPER, LOWER, np.array([[0.0, 0.0], [1.0, 0.0]])), "three vertices"),
        ((np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.2], [1.0, 2.0]]),), "convex"),
        ((), "at least one cell"),
        (
            (UPPER, LOWER, HalfPlanes(np.array([[1.0, -1.0], [0.0, 0.0]]), np.array([0.0, -1.0]))),
            "cell 2 is empty",
        ),
    ],
)
def test_bad_plane_partition_is_refused(cells, message):
    with pytest.raises(ValueError, match=message):
        Polygons(cells)


def test_plane_partition_by_polygons_and_half_planes():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    normals = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    offsets = np.array([0.0, -1.0, 0.0, -1.0])
    outer = [
        HalfPlanes(normals[:1].T, offsets[:1]),
        HalfPlanes(normals[1:2].T, offsets[1:2]),
        HalfPlanes(np.array([[-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.0, 1.0, 0.0])),
        HalfPlanes(np.array([[-1.0, 1.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0.0, 1.0, -1.0])),
    ]
    cells = as_cells([square, *outer])
    rng = np.random.default_rng(0)
    points = rng.uniform(-2.0, 3.0, (2, 7, 11))
    x, y = points
    wanted = np.select([x < 0, x > 1, y < 0, y > 1], [1, 2, 3, 4], default=0)
    assert np.array_equal(cells.locate(points), wanted)
    assert as_cells([square[::-1], *outer]).count == 5  # clockwise vertices are turned round


def test_lines_cut_the_plane_into_their_cells():
    assert line_cells([[1, 0, 1], [0, 1, 1]], [0, 0, 1]).count == 7
    cells = line_cells([[1, 0], [0, 1]], [0, 0])
    assert cells.locate(np.array([[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, -1.0, 1.0]])).tolist() == [
        0, 1, 2, 3,
    ]  # fmt: skip


def test_clipping_keeps_the_area():
    rng = np.random.default_rng(1)
    polygon = box(np.array([0.3, -0.2]), np.array([2.0, 1.0]))
    for _ in range(200):
        normal, offset = rng.standard_normal(2), rng.standard_normal()
        parts = clip(polygon, normal, offset), clip(polygon, -normal, -offset)
        assert sum(map(area, parts)) == pytest.approx(8.0, rel=1e-12)
    edge = clip(polygon, np.array([1.0, 0.0]), 2.3 * (1 + 1e-15))
    assert edge is polygon
    assert clip(polygon, np.array([1.0, 0.0]), -1.7).shape[1] == 0
    triangle = np.array([[0.0, 3.0, 0.0], [0.0, 0.0, 6.0]])
    assert centroid(triangle) == pytest.approx([1.0, 2.0])
    assert area(clip_all(triangle, UPPER)) == pytest.approx(9.0)
    assert area(triangle[:, :2]) == 0.0


def test_tangents_are_those_of_the_paper():
    system = examples.falling_body()
    edges = system.regions.edges
    assert edges[[1, 50, 99]] == pytest.approx([5.024935298, 7.035975447, 35.44406025], abs=5e-9)
    middles = np.convolve(np.concatenate([[5.0], edges[1:-1], [50.0]]), [0.5, 0.5], "valid")
    for t in (1.0, 4.0):
        k = 0.01 * (t - 0.5)
        c = system.dynamics_at(t - 1)
        assert c.offset[..., 0] == pytest.approx(np.stack([0 * middles, -2 * k / middles]))
        assert c.matrix[1, 0, :, 0] == pytest.approx(k / middles**2)
        assert np.array_equal(c.matrix[0, :, :, 0], np.stack([np.ones(100), np.zeros(100)]))
    seen = system.sensor_at(1.0)
    assert seen.noise.shape == (1, 1, 100, 1)
    assert (seen.noise == 1e-3).all()
    assert not seen.offset.any()


def test_partitions_of_the_falling_body():
    paper = np.concatenate([[5.0], examples.falling_body().regions.edges[1:-1], [50.0]])
    steps = np.diff(paper**-2.0)
    assert np.ptp(steps) <= 1e-12 * abs(steps[0])
    even = examples.falling_body(40, partition="curvature", span=(2.5, 100.0)).regions.edges[1:-1]
    assert np.ptp(np.diff(even**-0.5)) <= 1e-12
    for bad in ({"span": (5.0, 4.0)}, {"partition": "even"}, {"cells": 0}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            examples.falling_body(**bad)


def test_support_points_of_the_user_and_of_the_estimate():
    points = np.linspace(-3.6, 3.4, 8)
    c = scalar(support=points).dynamics_at(1.0)
    assert c.matrix[0, 0, :, 0] == pytest.approx(2 * np.cos(points))
    assert c.offset[0, :, 0] == pytest.approx(2 * np.sin(points) - 2 * np.cos(points) * points)
    assert c.noise[0, 0, :, 0] == pytest.approx(0.5)
    adaptive = scalar(support="estimate")
    estimate = np.array([[0.3, -7.0, np.nan]])
    slopes = adaptive.dynamics_at(1.0, estimate).matrix[0, 0]
    middles = np.arange(-3.5, 4.0)
    expected = np.repeat(2 * np.cos(middles)[:, None], 3, axis=1)
    expected[4, 0], expected[0, 1] = 2 * np.cos(0.3), 2 * np.cos(7.0)
    assert slopes == pytest.approx(expected)
    assert adaptive.sensor_at(1.0, estimate).matrix.shape == (1, 1, 8, 3)


def test_unrestricted_components_are_supported_at_the_prior_mean_or_the_estimate():
    parts = {
        "state": (X, Z),
        "dynamics": [X, X * Z],
        "sensor": [Z + V],
        "noise": V,
        "breakpoints": [0.0, 1.0, 2.0],
        "initial": ([1.0, 7.0], np.eye(2)),
    }
    system = PiecewiseLinearSystem.from_functions(**parts)
    assert system.dynamics_at(1.0).matrix[1, 0, :, 0] == pytest.approx([7.0, 7.0])
    follow = PiecewiseLinearSystem.from_functions(**parts, support="estimate")
    moved = follow.dynamics_at(1.0, np.array([[1.2], [3.0]]))
    assert moved.matrix[1, 0, :, 0] == pytest.approx([3.0, 3.0])
    assert moved.matrix[1, 1, :, 0] == pytest.approx([0.5, 1.2])


def test_plane_cells_take_their_centroids():
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    parts = {
        "state": (X, Z),
        "dynamics": [X * Z, Z],
        "sensor": [Z + V],
        "noise": V,
        "initial": ([1.0, 7.0], np.eye(2)),
    }
    with pytest.raises(ValueError, match="support: an unbounded cell has no centroid"):
        PiecewiseLinearSystem.from_functions(**parts, breakpoints=line_cells([[1], [0]], [0]))
    points = np.array([[-1.0, 2.0], [0.0, 3.0]])
    system = PiecewiseLinearSystem.from_functions(
        **parts, breakpoints=line_cells([[1], [0]], [0]), support=points
    )
    assert system.dynamics_at(1.0).matrix[0, :, :, 0] == pytest.approx(points[::-1])
    from seedslib.piecewise.functions import _cells

    frame = as_cells([
        square,
        HalfPlanes(np.array([[1.0], [0.0]]), np.array([0.0])),
        HalfPlanes(np.array([[-1.0], [0.0]]), np.array([-2.0])),
        HalfPlanes(np.array([[-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.0, 2.0, 0.0])),
        HalfPlanes(np.array([[-1.0, 1.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0.0, 2.0, -1.0])),
    ])  # fmt: skip
    assert _cells(frame)[1][:, 0] == pytest.approx([1.0, 0.5])


def test_noise_covariance_and_mean_enter_the_coefficients():
    u = sp.Symbol("u")
    cov = np.array([[0.5, 0.2, 0.0], [0.2, 0.4, 0.0], [0.0, 0.0, 0.09]])
    system = scalar(
        dynamics=[X + W + 2 * u],
        sensor=[X + V],
        noise=Noise((W, u, V), mean=[0.1, 0.2, 0.3], cov=cov),
    )
    c = system.dynamics_at(1.0)
    assert np.einsum("ip,jp->ij", c.noise[:, :, 0, 0], c.noise[:, :, 0, 0])[0, 0] == pytest.approx(
        0.5 + 4 * 0.2 + 4 * 0.4
    )
    assert c.offset[0, 0, 0] == pytest.approx(0.1 + 2 * 0.2)
    assert system.sensor_at(1.0).noise[0, 0, 0, 0] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dynamics": [X + Z]}, "dynamics: wanted known symbols, got z"),
        ({"sensor": [X + V + W]}, "noise: wanted independent noises"),
        ({"sensor": [X + V**2]}, "sensor: wanted noise that enters linearly"),
        ({"dynamics": [X, X]}, "dynamics: wanted shape .1., got .2,"),
        ({"sensor": []}, "sensor: wanted at least one"),
        ({"breakpoints": [1.0, 0.0]}, "breakpoints: wanted at least two strictly increasing"),
        ({"support": "middle"}, "support: wanted"),
        ({"support": np.zeros(8)}, "support: wanted one point in each cell"),
        ({"breakpoints": Intervals([-INF, 0.0, INF])}, "support: an unbounded cell"),
        ({"initial": ([1.0, 2.0], np.eye(2))}, "initial"),
        ({"initial": ([1.0], [[-1.0]])}, "cov0: wanted a positive semidefinite"),
        ({"noise": Noise((V, W), sample=lambda rng, n: rng.random((2, n)))}, "Gaussian"),
    ],
)
def test_bad_model_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        scalar(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"dynamics": ([[1.0, 1.0]], [[[1.8, -1.8, 0.0]]])},
            r"dynamics \(matrix\): wanted 2 cells",
        ),
        ({"dynamics": ([1.0, 1.0], [[1.0]])}, r"dynamics \(offset\): wanted shape \(1,\)"),
        ({"sensor": ([0.0], [[1.0, 2.0]])}, r"sensor \(matrix\)"),
        ({"sensor_noise": [[np.nan]]}, "finite"),
        ({"sensor_noise": None}, "sensor: wanted an offset, a matrix and a noise"),
        ({"mean0": [], "cov0": np.zeros((0, 0))}, "mean0: wanted at least 1"),
        ({"mean0": [0.0, 1.0]}, "mean0, cov0: wanted shapes"),
    ],
)
def test_bad_coefficients_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        tent(**changes)


def test_coefficients_may_depend_on_time_and_not_on_the_cell():
    system = tent(
        dynamics=lambda t: ([t], [[1.0]]), sensor_noise=lambda t: [[0.1 * t]], noise=[[0.5]]
    )
    assert system.dynamics_at(3.0).offset.tolist() == [[[3.0], [3.0]]]
    assert system.sensor_at(2.0).noise[0, 0] == pytest.approx(0.2)
    assert system.dynamics_at(1.0).noise.shape == (1, 1, 2, 1)


def test_simulation_of_a_linear_system_has_the_exact_moments():
    matrix, gain = np.array([[0.9, 0.2], [0.0, 0.7]]), np.array([[0.3, 0.0], [0.1, 0.4]])
    system = PiecewiseLinearSystem(
        regions=[-INF, INF],
        dynamics=([0.1, -0.2], matrix),
        noise=gain,
        sensor=([0.5], [[1.0, 2.0]]),
        sensor_noise=[[0.3]],
        mean0=[1.0, -1.0],
        cov0=[[0.5, 0.2], [0.2, 0.3]],
    )
    runs = system.simulate(3, 40_000, 5)
    mean, cov = system.mean0, system.cov0
    for _ in range(3):
        mean, cov = matrix @ mean + [0.1, -0.2], matrix @ cov @ matrix.T + gain @ gain.T
    x, y = runs.states[3], runs.measurements[3, 0]
    assert np.abs(x.mean(axis=1) - mean).max() <= 4 * np.sqrt(np.diag(cov).max() / 40_000)
    scale = np.sqrt(np.outer(np.diag(cov), np.diag(cov)))
    assert (np.abs(np.cov(x) - cov) <= 4 * scale * np.sqrt(2 / 40_000)).all()
    spread = np.array([1.0, 2.0]) @ cov @ [1.0, 2.0] + 0.09
    assert abs(y.mean() - 0.5 - mean @ [1.0, 2.0]) <= 4 * np.sqrt(spread / 40_000)
    assert abs(y.var() / spread - 1) <= 4 * np.sqrt(2 / 40_000)
    assert np.isnan(runs.measurements[0]).all()


def test_simulation_follows_the_nonlinear_functions_unless_told():
    system = scalar(dynamics=[2 * sp.sin(X)], noise=V)
    runs = system.simulate([0.0, 1.0, 2.0], 4, 1, start=[0.7])
    assert runs.states[:, 0, 0] == pytest.approx(
        [0.7, 2 * np.sin(0.7), 2 * np.sin(2 * np.sin(0.7))]
    )
    linear = system.simulate(2, 4, 1, start=[0.7], linear=True)
    assert linear.states[1, 0, 0] == pytest.approx(2 * np.sin(0.5) + 2 * np.cos(0.5) * 0.2)
    again = system.simulate(2, 9, 1, start=[0.7])
    assert np.array_equal(again.measurements[1:, :, :4], runs.measurements[1:])
    moving = scalar().simulate(5, 3, 2)
    assert moving.states.shape == (6, 1, 3)
    with pytest.raises(ValueError, match="start"):
        system.simulate(2, 4, 1, start=[0.7, 1.0])
    with pytest.raises(ValueError, match="times: wanted at least two"):
        system.simulate([0.0], 4, 1)


def test_tent_map_is_simulated_cell_by_cell():
    runs = tent().simulate(6, 50, 3)
    x = runs.states[:, 0]
    assert x[1:] == pytest.approx(1 - 1.8 * np.abs(x[:-1]))


def test_maps_of_the_system_for_other_filters():
    system = tent(noise=[[0.5, 0.2]])
    dynamics, sensor = (getattr(system.discrete(), name) for name in ("dynamics", "sensor"))
    x = np.array([[-1.0, 0.5, 2.0]])
    assert dynamics.value(1.0, x, np.zeros((2, 3))) == pytest.approx(1 - 1.8 * np.abs(x))
    mean, cov = dynamics.conditional_moments(1.0, x)
    assert mean == pytest.approx(1 - 1.8 * np.abs(x))
    assert cov == pytest.approx(np.full((1, 1, 3), 0.29))
    density = sensor.log_density(1.0, np.array([[0.7, np.nan, 0.7]]), x)
    expected = -0.5 * ((0.7 - np.array([1.0, 0.5, 2.0])) / 0.2) ** 2 - np.log(0.2)
    assert density == pytest.approx(np.where([1, 0, 1], expected - 0.5 * np.log(2 * np.pi), 0.0))
    smooth = scalar().discrete()
    assert smooth.dynamics.value(1.0, x, np.zeros((1, 3))) == pytest.approx(2 * np.sin(x))
    linear = scalar().discrete(linear=True)
    assert linear.dynamics.value(1.0, np.array([[0.5]]), np.zeros((1, 1))) == pytest.approx(
        2 * np.sin(0.5)
    )
