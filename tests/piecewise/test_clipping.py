"""Polygons cut by half-planes, against hulls and half-spaces of SciPy."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay, HalfspaceIntersection

from seedslib.piecewise.clipping import area, box, centroid, clip, clip_all, half_planes

SQUARE = box(np.array([0.0, 0.0]), np.array([1.0, 1.0]))
EPS = np.finfo(float).eps


def convex(seed, count=9):
    """Vertices of a convex polygon, counter-clockwise."""
    points = np.random.default_rng(seed).normal((0.4, -0.7), 1.0, (count, 2))
    return points[ConvexHull(points).vertices].T


def test_a_box_is_counter_clockwise_about_its_centre():
    found = box(np.array([0.5, -2.0]), np.array([1.5, 0.25]))
    assert found.T.tolist() == [[-1.0, -2.25], [2.0, -2.25], [2.0, -1.75], [-1.0, -1.75]]
    assert area(found) == 1.5
    assert area(found[:, ::-1]) == -1.5
    assert area(found[:, :3]) == 0.75
    assert area(found[:, :2]) == area(found[:, :0]) == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_area_and_centre_of_gravity_are_those_of_triangles(seed):
    polygon = convex(seed)
    corners = polygon.T[Delaunay(polygon.T).simplices]
    sides = corners[:, 1:] - corners[:, :1]
    parts = 0.5 * np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    assert area(polygon) == pytest.approx(parts.sum(), rel=1e-13)
    middle = parts @ corners.mean(axis=1) / parts.sum()
    np.testing.assert_allclose(centroid(polygon), middle, rtol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_polygons_in_common_are_intersections_of_half_spaces(seed):
    one, other = convex(seed), convex(seed + 10)
    cells = [half_planes(one), half_planes(other)]
    rows = np.concatenate([np.c_[c.normals.T, -c.offsets] for c in cells])
    wanted = ConvexHull(HalfspaceIntersection(rows, np.array([0.4, -0.7])).intersections)
    found = clip_all(one, cells[1])
    assert area(found) == pytest.approx(wanted.volume, rel=1e-12)
    assert area(clip_all(other, cells[0])) == pytest.approx(wanted.volume, rel=1e-12)
    assert found.shape[1] == len(wanted.vertices)


def test_half_planes_of_a_polygon_hold_its_points_and_no_others():
    cell = half_planes(SQUARE * [[2.0], [3.0]])
    points = np.array([[1.9, 2.1, -1.9, -2.1, 0.0, 0.0], [2.9, 0.0, -2.9, 0.0, 3.1, -3.1]])
    beyond = (cell.normals.T @ points - cell.offsets[:, None]).max(axis=0)
    assert (beyond <= 0.0).tolist() == [True, False, True, False, False, False]


def test_a_cut_through_vertices_makes_no_new_ones():
    triangle = clip(SQUARE, np.array([1.0, -1.0]), 0.0)
    assert triangle.T.tolist() == [[-1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
    through_one = clip(SQUARE, np.array([2.0, -1.0]), 1.0)
    assert through_one.T.tolist() == [[-1.0, -1.0], [0.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]


def test_what_is_inside_is_left_and_what_is_outside_is_empty():
    right = np.array([1.0, 0.0])
    assert clip(SQUARE, right, 1.0) is SQUARE
    assert clip(SQUARE, right, 5.0) is SQUARE
    for offset in (-1.0, -5.0):
        assert clip(SQUARE, right, offset).shape == (2, 0)
    nothing = np.empty((2, 0))
    assert clip(nothing, right, 0.0) is nothing
    assert clip_all(SQUARE, half_planes(SQUARE + 5.0)).shape == (2, 0)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_a_line_within_rounding_of_an_edge_cuts_nothing_off(size):
    """Rounding is measured by the farthest point, the normal and the offset."""
    away = size * np.array([[3.0], [0.0]])
    for normal in (np.array([1.0, 0.0]), np.array([-1.0, 0.0])):
        edge = 4.0 * size if normal[0] > 0 else -2.0 * size
        scale = 4.0 * size + abs(edge)
        polygon = size * SQUARE + away
        assert clip(polygon, normal, edge - 15.0 * EPS * scale) is polygon
        assert clip(polygon, normal, edge - 18.0 * EPS * scale) is not polygon
        assert clip(polygon, -normal, 15.0 * EPS * scale - edge).shape[1] == 0
        assert clip(polygon, -normal, 18.0 * EPS * scale - edge).shape[1] == 4
