"""Cells of a switching filter's memory against regressions and normal laws written out."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from seedslib.design.cells import cells_from_moments, fit_cells
from seedslib.design.regression import Scatter, combine, inverse_root, root_mean_squares, scatter

rng = np.random.default_rng(6)
ROOT = np.array([[1.1, 0.0, 0.0], [0.4, 0.8, 0.0], [-0.5, 0.3, 0.6]])


def samples(count, shift=0.0, scale=1.0):
    """State, and below it two remembered numbers: (3, count)."""
    return shift + scale * ROOT @ rng.normal(size=(3, count))


def law(rows):
    """Gain, offset and covariance of the state given the memory, least squares by themselves."""
    known = np.vstack([rows[1:], np.ones(rows.shape[1])])
    found = np.linalg.lstsq(known.T, rows[0], rcond=None)[0]
    return found[:2], found[2], ((rows[0] - found @ known) ** 2).mean()


def check(fit, c, i, rows):
    gain, offset, cov = law(rows)
    np.testing.assert_allclose(fit.gain[0, :, i, c], gain, rtol=1e-5, atol=1e-7)
    assert fit.offset[0, i, c] == pytest.approx(offset, rel=1e-5, abs=1e-7)
    assert fit.cov[0, 0, i, c] == pytest.approx(cov, rel=1e-5)
    np.testing.assert_allclose(fit.centre[:, i, c], rows[1:].mean(axis=1), rtol=1e-9)


def test_cells_with_many_samples_and_cells_with_few():
    """Thin ones borrow from the modes of their cell, then from their mode, then from everything."""
    rows = [
        [samples(90, 0.3), samples(70, -0.8, 1.4)],  # of their own
        [samples(49, 1.1), samples(60, 0.4, 0.7)],  # the first has too few
        [samples(20, 2.0), samples(0)],  # so has the cell
    ]
    total = sum(part.shape[1] for row in rows for part in row)
    fit, thin, raised = fit_cells([[scatter(p) for p in row] for row in rows], 1, total)
    assert (thin, raised) == (3, 0)
    check(fit, 0, 0, rows[0][0])
    check(fit, 0, 1, rows[0][1])
    check(fit, 1, 0, np.hstack(rows[1]))
    check(fit, 1, 1, rows[1][1])
    check(fit, 2, 0, np.hstack([row[0] for row in rows]))
    check(fit, 2, 1, np.hstack([row[1] for row in rows]))
    # the probability of a mode, by Bayes' formula; what was never met counts a half
    z = np.array([0.3, -0.6])
    for c, used in enumerate([
        rows[0], [np.hstack(rows[1]), rows[1][1]],
        [np.hstack([row[i] for row in rows]) for i in range(2)],
    ]):  # fmt: skip
        weights = [max(part.shape[1], 0.5) / total for part in rows[c]]
        mass = [
            w * multivariate_normal.pdf(z, p[1:].mean(axis=1), np.cov(p[1:], bias=True))
            for w, p in zip(weights, used, strict=True)
        ]
        found = fit.forecast(np.array(c), z)
        np.testing.assert_allclose(np.exp(found.log_prob), mass / np.sum(mass), rtol=1e-6)


def test_modes_that_are_rare_everywhere_borrow_from_everything():
    rows = [[samples(30), samples(5, 1.0)], [samples(10, 2.0), samples(20)]]
    fit, thin, _ = fit_cells([[scatter(p) for p in row] for row in rows], 1, 65)
    assert thin == 4
    everything = np.hstack([part for row in rows for part in row])
    for c in range(2):
        for i in range(2):
            check(fit, c, i, everything)


def test_how_many_samples_are_few_depends_on_the_rank():
    """Of twenty numbers: where three of them vary 55 samples are enough, where all do 63."""
    mixing = rng.normal(size=(20, 3))

    def wide(count, rank):
        inner = rng.normal(size=(3, count))
        memory = mixing @ inner if rank == 3 else rng.normal(size=(20, count))
        return scatter(np.vstack([memory[:1] + rng.normal(size=count), memory]))

    for count, few in ((55, 0), (49, 1)):
        rows = [[wide(count, 3)], [wide(200, 20)]]
        assert fit_cells(rows, 1, count + 200)[1] == few
    for count, few in ((62, 1), (63, 0)):
        rows = [[wide(count, 20)], [wide(200, 20)]]
        assert fit_cells(rows, 1, count + 200)[1] == few


def test_cells_from_moments():
    """A mode that never comes with a cell has the moments of the others."""
    mean = np.array([[[0.3], [-0.4]], [[0.1], [0.5]], [[1.2], [0.7]]])
    first, second = ROOT @ ROOT.T, 2.0 * ROOT @ ROOT.T + 0.3 * np.eye(3)
    cov = np.stack([first, second], axis=-1)[..., None]
    fit = cells_from_moments(np.array([[0.7], [0.3]]), mean, cov, 1, jitter=0.0)
    for i, part in enumerate((first, second)):
        gain = np.linalg.solve(part[1:, 1:], part[1:, 0])
        np.testing.assert_allclose(fit.gain[0, :, i, 0], gain, rtol=1e-10)
        left = part[0, 0] - part[0, 1:] @ gain
        assert fit.cov[0, 0, i, 0] == pytest.approx(left, rel=1e-10)
        offset = mean[0, i, 0] - gain @ mean[1:, i, 0]
        assert fit.offset[0, i, 0] == pytest.approx(offset, rel=1e-10)
    alone = cells_from_moments(np.array([[0.7], [0.0]]), mean, cov, 1, jitter=0.0)
    np.testing.assert_allclose(alone.gain[:, :, 1], fit.gain[:, :, 0], rtol=1e-10)
    assert np.exp(alone.forecast(np.array(0), np.zeros(2)).log_prob).tolist() == [1.0, 0.0]


def test_covariances_that_are_none_are_raised():
    cov = np.array([[1.0, 1.5], [1.5, 1.0]])[..., None, None]
    cell = Scatter(100, np.zeros(2), 100 * cov[..., 0, 0])
    fit, thin, raised = fit_cells([[cell]], 1, 100)
    assert (thin, raised) == (0, 1)
    assert 0 < fit.cov[0, 0, 0, 0] < 1e-9


def test_moments_of_bundles_are_those_of_all():
    parts = [samples(count, 3.0) for count in (7, 0, 12, 1)]
    found, whole = combine(scatter(part) for part in parts), np.hstack(parts)
    assert found.count == 20
    np.testing.assert_allclose(found.mean, whole.mean(axis=1), rtol=1e-13)
    np.testing.assert_allclose(found.cov, np.cov(whole, bias=True), rtol=1e-12)
    assert combine([scatter(parts[1]), scatter(parts[0])]).count == 7
    squares = np.vstack([whole[:1] ** 2, 0.0 * whole[:1], whole[:1]])
    rms, error, spread = root_mean_squares(scatter(squares), 2)
    np.testing.assert_allclose(rms, [np.sqrt((whole[0] ** 2).mean()), 0.0], rtol=1e-13)
    wanted = (whole[0] ** 2).std() / np.sqrt(20) / (2 * rms[0])
    np.testing.assert_allclose(error, [wanted, 0.0], rtol=1e-12)
    np.testing.assert_allclose(spread, squares.std(axis=1), rtol=1e-12, atol=1e-15)


def test_a_root_of_the_inverse_on_the_range():
    cov = np.cov(samples(40), bias=True)
    root = inverse_root(cov)
    np.testing.assert_allclose(root @ root.T, np.linalg.inv(cov), rtol=1e-10)
    # a component that is a multiple of another, one that is constant, units that differ
    unit = np.array([1e6, 1.0, 1e-5])
    mixed = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [0, 0, 0]]) * unit
    wide = mixed @ cov @ mixed.T
    root = inverse_root(wide)
    assert root.shape == (5, 3)
    np.testing.assert_allclose(wide @ root @ root.T @ wide, wide, rtol=1e-8)
    size = np.array([1e6, 1.0, 1e6, 1e6, 0.0])  # the third is constant beside its size
    assert inverse_root(wide, size).shape == (5, 2)
    assert not inverse_root(wide, size)[2].any()
    assert inverse_root(np.zeros((2, 2))).shape == (2, 0)
