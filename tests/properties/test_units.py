"""Units do not matter: from 1e-150 to 1e150, for each component of state and measurement."""

import warnings

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from seedslib.delay import DelaySystem
from seedslib.design import synthesize
from seedslib.designed import SwitchingFilter, large_order
from seedslib.export import compiled
from seedslib.filters import (
    GridBayesFilter,
    KalmanFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
)
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap, SwitchingSystem
from seedslib.two_step import LinearDiffusion

x1, x2, v1, v2, w1, w2 = sp.symbols("x1 x2 v1 v2 w1 w2", real=True)
F, Q = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.3, 0.1], [0.1, 0.2]])
H, R = np.array([[1.0, 0.5], [0.0, 1.0]]), np.array([[0.4, 0.1], [0.1, 0.3]])
MEAN, COV = np.array([0.3, -0.2]), np.array([[1.0, 0.3], [0.3, 2.0]])
TIMES = np.arange(6.0)
Y = np.random.default_rng(0).standard_normal((6, 2))
Y[0] = Y[3, 1] = Y[4] = np.nan
ONE = np.ones(2)
POWERS = st.tuples(*[st.integers(-150, 150)] * 4)


def turned(c, matrix, d):
    return c[:, None] * np.asarray(matrix) * d


def linear(c, d, **diffuse):
    cov = np.zeros((2, 2)) if diffuse else turned(c, COV, c)
    return KalmanFilter(
        LinearSystem(
            turned(c, F, 1 / c),
            turned(c, Q, c),
            turned(d, H, 1 / c),
            turned(d, R, d),
            c * MEAN,
            cov,
            **diffuse,
        )
    )


def late(c, d):
    near, far = (turned(c, part * F, 1 / c) for part in (0.6, 0.3))
    sensor, noises = turned(d, H, 1 / c), (turned(c, Q, c), turned(d, R, d))
    system = DelaySystem({0: near, 2: far}, sensor, *noises, turned(c, COV, c), mean0=c * MEAN)
    return KalmanFilter(system.stacked())


def bent(c, d):
    """A system whose powers and waves are written in other units."""
    z = x1 / sp.Float(c[0]), x2 / sp.Float(c[1])
    f = [
        sp.Float(c[0]) * (0.9 * z[0] + 0.3 * sp.sin(z[1])) + v1,
        sp.Float(c[1]) * (0.8 * z[1] - z[0] ** 2 / 40) + v2,
    ]
    h = [sp.Float(d[0]) * (z[0] + z[1] ** 2 / 8) + w1, sp.Float(d[1]) * z[1] + w2]
    return DiscreteSystem(
        StochasticMap((x1, x2), f, Noise((v1, v2), cov=turned(c, Q, c))),
        StochasticMap((x1, x2), h, Noise((w1, w2), cov=turned(d, R, d))),
        c * MEAN,
        turned(c, COV, c),
    )


def modes(c, d):
    z = x1 / sp.Float(c[0])
    return SwitchingSystem(
        (x1,),
        [[sp.Float(c[0]) * (a * z + b) + v1] for a, b in ((0.9, 0), (0.5, 1))],
        Noise((v1,), cov=[[0.3 * c[0] ** 2]]),
        [[0.9, 0.1], [0.2, 0.8]],
        [[sp.Float(d[0]) * z + w1]] * 2,
        Noise((w1,), cov=[[0.4 * d[0] ** 2]]),
        [(0.6, [0.3 * c[0]], [[c[0] ** 2]]), (0.4, [-c[0]], [[2 * c[0] ** 2]])],
    )


def designed(c, d, system=None):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        system = bent(c, d) if system is None else system
        return synthesize(system, large_order(1), Taylor(), TIMES, paths=200, seed=1, nodes=0)


def run(filter, d):
    options = {"covariances": True} if "covariances" in filter.takes else {}
    m = filter.system.measurement_size
    return filter.run(TIMES, Y[:, :m] * d[:m], **options)


def agree(found, wanted, c, d, shift=0.0):
    """The same numbers in other units."""
    n = wanted.mean.shape[1]
    c = c[:n]
    seen = np.isfinite(Y[:, : 1 if n == 1 else 2])
    density = (seen * np.log(d[: seen.shape[1]])).sum(axis=1)
    density[np.flatnonzero(seen.any(axis=1))[0]] -= shift
    mean, cov = found.mean / c, found.cov / c[:, None] / c
    for one, other in ((mean, wanted.mean), (cov, wanted.cov)):
        np.testing.assert_array_equal(np.isfinite(one), np.isfinite(other))
        kept = np.isfinite(other)
        np.testing.assert_allclose(one[kept], other[kept], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(found.loglik + density, wanted.loglik, rtol=1e-9, atol=1e-9)
    assert not found.diverged


def units(powers):
    c = 10.0 ** np.array(powers)
    return c[:2], c[2:]


@pytest.mark.parametrize("diffuse", [(), (0,), (1,), (0, 1)])
@given(powers=POWERS)
def test_kalman(diffuse, powers):
    c, d = units(powers)
    options = {"diffuse": diffuse} if diffuse else {}
    shift = np.log(c[list(diffuse)]).sum()
    one, other = run(linear(c, d, **options), d), run(linear(ONE, ONE, **options), ONE)
    agree(one, other, c, d, shift)


@given(powers=POWERS)
def test_delays(powers):
    c, d = units(powers)
    one, other = (late(*u).run(TIMES, Y * u[1]) for u in ((c, d), (ONE, ONE)))
    c = np.tile(c, 3)
    np.testing.assert_allclose(one.mean / c, other.mean, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(one.cov / c[:, None] / c, other.cov, rtol=1e-9, atol=1e-10)


@given(powers=POWERS)
def test_kalman_bucy(powers):
    c, d = units(powers)

    def moments(c, d):
        drift, noise = turned(c, F - 1.2 * np.eye(2), 1 / c), turned(c, Q, c)
        sensor, sensor_noise = turned(d, H, 1 / c), turned(d, R, d)
        start = c * MEAN, turned(c, COV, c)
        return LinearDiffusion(drift, noise, sensor, sensor_noise, *start).moments([0.0, 0.5, 5.0])

    one, other = moments(c, d), moments(ONE, ONE)
    np.testing.assert_allclose(one.mean / c, other.mean, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(one.error_cov / c[:, None] / c, other.error_cov, rtol=1e-9)


@pytest.mark.parametrize("unit", [1e-150, 1e-90, 1e90])
@pytest.mark.parametrize(
    "make",
    [
        lambda c, d: extended_kalman(bent(c, d)),
        lambda c, d: cubature_kalman(bent(c, d)),
        lambda c, d: SwitchingFilter(modes(c, d), Taylor()),
        lambda c, d: GridBayesFilter(modes(c, d), (-8 * c[0], 8 * c[0], 81)),
    ],
)
def test_systems_with_powers(make, unit):
    c = d = unit * ONE
    agree(run(make(c, d), d), run(make(ONE, ONE), ONE), c, d)


def test_in_c():
    c = d = 1e-150 * ONE
    agree(
        run(compiled(extended_kalman(bent(c, d))), d),
        run(extended_kalman(bent(ONE, ONE)), ONE),
        c,
        d,
    )


@pytest.mark.parametrize("unit", [1e-150, 1e-90, 1e90])
def test_designs(unit):
    """Records without gaps, which are corrected by one line of code in ordinary units."""
    y = np.where(np.isnan(Y), 0.5, Y)
    c = unit * ONE
    wanted, found = (designed(u, u).run(TIMES, y * u, covariances=True) for u in (ONE, c))
    np.testing.assert_allclose(found.mean / unit, wanted.mean, rtol=1e-9)
    np.testing.assert_allclose(found.cov / unit / unit, wanted.cov, rtol=1e-9)
    shift = 2 * np.log(unit)
    np.testing.assert_allclose(found.loglik + shift, wanted.loglik, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("make", "unit", "message"),
    [
        (extended_kalman, [1e140, 1e-90], "range of float64"),
    ],
)
def test_what_is_no_number_is_refused(make, unit, message):
    c = np.array(unit)
    with pytest.raises(ValueError, match=message):
        make(bent(c, c))


def test_moments_that_are_too_large_are_flagged():
    c = 1e100 * ONE
    found = run(assumed_density(bent(c, c)), c)
    assert found.diverged
