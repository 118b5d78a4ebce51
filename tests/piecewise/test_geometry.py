"""Regions of branches: their images, what of them lies in which cell, where they begin."""

import numpy as np
import pytest

from seedslib.piecewise.cells import Intervals, line_cells
from seedslib.piecewise.clipping import area, box
from seedslib.piecewise.geometry import IntervalRegions, PolygonRegions, prior_regions, whole_images

INF = np.inf
SQUARE = box(np.zeros(2), np.ones(2))
QUARTERS = line_cells([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0])


def test_intervals_are_turned_round_by_a_negative_slope():
    regions = IntervalRegions(np.array([-1.0, -INF, 2.0]), np.array([0.5, 3.0, INF]))
    slope, shift = np.array([[[2.0, -0.5, -1.0]]]), np.array([[1.0, 0.0, 4.0]])
    found = regions.image(slope, shift)
    assert found.lower.tolist() == [-1.0, -1.5, -INF]
    assert found.upper.tolist() == [2.0, INF, 2.0]
    assert found.take(np.array([2, 0])).upper.tolist() == [2.0, 2.0]


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_images_of_polygons_stay_counter_clockwise(mirror):
    slope = np.stack([np.eye(2), [[2.0, 0.3], [0.1 * mirror, 0.5 * mirror]]], axis=2)
    shift = np.array([[0.0, 3.0], [0.0, -1.0]])
    found = PolygonRegions((SQUARE, SQUARE)).image(slope, shift).vertices
    assert (found[0] == SQUARE).all()
    assert area(found[1]) == pytest.approx(4.0 * 0.97)
    wanted = shift[:, 1:] + slope[:, :, 1] @ SQUARE
    assert {*map(tuple, found[1].T)} == {*map(tuple, wanted.T)}


def test_polygons_are_cut_along_the_cells_of_their_images():
    """Random affine maps of two polygons: areas, and a grid of points of each piece."""
    rng = np.random.default_rng(1)
    cells = line_cells([[1.0, 0.3, 0.0], [0.2, 1.0, 1.0]], [0.1, -0.2, 0.6])
    triangle = np.array([[0.0, 2.0, 1.0], [0.0, 0.5, 2.0]])
    slope, shift = rng.standard_normal((2, 2, 2)), rng.standard_normal((2, 2))
    parent, cell, pieces = PolygonRegions((SQUARE, triangle)).split(cells, slope, shift)
    for b, whole in enumerate((SQUARE, triangle)):
        parts = [pieces.vertices[k] for k in np.flatnonzero(parent == b)]
        assert sum(map(area, parts)) == pytest.approx(area(whole), rel=1e-12)
        assert len(parts) > 1
    for b, i, piece in zip(parent, cell, pieces.vertices, strict=True):
        share = rng.dirichlet(np.ones(piece.shape[1]), 50).T
        inside = shift[:, b, None] + slope[:, :, b] @ (piece @ share)
        assert (cells.locate(inside) == i).all()


@pytest.mark.parametrize(
    ("point", "where"),
    [
        ((0.5, -0.2), (1, -1)), ((-0.5, 0.2), (-1, 1)), ((0.0, 0.5), (1, 1)), ((0.5, 0.0), (1, 1)),
        ((0.0, -0.5), (1, -1)), ((-0.5, 0.0), (-1, 1)), ((0.0, 0.0), (1, 1)),
    ],
)  # fmt: skip
def test_a_region_that_collapses_to_a_point_lies_in_one_cell(point, where):
    """On a line it is counted above it and to its right."""
    centers = np.array([[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, -1.0, 1.0]])
    regions = PolygonRegions((SQUARE,))
    shift = np.array(point)[:, None]
    parent, cell, pieces = regions.split(QUARTERS, np.zeros((2, 2, 1)), shift)
    assert parent.tolist() == [0]
    assert tuple(centers[:, cell[0]]) == where
    assert pieces.vertices[0] is SQUARE


def test_a_region_that_collapses_to_a_line_is_cut_where_the_line_is():
    """The image of (s, r) is (s, 0) or (0, s): cut at s = 0, on the upper or the right side."""
    for slope in (np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 0.0]])):
        _, cell, pieces = PolygonRegions((SQUARE,)).split(
            QUARTERS, slope[:, :, None], np.zeros((2, 1))
        )
        middle = [slope @ piece.mean(axis=1) for piece in pieces.vertices]
        assert [area(piece) for piece in pieces.vertices] == [2.0, 2.0]
        for point, i in zip(middle, cell, strict=True):
            assert QUARTERS.locate(point + 1e-9) == i


def test_an_edge_belongs_to_the_interval_above_it():
    """A region that begins or ends on an edge, and one that collapses onto it."""
    cells, ends = Intervals([-INF, 0.0, 2.0, INF]), (np.array([0.0]), np.array([2.0]))
    regions, still = IntervalRegions(*ends), np.zeros((1, 1))
    parent, cell, pieces = regions.split(cells, np.ones((1, 1, 1)), still)
    assert (parent.tolist(), cell.tolist()) == ([0], [1])
    assert (pieces.lower[0], pieces.upper[0]) == (0.0, 2.0)
    for shift, wanted in ((0.0, 1), (2.0, 2), (-1e-300, 0), (1.0, 1)):
        parent, cell, pieces = regions.split(cells, np.zeros((1, 1, 1)), still + shift)
        assert (parent.tolist(), cell.tolist()) == ([0], [wanted])
        assert (pieces.lower[0], pieces.upper[0]) == (0.0, 2.0)


def test_slivers_are_no_pieces():
    """Below eight units of rounding of the ends, and below 1e-15 of the area."""
    eps = np.finfo(float).eps
    whole, still = np.ones((1, 1, 1)), np.zeros((1, 1))
    for width, count in ((6.0 * eps, 1), (16.0 * eps, 2)):
        cells = Intervals([-INF, 1.0, INF])
        regions = IntervalRegions(np.array([0.0]), np.array([1.0 + width]))
        assert len(regions.split(cells, whole, still)[0]) == count
    corner = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    for leg, count in ((3.0e-8, 1), (3.4e-8, 2)):
        cells = line_cells([[1.0], [0.0]], [1.0 - leg])
        found = PolygonRegions((corner,)).split(cells, np.eye(2)[:, :, None], np.zeros((2, 1)))
        assert len(found[0]) == count


def test_cells_of_a_line_that_are_mapped_into_one():
    """Whole cells into cells; a constant map and cells that straddle an edge have none."""
    cells = Intervals([-INF, -1.0, 1.0, INF])
    slope, offset = np.array([0.5, 0.5, 0.0]), np.array([-0.5, 0.0, 0.3])
    assert whole_images(cells, offset[None], slope[None, None]).tolist() == [0, 1, -1]
    slope, offset = np.array([-1.0, 1.0, -2.0]), np.array([0.0, 0.5, 1.0])
    assert whole_images(cells, offset[None], slope[None, None]).tolist() == [2, -1, 0]
    slope, offset = np.array([0.5, 1.0, 1.0]), np.array([-1.0, -2.0, -1.0])
    assert whole_images(cells, offset[None], slope[None, None]).tolist() == [0, 0, -1]


@pytest.mark.parametrize(("away", "fits"), [(4.0, True), (40.0, False)])
def test_rounding_of_the_ends_of_an_image_is_forgiven(away, fits):
    eps = np.finfo(float).eps
    cells = Intervals([-INF, 0.5, 1.0, INF])
    for offset in (away * eps, -away * eps):
        slope, shift = np.array([[[1.0, 1.0, 1.0]]]), np.array([[0.0, offset, 0.0]])
        assert whole_images(cells, shift, slope).tolist() == [0, 1 if fits else -1, 2]


def test_a_plane_has_no_whole_images():
    offset, slope = np.zeros((2, 4)), np.repeat(0.1 * np.eye(2)[:, :, None], 4, axis=2)
    assert whole_images(QUARTERS, offset, slope).tolist() == [-1, -1, -1, -1]


def test_regions_of_the_prior_on_a_line_are_the_cells():
    cells = Intervals([-INF, -1.0, 1.0, INF])
    index, regions = prior_regions(cells, np.array([0.3]), np.eye(1))
    assert index.tolist() == [0, 1, 2]
    assert regions.lower.tolist() == [-INF, -1.0, 1.0]
    assert regions.upper.tolist() == [-1.0, 1.0, INF]


def test_regions_of_the_prior_on_a_plane_end_forty_deviations_from_the_mean():
    """One unit counts where the prior has no spread; cells that do not reach so far have none."""
    mean, cov = np.array([3.0, -70.0, 5.0]), np.diag([0.25, 4.0, 9.0])
    index, regions = prior_regions(QUARTERS, mean, cov)
    corners = np.concatenate(regions.vertices, axis=1)
    assert (corners.min(axis=1).tolist(), corners.max(axis=1).tolist()) == ([-17, -150], [23, 10])
    assert index.tolist() == [0, 1, 2, 3]
    areas = [area(piece) for piece in regions.vertices]
    assert areas == pytest.approx([17 * 150, 17 * 10, 23 * 150, 23 * 10], rel=1e-13)
    index, regions = prior_regions(QUARTERS, np.array([50.0, 0.0]), np.diag([1.0, 0.0]))
    assert index.tolist() == [2, 3]
    assert [area(piece) for piece in regions.vertices] == [80.0 * 40.0] * 2


def test_the_bound_of_the_mass_of_an_interval():
    """exp(-d^2 / 2) times the least of 1, or 1/2 beside the mean, and the width by sqrt(2 pi)."""
    ends = np.array([(-9.0, 9.0), (-0.3, 0.5), (3.0, INF), (-INF, -3.0), (3.0, 3.2), (-3.5, -3.0)])
    mean, cov = np.full((1, 6, 1), 0.4), np.full((1, 1, 6, 1), 0.25)
    found = IntervalRegions(*ends.T).log_mass_bound(mean, cov)[:, 0]
    root = np.sqrt(2 * np.pi)
    wanted = [
        0.0, np.log(1.6 / root), np.log(0.5) - 0.5 * 5.2**2, np.log(0.5) - 0.5 * 6.8**2,
        np.log(0.4 / root) - 0.5 * 5.2**2, np.log(1.0 / root) - 0.5 * 6.8**2,
    ]  # fmt: skip
    np.testing.assert_allclose(found, wanted, rtol=1e-13)
    several = IntervalRegions(*ends[:2].T).log_mass_bound(
        np.array([[[0.4, 9.5], [0.4, 1.0]]]), np.array([[[[0.25, 0.25], [0.25, 1.0]]]])
    )
    np.testing.assert_allclose(several[:, 0], wanted[:2], rtol=1e-13, atol=1e-15)
    beside = [np.log(0.5) - 0.5, np.log(0.8 / root) - 0.125]
    np.testing.assert_allclose(several[:, 1], beside, rtol=1e-13)


def test_the_bound_of_the_mass_of_a_polygon():
    """The same with the farthest edge line and the area by 2 pi and the root of the determinant."""
    squares = (
        box(np.zeros(2), np.full(2, 50.0)), box(np.zeros(2), np.array([0.1, 0.2])),
        box(np.array([60.0, 0.0]), np.full(2, 50.0)), box(np.array([6.0, 9.0]), np.ones(2)),
    )  # fmt: skip
    cov = np.array([[4.0, 1.0], [1.0, 1.0]])[:, :, None, None] * np.ones((4, 1))
    found = PolygonRegions(squares).log_mass_bound(np.zeros((2, 4, 1)), cov)[:, 0]
    wanted = [
        0.0, np.log(0.08 / (2 * np.pi * np.sqrt(3.0))), np.log(0.5) - 0.5 * (10 / 2) ** 2,
        np.log(4.0 / (2 * np.pi * np.sqrt(3.0))) - 0.5 * 8.0**2,
    ]  # fmt: skip
    np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-15)
    mean = np.random.default_rng(0).standard_normal((2, 4, 3))
    for several in (cov, cov * np.array([1.0, 2.0, 0.5])):
        found = PolygonRegions(squares).log_mass_bound(mean, several)
        for n in range(3):
            part = several[..., min(n, several.shape[-1] - 1)]
            alone = PolygonRegions(squares).log_mass_bound(mean[..., n : n + 1], part[..., None])
            np.testing.assert_allclose(found[:, n], alone[:, 0], rtol=1e-13)


def test_a_law_without_spread_lies_in_a_region_or_not():
    nothing = np.zeros((2, 2, 2, 1))
    line = IntervalRegions(np.array([-1.0, 1.0]), np.array([1.0, 3.0]))
    assert line.log_mass_bound(np.zeros((1, 2, 1)), nothing[:1, :1]).tolist() == [[0.0], [-INF]]
    plane = PolygonRegions((SQUARE, SQUARE + 3.0))
    assert plane.log_mass_bound(np.zeros((2, 2, 1)), nothing).tolist() == [[0.0], [-INF]]
