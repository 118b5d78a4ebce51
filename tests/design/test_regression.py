"""Regression from merged moments, against least squares on the whole sample."""

import numpy as np
import pytest

from seedslib.design.regression import combine, inverse_root, regress, scatter


def sample(rows=5, count=5000, seed=3):
    rng = np.random.default_rng(seed)
    mix = rng.standard_normal((rows, rows))
    return mix @ rng.standard_normal((rows, count)) + 10.0 * rng.standard_normal((rows, 1))


def test_blocks_merge_to_the_moments_of_the_whole():
    data = sample()
    parts = [scatter(data[:, a : a + 700]) for a in range(0, 5000, 700)]
    found = combine([scatter(data[:, :0]), *parts])
    assert found.count == 5000
    np.testing.assert_allclose(found.mean, data.mean(axis=1), rtol=1e-13)
    np.testing.assert_allclose(found.cov, np.cov(data, bias=True), rtol=1e-11, atol=1e-12)


def test_moments_far_from_the_origin_keep_their_digits():
    data = np.random.default_rng(0).standard_normal((2, 4000))
    near, far = scatter(data), scatter(data + 1e8)
    np.testing.assert_allclose(far.cov, near.cov, rtol=1e-6, atol=1e-7)


def test_regression_is_least_squares():
    data = sample()
    found = scatter(data)
    fit = regress(found.mean, found.cov, 2)
    design = np.concatenate([data[2:], np.ones((1, 5000))]).T
    expected, _, _, _ = np.linalg.lstsq(design, data[:2].T, rcond=None)
    np.testing.assert_allclose(fit.gain, expected[:3].T, rtol=1e-9)
    np.testing.assert_allclose(fit.offset, expected[3], rtol=1e-8)
    residual = data[:2].T - design @ expected
    np.testing.assert_allclose(fit.cov, residual.T @ residual / 5000, rtol=1e-9)
    np.testing.assert_allclose(fit.mean(data[2:]), (design @ expected).T, rtol=1e-9, atol=1e-9)


def test_redundant_regressors_change_neither_forecast_nor_covariance():
    data = sample()
    doubled = np.concatenate([data, data[2:3] + data[3:4], 1e6 * data[4:5]])
    lean, rich = (regress(s.mean, s.cov, 2) for s in (scatter(data), scatter(doubled)))
    np.testing.assert_allclose(rich.mean(doubled[2:]), lean.mean(data[2:]), atol=1e-8)
    np.testing.assert_allclose(rich.cov, lean.cov, rtol=1e-9)


def test_a_constant_regressor_is_dropped_although_its_rounding_varies():
    data = sample()
    noise = 1e-15 * np.random.default_rng(1).standard_normal(5000)
    found = scatter(np.concatenate([data, 3.0 + noise[None]]))
    fit = regress(found.mean, found.cov, 2)
    assert np.all(fit.gain[:, -1] == 0.0)
    lean = scatter(data)
    np.testing.assert_allclose(fit.cov, regress(lean.mean, lean.cov, 2).cov, rtol=1e-12)


def test_a_regressor_near_zero_is_measured_against_the_size_it_should_have():
    data = sample()
    noise = 1e-15 * np.random.default_rng(1).standard_normal(5000)
    found = scatter(np.concatenate([data, noise[None]]))
    assert regress(found.mean, found.cov, 2).gain[0, -1] != 0.0
    size = np.array([0.0, 0.0, 0.0, 1.0])
    assert np.all(regress(found.mean, found.cov, 2, size).gain[:, -1] == 0.0)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_units_do_not_matter(unit):
    data = sample()
    found, other = scatter(data), scatter(data * np.array([[1.0], [1], [unit], [1], [1 / unit]]))
    np.testing.assert_allclose(
        regress(other.mean, other.cov, 2).cov, regress(found.mean, found.cov, 2).cov, rtol=1e-9
    )


def test_inverse_root_of_a_singular_covariance():
    factor = np.random.default_rng(2).standard_normal((4, 2))
    cov = factor @ factor.T
    root = inverse_root(cov)
    assert root.shape == (4, 2)
    np.testing.assert_allclose(cov @ root @ root.T @ cov, cov, atol=1e-12)
    assert inverse_root(np.zeros((3, 3))).shape == (3, 0)


def test_no_regressors_leave_mean_and_covariance():
    found = scatter(sample()[:2])
    fit = regress(found.mean, found.cov, 2)
    np.testing.assert_array_equal(fit.offset, found.mean)
    np.testing.assert_allclose(fit.cov, found.cov, rtol=1e-14)


def test_moments_that_are_none():
    with pytest.raises(ValueError, match="positive semidefinite"):
        regress(np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]]), 1)
    with pytest.raises(ValueError, match="finite"):
        regress(np.zeros(2), np.array([[1.0, np.nan], [np.nan, 1.0]]), 1)
