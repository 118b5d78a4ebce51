"""Designed filters of systems whose functions depend on time, against the Kalman filter by hand."""

import numpy as np
import pytest
import sympy

from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

x, v, w, t = sympy.symbols("x v w t", real=True)
TIMES = 0.5 + 0.75 * np.arange(5)
PATHS = 20_000
MOVE = (sympy.Rational(9, 10) + sympy.sin(3 * t) / 2) * x + 3 * sympy.cos(2 * t) + v
SHOW = (1 + t / 5) * x + t**2 / 4 + w


def moved(m, p, k):
    a = 0.9 + np.sin(3 * k) / 2
    return a * m + 3 * np.cos(2 * k), a**2 * p + 0.5


def kalman(y):
    """Means (K+1, paths) and variances (K+1,) after each measurement."""
    m, p, means, variances = np.full(y.shape[1], 0.5), 2.0, [], []
    for i, k in enumerate(TIMES):
        if i:
            m, p = moved(m, p, TIMES[i - 1])
        c = 1 + k / 5
        gain = c * p / (c**2 * p + 0.4)
        m, p = m + gain * (y[i] - c * m - k**2 / 4), p - gain * c * p
        means.append(m)
        variances.append(p)
    return np.array(means), np.array(variances)


def one_mode():
    return SwitchingSystem(
        (x,), [[MOVE]], Noise((v,), cov=[[0.5]]), [[1]], [[SHOW]], Noise((w,), cov=[[0.4]]),
        [(1, [0.5], [[2.0]])], time=t,
    )  # fmt: skip


def discrete():
    return DiscreteSystem(
        StochasticMap((x,), [MOVE], Noise((v,), cov=[[0.5]]), time=t),
        StochasticMap((x,), [SHOW], Noise((w,), cov=[[0.4]]), time=t),
        [0.5], [[2.0]],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("make", "linearization"),
    [
        (discrete, Taylor()),
        (discrete, Cubature()),
        (one_mode, Taylor()),
        (one_mode, ExactGaussian()),
    ],
)
def test_a_design_finds_the_kalman_filter(make, linearization):
    """Its estimates differ by what a fit to so many paths misses, its errors are its."""
    system = make()
    memory = Memory(1) if make is discrete else large_order(1)
    options = {"nodes": 0} if make is discrete else {}
    filter = synthesize(system, memory, linearization, TIMES, paths=PATHS, seed=1, **options)
    y = system.simulate(TIMES, 400, 2).measurements
    found, (mean, after) = filter.run(TIMES, y), kalman(y[:, 0])
    apart = np.sqrt(((found.mean[:, 0] - mean) ** 2).mean(axis=1))
    # a fit of two coefficients to N paths misses deviations / sqrt(N)
    assert (apart < 6 * np.sqrt(after / PATHS) + 0.01).all(), apart
    rms, doubt = filter.predicted.rms[:, 0], filter.predicted.error[:, 0]
    assert (np.abs(rms - np.sqrt(after)) < 5 * doubt).all()


def test_gains_of_a_design_are_the_dynamics_of_the_time_they_leave():
    """M[X_{k+1} | Z_k] = a(t_k) Z_k + b(t_k), as Z_k is the conditional mean."""
    filter = synthesize(discrete(), Memory(1), Taylor(), TIMES, paths=PATHS, seed=3, nodes=0)
    for k, fit in zip(TIMES, filter.fits, strict=False):
        assert fit.gain[0, 0] == pytest.approx(0.9 + np.sin(3 * k) / 2, abs=0.05)
        assert fit.offset[0] == pytest.approx(3 * np.cos(2 * k), abs=0.1)


def test_memory_of_a_switching_design_says_what_its_estimates_say():
    """M[X_k | Z_k] = Z_k where the estimate is the conditional mean."""
    filter = synthesize(one_mode(), large_order(1), Taylor(), TIMES, paths=PATHS, seed=3)
    for fit in filter.fits:
        assert fit.gain[0, 0, 0, 0] == pytest.approx(1.0, abs=0.02)
        assert fit.offset[0, 0, 0] == pytest.approx(0.0, abs=0.05)


def test_one_mode_without_a_design_is_the_kalman_filter():
    y = one_mode().simulate(TIMES, 20, 4).measurements
    found = SwitchingFilter(one_mode(), Taylor()).run(TIMES, y, covariances=True)
    mean, after = kalman(y[:, 0])
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-11)
    np.testing.assert_allclose(found.cov[:, 0, 0], np.tile(after[:, None], 20), rtol=1e-11)
