"""Filters of systems whose functions depend on time, against recursions written out by hand.

Dynamics are those of the time they leave, the sensor that of the measurement.
"""

from functools import lru_cache
from itertools import pairwise, product

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from seedslib.designed import SwitchingFilter
from seedslib.filters import (
    CovarianceFilter,
    GridBayesFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem

x, v, w, t = sympy.symbols("x v w t", real=True)
TIMES = 0.5 + 0.75 * np.arange(6)
Y = np.array([[0.3], [1.4], [np.nan], [-0.8], [2.1], [0.9]])
SWITCH = np.array([[0.8, 0.2], [0.3, 0.7]])


def slope(k, mode=0):
    return 0.9 + 0.3 * np.sin(3 * k) - 0.5 * mode


def push(k, mode=0):
    return np.cos(2 * k) + mode


def noise(k):
    return 0.3 + 0.1 * k


def sight(k):
    return 1 + k / 5


def offset(k, mode=0):
    return k**2 / 4 + mode


def move(mode=0):
    a = sympy.Rational(9, 10) + sympy.Rational(3, 10) * sympy.sin(3 * t) - mode / sympy.Integer(2)
    return a * x + sympy.cos(2 * t) + mode + sympy.sqrt(noise(t)) * v


def show(mode=0):
    return sight(t) * x + offset(t, mode) + w


def scalar():
    return DiscreteSystem(
        StochasticMap((x,), [move()], Noise((v,)), time=t),
        StochasticMap((x,), [show()], Noise((w,), cov=[[0.4]]), time=t),
        [0.5], [[2.0]],
    )  # fmt: skip


@lru_cache
def switching():
    return SwitchingSystem(
        (x,), [[move(0)], [move(1)]], Noise((v,)), SWITCH.tolist(), [[show(0)], [show(1)]],
        Noise((w,), cov=[[0.4]]), [(0.6, [0.5], [[2.0]]), (0.4, [-0.5], [[1.0]])], time=t,
    )  # fmt: skip


def corrected(m, p, y, k, mode=0):
    """Posterior moments and density of the measurement."""
    if np.isnan(y):
        return m, p, 1.0
    s = sight(k) ** 2 * p + 0.4
    e = y - sight(k) * m - offset(k, mode)
    gain = sight(k) * p / s
    return m + gain * e, p - gain * sight(k) * p, np.exp(-e * e / 2 / s) / np.sqrt(2 * np.pi * s)


def moved(m, p, k, mode=0):
    return slope(k, mode) * m + push(k, mode), slope(k, mode) ** 2 * p + noise(k)


def kalman(modes, start=(0.5, 2.0)):
    """Means, variances and densities where the modes are known."""
    (m, p), rows = start, []
    for i, (k, y) in enumerate(zip(TIMES, Y[:, 0], strict=True)):
        if i:
            m, p = moved(m, p, TIMES[i - 1], modes[i - 1])
        m, p, density = corrected(m, p, y, k, modes[i])
        rows.append((m, p, density))
    return np.array(rows).T


def bayes():
    """Exact mean, variance and probability of mode 1 over all histories of the modes."""
    found = []
    for count in range(1, len(TIMES) + 1):
        parts = []
        for modes in product((0, 1), repeat=count):
            m, p, density = kalman([*modes, *[0] * 6][:6], [(0.5, 2.0), (-0.5, 1.0)][modes[0]])
            chance = [0.6, 0.4][modes[0]] * np.prod([SWITCH[a, b] for a, b in pairwise(modes)])
            parts.append((chance * np.prod(density[:count]), m[count - 1], p[count - 1], modes[-1]))
        weight, m, p, last = np.array(parts).T
        weight /= weight.sum()
        mean = weight @ m
        found.append((mean, weight @ (p + (m - mean) ** 2), weight @ last))
    return np.array(found).T


@pytest.mark.parametrize(
    "make",
    [
        extended_kalman, assumed_density, unscented_kalman, cubature_kalman,
        lambda system: CovarianceFilter(system, GaussHermite(4)),
    ],
)  # fmt: skip
def test_covariance_filters(make):
    found, (mean, variance, density) = make(scalar()).run(TIMES, Y), kalman([0] * 6)
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-12)
    np.testing.assert_allclose(found.cov[:, 0, 0], variance, rtol=1e-12)
    np.testing.assert_allclose(found.loglik, np.log(density), rtol=1e-12, atol=1e-15)


def near(system, mean):
    """Whether particles agree with exact means within the spread of independent runs."""
    many = np.repeat(Y[:, :, None], 30, axis=2)
    found = ParticleFilter(system, 4000).run(TIMES, many, seed=1).mean[:, 0]
    return (np.abs(found.mean(axis=1) - mean) < 5 * found.std(axis=1) / np.sqrt(30)).all()


def test_particles():
    assert near(scalar(), kalman([0] * 6)[0])


def test_simulated_means():
    states = scalar().simulate(TIMES, 100_000, 2)
    m, p = 0.5, 2.0
    for i, k in enumerate(TIMES):
        if i:
            m, p = moved(m, p, TIMES[i - 1])
        assert abs(states.states[i, 0].mean() - m) < 5 * np.sqrt(p / 1e5)
        shown = np.sqrt((sight(k) ** 2 * p + 0.4) / 1e5)
        assert abs(states.measurements[i, 0].mean() - sight(k) * m - offset(k)) < 5 * shown


@pytest.mark.parametrize("linearization", [Taylor(), ExactGaussian(), Cubature()])
def test_known_modes(linearization):
    modes = [0, 1, 1, 0, 1, 0]
    mean, variance, density = kalman(modes)
    found = KnownModeFilter(switching(), linearization).run(TIMES, Y, modes=np.array(modes))
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-12)
    np.testing.assert_allclose(found.cov[:, 0, 0], variance, rtol=1e-12)
    np.testing.assert_allclose(found.loglik, np.log(density), rtol=1e-12, atol=1e-15)


def test_histories_of_modes():
    mean, variance, one = bayes()
    found = RaoBlackwellFilter(switching(), 100).run(TIMES, Y)
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-11)
    np.testing.assert_allclose(found.cov[:, 0, 0], variance, rtol=1e-11)
    np.testing.assert_allclose(found.mode_prob[:, 1], one, rtol=1e-11)


def test_grid_and_particles_of_a_switching_system():
    mean, variance, one = bayes()
    found = GridBayesFilter(switching(), (-12, 12, 481)).run(TIMES, Y)
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-6)
    np.testing.assert_allclose(found.cov[:, 0, 0], variance, rtol=1e-6)
    np.testing.assert_allclose(found.mode_prob[:, 1], one, rtol=1e-6)
    assert near(switching(), mean)


@pytest.mark.parametrize("linearization", [Taylor(), ExactGaussian(), Cubature()])
def test_laws_of_all_modes(linearization):
    """One Gaussian law in each mode, mixed before the next step."""
    prob, m, p = np.array([0.6, 0.4]), np.array([0.5, -0.5]), np.array([2.0, 1.0])
    run = SwitchingFilter(switching(), linearization).run(TIMES, Y, covariances=True)
    for i, (k, y) in enumerate(zip(TIMES, Y[:, 0], strict=True)):
        if i:
            ahead = [moved(m[j], p[j], TIMES[i - 1], j) for j in (0, 1)]
            share = prob[:, None] * SWITCH
            prob = share.sum(axis=0)
            share = share / prob
            mean = share.T @ [a for a, _ in ahead]
            p = np.array(
                [
                    sum(share[j, l] * (ahead[j][1] + (ahead[j][0] - mean[l]) ** 2) for j in (0, 1))
                    for l in (0, 1)
                ]
            )
            m = mean
        m, p, density = np.array([corrected(m[j], p[j], y, k, j) for j in (0, 1)]).T
        total = prob @ density
        prob = prob * density / total
        np.testing.assert_allclose(run.mode_prob[i], prob, rtol=1e-11)
        np.testing.assert_allclose(run.mean[i, 0], prob @ m, rtol=1e-11)
        spread = prob @ (p + (m - prob @ m) ** 2)
        np.testing.assert_allclose(run.cov[i, 0, 0], spread, rtol=1e-11)
        np.testing.assert_allclose(run.loglik[i], np.log(total), rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize(
    "make", [extended_kalman, assumed_density, unscented_kalman, cubature_kalman]
)
def test_continuous_time(make):
    """dX = (-t X + cos 3t) dt + (1 + t/2) dW, moments by an integrator of another kind."""
    system = JumpDiffusion(
        (x,), [-t * x + sympy.cos(3 * t)], [[1 + t / 2]], [show()], Noise((w,), cov=[[0.4]]),
        [0.5], [[2.0]], step=0.01, time=t,
    )  # fmt: skip
    found, m, p = make(system).run(TIMES, Y), 0.5, 2.0
    for i, (k, y) in enumerate(zip(TIMES, Y[:, 0], strict=True)):
        if i:
            m, p = solve_ivp(
                lambda s, z: [-s * z[0] + np.cos(3 * s), -2 * s * z[1] + (1 + s / 2) ** 2],
                (TIMES[i - 1], k), [m, p], rtol=1e-11, atol=1e-12,
            ).y[:, -1]  # fmt: skip
        m, p, _ = corrected(m, p, y, k)
        np.testing.assert_allclose(found.mean[i, 0], m, rtol=1e-7)
        np.testing.assert_allclose(found.cov[i, 0, 0], p, rtol=1e-7)
