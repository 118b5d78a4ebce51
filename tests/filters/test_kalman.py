"""The Kalman filter with diffuse components, against generalised least squares and the Nile."""

from pathlib import Path

import numpy as np
import pytest

from oracles.linear import Regression, constant, kalman
from seedslib.filters import KalmanFilter, smooth
from seedslib.models import LinearSystem
from systems import INPUTS, TIMES, linear_numbers, linear_system, record

DATA = Path(__file__).resolve().parents[1] / "data"
NILE = np.loadtxt(DATA / "nile.csv", delimiter=",", skiprows=1)[:, 1]
YEARS = np.arange(100.0)
DIFFUSE = (0, 2)


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


def test_last_and_first_level_of_the_nile():
    """Of Durbin and Koopman, filtered and smoothed."""
    filter = level(0, 0, diffuse=(0,))
    estimates, smoothed = filter.run(YEARS, NILE[:, None]), smooth(filter, YEARS, NILE[:, None])
    assert estimates.mean[-1, 0] == pytest.approx(798.3703, abs=5e-5)
    assert estimates.cov[-1, 0, 0] == pytest.approx(4032.158, abs=5e-4)
    assert smoothed.mean[0, 0] == pytest.approx(1111.6683, abs=5e-5)


def least_squares(model, y, k, last, diffuse=DIFFUSE):
    """Distribution of x_k and the diffuse log-likelihood: unknown numbers d by generalised least
    squares."""
    base, unit = Regression(model), np.eye(len(model.mean0))
    moved = [Regression(model._replace(mean0=model.mean0 + unit[i])) for i in diffuse]
    present, row = ~np.isnan(y[: last + 1]), base.states[k]
    means = [each.measured_means - base.measured_means for each in moved]
    X = np.stack([part[: last + 1][present] for part in means], axis=-1)
    effect = np.stack([each.state_means[k] - base.state_means[k] for each in moved], axis=-1)
    seen = base.measured[: last + 1][present]
    error = (y - base.measured_means)[: last + 1][present]
    S = seen @ base.cov @ seen.T
    weighted = np.linalg.solve(S, X)
    information = X.T @ weighted
    d = np.linalg.solve(information, weighted.T @ error)
    rest = error - X @ d
    gain = np.linalg.solve(S, seen @ base.cov @ row.T).T
    lean = effect - gain @ X
    mean = base.state_means[k] + effect @ d + gain @ rest
    cov = row @ base.cov @ row.T - gain @ seen @ base.cov @ row.T
    cov = cov + lean @ np.linalg.solve(information, lean.T)
    logs = np.linalg.slogdet(S)[1] + np.linalg.slogdet(information)[1]
    loglik = len(rest) * np.log(2 * np.pi) + logs + rest @ np.linalg.solve(S, rest)
    return mean, cov, -0.5 * loglik


@pytest.fixture(scope="module")
def diffuse():
    """The reference system with two unknown numbers, and two records with unlike gaps."""
    system = linear_system(diffuse=DIFFUSE)
    model = linear_numbers(means=False)._replace(mean0=system.mean0, cov0=system.cov0)
    y = record(model)[1]
    full = np.random.default_rng(1).standard_normal(y.shape)
    full[3] = np.nan
    return KalmanFilter(system), model, np.stack([y, full], axis=-1)


def test_diffuse_start_with_gaps_and_inputs_equals_least_squares(diffuse):
    filter, model, y = diffuse
    estimates = filter.run(TIMES, y, inputs=INPUTS)
    smoothed = smooth(filter, TIMES, y, inputs=INPUTS)
    lagged = smooth(filter, TIMES, y, inputs=INPUTS, lag=3)
    for i in range(2):
        for k in range(7):
            for part, last in ((estimates, k), (smoothed, 6), (lagged, min(k + 3, 6))):
                if last == 0:
                    continue
                mean, cov, loglik = least_squares(model, y[..., i], k, last)
                np.testing.assert_allclose(part.mean[k, :, i], mean, rtol=1e-9)
                np.testing.assert_allclose(part.cov[k, ..., i], cov, rtol=1e-8, atol=1e-12)
                total = estimates.loglik[: last + 1, i].sum()
                assert total == pytest.approx(loglik, abs=1e-9)
    one = filter.run(TIMES, y[..., 0], inputs=INPUTS)
    np.testing.assert_allclose(one.mean[1:], estimates.mean[1:, :, 0], rtol=1e-12)
    assert not estimates.diverged.any()


def test_variance_of_what_no_measurement_has_determined_is_infinite(diffuse):
    filter, _, y = diffuse
    cov = filter.run(TIMES, y, inputs=INPUTS).cov
    # one measured number, and two: the second record determines both unknown ones at once
    assert np.isinf(cov[0, 0, 0, 0])
    assert np.isinf(cov[0, 2, 2, 0])
    assert np.isnan(cov[0, 0, 2, 0])
    assert cov[0, 1, 1, 0] == pytest.approx(0.8)
    assert np.isfinite(cov[0, ..., 1]).all()
    assert np.isfinite(cov[1:]).all()


def test_wide_start_comes_close_to_the_diffuse_one(diffuse):
    """A wide distribution costs half the logarithm of its variance for each unknown number."""
    filter, model, y = diffuse
    wide = model._replace(cov0=model.cov0 + 1e9 * np.diag([1, 0, 1]))
    estimates = filter.run(TIMES, y[..., 0], inputs=INPUTS)
    wanted = kalman(wide, y[..., 0])
    np.testing.assert_allclose(estimates.mean[-1], wanted.mean[-1], rtol=1e-6)
    assert estimates.loglik.sum() - wanted.loglik.sum() == pytest.approx(np.log(1e9), abs=1e-5)


@pytest.mark.parametrize("units", [1e-7, 1.0, 1e7])
def test_diffuse_components_that_are_hardly_distinguished(units):
    """Two roots near one another, noise in one component: units of the other are found."""
    F, Q = np.diag([0.95, 0.951]), np.diag([0.5, 0.0])
    y = np.random.default_rng(3).normal(size=(20, 1)).cumsum(axis=0)
    system = LinearSystem(
        F, Q * units**2, [[1, 1]], units**2, [0, 0], np.zeros((2, 2)), diffuse=(0, 1)
    )
    model = constant(F, Q, [[1, 1]], 1, [0, 0], np.zeros((2, 2)), 19)
    mean, cov, loglik = least_squares(model, y, 19, 19, (0, 1))
    estimates = KalmanFilter(system).run(np.arange(20.0), y * units)
    np.testing.assert_allclose(estimates.mean[-1] / units, mean, rtol=1e-5)
    np.testing.assert_allclose(estimates.cov[-1] / units**2, cov, rtol=1e-5)
    # the density of 20 numbers with two unknown ones, in the units of them all
    assert estimates.loglik.sum() + 18 * np.log(units) == pytest.approx(loglik, abs=1e-6)


def test_exact_sensor_determines_a_diffuse_level():
    """Then the record is the level: its differences are independent."""
    steps = np.diff(NILE)
    estimates = KalmanFilter(LinearSystem(1, 1469.1, 1, 0, 0, 0, diffuse=(0,))).run(
        YEARS, NILE[:, None]
    )
    logs = -0.5 * (steps**2 / 1469.1 + np.log(2 * np.pi * 1469.1))
    np.testing.assert_allclose(estimates.loglik[1:], logs, rtol=0, atol=1e-10)
    assert estimates.loglik[0] == pytest.approx(-0.5 * np.log(2 * np.pi))
    np.testing.assert_allclose(estimates.mean[:, 0], NILE)
    np.testing.assert_allclose(estimates.cov, 0.0, atol=1e-9)


@pytest.mark.parametrize("diffuse", [(), (0,)])
def test_matrices_from_a_table_that_ends(diffuse):
    """The filter is made although other times than those of the record are not in it."""
    table = {1900: [[1.0]], 1901: [[2.0]], 1902: [[0.5]]}
    cov0 = 0 if diffuse else 4
    system = LinearSystem(1, 1, lambda t: table[int(t)], 1, 0, cov0, diffuse=diffuse)
    times, y = 1900 + np.arange(3.0), np.array([[1.0], [2.0], [0.0]])
    model = constant(1, 1, 1, 1, 0, 1e10 if diffuse else 4, 2)
    wanted = kalman(model._replace(H=np.array(list(table.values()))), y)
    estimates = KalmanFilter(system).run(times, y)
    np.testing.assert_allclose(estimates.mean, wanted.mean, rtol=1e-8)
    np.testing.assert_allclose(estimates.cov, wanted.cov, rtol=1e-8)
