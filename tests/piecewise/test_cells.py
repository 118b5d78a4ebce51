"""Partitions: what is refused and with which words, tolerances, points on edges, reach."""

from itertools import combinations

import numpy as np
import pytest

from seedslib.piecewise.cells import Intervals, Polygons, as_cells, line_cells
from seedslib.piecewise.clipping import HalfPlanes, area, box, clip_all

INF = np.inf
LEFT = HalfPlanes(np.array([[1.0], [0.0]]), np.array([0.0]))
RIGHT = HalfPlanes(np.array([[-1.0], [0.0]]), np.array([0.0]))


def half(normal, offset):
    return HalfPlanes(np.reshape(np.array(normal, dtype=float), (2, 1)), np.array([float(offset)]))


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ([-INF], r"regions: wanted at least two edges in a row, got \(1,\)$"),
        ([[-INF, INF]], r"regions: wanted at least two edges in a row, got \(1, 2\)$"),
        (
            [-INF, 0.0, 2.5, 2.5, INF],
            "regions: wanted strictly increasing edges, got 2.5 then 2.5 at index 2$",
        ),
        (
            [-3.5, 0.0, INF],
            "regions: wanted cells that cover the line from -inf to inf, got edges from -3.5 to ",
        ),
        ([-INF, 0.0, 7.25], "regions: wanted cells that cover .* got edges from -inf to 7.25$"),
        ([-INF, np.nan, INF], "regions: wanted numbers or infinities, got NaN$"),
    ],
)
def test_edges_that_are_refused(edges, message):
    with pytest.raises(ValueError, match=message):
        Intervals(edges)


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ([1.0, 2.0], r"regions: wanted pairs \(lower, upper\), got shape \(2,\)$"),
        ([(1.0, 2.0, 3.0)], r"regions: wanted pairs \(lower, upper\), got shape \(1, 3\)$"),
        (np.zeros((0, 2)), r"regions: wanted pairs \(lower, upper\), got shape \(0, 2\)$"),
        (
            [(-INF, 0.0), (0.0, 1.0), (1.5, INF)],
            "regions: wanted adjoining cells, got a gap between cells 1 and 2: "
            r"\(0, 1\) and \(1.5, inf\)$",
        ),
        (
            [(-INF, 0.0), (-1.0, INF)],
            r"regions: wanted adjoining cells, got overlapping cells 0 and 1: \(-inf, 0\) and "
            r"\(-1, inf\)$",
        ),
        (
            [(2.0, 3.0), (1.0, 2.0)],
            r"regions: wanted adjoining cells, got out of order cells 0 and 1: \(2, 3\) and "
            r"\(1, 2\)$",
        ),
        ([(2.0, 3.0), (1.0, 2.5)], "regions: wanted adjoining cells, got overlapping cells 0"),
    ],
)
def test_pairs_that_are_refused(pairs, message):
    with pytest.raises(ValueError, match=message):
        Intervals.from_pairs(pairs)


def test_pairs_and_edges_are_the_same_intervals():
    cells = as_cells([(-INF, -1.0), (-1.0, 2.0), (2.0, INF)])
    assert cells.edges.tolist() == [-INF, -1.0, 2.0, INF]
    assert cells.lower.tolist() == [-INF, -1.0, 2.0]
    assert cells.upper.tolist() == [-1.0, 2.0, INF]
    assert (cells.count, cells.size) == (3, 1)
    assert as_cells(cells) is cells
    assert as_cells([-INF, INF]).count == 1
    with pytest.raises(ValueError, match="read-only"):
        cells.edges[1] = 0.0
    given = np.array([-INF, 0.0, INF])
    Intervals(given)
    given[1] = 1.0  # what the caller holds stays writeable


def test_points_of_any_batch_are_located():
    line, plane = Intervals([-INF, 0.0, 1.0, INF]), line_cells([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0])
    points = np.array([[[-1.0, 0.0, 0.5], [1.0, 2.0, 0.0]], [[1.0, 0.0, -2.0], [0.0, 3.0, -1.0]]])
    assert line.locate(points[:1]).tolist() == [[0, 1, 1], [2, 2, 1]]
    assert line.locate(points[:1, 0, 0]) == 0
    assert plane.locate(points).tolist() == [[1, 0, 2], [2, 3, 0]]
    assert plane.locate(points[:, 1, 1]) == 3


def test_one_cell_may_be_the_whole_plane():
    whole = line_cells(np.empty((2, 0)), [])
    assert whole.count == 1
    assert whole.locate(np.zeros((2, 3, 4))).tolist() == [[0] * 4] * 3
    triangle = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    for table in ([triangle], np.array([triangle])):
        with pytest.raises(ValueError, match="regions: wanted cells that cover the plane"):
            as_cells(table)


def test_a_common_edge_belongs_to_the_first_cell():
    for cells, wanted in (((LEFT, RIGHT), [0, 0, 1]), ((RIGHT, LEFT), [1, 0, 0])):
        points = np.array([[-1.0, 0.0, 1.0], [4.0, 5.0, 6.0]])
        assert Polygons(cells).locate(points).tolist() == wanted


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ((), "regions: wanted at least one cell, got none$"),
        ((LEFT, RIGHT, np.zeros((2, 2))), r"regions\[2\]: wanted at least three vertices that"),
        (
            (LEFT, [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]),
            r"regions\[1\]: wanted at least three vertices that span an area$",
        ),
        ((LEFT, np.zeros((3, 3))), r"regions\[1\]: wanted shape \(any, 2\)"),
        (
            ([[0.0, 0.0], [2.0, 0.0], [1.0, 0.2], [1.0, 2.0]],),
            r"regions\[0\]: wanted a convex cell; split it into convex ones$",
        ),
        (
            (LEFT, HalfPlanes(np.ones((3, 1)), np.zeros(1))),
            r"regions\[1\].normals: wanted shape \(2, any\), got \(3, 1\)$",
        ),
        (
            (LEFT, HalfPlanes(np.ones(2), np.zeros(1))),
            r"regions\[1\].normals: wanted 2 axes, got shape \(2,\)$",
        ),
        (
            (LEFT, HalfPlanes(np.ones((2, 1)), np.zeros(2))),
            r"regions\[1\].offsets: wanted shape \(1\), got \(2,\)$",
        ),
        (
            (HalfPlanes(np.array([[1.0, 0.0], [2.0, 0.0]]), np.zeros(2)),),
            r"regions\[0\].normals: wanted nonzero normals, got a zero column$",
        ),
        ((LEFT, half([-1, 0], -2.0)), "regions: wanted cells that cover the plane, got 0.111 of"),
        ((LEFT, RIGHT, LEFT), "regions: wanted cells without overlap, cells 0 and 2 share"),
        (
            (LEFT, HalfPlanes(np.array([[1.0, -1], [0, 0]]), np.array([-1.0, 0])), RIGHT),
            "regions: wanted cells of positive area, cell 1 is empty$",
        ),
    ],
)  # fmt: skip
def test_plane_cells_that_are_refused(cells, message):
    with pytest.raises(ValueError, match=message):
        Polygons(cells)


def test_kinds_that_are_no_partition_are_named():
    for thing, name in (
        (lambda x: x, "function"),
        (None, "NoneType"),
        ({1: LEFT}, "dict"),
        (3.0, "float"),
    ):
        with pytest.raises(TypeError, match=f"regions: wanted edges, pairs .*, got {name}$"):
            as_cells(thing)
    with pytest.raises(TypeError, match=r"regions\[0\]: wanted real numbers"):
        as_cells(["a", "b"])


def test_a_billionth_of_the_plane_may_be_missing_or_twice():
    """Shares of the square that reaches one unit, or four crossings more, to each side."""
    Polygons((LEFT, half([-1, 0], 0.9e-9)))
    with pytest.raises(ValueError, match="cells 0 and 1 share an area"):
        Polygons((LEFT, half([-1, 0], 1.1e-9)))
    Polygons((LEFT, half([-1, 0], -1.9e-9)))
    with pytest.raises(ValueError, match=r"cover the plane, got 1\.05e-09 of"):
        Polygons((LEFT, half([-1, 0], -2.1e-9)))


@pytest.mark.parametrize(("dent", "refused"), [(1e-13, False), (1e-11, True)])
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_dent_within_rounding_is_still_convex(dent, refused, size):
    """The middle of the lower side of a square is pushed in by a share of it."""
    square = size * np.array([[-1, -1], [0, -1 + dent], [1, -1], [1, 1], [-1, 1]])
    frame = [half(n, -size) for n in ([-1, 0], [1, 0])] + [
        HalfPlanes(np.array([[1.0, -1.0, 0.0], [0.0, 0.0, s]]), size * np.array([1.0, 1.0, -1.0]))
        for s in (1.0, -1.0)
    ]
    if refused:
        with pytest.raises(ValueError, match=r"regions\[0\]: wanted a convex cell"):
            as_cells([square, *frame])
    else:
        assert as_cells([square, *frame]).count == 5


def test_normals_have_length_one_whatever_was_given():
    cells = Polygons((half([3, 4], 10), half([-0.3, -0.4], -1.0))).cells
    assert [c.normals.T.tolist() for c in cells] == [[[0.6, 0.8]], [[-0.6, -0.8]]]
    assert [c.offsets.tolist() for c in cells] == [[2.0], [-2.0]]


def test_the_square_about_a_partition_reaches_beyond_every_crossing_and_line():
    """Four times as far as the farthest of them, and one unit more."""
    rng = np.random.default_rng(2)
    for _ in range(6):
        normals, offsets = rng.standard_normal((2, 4)), rng.standard_normal(4)
        crossings = [
            np.linalg.solve(normals[:, pair].T, offsets[list(pair)])
            for pair in (np.array(p) for p in combinations(range(4), 2))
        ]
        lines = np.abs(offsets) / np.linalg.norm(normals, axis=0)
        wanted = 4.0 * max(np.abs(crossings).max(), lines.max()) + 1.0
        assert line_cells(normals, offsets).radius == pytest.approx(wanted, rel=1e-9)
    assert line_cells([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0]).radius == 1.0
    assert line_cells([[1.0, 1.0], [0.0, 0.0]], [-3.0, 2.0]).radius == 13.0
    assert line_cells([[1.0, 1.0], [0.0, 1e-10]], [-3.0, 2.0]).radius == 13.0  # as good as parallel
    assert line_cells(np.empty((2, 0)), []).radius == 1.0


def test_cells_of_a_quarter_of_a_unit_lie_in_their_square():
    cells = line_cells([[1, 1, 0, 0], [0, 0, 1, 1]], [-0.25, 0.25, -0.25, 0.25])
    assert (cells.count, cells.radius) == (9, 2.0)
    square = box(np.zeros(2), np.full(2, cells.radius))
    inner = clip_all(square, cells.cells[int(cells.locate(np.zeros(2)))])
    assert area(inner) == pytest.approx(0.25, rel=1e-14)


def test_lines_leave_out_cells_of_a_trillionth_of_the_square():
    """Two axes and a line at a small distance cut off a triangle."""
    for leg, count in ((2.80e-6, 6), (2.86e-6, 7)):
        assert line_cells([[1, 0, 1], [0, 1, 1]], [0, 0, leg]).count == count


def test_arguments_of_lines_are_checked_by_their_names():
    with pytest.raises(ValueError, match=r"normals: wanted shape \(2, any\)"):
        line_cells([[1.0, 0.0]], [0.0, 0.0])
    with pytest.raises(ValueError, match=r"offsets: wanted shape \(2\), got \(1,\)$"):
        line_cells([[1.0, 0.0], [0.0, 1.0]], [0.0])
