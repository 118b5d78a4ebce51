"""Covariance filters of systems that depend on time, against moment equations written out."""

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from seedslib.evaluation import evaluate
from seedslib.filters import CovarianceFilter, assumed_density, extended_kalman
from seedslib.filters.covariance import FilterState
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import JumpDiffusion, Noise

x, v, z = sympy.symbols("x v z", real=True)
t = sympy.Symbol("t")
MARK, SPREAD, SENSOR, LOUD = 0.6, 0.5, -0.8, 0.3
TIMES, RECORD = [0.3, 0.7, 1.5], np.array([[0.4], [1.9], [-0.6]])


def affine(**options):
    """Drift, diffusion, intensity, jump and sensor depend on time, and all noises have a mean."""
    return JumpDiffusion(
        (x,), [-(1 + t) * x + sympy.cos(3 * t)], [[1 + t]],
        [(1 + t) * x + sympy.sin(t) + t * v], Noise((v,), mean=SENSOR, cov=[[LOUD]]),
        [1.0], [[0.4]], intensity=2 * t, jump=[-t * x / 2 + (1 + t) * z],
        marks=Noise((z,), mean=MARK, cov=[[SPREAD]]), **options,
    )  # fmt: skip


def rates(t, moments, exact):
    """m' = E b and P' = 2 cov(b, x) + E Sigma; a first-order filter takes Sigma at the mean."""
    m, p = moments
    a, c, d, mu = -(1 + t), -t / 2, 1 + t, 2 * t
    square = (c * m + d * MARK) ** 2 + d**2 * SPREAD + (c**2 * p if exact else 0)
    change = 2 * (a + mu * c) * p + (1 + t) ** 2 + mu * square
    return np.array([a * m + np.cos(3 * t) + mu * (c * m + d * MARK), change])


def by_hand(move):
    """Kalman's correction of Y = (1 + t) X + sin t + t V between moves of (m, P)."""
    m, p, found, before = 1.0, 0.4, [], TIMES[0]
    for now, y in zip(TIMES, RECORD[:, 0], strict=True):
        if now > before:
            m, p = move(before, now, np.array([m, p]))
        slope = 1 + now
        s = slope**2 * p + now**2 * LOUD
        error = y - slope * m - np.sin(now) - now * SENSOR
        loglik = -0.5 * (error**2 / s + np.log(2 * np.pi * s))
        m, p = m + slope * p / s * error, p - (slope * p) ** 2 / s
        found.append((m, p, loglik))
        before = now
    return np.array(found).T


SYSTEM = affine()


@pytest.mark.parametrize("integrator", ["rk4", "adaptive"])
@pytest.mark.parametrize(
    "rule", [Taylor(), ExactGaussian(), Unscented(), Unscented(0.5, 2, 0), Cubature(),
             GaussHermite(3)],
)  # fmt: skip
def test_affine_system_with_jumps(rule, integrator):
    exact = not isinstance(rule, Taylor)

    def move(before, now, moments):
        options = {"rtol": 1e-11, "atol": 1e-13, "args": (exact,)}
        return solve_ivp(rates, (before, now), moments, **options).y[:, -1]

    options = {"rtol": 1e-10, "atol": 1e-12} if integrator == "adaptive" else {}
    filter = CovarianceFilter(SYSTEM, rule, step=0.02, integrator=integrator, **options)
    found = filter.run(TIMES, RECORD)
    mean, cov, loglik = by_hand(move)
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=2e-7)
    np.testing.assert_allclose(found.cov[:, 0, 0], cov, rtol=2e-7)
    np.testing.assert_allclose(found.loglik, loglik, rtol=2e-7)


def test_euler_steps_take_their_rates_at_their_beginning():
    """Four long steps, written out; the system's own step is the default."""

    def move(before, now, moments):
        steps = int(np.ceil((now - before) / 0.2 - 1e-9))
        h = (now - before) / steps
        for k in range(steps):
            moments = moments + h * rates(before + k * h, moments, False)
        return moments

    found = extended_kalman(affine(step=0.2), integrator="euler").run(TIMES, RECORD)
    mean, cov, loglik = by_hand(move)
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-12)
    np.testing.assert_allclose(found.cov[:, 0, 0], cov, rtol=1e-12)
    np.testing.assert_allclose(found.loglik, loglik, rtol=1e-12)


@pytest.mark.parametrize(("make", "exact"), [(extended_kalman, 0.0), (assumed_density, 1.0)])
def test_cubic_drift(make, exact):
    """dX = (-t X³ + sin t) dt + t X dW: means over N(m, P), or the first-order ones."""
    system = JumpDiffusion(
        (x,), [-t * x**3 + sympy.sin(t)], [[t * x]], [x + v], Noise((v,)), [1.0], [[0.4]]
    )

    def rate(t, moments):
        m, p = moments
        e = exact * p
        drift = -t * (m**3 + 3 * m * e) + np.sin(t)
        return [drift, -6 * t * (m**2 + e) * p + t**2 * (m**2 + e)]

    want = solve_ivp(rate, (0.2, 1.2), [1.0, 0.4], rtol=1e-11, atol=1e-13).y[:, -1]
    start = FilterState(0.2, np.array([1.0]), np.array([[0.4]]))
    for state in (start, start._replace(mean=np.ones((1, 3)), cov=np.full((1, 1, 3), 0.4))):
        got = make(system, step=0.01).predict(state, 1.2)
        np.testing.assert_allclose(got.mean[0], want[0], rtol=1e-8)
        np.testing.assert_allclose(got.cov[0, 0], want[1], rtol=1e-8)


def test_claimed_covariance_of_a_system_that_depends_on_time():
    """Without jumps the filter is Kalman's: normalised squares lie in the chi-square band."""
    system = JumpDiffusion(
        (x,), [-(1 + t) * x + sympy.cos(3 * t)], [[1 + t]], [(1 + t) * x + t * v],
        Noise((v,), mean=SENSOR, cov=[[LOUD]]), [1.0], [[0.4]], step=0.005,
    )  # fmt: skip
    got = evaluate(extended_kalman(system), system, [0.3, 0.7, 1.0, 1.5], 4000, 1, consistency=True)
    apart = 4 * np.sqrt(2 / 4000)
    assert np.abs(got.nees - 1).max() < apart
    assert np.abs(got.nis - 1).max() < apart
    assert (np.abs(got.bias) < 4 * got.bias_error).all()
