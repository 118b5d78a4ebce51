"""Noises with a mean through every filter: as good as the mean written into the model's functions.

A noise of mean c, or one of mean zero to which the functions add c: the same system, and with the
same seed the same numbers, but for rounding. For the covariance filters Kalman's recursion is
written out as well.
"""

import numpy as np
import pytest
import sympy

from seedslib.design import Continuous, synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.evaluation import evaluate
from seedslib.filters import (
    CovarianceFilter,
    GridBayesFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
)
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem

x, v, w, z = sympy.symbols("x v w z", real=True)
PUSH, SHIFT, MARK = 0.7, -1.3, 0.6
RULES = [Taylor(), ExactGaussian(), Unscented(), Unscented(0.5, 2, 0), Cubature(), GaussHermite(3)]


def noise(symbol, mean, variance, moved):
    """The noise, and what stands for it in an expression."""
    given = Noise((symbol,), mean=0.0 if moved else mean, cov=[[variance]])
    return given, symbol + mean if moved else symbol


def close(one, two, tolerance=1e-9):
    for a, b in zip(one, two, strict=True):
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance)


# Discrete time


def discrete(moved=False, bent=0.0):
    drive, a = noise(v, PUSH, 0.5, moved)
    loud, b = noise(w, SHIFT, 0.8, moved)
    return DiscreteSystem(
        StochasticMap((x,), [0.9 * x + bent * sympy.sin(x) + 2 * a], drive),
        StochasticMap((x,), [2 * x + bent * x * b + b / 2], loud), [0.5], [[1.5]],
    )  # fmt: skip


def kalman(y):
    """Kalman's recursion of the linear system: means (K+1, N), variances and likelihoods."""
    mean, p, found = np.full(y.shape[2], 0.5), 1.5, []
    for k, shown in enumerate(y[:, 0]):
        if k:
            mean, p = 0.9 * mean + 2 * PUSH, 0.81 * p + 4 * 0.5
        s = 4 * p + 0.8 / 4
        error = shown - 2 * mean - SHIFT / 2
        loglik = -0.5 * (error**2 / s + np.log(2 * np.pi * s))
        mean, p = mean + 2 * p / s * error, p - 4 * p**2 / s
        found.append((mean, np.full(y.shape[2], p), loglik))
    return [np.array(part) for part in zip(*found, strict=True)]


@pytest.mark.parametrize("rule", RULES)
def test_covariance_filters_are_kalmans(rule):
    system, times = discrete(), np.arange(6.0)
    y = system.simulate(times, 20, 1).measurements
    found = CovarianceFilter(system, rule).run(times, y)
    cov = np.broadcast_to(found.cov.reshape(6, -1), (6, 20))
    close((found.mean[:, 0], cov, found.loglik), kalman(y), 1e-11)


def test_claimed_covariance_in_discrete_time():
    """Estimates are unbiased, and normalised squares have the mean of their freedom."""
    system = discrete()
    got = evaluate(
        CovarianceFilter(system, Taylor()), system, np.arange(5.0), 10_000, 2, consistency=True
    )
    assert np.abs(got.nees - 1).max() < 4 * np.sqrt(2 / 10_000)
    assert np.abs(got.nis - 1).max() < 4 * np.sqrt(2 / 10_000)
    assert (np.abs(got.bias) < 4 * got.bias_error).all()


def test_simulation_and_particles_in_discrete_time():
    times, (given, moved) = np.arange(4.0), (discrete(m, bent=0.3) for m in (False, True))
    data, same = (s.simulate(times, 50, 1) for s in (given, moved))
    close((data.states, data.measurements), (same.states, same.measurements))
    one, two = (ParticleFilter(s, 60).run(times, data.measurements, seed=2) for s in (given, moved))
    close((one.mean, one.cov, one.loglik), (two.mean, two.cov, two.loglik))


def test_particles_come_to_kalman():
    """Within what 2000 particles scatter, about 0.03 of the deviation: a mean left out is 1.4."""
    system, times = discrete(), np.arange(4.0)
    y = system.simulate(times, 40, 3).measurements
    found = ParticleFilter(system, 2000).run(times, y, seed=4)
    mean, p, _ = kalman(y)
    apart = (found.mean[:, 0] - mean) / np.sqrt(p)
    assert np.sqrt((apart**2).mean()) < 0.1


# Switching systems


def switching(moved=False, bent=0.0):
    drive, a = noise(v, PUSH, 0.5, moved)
    loud, b = noise(w, SHIFT, 0.8, moved)
    leave = [0.1 + bent * sympy.exp(-(x**2)), 0.3]
    return SwitchingSystem(
        (x,), [[0.9 * x + a], [0.5 * x - 2 * a]], drive,
        [[1 - leave[0], leave[0]], [leave[1], 1 - leave[1]]],
        [[x + b], [x + 3 * b]], loud, [(0.6, [0.5], [[1.5]]), (0.4, [-1.0], [[0.5]])],
        indicator=[[0.9, 0.1], [0.2, 0.8]],
    )  # fmt: skip


@pytest.fixture(scope="module")
def pair():
    """The system with state-dependent switching in both forms, and a record of each."""
    systems = switching(False, 0.3), switching(True, 0.3)
    return [(s, s.simulate(np.arange(4.0), 30, 1)) for s in systems]


def test_simulated_switching_system(pair):
    (_, data), (_, same) = pair
    close((data.states, data.measurements), (same.states, same.measurements))
    np.testing.assert_array_equal(data.modes, same.modes)


@pytest.mark.parametrize("rule", RULES)
def test_filters_of_a_switching_system(pair, rule):
    found = []
    for system, data in pair:
        filter = SwitchingFilter(system, rule)
        got = filter.run(
            data.times, data.measurements, indicators=data.indicators, covariances=True
        )
        found.append((got.mean, got.cov, got.mode_prob, got.loglik))
    close(*found)


@pytest.mark.parametrize("make", [GridBayesFilter, lambda s: ParticleFilter(s, 50)])
def test_references_of_a_switching_system(pair, make):
    found = []
    for system, data in pair:
        got = make(system).run(data.times, data.measurements, indicators=data.indicators)
        found.append((got.mean, got.cov, got.mode_prob, got.loglik))
    close(*found)


@pytest.mark.parametrize("memory", [Memory(2), Memory(0, 2, 2)])
def test_designed_filters_of_a_switching_system(pair, memory):
    found = []
    for system, data in pair:
        made = synthesize(system, memory, ExactGaussian(), data.times, paths=4000, seed=3)
        got = made.run(data.times, data.measurements, indicators=data.indicators)
        found.append((got.mean, got.loglik))
    close(*found, 1e-7)


def by_modes(data):
    """Kalman's recursion along the true modes."""
    modes, y = data.modes, data.measurements[:, 0]
    mean = np.where(modes[0] == 0, 0.5, -1.0)
    p, kept = np.where(modes[0] == 0, 1.5, 0.5), []
    for k in range(len(y)):
        if k:
            old = modes[k - 1]
            mean = np.where(old == 0, 0.9 * mean + PUSH, 0.5 * mean - 2 * PUSH)
            p = np.where(old == 0, 0.81 * p + 0.5, 0.25 * p + 4 * 0.5)
        gain = np.where(modes[k] == 0, 1.0, 3.0)
        s = p + gain**2 * 0.8
        mean, p = mean + p / s * (y[k] - mean - gain * SHIFT), p - p**2 / s
        kept.append((mean, p))
    return [np.array(part) for part in zip(*kept, strict=True)]


def test_filters_of_a_jump_linear_system():
    systems, times = (switching(), switching(True)), np.arange(4.0)
    data = systems[0].simulate(times, 30, 1)
    known = KnownModeFilter(systems[0]).run(
        times, data.measurements, modes=data.modes, indicators=data.indicators
    )
    close((known.mean[:, 0], known.cov[:, 0, 0]), by_modes(data), 1e-11)
    found = []
    for system in systems:  # 8 histories of 4 modes at the most are drawn
        got = RaoBlackwellFilter(system, 8).run(
            times, data.measurements, indicators=data.indicators, seed=5
        )
        found.append((got.mean, got.cov, got.mode_prob, got.loglik))
    close(*found)


# Jump-diffusions


def diffusion(moved=False):
    marks, a = noise(z, MARK, 0.5, moved)
    loud, b = noise(v, SHIFT, 0.8, moved)
    return JumpDiffusion(
        (x,), [x - x**3], [[0.5]], [x * (1 + 0.3 * b) + b], loud, [1.0], [[0.25]],
        intensity=0.5 + 0.2 * x**2, jump=[a - x / 2], marks=marks, step=0.02,
    )  # fmt: skip


@pytest.fixture(scope="module")
def kicked():
    systems = diffusion(), diffusion(True)
    return [(s, s.simulate([0.0, 0.2, 0.4], 20, 1)) for s in systems]


def test_simulated_jump_diffusion(kicked):
    (_, data), (_, same) = kicked
    close((data.states, data.measurements), (same.states, same.measurements))


@pytest.mark.parametrize("rule", RULES)
def test_covariance_filters_of_a_jump_diffusion(kicked, rule):
    found = []
    for system, data in kicked:
        got = CovarianceFilter(system, rule).run(data.times, data.measurements)
        found.append((got.mean, got.cov, got.loglik))
    close(*found)


@pytest.mark.parametrize("predictor", [None, Continuous()])
def test_designed_filters_of_a_jump_diffusion(kicked, predictor):
    found = []
    for system, data in kicked:
        options = {} if predictor is None else {"predictor": predictor}
        made = synthesize(
            system, Memory(1), ExactGaussian(), data.times, paths=400, seed=3, **options
        )
        got = made.run(data.times, data.measurements)
        found.append((got.mean, got.loglik))
    close(*found, 1e-7)
