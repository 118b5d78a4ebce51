"""The larger of two variables whose scales are up to sixteen decades apart."""

from functools import cache

import mpmath as mp
import numpy as np
import pytest

from seedslib.gaussian import max_errors, max_moments


def exact_variance(mean, cov):
    """Clark's formula in 400 digits, where nothing cancels."""
    with mp.workdps(400):
        m1, m2 = map(mp.mpf, mean)
        a, b, c = mp.mpf(cov[0, 0]), mp.mpf(cov[1, 1]), mp.mpf(cov[0, 1])
        s = mp.sqrt(a + b - 2 * c)
        p, q, phi = mp.ncdf((m1 - m2) / s), mp.ncdf((m2 - m1) / s), mp.npdf((m1 - m2) / s)
        first = m1 * p + m2 * q + s * phi
        return (m1**2 + a) * p + (m2**2 + b) * q + (m1 + m2) * s * phi - first**2


def exact_errors(mean, cov, error_cov):
    """Conditional variance and squared gap, averaged over the estimate of the difference."""
    with mp.workdps(30):
        gap = mp.mpf(mean[0]) - mp.mpf(mean[1])

        def spread(c):
            return mp.mpf(c[0, 0]) + mp.mpf(c[1, 1]) - 2 * mp.mpf(c[0, 1])

        root = mp.sqrt(spread(error_cov))
        known = mp.sqrt(spread(cov) - spread(error_cov))
        a, b, c = (mp.mpf(error_cov[i]) for i in ((0, 0), (1, 1), (0, 1)))

        @cache
        def parts(u):  # of both integrals, which share their nodes
            x = u / root
            p, q, phi = mp.ncdf(x), mp.ncdf(-x), mp.npdf(x)
            h = phi**2 + x * phi * (p - q) - x**2 * p * q
            e = phi - abs(x) * (q if x > 0 else p)
            density = mp.npdf(u, gap, known)
            return density * ((p - h) * a + (q - h) * b + 2 * h * c), density * root**2 * e**2

        edges = {gap + k * known for k in (-14, -9, -6, -3, 0, 3, 6, 9, 14)}
        edges |= {mp.mpf(k) * root for k in (-14, -9, -6, -3, -1, 0, 1, 3, 6, 9, 14)}
        lowest, highest = gap - 14 * known, gap + 14 * known
        edges = sorted(u for u in edges if lowest <= u <= highest)

        def weighed(k):
            return mp.quad(lambda u: parts(u)[k], edges)

        optimal, square = weighed(0), weighed(1)
        return optimal, optimal + square


def random_cov(rng):
    deviations = 10 ** rng.uniform(-8, 8, 2)
    rho = rng.choice([0.0, rng.uniform(-1, 1), 1 - 10 ** rng.uniform(-10, -1)])
    cross = rho * deviations.prod()
    return np.array([[deviations[0] ** 2, cross], [cross, deviations[1] ** 2]])


def test_variances_keep_their_relative_accuracy_over_sixteen_decades():
    rng = np.random.default_rng(7)
    for _ in range(200):
        cov = random_cov(rng)
        wide = np.sqrt(cov[0, 0] + cov[1, 1] - 2 * cov[0, 1])
        mean = [0.0, rng.choice([rng.uniform(-12, 12) * wide, 10 ** rng.uniform(-8, 8)])]
        found = max_moments(mean, cov).var
        assert found == pytest.approx(float(exact_variance(mean, cov)), rel=1e-13), (mean, cov)


@pytest.mark.parametrize(
    ("mean", "cov", "variance"),
    [
        ([-1e6, 0.0], np.diag([1e9, 1e-9]), 1e-9),
        ([0.0, 1e6], np.diag([1e8, 1e-8]), 1e-8),
        ([0.0, 0.0], np.diag([1.0, 1.0]), 1 - 1 / np.pi),
        ([3.0, 3.0], np.ones((2, 2)), 1.0),
    ],
)
def test_small_variances_are_not_lost(mean, cov, variance):
    assert max_moments(mean, cov).var == pytest.approx(variance, rel=1e-14)
    assert max_moments(mean[::-1], cov[::-1, ::-1]).var == pytest.approx(variance, rel=1e-14)
    assert max_errors(mean, cov, cov).optimal == pytest.approx(variance, rel=1e-14)


def test_errors_keep_their_relative_accuracy():
    rng = np.random.default_rng(8)
    for _ in range(4):
        error_cov = random_cov(rng)
        gained = np.diag(np.diag(error_cov) * 10 ** rng.uniform(-3, 3, 2))
        wide = np.sqrt((error_cov + gained).trace())
        mean, cov = [0.0, rng.uniform(-6, 6) * wide], error_cov + gained
        got, wanted = max_errors(mean, cov, error_cov), exact_errors(mean, cov, error_cov)
        # the variance gained is a difference of the arguments
        scale = cov.max() / gained.max()
        assert got.optimal == pytest.approx(float(wanted[0]), rel=1e-12 * max(1.0, scale))
        assert got.plugin == pytest.approx(float(wanted[1]), rel=1e-12 * max(1.0, scale))


def test_a_difference_that_is_nearly_known_before_the_measurement():
    """The limit of an estimate that does not vary: the conditional moments themselves."""
    error_cov = np.array([[2.0, 0.3], [0.3, 1.0]])
    for small in (1e-9, 1e-12, 0.0):
        cov = error_cov + small * np.diag([1.0, 0.0])
        got = max_errors([1.0, -2.0], cov, error_cov).optimal
        assert got == pytest.approx(max_moments([1.0, -2.0], error_cov).var, rel=1e-8)
    exact = max_errors([1.0, -2.0], error_cov, np.zeros((2, 2)))
    assert exact == (0.0, 0.0)
