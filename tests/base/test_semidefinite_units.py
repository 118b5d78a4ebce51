"""Semidefinite matrices item by item: rank, range and repair against eigenvalues, in all units."""

import numpy as np
import pytest

from seedslib.base.semidefinite import (
    ABSOLUTE,
    INDEFINITE,
    NEGATIVE,
    RELATIVE,
    factor,
    mended,
    range_root,
    settled,
    square_root,
    symmetrized,
)
from seedslib.base.triangles import lower_triangle, mirrored

UNITS = np.array([3.0, 0.02, 50.0, 7.0])
"""Deviations that have nothing in common."""


def turned(values, seed=0):
    """A symmetric matrix of these eigenvalues."""
    basis = np.linalg.qr(np.random.default_rng(seed).standard_normal((len(values),) * 2))[0]
    return basis * values @ basis.T


def in_units(matrix, units=None):
    units = UNITS[: len(matrix)] if units is None else units
    return matrix * np.outer(units, units)


def correlations(n, rank, seed=1):
    """A correlation matrix of given rank."""
    rows = np.random.default_rng(seed).standard_normal((n, rank))
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    return rows @ rows.T


def pseudo(matrix, rank):
    values, vectors = np.linalg.eigh(matrix)
    values, vectors = values[len(values) - rank :], vectors[:, len(values) - rank :]
    return vectors / values @ vectors.T, np.log(values).sum()


def test_mean_of_a_matrix_and_its_transpose():
    np.testing.assert_array_equal(
        symmetrized(np.array([[3.0, 1.0], [2.0, 5.0]])), [[3.0, 1.5], [1.5, 5.0]]
    )


# Moore-Penrose


def test_rank_range_and_determinant_item_by_item():
    """R^T R = S+ of each rank, whatever the units; a component without variance has none."""
    wanted = [(in_units(correlations(4, r, r)), r) for r in (4, 3, 2, 1)]
    alone = np.zeros((4, 4))
    alone[np.ix_([0, 2], [0, 2])] = [[5.0, 2.0], [2.0, 3.0]]
    wanted += [(alone, 2), (np.zeros((4, 4)), 0)]
    spread = np.stack([matrix for matrix, _ in wanted])
    root, log_det, rank = range_root(spread)
    for k, (matrix, r) in enumerate(wanted):
        assert rank[k] == r
        inverse, log = pseudo(matrix, r)
        size = np.abs(inverse).max() or 1.0
        np.testing.assert_allclose(root[k].T @ root[k] / size, inverse / size, atol=1e-8)
        assert log_det[k] == pytest.approx(log, abs=1e-7)
        assert np.count_nonzero(np.abs(root[k]).max(axis=1)) == r


def test_what_is_no_covariance_has_no_root():
    """Undefined, infinite, negative, or with an eigenvalue below minus 1e-9 of its correlations."""
    base = in_units(correlations(3, 3))
    undefined, infinite, negative = base.copy(), base.copy(), base.copy()
    undefined[0, 1], infinite[2, 2] = np.nan, np.inf
    negative[1] = negative[:, 1] = 0.0
    negative[1, 1] = -1e-100
    past, within = (in_units(np.array([[1.0, c], [c, 1.0]])) for c in
                    (1 + 2 * INDEFINITE, 1 + 0.5 * INDEFINITE))  # fmt: skip
    broken = [undefined, infinite, negative]
    root = range_root(np.stack([base, *broken]))[0]
    assert np.isfinite(root[0]).all()
    assert np.isnan(root[1:]).all()
    root, _, rank = range_root(np.stack([past, within]))
    assert np.isnan(root[0]).all()
    assert np.isfinite(root[1]).all()
    assert rank[1] == 1


def test_a_component_of_the_least_variance_is_none():
    for variance, rank in ((0.25 * ABSOLUTE, 1), (ABSOLUTE, 1), (4 * ABSOLUTE, 2)):
        found = range_root(np.diag([variance, 1.0])[None])
        assert found[2].tolist() == [rank]
        assert found[1][0] == pytest.approx(np.log(variance) if rank == 2 else 0.0)


@pytest.mark.parametrize("gap", [0.2, 5.0])
def test_an_eigenvalue_up_to_1e_13_is_none(gap):
    """Two sensors of correlation 1 - g: of rank two where g is more than rounding."""
    c = 1.0 - gap * RELATIVE
    _, _, rank = range_root(np.array([[[1.0, c], [c, 1.0]]]))
    assert rank[0] == (1 if gap < 1 else 2)


# Factors


def test_negative_pivots_are_judged_by_a_scale():
    """A pivot of -1e-9 of the variance before, or of its own where nothing else is said."""
    for value, judged, none in [
        (-0.5 * INDEFINITE, [1.0, 1.0], False),
        (-2.0 * INDEFINITE, [1.0, 1.0], True),
        (-2.0 * INDEFINITE, [1.0, 4.0], False),
        (-2.0 * INDEFINITE, [4.0, 1.0], True),
        (-INDEFINITE, [1.0, 1.0], False),
        (-0.5 * INDEFINITE, None, True),
    ]:
        found = factor(np.diag([4.0, value]), None if judged is None else np.array(judged))
        assert found[0, 0] == 2.0
        assert np.isnan(found[1, 1]) == none
        if not none:
            np.testing.assert_array_equal(found[1], 0.0)


def test_a_pivot_of_rounding_is_a_zero_column():
    for extra, zero in ((0.5, True), (4.0, False)):
        cov = np.array([[4.0, 6.0, 2.0], [6.0, 9.0 * (1 + extra * RELATIVE), 3.0], [2.0, 3.0, 7.0]])
        found = factor(cov)
        assert (found[1, 1] == 0.0) == zero
        if zero:
            np.testing.assert_array_equal(found[:, 1], 0.0)
            np.testing.assert_allclose(found[:, 0], [2.0, 3.0, 1.0])
            np.testing.assert_allclose(found[2, 2], np.sqrt(6.0))
        assert factor(np.diag([ABSOLUTE, 1.0]))[0, 0] == 0.0
        assert factor(np.diag([4 * ABSOLUTE, 1.0]))[0, 0] > 0.0


def test_broken_items_of_a_batch_stay_alone():
    good, bad = in_units(correlations(3, 3)), in_units(turned([1.0, -0.2, 0.5]))
    found = factor(np.stack([good, bad, good], axis=-1))
    np.testing.assert_allclose(found[..., 0], np.linalg.cholesky(good), rtol=1e-12)
    np.testing.assert_array_equal(found[..., 0], found[..., 2])
    assert np.isnan(found[..., 1]).any()


def test_factors_of_whole_numbers():
    cov = np.array([[4, 2, 6], [2, 10, 9], [6, 9, 27]])
    wanted = np.linalg.cholesky(cov)
    np.testing.assert_allclose(square_root(cov), wanted, rtol=1e-14)
    np.testing.assert_allclose(factor(cov), wanted, rtol=1e-14)


def test_no_entry_of_a_root_exceeds_its_variance():
    """A covariance that is too large for its variances is cut, in each sign and each column."""
    cov = np.array([[4.0, 9.0, -5.0, 1.0], [9.0, 2.0, 0.7, 0.3], [-5.0, 0.7, 3.0, -0.4],
                    [1.0, 0.3, -0.4, 6.0]])  # fmt: skip
    found = square_root(cov)
    np.testing.assert_allclose(found[:, 0], [2.0, np.sqrt(2.0), -np.sqrt(3.0), 0.5])
    assert found[1, 1] == found[2, 2] == 0.0
    assert found[3, 3] == pytest.approx(np.sqrt(5.75))
    np.testing.assert_array_equal(found, np.tril(found))
    # a negative pivot takes nothing along
    np.testing.assert_array_equal(square_root(np.array([[-1.0, 2.0], [2.0, 9.0]])), np.diag([0, 3]))


def test_least_pivots_of_a_root():
    for extra, zero in ((0.5, True), (4.0, False)):
        cov = np.array([[4.0, 6.0], [6.0, 9.0 * (1 + extra * RELATIVE)]])
        assert (square_root(cov)[1, 1] == 0.0) == zero
    least = ABSOLUTE
    for _ in range(3):
        least = RELATIVE * least + ABSOLUTE
    assert least == RELATIVE * least + ABSOLUTE  # the variance that is its own bound
    assert square_root(np.array([[least]])) == factor(np.array([[least]])) == 0.0
    found = square_root(np.stack([np.diag([ABSOLUTE, 2.0]), np.diag([4 * ABSOLUTE, 2.0])]))
    assert (found[:, 0, 0] == 0.0).tolist() == [True, False]


# What rounding has left


def test_directions_known_exactly_are_settled():
    """A variance left over by rounding beside what it was goes, and takes its covariances."""
    before = in_units(correlations(3, 3))
    regular = 0.25 * before
    settled_one = regular.copy()
    settled_one[1] = settled_one[:, 1] = 0.0
    left = settled_one.copy()
    left[1, 1] = -1e-12 * before[1, 1]
    left[0, 1] = left[1, 0] = 1e-9 * np.sqrt(before[0, 0] * before[1, 1])
    cov = np.stack([regular, left, in_units(turned([1.0, -0.2, 0.5]))], axis=-1)
    for prior in (before, np.stack([before] * 3, axis=-1)):
        found = settled(cov, prior)
        np.testing.assert_array_equal(found[..., 0], regular)
        np.testing.assert_array_equal(found[..., 2], cov[..., 2])
        np.testing.assert_allclose(found[[0, 0, 2], [0, 2, 2], 1], regular[[0, 0, 2], [0, 2, 2]])
        values = np.linalg.eigvalsh(in_units(found[..., 1], 1 / UNITS[:3]))
        assert abs(values[0]) < 1e-16
        assert values[1] > 0.01
    np.testing.assert_array_equal(settled(regular, before), regular)
    np.testing.assert_allclose(settled(left, before), found[..., 1], rtol=1e-13)


def test_negative_eigenvalues_are_raised_in_units_of_the_deviations():
    """The others and all eigenvectors stay; each item by itself, and the given one as it was."""
    values = [np.array([0.7, 1.6, -0.3, 2.0]), np.array([0.4, 1.3, 0.8, 1.5])]
    items = [in_units(turned(v, k)) for k, v in enumerate(values)]
    squares = np.stack([UNITS**2, UNITS**2], axis=-1)
    cov = np.stack([items[0], items[1]], axis=-1)
    kept = cov.copy()
    found, count = mended(cov, squares)
    np.testing.assert_array_equal(cov, kept)
    assert count == 1
    np.testing.assert_array_equal(found[..., 1], items[1])
    wanted = in_units(turned([0.7, 1.6, NEGATIVE, 2.0], 0))
    np.testing.assert_allclose(in_units(found[..., 0] - wanted, 1 / UNITS), 0.0, atol=1e-14)
    # by its own deviations, which are others
    own = np.sqrt(np.abs(np.diag(items[0])))
    found, count = mended(cov)
    values, vectors = np.linalg.eigh(in_units(items[0], 1 / own))
    wanted = vectors * np.where(values < -NEGATIVE, NEGATIVE, values) @ vectors.T
    np.testing.assert_allclose(in_units(found[..., 0], 1 / own), wanted, atol=1e-14)
    assert count == 1


def test_the_least_eigenvalue_that_is_rounding():
    """-1e-12 of the variance before is none, the next number is a fault; variances are given."""
    values = np.array([[[-4 * NEGATIVE, np.nextafter(-4 * NEGATIVE, -1.0), 0.0, 3.0]]])
    found, count = mended(values, np.full((1, 4), 4.0))
    assert count == 1
    np.testing.assert_allclose(found[0, 0], [0.0, 4 * NEGATIVE, 0.0, 3.0], rtol=1e-15)


@pytest.mark.parametrize(("least", "raised"), [(-0.5, False), (-5.0, True)])
def test_rounding_counts_for_nothing(least, raised):
    """An eigenvalue of -1e-12 and more becomes zero, one below it is a fault and 1e-12."""
    cov = turned(np.array([1.4, least * NEGATIVE, 0.6]), 3)
    found, count = mended(cov, np.ones(3))
    assert count == raised
    assert found.shape == (3, 3)
    assert abs(np.linalg.eigvalsh(found)[0] - NEGATIVE * raised) < 1e-15


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_the_first_bad_pivot_may_come_late(n):
    """Wherever elimination meets a negative pivot, the matrix is mended; a zero row is no fault."""
    for j in range(n):
        cov = correlations(n, n, n)
        cov[j, j] -= 1.0 / np.linalg.inv(cov)[j, j] + 0.3
        found, count = mended(cov)
        assert count == 1
        unit = np.sqrt(np.abs(np.diag(cov)))
        assert np.linalg.eigvalsh(in_units(found, 1 / unit))[0] > 0
        nothing = correlations(n, n, n)
        nothing[j] = nothing[:, j] = 0.0
        found, count = mended(nothing)
        assert found is nothing
        assert count == 0


def test_a_zero_variance_that_covaries_is_a_fault():
    for j, i in ((0, 1), (0, 2), (1, 2), (2, 0)):
        cov = np.eye(3)
        cov[j, j], cov[i, j], cov[j, i] = 0.0, 0.5, 0.5
        found, count = mended(cov)
        assert count == 1
        values, vectors = np.linalg.eigh(cov)  # a component without a deviation has the unit one
        want = vectors * np.where(values < 0, NEGATIVE, values) @ vectors.T
        np.testing.assert_allclose(found, want, atol=1e-14)


# Places in triangles


@pytest.mark.parametrize("n", [1, 2, 4])
def test_places_in_the_list_of_a_triangle(n):
    places = [(i, j) for i in range(n) for j in range(i + 1)]
    assert list(zip(*lower_triangle(n), strict=True)) == places
    for i in range(n):
        for j in range(n):
            assert mirrored(n)[i, j] == places.index((max(i, j), min(i, j)))


def test_places_are_shared_and_cannot_be_spoilt():
    assert lower_triangle(3) is lower_triangle(3)
    assert mirrored(3) is mirrored(3)
    for part in (*lower_triangle(3), mirrored(3)):
        with pytest.raises(ValueError, match="read-only"):
            part[0] = 0
