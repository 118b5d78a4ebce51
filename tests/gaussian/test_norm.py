"""Mean length of a Gaussian vector against special functions; `references` has 25 digits of it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import elliprg, gammaln, hyp1f1, hyp2f1

from seedslib.gaussian import norm_errors, norm_mean

PAPER = np.array([[1.5, -0.5], [-0.5, 1.5]])


def test_norm_mean_in_the_plane_and_in_space_by_special_functions():
    """(2.6) with the constant 2 sqrt(pi), and Carlson's integral, singular distributions
    included."""
    printed = 2 * np.sqrt(np.pi) * 2.0 / 3.0**1.5
    found = norm_mean([0, 0], PAPER)
    assert found == pytest.approx(printed * hyp2f1(0.75, 1.25, 1, 1 / 9), rel=1e-14)
    spread = np.random.default_rng(1).uniform(0, 3, (3, 50))
    spread[2, ::5] = 0.0
    cov = np.einsum("ik,ij->ijk", spread, np.eye(3))
    exact = np.sqrt(8 / np.pi) * elliprg(*spread)
    assert_allclose(norm_mean(np.zeros((3, 1)), cov), exact, rtol=2e-15)


@pytest.mark.parametrize("n", [1, 2, 3, 10, 30])
def test_norm_mean_of_an_isotropic_distribution(n):
    length = np.exp(gammaln((n + 1) / 2) - gammaln(n / 2))
    exact = np.sqrt(2) * 1.5 * length * hyp1f1(-0.5, n / 2, -n * 0.16 / (2 * 1.5**2))
    assert norm_mean(np.full(n, 0.4), 2.25 * np.eye(n)) == pytest.approx(exact, rel=1e-13)


def test_norm_mean_of_degenerate_distributions():
    zero = np.zeros((2, 2))
    assert norm_mean([0, 0], zero) == 0.0
    assert norm_mean([3, 4], zero) == pytest.approx(5.0, rel=2e-15)
    assert norm_mean([3e-200, -4e-200], zero) == pytest.approx(5e-200, rel=2e-15, abs=0)
    assert norm_mean([3e180, 4e180], np.eye(2)) == pytest.approx(5e180, rel=2e-15)
    # an eigenvalue of minus a rounding counts as zero
    thin = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-16]])
    assert norm_mean([0, 0], thin) == pytest.approx(np.sqrt(4 / np.pi), rel=2e-15)


def test_norm_mean_of_batches_is_that_of_their_members():
    """Blocks are joined without a seam; a point of no spread may lie among them."""
    mean = np.random.default_rng(3).normal(size=(2, 3, 700))
    mean[..., [0, 255, 256, 699]] = 0.0
    scales = np.linspace(0.5, 2.0, 700)
    scales[[0, 256]] = 0.0
    cov = PAPER[..., None] * scales
    found = norm_mean(mean, cov)
    pieces = [norm_mean(mean[..., k : k + 70], cov[..., k : k + 70]) for k in range(0, 700, 70)]
    assert_allclose(found, np.concatenate(pieces, axis=-1), rtol=1e-14)
    assert not found[:, [0, 256]].any()
    alone = norm_mean([0.0, 0.0], PAPER)
    assert isinstance(alone, float)
    assert_allclose(found[:, 255], alone * np.sqrt(scales[255]), rtol=1e-14)
    many = norm_mean([0.3, -0.4], cov)
    assert many[0] == pytest.approx(0.5, rel=1e-15)
    assert many[9] == pytest.approx(float(norm_mean([0.3, -0.4], cov[..., 9])), rel=1e-14)
    table = norm_mean([0.0, 0.0], np.multiply.outer(PAPER, scales[1:7].reshape(2, 3)))
    assert_allclose(table, alone * np.sqrt(scales[1:7].reshape(2, 3)), rtol=4e-15)
    assert norm_mean(np.empty((2, 0)), PAPER).shape == (0,)


def test_norm_errors_against_simulation():
    optimal, plugin = norm_errors(PAPER)
    assert optimal == pytest.approx(3 - norm_mean([0, 0], PAPER) ** 2, rel=1e-12)
    rng = np.random.default_rng(0)
    lengths = np.linalg.norm(rng.multivariate_normal([0, 0], PAPER, 400_000), axis=1)
    for value, guess in ((optimal, norm_mean([0, 0], PAPER)), (plugin, np.sqrt(3))):
        squares = (lengths - guess) ** 2
        assert abs(squares.mean() - value) < 4 * squares.std() / np.sqrt(squares.size)
    assert norm_errors(np.zeros((2, 2))) == (0.0, 0.0)
