"""What a filter of a switching system says of its own errors: the law of total covariance."""

import numpy as np
import pytest
import sympy

from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.designed.switching.lemmas import ModeLaw, total_covariance
from seedslib.evaluation import evaluate
from seedslib.filters import KnownModeFilter, RaoBlackwellFilter
from seedslib.linearization import ExactGaussian
from seedslib.models import Noise, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)


def test_two_modes_far_apart():
    """Equal covariances C and means ± d of equal probability: C + d dᵀ."""
    d, inner = np.array([3.0, -40.0]), np.array([[0.5, 0.1], [0.1, 0.2]])
    law = ModeLaw.of(
        np.array([0.5, 0.5]), np.stack([d, -d], axis=1), np.stack([inner, inner], axis=2)
    )
    np.testing.assert_allclose(total_covariance(law), inner + np.outer(d, d), rtol=1e-14)


def test_law_of_total_covariance():
    """E X Xᵀ - E X E Xᵀ of three modes, for each path of a batch."""
    rng = np.random.default_rng(0)
    n, modes, batch = 3, 3, 5
    prob = rng.dirichlet(np.ones(modes), batch).T
    mean = 4 * rng.standard_normal((n, modes, batch))
    root = rng.standard_normal((n, n, modes, batch))
    cov = np.einsum("ik...,jk...->ij...", root, root)
    got = total_covariance(ModeLaw.of(prob, mean, cov))
    for b in range(batch):
        second = sum(
            prob[l, b] * (cov[:, :, l, b] + np.outer(mean[:, l, b], mean[:, l, b]))
            for l in range(modes)
        )
        first = mean[:, :, b] @ prob[:, b]
        np.testing.assert_allclose(got[..., b], second - np.outer(first, first), atol=1e-12)


def hidden(apart, stay=1):
    """Two modes that start far apart and pull to their own sides, under a loud sensor."""
    leave = 1 - stay
    return SwitchingSystem(
        (x,), [[0.8 * x + apart / 5 + v / 3], [0.8 * x - apart / 5 + v / 3]], Noise((v,)),
        [[stay, leave], [leave, stay]], [[x + 4 * w]] * 2, Noise((w,)),
        [(0.5, [apart], [[0.3]]), (0.5, [-apart], [[0.3]])],
    )  # fmt: skip


@pytest.mark.parametrize("apart", [1.0, 2.0])
@pytest.mark.parametrize("make", [lambda s: SwitchingFilter(s, ExactGaussian()),
                                  lambda s: RaoBlackwellFilter(s, 32)])  # fmt: skip
def test_normalised_squares_where_the_filter_is_exact(make, apart):
    """A mode that never changes: the law is the exact one, and E e² / P = 1 at every time.

    The tops are so near each other that the squares scatter about as chi-square numbers do.
    """
    system = hidden(apart)
    got = evaluate(make(system), system, np.arange(5.0), 8000, 1, consistency=True)
    assert np.abs(got.nees - 1).max() < 4 * np.sqrt(2 / 8000)
    # the loud sensor leaves the modes open: much of the variance is between them
    assert got.rms[0, 0] > 0.6 * apart


@pytest.mark.parametrize("make", [
    lambda s: SwitchingFilter(s, ExactGaussian()),
    lambda s: synthesize(s, Memory(2), ExactGaussian(), np.arange(5.0), paths=20_000, seed=1),
])  # fmt: skip
def test_normalised_squares_with_rare_switches(make):
    """Normal laws in each mode are nearly right; without the spread of modes the mean is 3."""
    system = hidden(3.0, stay=0.95)
    got = evaluate(make(system), system, np.arange(5.0), 8000, 2, consistency=True)
    assert np.abs(got.nees - 1).max() < 0.25


def test_normalised_squares_with_known_modes():
    """Nothing is hidden but the noise: chi-square numbers, and their mean is near one."""
    system = hidden(3.0, stay=0.7)
    got = evaluate(KnownModeFilter(system), system, np.arange(5.0), 8000, 3, consistency=True)
    assert np.abs(got.nees - 1).max() < 4 * np.sqrt(2 / 8000)
