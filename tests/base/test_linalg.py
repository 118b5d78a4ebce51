"""Semidefinite matrices item by item: factors and repair against eigenvalues."""

import numpy as np
import pytest

from seedslib.base.linalg import cholesky, nearest_psd, solve_psd, without_rounding

UNITS = np.array([3.0, 0.02, 50.0, 7.0])
"""Deviations that have nothing in common."""
ZERO, BROKEN, RAISED = 1e-13, 1e-9, 1e-12
"""A pivot that is rounding, one that is none of a covariance, the least eigenvalue."""
TINY = np.finfo(float).tiny


def turned(values, seed=0):
    """A symmetric matrix of these eigenvalues."""
    basis = np.linalg.qr(np.random.default_rng(seed).standard_normal((len(values),) * 2))[0]
    return basis * values @ basis.T


def in_units(matrix, units=UNITS):
    units = units[: len(matrix)]
    return matrix * np.outer(units, units)


def correlations(n, rank, seed=1):
    rows = np.random.default_rng(seed).standard_normal((n, rank))
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    return rows @ rows.T


# Factors


@pytest.mark.parametrize(("n", "rank"), [(1, 1), (3, 3), (6, 6), (40, 40), (2, 1), (4, 2), (7, 3)])
def test_factors_are_the_triangular_ones_and_keep_the_rank(n, rank):
    """With a positive diagonal the factor of a regular matrix is unique."""
    rng = np.random.default_rng([n, rank])
    units = 10.0 ** rng.integers(-6, 7, size=n)
    cov = in_units(correlations(n, rank, n), units)
    found = cholesky(cov)
    scaled = found / units[:, None]
    np.testing.assert_allclose(scaled @ scaled.T, correlations(n, rank, n), atol=1e-12)
    np.testing.assert_array_equal(found, np.tril(found))
    assert (np.diagonal(found) >= 0).all()
    assert np.count_nonzero(np.abs(scaled).max(axis=0) > 1e-6) == rank


def test_factors_of_batches_are_those_of_their_items():
    covs = np.stack([correlations(3, 3), np.zeros((3, 3)), np.diag([0.0, 4.0, 0.0])], axis=-1)
    found = cholesky(covs)
    for k in range(3):
        np.testing.assert_array_equal(found[..., k], cholesky(covs[..., k]))
    np.testing.assert_array_equal(found[..., 1:], np.sqrt(covs[..., 1:]))
    whole = np.array([[4, 2, 6], [2, 10, 9], [6, 9, 27]])
    np.testing.assert_allclose(cholesky(whole), np.linalg.cholesky(whole), rtol=1e-14)
    bad = in_units(turned([1.0, -0.2, 0.5]))
    found = cholesky(np.stack([whole, bad, whole], axis=-1))
    np.testing.assert_array_equal(found[..., 0], found[..., 2])
    assert np.isnan(found[..., 1]).any()
    assert np.isfinite(found[..., 0]).all()


def test_pivots_of_rounding_are_zero_columns():
    for extra, zero in ((0.5, True), (4.0, False)):
        cov = np.array([[4.0, 6.0, 2.0], [6.0, 9.0 * (1 + extra * ZERO), 3.0], [2.0, 3.0, 7.0]])
        found = cholesky(cov)
        assert (found[1, 1] == 0.0) == zero
        if zero:
            np.testing.assert_array_equal(found[:, 1], 0.0)
            np.testing.assert_allclose(found[:, 0], [2.0, 3.0, 1.0])
            np.testing.assert_allclose(found[2, 2], np.sqrt(6.0))
    for variance, zero in ((TINY, True), (4 * TINY, False)):
        cov = np.diag([variance, 1.0])
        assert (cholesky(cov)[0, 0] == 0.0) == zero


def test_negative_pivots_are_judged_by_a_scale():
    """Below -1e-9 of the variance before, or of its own where nothing else is said, is NaN."""
    for value, judged, none in (
        (-0.5 * BROKEN, [1.0, 1.0], False),
        (-2.0 * BROKEN, [1.0, 1.0], True),
        (-2.0 * BROKEN, [1.0, 4.0], False),
        (-2.0 * BROKEN, [4.0, 1.0], True),
        (-BROKEN, [1.0, 1.0], False),
        (-0.5 * BROKEN, None, True),
    ):
        found = cholesky(np.diag([4.0, value]), None if judged is None else np.array(judged))
        assert found[0, 0] == 2.0
        assert np.isnan(found[1, 1]) == none
        if not none:
            np.testing.assert_array_equal(found[1], 0.0)


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4], [4, 2, 0, 1, 3], [1, 0, 3, 4, 2]])
def test_components_without_variance_that_covary_get_the_least_one(order):
    """L Lᵀ is the covariance of three components and two affine functions of them."""
    rest = in_units(correlations(3, 3), UNITS[:3])
    slope = np.array([[0.3, -2.0, 0.7], [0.0, 1.0, 0.1]])
    cross = slope @ rest
    wanted = np.block([[rest, cross.T], [cross, cross @ slope.T]])[np.ix_(order, order)]
    known = np.isin(order, [3, 4])
    cov = np.where(known[:, None] & known, 0.0, wanted)
    found = cholesky(cov)
    np.testing.assert_allclose(found @ found.T, wanted, rtol=1e-9)
    many = np.stack([cov, np.eye(5), np.diag([0.0, 1.0, 2.0, 3.0, 0.0])], axis=-1)
    batch = cholesky(many)
    np.testing.assert_allclose(batch[..., 0], found, rtol=1e-12)
    np.testing.assert_array_equal(batch[..., 1:], np.sqrt(many[..., 1:]))


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_solutions_are_those_of_the_components_that_others_do_not_determine(batch):
    rng = np.random.default_rng(3)
    regular = np.moveaxis(
        [np.outer(UNITS, UNITS) * correlations(4, 4, 5 + k) for k in range(6)], 0, -1
    )
    S = regular[..., 0] if not batch else regular[..., : np.prod(batch)].reshape(4, 4, *batch)
    X = rng.standard_normal((4, 2, *batch))
    B = np.einsum("ij...,jk...->ik...", S, X)
    np.testing.assert_allclose(solve_psd(S, B), X, rtol=1e-9)
    # common to all items, or a copy of a component: its row is zero
    if batch:
        np.testing.assert_allclose(
            solve_psd(S[..., :1], B)[..., 0], solve_psd(S[..., 0], B[..., 0]), rtol=1e-13
        )
        assert solve_psd(S, B[(..., *(0,) * len(batch))]).shape == X.shape
    pick = [0, 1, 1, 2, 3]
    found = solve_psd(S[pick][:, pick], B[pick])
    np.testing.assert_array_equal(found[2], 0.0)
    np.testing.assert_allclose(found[[0, 1, 3, 4]], X, rtol=1e-9)
    assert np.isnan(solve_psd(turned([1.0, -0.2, 0.5]), np.eye(3))).any()


# Repair


def test_directions_known_exactly_are_settled():
    """A variance left over by rounding beside what it was goes, and takes its covariances."""
    before = in_units(correlations(3, 3))
    regular = 0.25 * before
    left = regular.copy()
    left[1] = left[:, 1] = 0.0
    left[1, 1] = -1e-12 * before[1, 1]
    left[0, 1] = left[1, 0] = 1e-9 * np.sqrt(before[0, 0] * before[1, 1])
    cov = np.stack([regular, left, in_units(turned([1.0, -0.2, 0.5]))], axis=-1)
    for prior in (before, np.stack([before] * 3, axis=-1)):
        found = without_rounding(cov, prior)
        np.testing.assert_array_equal(found[..., 0], regular)
        np.testing.assert_array_equal(found[..., 2], cov[..., 2])
        np.testing.assert_allclose(found[[0, 0, 2], [0, 2, 2], 1], regular[[0, 0, 2], [0, 2, 2]])
        values = np.linalg.eigvalsh(in_units(found[..., 1], 1 / UNITS))
        assert abs(values[0]) < 1e-16
        assert values[1] > 0.01
    np.testing.assert_array_equal(without_rounding(regular, before), regular)
    np.testing.assert_allclose(without_rounding(left, before), found[..., 1], rtol=1e-13)


def test_negative_eigenvalues_are_raised_in_units_of_the_deviations():
    """The others and all eigenvectors stay; each item by itself, and the given one as it was."""
    values = [np.array([0.7, 1.6, -0.3, 2.0]), np.array([0.4, 1.3, 0.8, 1.5])]
    items = [in_units(turned(v, k)) for k, v in enumerate(values)]
    cov = np.stack(items, axis=-1)
    kept = cov.copy()
    found, count = nearest_psd(cov, np.stack([UNITS**2] * 2, axis=-1))
    np.testing.assert_array_equal(cov, kept)
    assert count == 1
    np.testing.assert_array_equal(found[..., 1], items[1])
    wanted = in_units(turned([0.7, 1.6, RAISED, 2.0], 0))
    np.testing.assert_allclose(in_units(found[..., 0] - wanted, 1 / UNITS), 0.0, atol=1e-14)
    # by its own deviations, which are others
    own = np.sqrt(np.abs(np.diag(items[0])))
    found, count = nearest_psd(cov)
    values, vectors = np.linalg.eigh(in_units(items[0], 1 / own))
    wanted = vectors * np.where(values < -RAISED, RAISED, values) @ vectors.T
    np.testing.assert_allclose(in_units(found[..., 0], 1 / own), wanted, atol=1e-14)
    assert count == 1


def test_an_eigenvalue_of_rounding_becomes_zero_and_a_fault_the_least_one():
    values = np.array([[[-4 * RAISED, np.nextafter(-4 * RAISED, -1.0), 0.0, 3.0]]])
    found, count = nearest_psd(values, np.full((1, 4), 4.0))
    assert count == 1
    np.testing.assert_allclose(found[0, 0], [0.0, 4 * RAISED, 0.0, 3.0], rtol=1e-15)
    for least, raised in ((-0.5, False), (-5.0, True)):
        found, count = nearest_psd(turned(np.array([1.4, least * RAISED, 0.6]), 3), np.ones(3))
        assert count == raised
        assert abs(np.linalg.eigvalsh(found)[0] - RAISED * raised) < 1e-15


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_a_bad_pivot_may_come_late_and_a_zero_row_is_none(n):
    for j in range(n):
        cov = correlations(n, n, n)
        cov[j, j] -= 1.0 / np.linalg.inv(cov)[j, j] + 0.3
        found, count = nearest_psd(cov)
        assert count == 1
        unit = np.sqrt(np.abs(np.diag(cov)))
        assert np.linalg.eigvalsh(in_units(found, 1 / unit))[0] > 0
        nothing = correlations(n, n, n)
        nothing[j] = nothing[:, j] = 0.0
        found, count = nearest_psd(nothing)
        assert found is nothing
        assert count == 0
    for j, i in ((0, 1), (0, 2), (1, 2), (2, 0)):  # a zero variance that covaries is a fault
        cov = np.eye(3)
        cov[j, j], cov[i, j], cov[j, i] = 0.0, 0.5, 0.5
        found, count = nearest_psd(cov)
        assert count == 1
        values, vectors = np.linalg.eigh(cov)
        want = vectors * np.where(values < 0, RAISED, values) @ vectors.T
        np.testing.assert_allclose(found, want, atol=1e-14)
