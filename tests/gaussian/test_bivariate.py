"""The distribution function of two correlated standard normals."""

import mpmath as mp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ndtr

from seedslib.gaussian import bivariate_normal_cdf


def thirty_digits(h, k, rho):
    """Integral of the conditional probability given the first variable."""
    with mp.workdps(30):
        h, k, rho = mp.mpf(h), mp.mpf(k), mp.mpf(rho)
        root = mp.sqrt(1 - rho**2)
        low, high = mp.mpf(-13), min(h, mp.mpf(13))
        kink = k / rho if rho else mp.mpf(0)
        cuts = [kink + c * root for c in (-6, -2, 0, 2, 6)] + [-6, -3, -1, 0, 1, 3, 6]
        points = sorted({low, high, *(mp.mpf(c) for c in cuts if low < c < high)})
        if low >= high:
            return 0.0
        return float(mp.quad(lambda x: mp.npdf(x) * mp.ncdf((k - rho * x) / root), points))


CASES = [
    (0.3, -0.7, 0.4),
    (0.0, 0.8, -0.6),
    (0.0, -0.8, 0.6),
    (1.5, 0.0, 0.9),
    (-2.0, -3.0, 0.5),
    (2.5, 2.5, 0.999),
    (2.5, 2.5000001, 1 - 1e-9),
    (-1.0, 1.0, -0.9999),
    (4.0, -4.0, 0.2),
    (14.0, 0.5, 0.3),
    (15.0, 14.0, -0.7),
    (-14.0, 1.0, 0.9),
    (0.7, -0.2, 0.0),
    (-0.0, -1.0, 0.3),
]


@pytest.mark.parametrize("case", CASES)
def test_bivariate_cdf_against_thirty_digits(case):
    assert bivariate_normal_cdf(*case) == pytest.approx(thirty_digits(*case), abs=1e-15)


def test_bivariate_cdf_of_arrays_is_symmetric():
    rng = np.random.default_rng(0)
    h, k = rng.normal(size=(2, 500)) * 2
    rho = rng.uniform(-1, 1, 500)
    found = bivariate_normal_cdf(h, k, rho)
    assert_allclose(found, bivariate_normal_cdf(k, h, rho), atol=2e-16)
    assert_allclose(found + bivariate_normal_cdf(h, -k, -rho), ndtr(h), atol=4e-16)
    assert bivariate_normal_cdf(h[:, None], k, 0.5).shape == (500, 500)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_bivariate_cdf_with_perfect_correlation(sign):
    for h, k in [(0.4, 0.7), (-0.4, 0.7), (0.4, -0.7), (-1.0, -0.2), (0, 0)]:
        exact = ndtr(min(h, k)) if sign > 0 else max(0.0, ndtr(h) - ndtr(-k))
        assert bivariate_normal_cdf(h, k, sign) == pytest.approx(exact, abs=1e-15)


@pytest.mark.parametrize("rho", [-1.0, 0.0, 0.5, 1.0])
def test_bivariate_cdf_at_far_and_infinite_limits(rho):
    assert bivariate_normal_cdf(1e308, 0.3, rho) == pytest.approx(ndtr(0.3), rel=1e-14)
    assert bivariate_normal_cdf(-1e200, 1e150, rho) == 0.0
    assert bivariate_normal_cdf(np.inf, 1.0, rho) == pytest.approx(ndtr(1.0), abs=1e-15)
    assert bivariate_normal_cdf(np.inf, np.inf, rho) == 1.0
    assert bivariate_normal_cdf(-np.inf, np.inf, rho) == 0.0
    assert bivariate_normal_cdf(0, 0, 0.5) == pytest.approx(1 / 3, abs=1e-16)
