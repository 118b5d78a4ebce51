"""Factors of semidefinite matrices: unique, exact where the matrix is singular, never larger."""

import numpy as np
import pytest

from seedslib.base.semidefinite import factor, square_root


def covariance(rng, n, rank=None):
    half = rng.standard_normal((n, rank or n)) * 10.0 ** rng.integers(-6, 7, size=(n, 1))
    return half @ half.T


@pytest.mark.parametrize("n", [1, 2, 3, 6, 40])
def test_the_factor_is_that_of_cholesky(n):
    """The triangular factor with a positive diagonal is unique: no other one can be right."""
    cov = covariance(np.random.default_rng(n), n)
    scale = np.sqrt(np.diag(cov))
    right = np.linalg.cholesky(cov / np.outer(scale, scale))
    found = square_root(cov) / scale[:, None]
    worst = np.linalg.cond(right) * 1e-15
    np.testing.assert_allclose(found, right, atol=10 * n * worst)
    np.testing.assert_array_equal(found, np.tril(found))


@pytest.mark.parametrize(("n", "rank"), [(2, 1), (3, 1), (4, 2), (7, 3)])
def test_singular_covariances_keep_their_rank(n, rank):
    cov = covariance(np.random.default_rng(10 * n + rank), n, rank)
    found = square_root(cov)
    scale = np.sqrt(np.diag(cov))
    np.testing.assert_allclose(
        found @ found.T / np.outer(scale, scale), cov / np.outer(scale, scale), atol=1e-12
    )
    assert np.count_nonzero(np.abs(found / scale[:, None]).max(axis=0) > 1e-6) == rank


def test_repeated_eigenvalues_leave_no_choice():
    """Where eigenvectors are free the factor is not: a rounding error moves it by as much."""
    rng = np.random.default_rng(0)
    cov = 2.5 * np.eye(4)
    noise = rng.standard_normal((4, 4))
    moved = cov + 1e-15 * (noise + noise.T)
    np.testing.assert_allclose(square_root(moved), square_root(cov), atol=1e-14)
    np.testing.assert_array_equal(square_root(cov), np.sqrt(2.5) * np.eye(4))


def test_what_is_rounding_only_stays_small():
    """A difference of equal covariances is rounding: no pivot of it may blow anything up."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        noise = rng.standard_normal((5, 5)) * 10.0 ** rng.integers(-30, -15, size=(5, 5))
        noise = noise + noise.T
        found = square_root(noise)
        assert np.isfinite(found).all()
        own = np.sqrt(np.maximum(np.diag(noise), 0.0))
        assert (np.abs(found) <= own[:, None] * (1 + 1e-12)).all()


def test_batch_axes_and_zeros():
    rng = np.random.default_rng(2)
    covs = np.stack([covariance(rng, 3), np.zeros((3, 3)), np.diag([0.0, 4.0, 0.0])])
    found = square_root(covs)
    for one, cov in zip(found, covs, strict=True):
        np.testing.assert_array_equal(one, square_root(cov))
    np.testing.assert_array_equal(found[1:], np.sqrt(covs[1:]))
    # the same factor as the one with the batch axes last
    right = np.moveaxis(factor(np.moveaxis(covs, 0, -1)), -1, 0)
    np.testing.assert_allclose(found, right, rtol=1e-13, atol=1e-300)
