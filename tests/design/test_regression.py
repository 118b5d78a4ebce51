"""The regression that every design solves, against least squares with forty digits."""

import mpmath
import numpy as np
import pytest

from seedslib.design.regression import combine, inverse_root, regress, scatter


def sample(rows=5, count=400, seed=3):
    """Rows that depend on each other, far from zero."""
    rng = np.random.default_rng(seed)
    mix = rng.standard_normal((rows, rows))
    return mix @ rng.standard_normal((rows, count)) + 10.0 * rng.standard_normal((rows, 1))


def least_squares(targets, known):
    """Gain, offset and mean products of the residuals, by normal equations of forty digits."""
    with mpmath.workdps(40):
        design = mpmath.matrix(np.vstack([known, np.ones(known.shape[1])]).tolist())
        wanted = mpmath.matrix(targets.tolist())
        found = (mpmath.inverse(design * design.T) * design * wanted.T).T
        rest = wanted - found * design
        cov = rest * rest.T / targets.shape[1]
        found, cov = (np.array(part.tolist(), dtype=float) for part in (found, cov))
    return found[:, :-1], found[:, -1], cov


def fitted(rows, targets, size=None):
    moments = scatter(rows)
    return regress(moments.mean, moments.cov, targets, size)


@pytest.mark.parametrize("unit", [1.0, 1e-7, 1e7])
def test_regression_is_least_squares_in_every_unit(unit):
    data = sample() * np.array([[1.0], [1.0], [unit], [1.0], [1 / unit]])
    fit = fitted(data, 2)
    gain, offset, cov = least_squares(data[:2], data[2:])
    np.testing.assert_allclose(fit.gain, gain, rtol=1e-9)
    np.testing.assert_allclose(fit.offset, offset, rtol=1e-9)
    np.testing.assert_allclose(fit.cov, cov, rtol=1e-9)
    wanted = gain @ data[2:] + offset[:, None]
    np.testing.assert_allclose(fit.mean(data[2:]), wanted, rtol=1e-9, atol=1e-9)


def test_regression_on_nearly_dependent_regressors_keeps_its_residuals():
    data = sample()
    data[4] = data[3] + 1e-4 * data[4]
    fit, (_, _, cov) = fitted(data, 2), least_squares(data[:2], data[2:])
    np.testing.assert_allclose(fit.cov, cov, rtol=1e-6)
    rest = data[:2] - fit.mean(data[2:])
    np.testing.assert_allclose(rest @ rest.T / data.shape[1], cov, rtol=1e-6)


def test_blocks_merge_to_the_moments_of_the_whole():
    data = sample()
    parts = [scatter(data[:, a:b]) for a, b in ((0, 0), (0, 70), (70, 70), (70, 71), (71, 400))]
    for found in (combine(parts), combine(parts[1:])):
        assert found.count == 400
        np.testing.assert_allclose(found.mean, data.mean(axis=1), rtol=1e-13)
        np.testing.assert_allclose(found.cov, np.cov(data, bias=True), rtol=1e-11)


def test_moments_far_from_the_origin_keep_their_digits():
    data = np.random.default_rng(0).standard_normal((2, 4000))
    near, far = scatter(data), scatter(data + 1e8)
    np.testing.assert_allclose(far.cov, near.cov, rtol=1e-6, atol=1e-7)


def test_constants_are_dropped_beside_their_size():
    """Rounding about 3, and about 0 where the size of the component is known."""
    data, size = sample(), np.array([0.0, 0.0, 0.0, 1.0])
    noise = 1e-15 * np.random.default_rng(1).standard_normal((1, 400))
    lean = fitted(data, 2)
    for rows, given in (([data, 3.0 + noise], None), ([data, noise], size)):
        fit = fitted(np.concatenate(rows), 2, given)
        assert not fit.gain[:, -1].any()
        np.testing.assert_allclose(fit.cov, lean.cov, rtol=1e-12)
    assert fitted(np.concatenate([data, noise]), 2).gain[0, -1] != 0.0


def test_what_is_explained_exactly_leaves_a_covariance_without_negative_eigenvalues():
    data = sample()
    data[0] = 2 * data[2] - data[3]
    data[1] = data[4] + 1e-9 * data[1]
    values = np.linalg.eigvalsh(fitted(data, 2).cov)
    assert values.min() > -1e-18
    assert values.max() < 1e-11


def test_root_of_a_singular_covariance_inverts_it_on_its_range():
    unit = np.array([1e6, 1.0, 1e-5])
    cov = np.cov(sample(3), bias=True)
    mixed = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [0, 0, 0]]) * unit
    wide = mixed @ cov @ mixed.T
    root = inverse_root(wide)
    assert root.shape == (5, 3)
    np.testing.assert_allclose(wide @ root @ root.T @ wide, wide, rtol=1e-8)
    size = np.array([1e6, 1.0, 1e6, 1e6, 0.0])  # the third is constant beside its size
    assert inverse_root(wide, size).shape == (5, 2)
    assert not inverse_root(wide, size)[2].any()
    assert inverse_root(np.zeros((3, 3))).shape == (3, 0)


def test_moments_that_are_none_are_refused():
    with pytest.raises(ValueError, match="moments"):
        regress(np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]]), 1)
    with pytest.raises(ValueError, match="moments"):
        regress(np.zeros(2), np.array([[1.0, np.nan], [np.nan, 1.0]]), 1)
