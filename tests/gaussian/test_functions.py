from functools import cache
from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
from scipy.special import ndtr

from oracles.positive_parts import positive_part_product
from seedslib.gaussian import (
    abs_errors,
    abs_moments,
    gauss_hermite,
    max_errors,
    max_moments,
    mean_of,
    sine_errors,
    sine_moments,
)
from seedslib.gaussian.errors.bivariate import density

MU = np.array([0.3, -0.2])
P = np.array([[0.5, 0.1], [0.1, 0.3]])
SIGMA = np.array([[1.0, -0.4], [-0.4, 0.8]])


def split_rule(kink, mean, deviation, count=120):
    """Points and weights under N(mean, deviation²), split at a kink."""
    x, w = np.polynomial.legendre.leggauss(count)
    edges = np.unique(np.clip([-11.0, (kink - mean) / deviation, 11.0], -11, 11))
    z = np.concatenate([0.5 * (a + b) + 0.5 * (b - a) * x for a, b in pairwise(edges)])
    weight = np.concatenate([0.5 * (b - a) * w for a, b in pairwise(edges)])
    return mean + deviation * z, weight * density(z)


def modulus_product(h, k, rho):
    """Mean of |X + h| |Y + k| from the four sign patterns."""
    signs = [(1, 1), (-1, -1), (1, -1), (-1, 1)]
    return sum(positive_part_product(a * h, b * k, a * b * rho) for a, b in signs)


def clark(mean, cov):
    """Mean and second moment of the maximum, as printed by Clark."""
    root = np.sqrt(cov[0, 0] + cov[1, 1] - 2 * cov[0, 1])
    alpha = (mean[0] - mean[1]) / root
    first = mean[0] * ndtr(alpha) + mean[1] * ndtr(-alpha) + root * density(alpha)
    second = (mean[0] ** 2 + cov[0, 0]) * ndtr(alpha) + (mean[1] ** 2 + cov[1, 1]) * ndtr(-alpha)
    return first, second + (mean[0] + mean[1]) * root * density(alpha)


# ---------------------------------------------------------------- modulus (example 4)


@pytest.mark.parametrize("seed", range(10))
def test_modulus_against_quadrature_and_both_printed_forms(seed):
    rng = np.random.default_rng(seed)
    mean, origin = rng.normal(size=2) * 2
    var = rng.uniform(0.05, 4)
    x, w = split_rule(origin, mean, np.sqrt(var))
    ours = abs_moments(mean, var, origin)
    first = w @ np.abs(x - origin)
    assert ours.mean == pytest.approx(first, rel=2e-14)
    assert ours.var == pytest.approx(w @ (np.abs(x - origin) - first) ** 2, rel=1e-12)
    gap, root = origin - mean, np.sqrt(var)
    bell = np.sqrt(2 * var / np.pi) * np.exp(-(gap**2) / (2 * var))
    assert ours.mean == pytest.approx(bell + gap * (2 * ndtr(gap / root) - 1), rel=1e-14)
    centred = abs_moments(mean, var)
    bell = np.sqrt(2 * var / np.pi) * np.exp(-(mean**2) / (2 * var))
    assert centred.mean == pytest.approx(bell + mean * (1 - 2 * ndtr(-mean / root)), rel=1e-14)


def test_modulus_of_degenerate_laws():
    ours = abs_moments([0.0, -2.0, 3.0, 0.0, 1e9], [0.0, 0.0, 0.0, 1.0, 1.0])
    np.testing.assert_allclose(ours.mean, [0, 2, 3, np.sqrt(2 / np.pi), 1e9], rtol=1e-15)
    np.testing.assert_allclose(ours.var, [0, 0, 0, 1 - 2 / np.pi, 1], rtol=1e-14)


@pytest.mark.parametrize(
    ("mean", "var", "error_var"),
    [(1.0, 1.0, 0.5), (1.0, 1.0, 0.9), (0.0, 1.0, 0.1), (0.3, 2.0, 1.99), (0.0, 1.0, 0.5)],
)
def test_errors_of_the_modulus_against_the_closed_form(mean, var, error_var):
    """Closed form through the bivariate function L (four sign patterns)."""
    tau, known = np.sqrt(var), np.sqrt(var - error_var)
    ours = abs_errors(mean, var, error_var)
    scaled = mean / tau
    optimal = var + mean**2 - var * modulus_product(scaled, scaled, known**2 / var)
    mixed = tau * known * modulus_product(scaled, mean / known, known / tau)
    assert ours.optimal == pytest.approx(optimal, rel=5e-14)
    assert ours.plugin == pytest.approx(var + known**2 + 2 * mean**2 - 2 * mixed, rel=5e-14)


@pytest.mark.parametrize(
    ("mean", "var", "error_var"),
    [(1, 1, 2e-5), (1, 1, 2e-9), (0, 1, 1e-15), (3, 1, 1e-18), (1, 1, 1e-30), (0.2, 1, 0.999),
     (5, 1, 0.1), (1, 1, 1 - 1e-9)],
)  # fmt: skip
def test_errors_of_the_modulus_to_forty_digits(mean, var, error_var):
    with mp.workdps(40):
        m, v, p = (mp.mpf(value) for value in (mean, var, error_var))
        width, centre = mp.sqrt((v - p) / p), m / mp.sqrt(p)

        @cache  # both integrals have the same nodes
        def parts(a):
            gap = 2 * (mp.npdf(a) - a * mp.ncdf(-a))
            return gap, (mp.npdf((a - centre) / width) + mp.npdf((a + centre) / width)) / width

        def first(a):
            gap, weight = parts(a)
            return (2 * a * gap + gap**2) * weight

        def second(a):
            gap, weight = parts(a)
            return gap**2 * weight

        cuts = {mp.mpf(c) for c in (0, 1, 2, 4, 8, 14)}
        cuts |= {
            c for c in (centre + width * j for j in (-9, -6, -3, -1, 0, 1, 3, 6, 9)) if 0 < c < 14
        }
        cuts = sorted(cuts)
        lost, square = mp.quad(first, cuts), mp.quad(second, cuts)
        optimal, excess = float(p * (1 - lost)), float(p * square)
    ours = abs_errors(mean, var, error_var)
    assert ours.optimal == pytest.approx(optimal, rel=1e-14)
    assert ours.plugin - ours.optimal == pytest.approx(excess, rel=1e-10, abs=4e-16 * optimal)


def test_errors_of_the_modulus_at_the_ends():
    ours = abs_errors([1.0, 1.0, 0.0, 0.0], [1.0, 1.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0])
    first = abs_moments(1.0, 1.0)
    np.testing.assert_allclose(ours.optimal, [0, first.var, 0, 1 - 2 / np.pi], rtol=1e-14)
    plain = 2.0 + 1.0 - 2 * first.mean  # E(|θ| - 1)² with the estimate fixed at its mean 1
    np.testing.assert_allclose(ours.plugin, [0, plain, 0, 1.0], rtol=1e-14)
    shifted = abs_errors(3.0, 1.0, 0.3, origin=2.0)
    assert shifted.optimal == pytest.approx(float(abs_errors(1.0, 1.0, 0.3).optimal), rel=1e-15)


def test_errors_of_the_modulus_against_simulation():
    rng = np.random.default_rng(1)
    estimate = rng.normal(1.0, np.sqrt(0.6), 300_000)
    theta = estimate + rng.normal(0.0, np.sqrt(0.4), 300_000)
    ours = abs_errors(1.0, 1.0, 0.4)
    for value, guess in (
        (ours.optimal, abs_moments(estimate, 0.4).mean),
        (ours.plugin, np.abs(estimate)),
    ):
        squares = (np.abs(theta) - guess) ** 2
        assert abs(squares.mean() - value) < 4 * squares.std() / np.sqrt(squares.size)


# ---------------------------------------------------------------- maximum (example 2)


@pytest.mark.parametrize("seed", range(12))
def test_maximum_against_clark_and_quadrature(seed):
    rng = np.random.default_rng(seed)
    mean, factor = rng.normal(size=2), rng.normal(size=(2, 2))
    cov = factor @ factor.T
    ours = max_moments(mean, cov)
    first, second = clark(mean, cov)
    assert ours.mean == pytest.approx(first, rel=1e-13, abs=1e-14)
    assert ours.var == pytest.approx(second - first**2, rel=1e-11)
    # max = x2 + (x1 - x2)+, integrated over the difference
    root = np.sqrt(cov[0, 0] + cov[1, 1] - 2 * cov[0, 1])
    u, w = split_rule(0.0, mean[0] - mean[1], root)
    slope = (cov[0, 1] - cov[1, 1]) / root**2
    level = mean[1] + slope * (u - mean[0] + mean[1]) + np.maximum(u, 0)
    rest = cov[1, 1] - slope**2 * root**2
    assert ours.mean == pytest.approx(w @ level, rel=1e-12, abs=1e-13)
    assert ours.var == pytest.approx(rest + w @ (level - w @ level) ** 2, rel=1e-11)


def test_maximum_of_degenerate_laws():
    flat = np.ones((2, 2))
    assert max_moments([1.0, 2.0], flat) == (2.0, 1.0)
    assert max_moments([2.0, 2.0], np.zeros((2, 2))) == (2.0, 0.0)
    # a law without spread in the difference keeps the variance of the larger component
    far = max_moments([50.0, 0.0], np.array([[4.0, 1.0], [1.0, 9.0]]))
    assert far.mean == pytest.approx(50.0, rel=1e-15)
    assert far.var == pytest.approx(4.0, rel=1e-15)
    batch = max_moments(np.ones((2, 3, 4)), np.eye(2))
    assert batch.mean.shape == batch.var.shape == (3, 4)


def test_errors_of_the_maximum_against_the_bivariate_closed_form():
    """The closed form through L and Clark's moments, and the stored reference values."""
    cov, c = P + SIGMA, np.array([1.0, -1.0])
    delta, tau, s = MU @ c, np.sqrt(c @ cov @ c), np.sqrt(c @ SIGMA @ c)

    def ramp(root):
        return delta * ndtr(delta / root) + root * density(delta / root)

    shift, base = (SIGMA @ c)[1], MU[1] ** 2 + SIGMA[1, 1]
    square = base + 2 * (MU[1] * ramp(tau) + shift * ndtr(delta / tau))
    square += tau**2 * positive_part_product(delta / tau, delta / tau, s**2 / tau**2)
    prior = clark(MU, cov)[1]
    mixed = base + MU[1] * ramp(s) + shift * ndtr(delta / s)
    mixed += MU[1] * ramp(tau) + shift * ndtr(delta / tau)
    mixed += tau * s * positive_part_product(delta / tau, delta / s, s / tau)
    ours = max_errors(MU, cov, P)
    assert ours.optimal == pytest.approx(prior - square, rel=1e-13)
    assert ours.plugin == pytest.approx(prior - 2 * mixed + clark(MU, SIGMA)[1], rel=1e-13)
    assert ours.optimal == pytest.approx(0.384190, abs=5e-7)
    assert ours.plugin == pytest.approx(0.396050, abs=5e-7)


def test_errors_of_the_maximum_against_simulation():
    rng = np.random.default_rng(2)
    estimate = rng.multivariate_normal(MU, SIGMA, 300_000).T
    state = estimate + rng.multivariate_normal([0, 0], P, 300_000).T
    ours = max_errors(MU, P + SIGMA, P)
    for value, guess in (
        (ours.optimal, max_moments(estimate, P).mean),
        (ours.plugin, estimate.max(axis=0)),
    ):
        squares = (state.max(axis=0) - guess) ** 2
        assert abs(squares.mean() - value) < 4 * squares.std() / np.sqrt(squares.size)


def test_errors_of_the_maximum_at_the_ends():
    cov = P + SIGMA
    assert max_errors(MU, cov, np.zeros((2, 2))) == (0.0, 0.0)
    nothing = max_errors(MU, cov, cov)
    first, second = clark(MU, cov)
    assert nothing.optimal == pytest.approx(second - first**2, rel=1e-13)
    assert nothing.plugin == pytest.approx(second - 2 * 0.3 * first + 0.09, rel=1e-13)


# ---------------------------------------------------------------- sine (example 3)


@pytest.mark.parametrize(
    ("mean", "var", "error_var"), [(0, 2, 0.7), (0.4, 1.5, 1.2), (2.0, 0.3, 0.3)]
)
def test_sine_against_the_three_printed_constants(mean, var, error_var):
    k1 = 0.5 * (1 - np.exp(-2 * var) * np.cos(2 * mean))
    k2 = np.exp(-error_var / 2) - np.exp(-(4 * var - 3 * error_var) / 2) * np.cos(2 * mean)
    k3 = 0.5 * (1 - np.exp(-2 * (var - error_var)) * np.cos(2 * mean))
    shrink = np.exp(-error_var / 2)
    ours = sine_errors(mean, var, error_var)
    assert ours.optimal == pytest.approx(k1 - shrink * k2 + shrink**2 * k3, rel=1e-13)
    assert ours.plugin == pytest.approx(k1 - k2 + k3, rel=1e-13)
    assert k2 / 2 == pytest.approx(shrink * k3, rel=1e-13)


@pytest.mark.parametrize("seed", range(4))
def test_sine_against_gauss_hermite(seed):
    rng = np.random.default_rng(seed)
    mean, var = rng.normal(), rng.uniform(0.1, 3)
    rule = gauss_hermite(1, 60)
    ours = sine_moments(mean, var)
    first = mean_of(lambda x: np.sin(x[0]), [mean], [[var]], rule)
    second = mean_of(lambda x: (np.sin(x[0]) - first) ** 2, [mean], [[var]], rule)
    assert ours.mean == pytest.approx(first, rel=1e-12, abs=1e-14)
    assert ours.var == pytest.approx(second, rel=1e-12)


def test_sine_keeps_relative_accuracy():
    """Error variance sixteen orders below the variance, at the crest, where the slope is zero."""
    with mp.workdps(50):
        p, v, m = mp.mpf(1e-14), mp.mpf(1e-13), mp.mpf(np.pi / 2)
        exact = (-mp.expm1(-p) + mp.expm1(p) * mp.exp(-2 * v) * mp.cos(2 * m)) / 2
    assert sine_errors(np.pi / 2, 1e-13, 1e-14).optimal == pytest.approx(float(exact), rel=1e-14)
    assert sine_errors(0.3, 1e4, 1e4).optimal == 0.5
    assert sine_errors(0.3, 2.0, 0.0) == (0.0, 0.0)
    assert sine_moments(0.5, 0.0) == (np.sin(0.5), 0.0)


def test_sine_at_the_time_of_the_greatest_loss():
    error_var = 2 / (1 + 2 * 0.2692247)
    ours = sine_errors(0, 2, error_var)
    assert ours.optimal == pytest.approx(0.388181, abs=5e-7)
    assert ours.plugin == pytest.approx(0.474235, abs=5e-7)


# ---------------------------------------------------------------- bad input


def test_bad_input():
    with pytest.raises(ValueError, match="var: wanted nonnegative variances"):
        abs_moments(0.0, -1.0)
    with pytest.raises(ValueError, match="error_var: wanted at most the variance"):
        abs_errors(0.0, 1.0, 1.1)
    with pytest.raises(ValueError, match="error_var: wanted at most the variance"):
        sine_errors(0.0, [1.0, 2.0], [0.5, 2.5])
    with pytest.raises(ValueError, match="mean: wanted 2 components"):
        max_moments([0.0], [[1.0]])
    with pytest.raises(ValueError, match="exceeds"):
        max_errors(MU, P, P + SIGMA)
    with pytest.raises(ValueError, match="mean: wanted finite"):
        sine_moments(np.inf, 1.0)
    with pytest.raises(TypeError, match="var"):
        sine_moments(0.0, 1j)
