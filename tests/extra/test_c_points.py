"""Filters with sigma points in C against the same filters in Python."""

import math

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Continuous, synthesize
from seedslib.designed import Memory
from seedslib.filters import CovarianceFilter, cubature_kalman, unscented_kalman
from seedslib.linearization import Cubature, GaussHermite, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap

TIMES = 0.5 * np.arange(9.0)

a, b, c, d, p, q, r, t = sympy.symbols("a b c d p q r t", real=True)
x1, x2, v1, v2 = sympy.symbols("x1 x2 v1 v2", real=True)


def target(bent=False):
    """A turning target, four numbers, seen by range and bearing across the cut of the angle."""
    moves = [a + c, b + d, sympy.cos(0.1) * c - sympy.sin(d / 9) + p, 0.99 * d + q]
    noise = sympy.exp(r / 9) - 1 if bent else r * (1 + a**2 / 400)
    shows = [sympy.sqrt(a**2 + b**2) + v1, sympy.atan2(b, a) + noise]
    return DiscreteSystem(
        StochasticMap([a, b, c, d], moves, Noise((p, q), cov=0.01 * np.eye(2))),
        StochasticMap([a, b, c, d], shows, Noise((v1, r), cov=[[0.1, 0], [0, 4e-4]]),
                      period={1: 2 * math.pi}),
        [-8.0, 1.0, 0.2, -0.4], np.diag([1.0, 1.0, 0.1, 0.1]),
    )  # fmt: skip


def growing():
    """Two numbers in discrete time, with noise inside of the dynamics and a time in both maps."""
    moves = [x1 + 0.1 * x2 * v1, 0.9 * x2 + sympy.cos(t) + v2]
    return DiscreteSystem(
        StochasticMap((x1, x2), moves, Noise((v1, v2), cov=0.1 * np.eye(2)), time=t),
        StochasticMap((x1, x2), [x1**2 / 20 + t + r], Noise((r,)), time=t),
        [1.0, 0.5], 0.3 * np.eye(2),
    )  # fmt: skip


def exactly():
    """A number that is seen without noise, beside one that is not: variances become zero."""
    return DiscreteSystem(
        StochasticMap((x1, x2), [x1, 0.5 * x2 + v1], Noise((v1,))),
        StochasticMap((x1, x2), [x1, x2 + v2], Noise((v2,))),
        [1.0, 0.5], np.eye(2),
    )  # fmt: skip


FILTERS = {
    "unscented": lambda: unscented_kalman(target()),
    "unscented, another spread": lambda: unscented_kalman(target(), alpha=0.6, beta=2.0, kappa=1.0),
    "cubature": lambda: cubature_kalman(target()),
    "Gauss-Hermite": lambda: CovarianceFilter(growing(), GaussHermite(4)),
    "points that cover the noise": lambda: unscented_kalman(target(bent=True)),
    "known exactly": lambda: unscented_kalman(exactly()),
    "continuous": lambda: unscented_kalman(zoo.van_der_pol(), step=0.05),
    "continuous, Euler": lambda: cubature_kalman(zoo.van_der_pol(), integrator="euler", step=0.01),
    "Gauss-Hermite in loops": lambda: CovarianceFilter(target(), GaussHermite(3)),
    "continuous, jumps": lambda: CovarianceFilter(zoo.kicked_duffing(), GaussHermite(3), step=0.1),
}  # fmt: skip


def near(found, wanted, part=1e-10):
    lost = ~np.isfinite(wanted)
    assert np.array_equal(lost, ~np.isfinite(found))
    apart = np.abs(np.where(lost, 0.0, found - wanted))
    assert apart.max() <= part * np.abs(np.where(lost, 0.0, wanted)).max(), apart.max()


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.filterwarnings("ignore:cov0:UserWarning")
def test_sigma_points(name, compiled):
    filter = FILTERS[name]()
    y = filter.system.simulate(TIMES, 60, 2).measurements
    rng = np.random.default_rng(0)
    y[rng.random(y.shape) < 0.1] = np.nan
    wanted = filter.run(TIMES, y)
    assert np.isfinite(wanted.mean).all()
    mean, cov, loglik, _ = compiled(filter).run(TIMES, y)
    near(mean, wanted.mean)
    near(cov, wanted.cov if wanted.cov.ndim == 4 else wanted.cov[..., None] * np.ones(60))
    if name != "known exactly":  # there a density is that of what rounding has left
        near(loglik, wanted.loglik)


def test_the_linear_case_is_the_kalman_filter(compiled):
    """By a recursion written out by hand: points are exact on a line."""
    move, see = np.array([[1.0, 0.5], [0.0, 0.9]]), np.array([[1.0, 0.0]])
    system = DiscreteSystem(
        StochasticMap((x1, x2), [x1 + 0.5 * x2, 0.9 * x2 + v1], Noise((v1,), cov=[[0.2]])),
        StochasticMap((x1, x2), [x1 + r], Noise((r,), cov=[[0.3]])), [1.0, -1.0], np.eye(2),
    )  # fmt: skip
    y = system.simulate(np.arange(30.0), 1, 1).measurements
    mean, cov, loglik, _ = compiled(cubature_kalman(system)).run(np.arange(30.0), y)
    m, pp = np.array([1.0, -1.0]), np.eye(2)
    for k in range(30):
        if k:
            m, pp = move @ m, move @ pp @ move.T + np.diag([0.0, 0.2])
        s = (see @ pp @ see.T).item() + 0.3
        e, gain = y[k, 0, 0] - m[0], pp @ see[0] / s
        m, pp = m + gain * e, pp - np.outer(gain, gain) * s
        np.testing.assert_allclose(mean[k, :, 0], m, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(cov[k, ..., 0], pp, rtol=1e-11, atol=1e-12)
        density = -0.5 * (e * e / s + math.log(2 * math.pi * s))
        np.testing.assert_allclose(loglik[k, 0], density, rtol=1e-11)


@pytest.mark.parametrize("rule", [Unscented(), Cubature(), GaussHermite(3)])
@pytest.mark.parametrize("predictor", [None, Continuous()])
def test_designs_with_points(rule, predictor, compiled):
    options = {} if predictor is None else {"predictor": predictor, "step": 0.05}
    system = zoo.van_der_pol()
    filter = synthesize(system, Memory(1), rule, TIMES, paths=500, seed=1, **options)
    y = system.simulate(TIMES, 40, 3).measurements
    wanted = filter.run(TIMES, y, covariances=True)
    mean, cov, loglik, _ = compiled(filter).run(TIMES, y)
    near(mean, wanted.mean)
    near(cov, wanted.cov)
    near(loglik, wanted.loglik)
