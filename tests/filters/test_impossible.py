"""Outliers of a million deviations, and measurements that cannot be."""

import warnings

import numpy as np
import pytest
import sympy

from seedslib.base import correct
from seedslib.delay import RECURSIONS, DelayKalmanFilter, DelaySystem
from seedslib.designed import SwitchingFilter
from seedslib.filters import (
    CovarianceFilter,
    GridBayesFilter,
    KalmanFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.linearization import GaussHermite, Moments, Taylor
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)
A, Q, R = 0.9, 0.3, 0.5
TIMES, PLACE = np.arange(12.0), 4
WALK = DiscreteSystem(
    StochasticMap((x,), [A * x + v], Noise((v,), cov=[[Q]])),
    StochasticMap((x,), [x + w], Noise((w,), cov=[[R]])), [0], [[1]],
)  # fmt: skip
MODES = SwitchingSystem(
    (x,), [[A * x + v]] * 2, Noise((v,), cov=[[Q]]), [[0.9, 0.1], [0.2, 0.8]], [[x + w]] * 2,
    Noise((w,), cov=[[R]]), [(0.5, [0], [[1]])] * 2,
)  # fmt: skip
FILTERS = {
    "Kalman": lambda: KalmanFilter(LinearSystem(A, Q, 1, R, 0, 1)),
    "extended": lambda: extended_kalman(WALK),
    "assumed density": lambda: assumed_density(WALK),
    "unscented": lambda: unscented_kalman(WALK),
    "cubature": lambda: cubature_kalman(WALK),
    "Gauss-Hermite": lambda: CovarianceFilter(WALK, GaussHermite(3)),
    "IMM": lambda: SwitchingFilter(MODES, Taylor()),
    "known modes": lambda: KnownModeFilter(MODES),
    "Rao-Blackwell": lambda: RaoBlackwellFilter(MODES, 10),
    **{f"delay, {m}": lambda m=m: DelayKalmanFilter(DelaySystem({0: A, 1: 0}, 1, Q, R, 1), m)
       for m in RECURSIONS},
}  # fmt: skip


def record(size, first=0.3):
    y = np.random.default_rng(0).standard_normal(12)
    y[0], y[PLACE] = first, size
    return y


def by_hand(y):
    mean, var, rows = 0.0, 1.0, []
    for k, seen in enumerate(y):
        if k:
            mean, var = A * mean, A * A * var + Q
        loglik = 0.0
        if np.isfinite(seen):
            total = var + R
            loglik = -0.5 * (np.log(2 * np.pi * total) + (seen - mean) ** 2 / total)
            mean, var = mean + var / total * (seen - mean), var * R / total
        rows.append((mean, var, loglik))
    return np.array(rows).T


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("size", [1e6, -1e6])
def test_an_outlier_of_a_million_deviations(name, size):
    """Linear systems, whose filters are one: its numbers, before and after."""
    y = record(size, np.nan if "delay" in name else 0.3)
    options = {"modes": np.zeros(12, dtype=int)} if name == "known modes" else {}
    options |= {"covariances": True} if name == "IMM" else {}
    found, (mean, var, loglik) = FILTERS[name]().run(TIMES, y[:, None], **options), by_hand(y)
    assert not found.diverged
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.cov[:, 0, 0], var, rtol=1e-9)
    np.testing.assert_allclose(found.loglik, loglik, rtol=1e-9)


@pytest.mark.parametrize("system", [WALK, MODES])
def test_a_grid_that_a_measurement_leaves_says_so(system):
    """All that is left of the law is its last node; where the others are right nothing is said."""
    filter = GridBayesFilter(system, (-6, 6, 121))
    y = np.stack([record(0.1), record(1e6), record(np.nan)], axis=1)[:, None]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = filter.run(TIMES, y)
    np.testing.assert_array_equal(found.diverged, [False, True, False])
    # when measurements are sane again the estimate is back on the nodes
    np.testing.assert_allclose(found.mean[-1, 0, 1], found.mean[-1, 0, 0], atol=0.1)


@pytest.mark.parametrize("system", [WALK, MODES])
def test_particles_that_are_nowhere_near_say_so(system):
    filter = ParticleFilter(system, 100)
    with pytest.warns(UserWarning, match="y: no particle is near the measurement at time 4:"):
        filter.run(TIMES, record(1e6)[:, None], seed=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        filter.run(TIMES, record(9.0)[:, None], seed=0)


def still(sensor=x, noise=None):
    """A number that stays what it is, seen without noise."""
    return DiscreteSystem(
        StochasticMap((x,), [x], Noise()), StochasticMap((x,), [sensor], noise or Noise()), [0],
        [[1]],
    )  # fmt: skip


SURE = SwitchingSystem(
    (x,), [[x]] * 2, Noise(), [[0.9, 0.1], [0.2, 0.8]], [[x]] * 2, Noise(), [(0.5, [0], [[1]])] * 2
)


@pytest.mark.parametrize(
    "make",
    [
        lambda: KalmanFilter(LinearSystem(1, 0, 1, 0, 0, 1)), lambda: extended_kalman(still()),
        lambda: assumed_density(still()), lambda: unscented_kalman(still()),
        lambda: cubature_kalman(still()), lambda: KnownModeFilter(SURE),
        lambda: RaoBlackwellFilter(SURE, 10),
    ],
)  # fmt: skip
def test_an_exact_sensor_that_is_contradicted(make):
    """What was measured once is so; a rounding error is none, another value is impossible."""
    filter, y = make(), np.full((12, 1, 3), 1.3)
    y[PLACE, 0, 1:] = 1.3 * (1 + 1e-12), 1.4
    options = {"modes": np.zeros((12, 3), dtype=int)} if "modes" in filter.takes else {}
    found = filter.run(TIMES, y, **options)
    np.testing.assert_array_equal(found.diverged, [False, False, True])
    assert found.loglik[PLACE, 2] == -np.inf
    assert np.isfinite(found.loglik[:, :2]).all()
    assert np.isfinite(found.loglik[PLACE + 1 :]).all()
    np.testing.assert_allclose(found.mean, 1.3)


def test_only_what_is_out_of_the_range_is_impossible():
    """Two sensors of one number; the third shows another thing, and may be missing."""
    spread = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    moments = Moments(np.zeros(3), np.array([[1.0, 1.0, 0.0]]), spread)
    y = np.array([[1.0, 1.0, 0.3], [1.0, 1.1, 0.3], [1.0, np.nan, 0.3], [1e6, 1e6 + 1e-3, 0.3]]).T
    mean, _, loglik = correct(np.zeros(1), np.ones((1, 1)), y, moments, exact=True)
    np.testing.assert_array_equal(loglik == -np.inf, [False, True, False, False])
    np.testing.assert_allclose(mean[0, [0, 2]], 1.0)
