"""The distribution function of two correlated standard normals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ndtr

from seedslib.gaussian import bivariate_normal_cdf


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
