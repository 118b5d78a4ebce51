"""The Kalman filter with diffuse components, against generalised least squares and the Nile."""

from pathlib import Path

import numpy as np
import pytest

from seedslib.filters import KalmanFilter, extended_kalman, smooth
from seedslib.models import LinearSystem

DATA = Path(__file__).resolve().parents[2] / "benchmarks" / "data"
NILE = np.loadtxt(DATA / "nile.csv", delimiter=",", skiprows=1)[:, 1]
YEARS = np.arange(100.0)
TREND = [[1.0, 1.0], [0.0, 1.0]]


def level(mean0, cov0, **options):
    return KalmanFilter(LinearSystem(1, 1469.1, 1, 15099, mean0, cov0, **options))


@pytest.mark.parametrize(
    ("filter", "loglik"),
    [
        (level(1000, 1e5), -639.3007238141726),  # statsmodels 0.15.0 gives both
        (level(0, 0, diffuse=(0,)), -633.4645636488787),
    ],
)
def test_log_likelihood_of_the_nile(filter, loglik):
    assert filter.run(YEARS, NILE[:, None]).loglik.sum() == pytest.approx(loglik, abs=1e-9)


def test_last_level_of_the_nile_and_the_first_smoothed_one():
    filter = level(0, 0, diffuse=(0,))
    found, smoothed = filter.run(YEARS, NILE[:, None]), smooth(filter, YEARS, NILE[:, None])
    assert found.mean[-1, 0] == pytest.approx(798.3703, abs=5e-5)
    assert found.cov[-1, 0, 0] == pytest.approx(4032.158, abs=5e-4)
    assert smoothed.mean[0, 0] == pytest.approx(1111.6683, abs=5e-5)


def least_squares(y, q, r, effect=True):
    """Law of all states of a trend and the diffuse log-likelihood, by one large regression.

    x_k = F^k d + sum F^(k-j) w_j with d unknown; y = X d + e, e ~ N(0, S).
    """
    count = len(y)
    powers = [np.linalg.matrix_power(TREND, k) for k in range(count)]
    slope = np.concatenate(powers)  # (2 K, 2)
    move = np.zeros((2 * count, 2 * count))
    for k in range(count):
        for j in range(1, k + 1):
            move[2 * k : 2 * k + 2, 2 * j : 2 * j + 2] = powers[k - j]
    states = move @ np.kron(np.eye(count), q) @ move.T
    seen = np.flatnonzero(np.isfinite(y))
    pick = np.zeros((len(seen), 2 * count))
    pick[range(len(seen)), 2 * seen] = 1.0
    S = pick @ states @ pick.T + r * np.eye(len(seen))
    X, data = pick @ slope, y[seen]
    inverse = np.linalg.inv(S)
    information = X.T @ inverse @ X
    d = np.linalg.solve(information, X.T @ inverse @ data)
    rest = data - X @ d
    gain = states @ pick.T @ inverse
    mean = slope @ d + gain @ rest
    lean = slope - gain @ X
    cov = states - gain @ pick @ states + lean @ np.linalg.inv(information) @ lean.T
    logs = np.linalg.slogdet(S)[1] + np.linalg.slogdet(information)[1]
    loglik = -0.5 * (len(seen) * np.log(2 * np.pi) + logs + rest @ inverse @ rest)
    return mean.reshape(count, 2), cov, loglik


@pytest.fixture(scope="module")
def trend():
    """A filter of level and slope, two records of which one has gaps at the start."""
    q, r = np.diag([900.0, 40.0]), 15099.0
    system = LinearSystem(TREND, q, [[1, 0]], r, [0, 0], np.zeros((2, 2)), diffuse=(0, 1))
    y = np.stack([NILE[:25], NILE[25:50]], axis=-1)
    y[[0, 2, 3, 11], 0] = np.nan
    return KalmanFilter(system), np.arange(25.0), y, q, r


def test_diffuse_trend_with_gaps_against_one_regression(trend):
    filter, times, y, q, r = trend
    smoothed, found = smooth(filter, times, y[:, None]), filter.run(times, y[:, None])
    for path in range(2):
        mean, cov, loglik = least_squares(y[:, path], q, r)
        assert np.allclose(smoothed.mean[..., path], mean, rtol=1e-9)
        for k in (0, 3, 12, 24):
            block = cov[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
            assert np.allclose(smoothed.cov[k, ..., path], block, rtol=1e-8)
        assert found.loglik[:, path].sum() == pytest.approx(loglik, abs=1e-8)
        partial, cov, _ = least_squares(y[:9, path], q, r)
        assert np.allclose(found.mean[8, :, path], partial[-1], rtol=1e-9)
        assert np.allclose(found.cov[8, ..., path], cov[-2:, -2:], rtol=1e-9)


def test_what_no_measurement_has_told_is_infinite(trend):
    filter, times, y, _, r = trend
    cov = filter.run(times, y[:, None]).cov
    assert np.isinf(cov[0, 0, 0, 0])
    assert np.isinf(cov[0, 1, 1, 0])
    assert cov[0, 0, 0, 1] == pytest.approx(r)
    assert np.isinf(cov[0, 1, 1, 1])
    assert np.isnan(cov[0, 0, 1]).all()
    assert np.isinf(cov[3, 1, 1, 0])
    assert np.isfinite(cov[4, ..., 0]).all()
    assert np.isfinite(cov[1:, ..., 1]).all()


def test_a_wide_law_comes_close_to_the_diffuse_one(trend):
    filter, times, y, q, r = trend
    wide = extended_kalman(LinearSystem(TREND, q, [[1, 0]], r, [0, 0], 1e9 * np.eye(2)))
    one, two = (f.run(times, y[:, None]) for f in (filter, wide))
    assert np.allclose(one.mean[-1], two.mean[-1], rtol=1e-4)
    # a wide law costs half the logarithm of its variance for each unknown number
    assert np.allclose(one.loglik.sum(0) - two.loglik.sum(0), np.log(1e9), atol=1e-3)


def test_a_mask_is_a_gap_while_the_start_is_unknown(trend):
    filter = trend[0]
    state = filter.predict(filter.initial(), 0.0)
    masked = filter.correct(state, np.ma.masked_array([1000.0], [True]))
    missing = filter.correct(state, [np.nan])
    for one, two in zip(masked, missing, strict=True):
        assert np.array_equal(one, two)


def test_an_exact_sensor_tells_an_unknown_level():
    """Then the record is the level: its differences are independent."""
    steps = np.diff(NILE)
    found = KalmanFilter(LinearSystem(1, 1469.1, 1, 0, 0, 0, diffuse=(0,))).run(
        YEARS, NILE[:, None]
    )
    logs = -0.5 * (steps**2 / 1469.1 + np.log(2 * np.pi * 1469.1))
    assert np.allclose(found.loglik[1:], logs, rtol=0, atol=1e-10)
    assert found.loglik[0] == pytest.approx(-0.5 * np.log(2 * np.pi))
    assert np.allclose(found.mean[:, 0], NILE)
    assert np.allclose(found.cov, 0.0, atol=1e-9)


def test_components_that_are_hardly_told_apart():
    """Two roots d apart: the information on both has the determinant of d² times a number."""
    y = np.random.default_rng(3).normal(size=(60, 1)).cumsum(axis=0)

    def loglik(apart):
        F, Q = np.diag([0.95, 0.95 + apart]), np.diag([0.5, 0.3])
        system = LinearSystem(F, Q, [[1, 1]], 1, [0, 0], np.zeros((2, 2)), diffuse=(0, 1))
        return KalmanFilter(system).run(np.arange(60.0), y).loglik.sum()

    assert loglik(1e-5) - loglik(1e-4) == pytest.approx(np.log(10), abs=0.01)


def test_matrices_from_a_table():
    """The filter is made although the table ends before times at which sensors are looked at."""
    table = np.array([[[1.0]], [[2.0]], [[0.5]]])
    varied = LinearSystem(1, 1, lambda t: table[int(t)], 1, 0, 4)
    y = np.array([[1.0], [2.0], [0.0]])
    found = KalmanFilter(varied).run(np.arange(3.0), y)
    mean, cov = 0.0, 4.0
    for k, h in enumerate([1.0, 2.0, 0.5]):
        cov += k > 0
        gain = cov * h / (h * h * cov + 1)
        mean, cov = mean + gain * (y[k, 0] - h * mean), cov - gain * h * cov
        assert found.mean[k, 0] == pytest.approx(mean)
        assert found.cov[k, 0, 0] == pytest.approx(cov)
    late = LinearSystem(1, 1, lambda t: {1900: [[1.0]], 1901: [[2.0]]}[int(t)], 1, 0, 4)
    assert KalmanFilter(late).run([1900.0, 1901.0], y[:2]).mean[0, 0] == pytest.approx(0.8)
