"""Moments of a Gaussian distribution over intervals, against many digits and by their sums."""

import mpmath as mp
import numpy as np
import pytest

from seedslib.gaussian import interval

INF = np.inf
CASES = [  # mean, variance, lower, upper
    (0, 1, -INF, INF),
    (0, 1, -INF, 0),
    (0, 1, 0, INF),
    (0, 1, -1, 1),
    (0, 1, -40, 40),
    (0, 1, 8, 9),
    (0, 1, -9, -8),
    (0, 1, 3, 3 + 1e-7),
    (0, 1, 30, 31),
    (0, 1, 30, INF),
    (0, 1, 1e4, 1e4 + 1),
    (0, 1, 14142, INF),
    (0, 1, -14142, -14141.9),
    (0, 1, -1e-9, 1e-9),
    (0, 1, -1e-9, 3),
    (0, 1, -8.94, INF),
    (0, 1, -8.95, 8.94),
    (0, 1, -6, -6 + 1e-12),
    (5, 2.3, -INF, 5.1),
    (1e9, 1e-3, 1e9, 1e9 + 1),
    (3, 0.5, -7, -6),
    (0, 1e20, 1, 2),
    (27.5, 126.5625, 5, 5.024935298),
    (0, 1e-8, -1, 1),
    (0, 1, 0.1, 8.5),
    (0, 1, 2, 12),
    (-3e5, 7e-6, -3e5 + 0.02, INF),
    (0, 1, 0, 3.9),
    (0, 1, 0, 4.1),
    (0, 1, 0, 7.7),
    (0, 1, 0, 7.8),
    (0, 1, -3.9, 4.0),
]


def exact(mean, var, lower, upper):
    """ln P, mean, variance of the conditioned distribution; the digits pay for the tails'
    cancellation."""
    reach = max([abs(t - mean) / np.sqrt(var) for t in (lower, upper) if np.isfinite(t)] + [1])
    with mp.workdps(80 + min(int(reach * reach / 4), 60)):
        m, v = mp.mpf(mean), mp.mpf(var)
        a, b = ((mp.mpf(t) - m) / mp.sqrt(v) for t in (lower, upper))
        sign = 1
        if b <= 0:
            a, b, sign = -b, -a, -1
        tail = [mp.erfc(t / mp.sqrt(2)) / 2 if mp.isfinite(t) else mp.mpf(t < 0) for t in (a, b)]
        bell = [mp.npdf(t) if mp.isfinite(t) else mp.mpf(0) for t in (a, b)]
        edge = [t * p if mp.isfinite(t) else mp.mpf(0) for t, p in zip((a, b), bell, strict=True)]
        mass = tail[0] - tail[1]
        centre = (bell[0] - bell[1]) / mass
        spread = 1 + (edge[0] - edge[1]) / mass - centre**2
        return mp.log(mass), m + sign * mp.sqrt(v) * centre, v * spread


def assert_exact(found, case):
    log_mass, mean, var = exact(*case)
    assert abs(float(found.log_mass) - log_mass) <= 1e-15 * max(1, abs(log_mass))
    last_bits = 2 * np.spacing(abs(float(mean)))
    assert abs(float(found.mean) - mean) <= 2e-14 * mp.sqrt(var) + last_bits
    assert abs(float(found.cov) / var - 1) <= 2e-14


@pytest.mark.parametrize("case", CASES)
def test_interval_against_many_digits(case):
    assert_exact(interval(*case), case)


def test_random_intervals_against_many_digits():
    rng = np.random.default_rng(4)
    for _ in range(150):
        mean, sigma = rng.normal() * 10 ** rng.uniform(-3, 3), 10 ** rng.uniform(-3, 3)
        lower = mean + sigma * rng.normal() * 10 ** rng.uniform(-6, 2)
        upper = INF if rng.uniform() < 0.1 else lower + sigma * 10 ** rng.uniform(-10, 2)
        case = (float(mean), float(sigma**2), float(lower), float(upper))
        if case[2] < case[3]:
            assert_exact(interval(*case), case)


def test_intervals_of_a_partition_sum_to_the_distribution():
    """Mass, first and second moment, the latter about a point."""
    rng = np.random.default_rng(1)
    edges = np.concatenate([[-INF], np.sort(rng.normal(size=30) * 3), [INF]])
    mean, var = rng.normal(size=200), rng.uniform(0.1, 5, size=200)
    cells = interval(mean, var, edges[:-1, None], edges[1:, None])
    np.testing.assert_allclose(cells.mass.sum(axis=0), 1.0, rtol=1e-14)
    np.testing.assert_allclose(cells.first.sum(axis=0), mean, atol=1e-14)
    np.testing.assert_allclose(cells.second(0.7).sum(axis=0), var + (mean - 0.7) ** 2, rtol=1e-13)
    np.testing.assert_allclose(cells.second(mean).sum(axis=0), var, rtol=1e-13)


def test_many_intervals_at_once_equal_single_ones():
    """Across the boundaries of blocks, and of a batch of three axes."""
    lower = np.linspace(-30, 30, 40_001)
    found = interval(0.0, 1.0, lower[:-1], lower[1:])
    np.testing.assert_allclose(found.mass.sum(), 1.0, rtol=1e-13)
    some = interval(0.0, 1.0, lower[17_000], lower[17_001])
    np.testing.assert_allclose(found.cov[17_000], some.cov, rtol=5e-15)
    mean, var = np.linspace(-2, 2, 5), np.array([0.3, 1.0, 4.0])[:, None]
    ends = [np.array(e)[:, None, None] for e in ((-INF, -1.0, 6.0), (-1.0, 6.0, INF))]
    found = interval(mean, var, *ends)
    assert found.log_mass.shape == found.mean.shape == found.cov.shape == (3, 3, 5)
    single = interval(mean[3], var[1, 0], 6.0, INF)
    assert single.log_mass.shape == ()
    np.testing.assert_allclose(found.second(mean)[2, 1, 3], single.second(mean[3]), rtol=5e-15)
    assert interval(np.zeros((0, 3)), 1.0, 0.0, 1.0).mean.shape == (0, 3)


def test_a_point_belongs_to_one_half_open_interval():
    cells = interval(1.0, 0.0, [-INF, 0.0, 1.0, 2.0], [0.0, 1.0, 2.0, INF])
    np.testing.assert_array_equal(cells.mass, [0.0, 0.0, 1.0, 0.0])
    assert (cells.mean[2], cells.cov[2]) == (1.0, 0.0)
    assert np.isnan(cells.mean[[0, 1, 3]]).all()
    np.testing.assert_array_equal(cells.first, [0.0, 0.0, 1.0, 0.0])


@pytest.mark.parametrize(("lower", "upper"), [(1.0, 1.0), (0.3, 0.3), (INF, INF), (-INF, -INF)])
def test_empty_interval_has_no_mass(lower, upper):
    found = interval(0.3, 1.0, lower, upper)
    assert found.log_mass == -INF
    assert np.isnan(found.mean)
    assert found.second() == 0.0
