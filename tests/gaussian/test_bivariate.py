import mpmath as mp
import numpy as np
import pytest
from scipy.special import ndtr

from oracles.positive_parts import positive_part_product
from seedslib.gaussian import bivariate_normal_cdf


def by_quadrature(h, k, rho, product):
    """30-digit integral over X of the conditional mean given X."""
    with mp.workdps(30):
        h, k, rho = mp.mpf(h), mp.mpf(k), mp.mpf(rho)
        root = mp.sqrt(1 - rho**2)
        if product:  # E (X + h)+ (Y + k)+

            def inner(x):
                z = (k + rho * x) / root
                return (x + h) * mp.npdf(x) * root * (z * mp.ncdf(z) + mp.npdf(z))

            low, high = max(-h, mp.mpf(-13)), mp.mpf(13)
        else:

            def inner(x):
                return mp.npdf(x) * mp.ncdf((k - rho * x) / root)

            low, high = mp.mpf(-13), min(h, mp.mpf(13))
        kink = (-k if product else k) / rho if rho else mp.mpf(0)
        cuts = [kink + c * root for c in (-6, -2, 0, 2, 6)] + [-6, -3, -1, 0, 1, 3, 6]
        points = sorted({low, high, *(mp.mpf(c) for c in cuts if low < c < high)})
        return float(mp.quad(inner, points)) if low < high else 0.0


CASES = [
    (0.3, -0.7, 0.4), (0.0, 0.8, -0.6), (0.0, -0.8, 0.6), (1.5, 0.0, 0.9), (-2.0, -3.0, 0.5),
    (2.5, 2.5, 0.999), (2.5, 2.5000001, 1 - 1e-9), (-1.0, 1.0, -0.9999), (4.0, -4.0, 0.2),
    (14.0, 0.5, 0.3), (15.0, 14.0, -0.7), (-14.0, 1.0, 0.9), (0.7, -0.2, 0.0), (-0.0, -1.0, 0.3),
]  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_distribution_against_thirty_digits(case):
    assert bivariate_normal_cdf(*case) == pytest.approx(by_quadrature(*case, False), abs=1e-15)


@pytest.mark.parametrize("case", CASES)
def test_product_against_thirty_digits(case):
    exact = by_quadrature(*case, True)
    size = (1 + abs(case[0])) * (1 + abs(case[1]))
    assert positive_part_product(*case) == pytest.approx(exact, abs=2e-15 * size)


def test_distribution_is_vectorised_and_symmetric():
    rng = np.random.default_rng(0)
    h, k = rng.normal(size=(2, 500)) * 2
    rho = rng.uniform(-1, 1, 500)
    ours = bivariate_normal_cdf(h, k, rho)
    np.testing.assert_allclose(ours, bivariate_normal_cdf(k, h, rho), atol=2e-16)
    np.testing.assert_allclose(ours + bivariate_normal_cdf(h, -k, -rho), ndtr(h), atol=4e-16)
    assert bivariate_normal_cdf(h[:, None], k, 0.5).shape == (500, 500)


def test_distribution_at_the_origin_and_at_infinity():
    assert bivariate_normal_cdf(0, 0, 0.5) == pytest.approx(1 / 3, abs=1e-16)
    assert bivariate_normal_cdf(np.inf, 1.0, 0.5) == ndtr(1.0)
    assert bivariate_normal_cdf(np.inf, np.inf, -1.0) == 1.0
    assert bivariate_normal_cdf(-np.inf, np.inf, 0.5) == 0.0


@pytest.mark.parametrize(("h", "k"), [(0.4, 0.7), (-0.4, 0.7), (0.4, -0.7), (-1.0, -0.2), (0, 0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_limits_of_perfect_correlation(h, k, sign):
    near = sign * (1 - 1e-13)
    for function in (bivariate_normal_cdf, positive_part_product):
        assert function(h, k, sign) == pytest.approx(function(h, k, near), abs=2e-7)
    x, w = np.polynomial.legendre.leggauss(200)
    low, high = (-min(h, k), 12.0) if sign > 0 else (-h, k)
    if low >= high:
        assert positive_part_product(h, k, sign) == 0.0
        return
    points = 0.5 * (low + high) + 0.5 * (high - low) * x
    values = (points + h) * (sign * points + k) * np.exp(-(points**2) / 2) / np.sqrt(2 * np.pi)
    exact = 0.5 * (high - low) * (w @ values)
    assert positive_part_product(h, k, sign) == pytest.approx(exact, abs=1e-14)


def test_product_against_simulation():
    rng = np.random.default_rng(3)
    x, y = rng.standard_normal((2, 400_000))
    y = 0.6 * x + 0.8 * y
    draws = np.maximum(x + 0.2, 0) * np.maximum(y - 0.5, 0)
    error = draws.std() / np.sqrt(draws.size)
    assert abs(draws.mean() - positive_part_product(0.2, -0.5, 0.6)) < 4 * error


def test_bad_input():
    with pytest.raises(ValueError, match="rho: wanted a correlation"):
        bivariate_normal_cdf(0, 0, 1.1)
    with pytest.raises(ValueError, match="h: wanted"):
        bivariate_normal_cdf(np.nan, 0, 0)
    with pytest.raises(TypeError, match="k: wanted real"):
        bivariate_normal_cdf(0, 1j, 0)
