"""Single steps of branches: the start, the move, the spread over all cells, the measurement."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from oracles import piecewise_routes as routes
from oracles.piecewise_branches import branches
from seedslib.piecewise.branches import (
    alive,
    measure,
    move,
    obstacle,
    prior_branches,
    spread_out,
)
from seedslib.piecewise.cells import Intervals, line_cells
from seedslib.piecewise.coefficients import Coefficients, as_coefficients
from seedslib.piecewise.geometry import IntervalRegions

INF = np.inf
CELLS = Intervals([-INF, 0.0, INF])
QUARTERS = line_cells([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0])


def dynamics(offset, matrix, noise, cells=2):
    size = len(offset)
    return as_coefficients("dynamics", (offset, matrix, noise), cells, size, size)


def test_branches_of_the_prior_are_one_for_each_cell():
    system = routes.noisy_block()
    found = prior_branches(system, 3)
    assert found.cell.tolist() == [0, 1]
    assert (found.mean == system.mean0[:, None, None]).all()
    assert (found.cov == system.cov0[:, :, None, None]).all()
    assert (found.mean.shape, found.cov.shape) == ((2, 2, 3), (2, 2, 2, 1))
    assert (found.slope == 1.0).all()
    assert not found.shift.any()
    assert not found.log_unit.any()
    plane = prior_branches(routes.lozi(), 1)
    assert (plane.slope == np.eye(2)[:, :, None]).all()
    assert (plane.slope.shape, plane.shift.shape) == ((2, 2, 2), (2, 2))


def test_what_stands_in_the_way_of_an_exact_transition():
    still, noise = np.eye(2), np.array([[0.0], [1.0]])
    assert obstacle(dynamics([0.0, 1.0], still, noise), 1) is None
    assert obstacle(dynamics([0.0, 1.0], [[1.0, 0.0], [2.0, 1.0]], noise), 1) is None
    entering = "noise enters the restricted components"
    assert obstacle(dynamics([0.0, 1.0], still, noise), 2) == entering
    assert obstacle(dynamics([0.0, 1.0], still, [[1.0], [0.0]]), 1) == entering
    leaning = dynamics([0.0, 1.0], [[1.0, 1e-9], [0.0, 1.0]], noise)
    assert obstacle(leaning, 1) == "the restricted components depend on the others"
    differ = "the restricted rows of the dynamics differ between data sets"
    base = dynamics([0.0, 1.0], still, noise)
    for name, place, told in (
        ("offset", (0, 1), differ), ("matrix", (0, 0, 1), differ), ("offset", (1, 1), None),
        ("matrix", (1, 0, 1), None), ("matrix", (1, 1, 0), None),
    ):  # fmt: skip
        part = np.repeat(getattr(base, name), 3, axis=-1)
        part[(*place, 2)] += 0.5
        assert obstacle(base._replace(**{name: part}), 1) == told


def test_branches_that_some_data_set_has():
    log_unit = np.array([[-INF, -INF], [-INF, 0.0], [-INF, -INF], [-3.0, -INF]])
    assert alive(log_unit).tolist() == [1, 3]
    assert alive(np.full((4, 2), -INF)).tolist() == [0]


def unrestricted(found, b, n):
    """Mean and covariance of x = (shift + slope s, x2), as if s were not restricted."""
    size, cov = len(found.shift), found.cov[:, :, b, min(n, found.cov.shape[-1] - 1)]
    turn, mean = np.eye(len(cov)), found.mean[:, b, n].copy()
    turn[:size, :size] = found.slope[:, :, b]
    mean[:size] = found.shift[:, b] + found.slope[:, :, b] @ mean[:size]
    return mean, turn @ cov @ turn.T


def one_branch(cell):
    """A branch with ``x1 = 0.3 - 0.8 s`` and three data sets, and the ends of its interval."""
    rng, ends = np.random.default_rng(cell), [(0.5, 2.0), (-1.5, 0.3)][cell]
    old = branches([ends], [0.0], 1.0, [0.5], cell=cell, slope=-0.8, shift=0.3)[0]
    root = rng.standard_normal((3, 3, 1, 3))
    mean = rng.standard_normal((3, 1, 3))
    return old._replace(mean=mean, cov=np.einsum("ij...,kj...->ik...", root, root)), ends


@pytest.mark.parametrize("lead", [1.7, -1.2, 0.3, -0.4, 0.01, 0.0])
@pytest.mark.parametrize("cell", [0, 1])
@pytest.mark.parametrize(("depth", "other"), [(1, False), (3, False), (3, True)])
def test_a_move_carries_the_law_and_cuts_the_region(lead, cell, depth, other):
    """Three components, noise in two of them; the first row expands, contracts or collapses."""
    rng = np.random.default_rng(7)
    matrix, noise = rng.standard_normal((3, 3, 2, 1)), rng.standard_normal((3, 2, 2, depth))
    matrix[0, 1:], matrix[0, 0], noise[0] = 0.0, 5.0, 0.0
    matrix[0, 0, cell] = lead
    offset = rng.standard_normal((3, 2, 1)) * np.append(1.0, rng.uniform(1, 2, depth - 1))
    if other:  # coefficients of every data set in the matrix and not in the offset
        offset, matrix = offset[..., :1], matrix * np.append(1.0, rng.uniform(1, 2, depth - 1))
        matrix[0] = matrix[0, ..., :1]
    offset[0] = 0.2
    old, ends = one_branch(cell)
    new = move(old, CELLS, Coefficients(offset, matrix, noise))
    at = slice(0, 1), slice(0, 1)
    followed = (new.slope[*at] == 1.0).all()
    assert followed == (abs(lead) > 0.1)
    start = lead * (0.3 - 0.8 * np.array(ends)) + 0.2 if followed else np.array(ends)
    covered = np.unique(np.stack([new.regions.lower, new.regions.upper]))
    np.testing.assert_allclose(covered[[0, -1]], np.sort(start), rtol=1e-14)
    assert len(covered) == len(new.cell) + 1  # the pieces adjoin
    for k, i in enumerate(new.cell):
        inner = new.regions.lower[k] + np.ptp(covered) * 1e-6, new.regions.upper[k] - 1e-6
        x = new.shift[0, k] + new.slope[0, 0, k] * np.array([inner])
        assert (CELLS.locate(x) == i).all()
        for n in range(3):
            a = offset[:, cell, min(n, offset.shape[-1] - 1)]
            A = matrix[:, :, cell, min(n, matrix.shape[-1] - 1)]
            G = noise[..., cell, min(n, depth - 1)]
            mean, cov = unrestricted(old, 0, n)
            found = unrestricted(new, k, n)
            np.testing.assert_allclose(found[0], a + A @ mean, rtol=1e-12, atol=1e-14)
            np.testing.assert_allclose(found[1], A @ cov @ A.T + G @ G.T, rtol=1e-11, atol=1e-13)
            if not followed:  # s is what it was, and goes with x2 as before
                assert new.mean[0, k, n] == old.mean[0, 0, n]
                assert new.cov[0, 0, k, n] == pytest.approx(old.cov[0, 0, 0, n])
                turn = np.diag([-0.8, 1.0, 1.0])
                along = (A @ turn @ old.cov[:, 0, 0, n])[1:]
                np.testing.assert_allclose(new.cov[0, 1:, k, n], along, rtol=1e-12)
    assert (new.cov == np.swapaxes(new.cov, 0, 1)).all()


def followed(lead, ends, var, offset=0.0):
    old, var = branches([(-1.0, 1.0)], [0.0], 1.0, [0.5])[0], np.array(var)
    regions = IntervalRegions(*np.array(ends)[:, None])
    old = old._replace(mean=np.zeros((1, 1, var.size)), cov=var[None, None, None], regions=regions)
    new = move(old, Intervals([-INF, INF]), dynamics([offset], [[lead]], np.zeros((1, 0)), 1))
    assert (new.slope == (1.0 if new.slope[0, 0, 0] == 1.0 else lead)).all()
    return bool((new.slope == 1.0).all() and (new.shift == 0.0).all())


def test_intervals_become_their_images_as_long_as_these_are_wide():
    """Contraction to a tenth at most, and 1e-5 of the numbers that describe interval and law."""
    wide = (-2.0, 3.0)
    leads = (-1.0, 0.99, 0.1, 0.0999, -0.1, -0.0999)
    assert [followed(a, wide, [1.0]) for a in leads] == [True, True, True, False, True, False]
    # ends of the image at 500, and at 500.005
    assert [followed(0.5, (1000.0, 1000.0 + w), [1.0]) for w in (0.0099, 0.0101)] == [False, True]
    assert [followed(0.5, (-1000.0 - w, -1000.0), [1.0]) for w in (0.0099, 0.0101)] == [False, True]
    assert [followed(0.5, (1000.0, INF), [9.0, v**2]) for v in (0.0099, 0.0101)] == [False, True]
    assert [followed(0.5, (-INF, 1000.0), [v**2, 9.0]) for v in (0.0099, 0.0101)] == [False, True]
    assert [followed(0.5, (0.0, 1.0), [1.0], 5e4 * f) for f in (1.1, 0.9)] == [False, True]
    assert followed(0.5, (-INF, INF), [1e-20])
    assert followed(1.0, (1000.0, 1000.0 + 1e-9), [1.0])


@pytest.mark.parametrize("cell", [0, 1])
def test_rounding_does_not_move_a_branch_out_of_a_cell_that_keeps_to_itself(cell):
    """``x <- 1 + x / 2`` near 2, which is an edge, with all digits of the distance in s."""
    cells, sign = Intervals([-INF, 2.0, INF]), (-1.0, 1.0)[cell]
    old = branches([(0.5, 5.0)], [1.0], 1.0, [0.5], cell=cell, slope=sign * 1e-20,
                   shift=2.0 - sign * 4e-16)[0]  # fmt: skip
    new = move(old, cells, dynamics([1.0], [[0.5]], np.zeros((1, 0))))
    assert new.cell.tolist() == [cell]
    assert (new.regions.lower[0], new.regions.upper[0]) == (0.5, 5.0)
    assert new.slope.item() == sign * 0.5e-20
    away = move(old._replace(shift=np.array([[2.0 - sign]])), cells,
                dynamics([1.0], [[(0.9, 0.2)[cell]]], np.zeros((1, 0))))  # fmt: skip
    assert away.cell.tolist() == [1 - cell]  # not all of the cell stays in it


def test_plane_regions_become_their_images_where_these_are_as_large():
    old = prior_branches(routes.lozi(), 1)
    for matrix, kept in (
        ([[0.5, 0.0], [0.0, 2.0]], True), ([[0.0, 2.0], [0.5, 0.0]], True),
        ([[0.5, 0.0], [0.0, 1.99]], False), ([[0.0, 0.0], [0.0, 9.0]], False),
    ):  # fmt: skip
        plain = line_cells([[1.0], [0.0]], [0.0])
        new = move(old, plain, dynamics([0.1, 0.2], matrix, np.zeros((2, 0))))
        assert (new.slope == np.eye(2)[:, :, None]).all() == kept
        assert (new.shift == 0.0).all() == kept
        for k in range(len(new.cell)):
            np.testing.assert_allclose(
                unrestricted(new, k, 0)[0], [0.1, 0.2] + np.array(matrix) @ [0.1, 0.1], rtol=1e-14
            )


def test_laws_of_the_cells_are_spread_over_all_cells():
    """Prediction of one Gaussian per cell; a cell without weight in any data set has none."""
    rng = np.random.default_rng(9)
    cells = Intervals([-INF, -1.0, 1.0, INF])
    c = dynamics(rng.standard_normal((2, 3)), rng.standard_normal((2, 2, 3)),
                 rng.standard_normal((2, 2, 3)), 3)  # fmt: skip
    log_weight = np.array([[-1.0, -INF], [-INF, -INF], [-0.5, 0.0]])
    mean, root = rng.standard_normal((2, 3, 2)), rng.standard_normal((2, 2, 3, 2))
    cov = np.einsum("ij...,kj...->ik...", root, root)
    mean[:, 1] = cov[:, :, 1] = np.nan
    found = spread_out(cells, c, log_weight, mean, cov)
    assert found.cell.tolist() == [0, 1, 2, 0, 1, 2]
    assert found.regions.lower.tolist() == [-INF, -1.0, 1.0] * 2
    assert found.regions.upper.tolist() == [-1.0, 1.0, INF] * 2
    assert (found.slope == 1.0).all()
    assert not found.shift.any()
    for k, i in enumerate([0, 0, 0, 2, 2, 2]):
        assert (found.log_unit[k] == log_weight[i]).all()
        A, G = c.matrix[:, :, i, 0], c.noise[:, :, i, 0]
        for n in range(2):
            first, second = c.offset[:, i, 0] + A @ mean[:, i, n], A @ cov[:, :, i, n] @ A.T
            np.testing.assert_allclose(found.mean[:, k, n], first, rtol=1e-13)
            np.testing.assert_allclose(found.cov[:, :, k, n], second + G @ G.T, rtol=1e-13)


def test_plane_cells_reach_forty_deviations_beyond_every_predicted_mean():
    """Of the widest law in each direction; far beyond, cells have no regions."""
    c = dynamics([0.0, 0.0], np.eye(2), np.zeros((2, 0)), 4)
    mean = np.array(
        [[[-3.0, 1.0], [0.0, 2.0], [0, 0], [0, 0]], [[7.0, 8.0], [5.0, 6.0], [6, 6], [6, 6]]]
    )
    cov = np.zeros((2, 2, 4, 2))
    cov[0, 0], cov[1, 1], cov[0, 1], cov[1, 0] = 0.04, 0.01, -0.01, -0.01
    cov[0, 0, 1, 1], cov[1, 1, 2, 0] = 0.25, 0.09
    found = spread_out(QUARTERS, c, np.zeros((4, 2)), mean, cov)
    corners = np.concatenate(found.regions.vertices, axis=1)
    np.testing.assert_allclose(corners.min(axis=1), [-3.0 - 20.0, 5.0 - 12.0], rtol=1e-13)
    np.testing.assert_allclose(corners.max(axis=1), [2.0 + 20.0, 8.0 + 12.0], rtol=1e-13)
    assert found.cell.tolist() == [0, 1, 2, 3] * 4
    for k in range(16):
        assert (found.mean[:, k] == mean[:, k // 4]).all()
        assert (found.cov[:, :, k] == cov[:, :, k // 4]).all()
    away = spread_out(QUARTERS, c, np.zeros((4, 2)), mean + 100.0, cov)
    assert away.cell.tolist() == [3, 3, 3, 3]


@pytest.mark.parametrize("depth", [1, 3])
def test_a_measurement_corrects_laws_and_units(depth):
    """Against the joint law of state and measurement; the second data set misses one component."""
    rng = np.random.default_rng(5)
    old = branches([(-1.0, 1.0)] * 2, [0.0, 0.0], 1.0, [0.5, 0.5], cell=[1, 0],
                   slope=np.array([1.0, -0.7]), shift=np.array([0.0, 0.4]))[0]  # fmt: skip
    root = rng.standard_normal((3, 3, 2, depth))
    old = old._replace(mean=rng.standard_normal((3, 2, 3)), log_unit=rng.standard_normal((2, 3)),
                       cov=np.einsum("ij...,kj...->ik...", root, root))  # fmt: skip
    c = Coefficients(*(rng.standard_normal((*core, 2, depth)) for core in ((2,), (2, 3), (2, 2))))
    y = rng.standard_normal((2, 3))
    y[0, 1] = np.nan
    new, innovation = measure(old, c, y)
    for b, i in enumerate([1, 0]):
        for n in range(3):
            d = min(n, depth - 1)
            seen = c.matrix[:, :, i, d].copy()
            offset = c.offset[:, i, d] + seen[:, 0] * old.shift[0, b]
            seen[:, 0] *= old.slope[0, 0, b]
            prior, noise = old.cov[:, :, b, d], c.noise[:, :, i, d]
            spread = seen @ prior @ seen.T + noise @ noise.T
            np.testing.assert_allclose(innovation[:, :, b, d], spread, rtol=1e-12)
            rows = np.flatnonzero(np.isfinite(y[:, n]))
            spread, cross = spread[np.ix_(rows, rows)], prior @ seen[rows].T
            center = (offset + seen @ old.mean[:, b, n])[rows]
            gain = cross @ np.linalg.inv(spread)
            mean = old.mean[:, b, n] + gain @ (y[rows, n] - center)
            np.testing.assert_allclose(new.mean[:, b, n], mean, rtol=1e-11, atol=1e-13)
            left = new.cov[:, :, b, min(n, new.cov.shape[-1] - 1)]
            np.testing.assert_allclose(left, prior - gain @ cross.T, rtol=1e-10, atol=1e-12)
            gained = multivariate_normal(center, spread).logpdf(y[rows, n])
            np.testing.assert_allclose(new.log_unit[b, n] - old.log_unit[b, n], gained, rtol=1e-11)
    assert new.regions is old.regions


def test_a_measurement_beyond_the_range_of_floats_drops_the_branch_only():
    old = branches([(-1.0, 1.0)] * 2, [0.1, 0.2], 1.0, [0.5, 0.5], cell=[0, 1])[0]
    old = old._replace(
        cov=old.cov * np.ones(2), mean=old.mean * np.ones(2), log_unit=np.zeros((2, 2))
    )
    c = as_coefficients("sensor", ([0.0], [[[1.0, 1e-200]]], [[0.5]]), 2, 1, None)
    new, _ = measure(old, c, np.array([[1e200, 0.4]]))
    assert (new.log_unit[:, 0] == -INF).all()
    assert (new.mean[:, :, 0] == 0.0).all()
    gained = multivariate_normal([0.1], [1.25]).logpdf(0.4)
    np.testing.assert_allclose(new.log_unit[0, 1], gained, rtol=1e-13)
    assert new.mean[0, 0, 1] == pytest.approx(0.1 + 0.3 / 1.25)
