"""Exact sensors, states known exactly, and priors wider than the digits of a number."""

import warnings

import numpy as np
import pytest
import sympy

from seedslib.base import correct
from seedslib.designed import SwitchingFilter
from seedslib.filters import (
    CovarianceFilter,
    KnownModeFilter,
    RaoBlackwellFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.linearization import Cubature, GaussHermite, Moments, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)
FILTERS = [
    extended_kalman, assumed_density, unscented_kalman, cubature_kalman,
    lambda system: unscented_kalman(system, alpha=0.5, beta=2.0),
    lambda system: CovarianceFilter(system, GaussHermite(5)),
]  # fmt: skip


def linear(transition, noise, sensor, error, mean0, cov0):
    """x' = A x + noise, y = C x + error, all in numbers; zero covariances are no noise."""
    n, m = len(transition), len(sensor)
    state, vs, ws = (sympy.symbols(f"{name}:{k}") for name, k in zip("xvw", (n, n, m), strict=True))

    def map(rows, symbols, cov):
        value = [sum(a * b for a, b in zip(row, state, strict=True)) for row in rows]
        if not np.any(cov):
            return StochasticMap(state, value, Noise())
        return StochasticMap(
            state, [a + b for a, b in zip(value, symbols, strict=True)], Noise(symbols, cov=cov)
        )

    return DiscreteSystem(map(transition, vs, noise), map(sensor, ws, error), mean0, cov0)


@pytest.mark.parametrize("make", FILTERS)
def test_an_exact_sensor(make):
    system = linear([[0.8]], [[0.5]], [[1.0]], [[0.0]], [0.3], [[1.7]])
    y = np.random.default_rng(0).standard_normal((40, 1))
    found = make(system).run(np.arange(40.0), y)
    np.testing.assert_allclose(found.mean, y, rtol=1e-12)
    assert (np.abs(found.cov) < 1e-14).all()


@pytest.mark.parametrize("make", FILTERS)
def test_an_exact_sensor_of_a_sum(make):
    """Three correlated states of which a sum is known exactly, in other units each."""
    rng, units = np.random.default_rng(1), np.array([1.0, 1e3, 1e-3])
    a = 0.5 * rng.standard_normal((3, 3)) * units[:, None] / units
    root = rng.standard_normal((3, 3))
    cov = root @ root.T * np.outer(units, units)
    row = rng.standard_normal((1, 3)) / units
    system = linear(a, 0.1 * cov, row, [[0.0]], [0, 0, 0], cov)
    y = rng.standard_normal((25, 1))
    found = make(system).run(np.arange(25.0), y)
    assert not found.diverged
    np.testing.assert_allclose(found.mean @ row[0], y[:, 0], atol=1e-9)
    np.testing.assert_allclose(row[0] @ found.cov @ row[0], 0, atol=1e-11)


@pytest.mark.parametrize("size", [1, 2, 4, 5])
@pytest.mark.parametrize("make", FILTERS[:4])
def test_a_state_that_is_known_exactly(make, size):
    rng = np.random.default_rng(size)
    a, start = rng.standard_normal((size, size)) / size, rng.standard_normal(size)
    none = np.zeros((size, size))
    system = linear(a, none, np.ones((1, size)), [[1.0]], start, none)
    found = make(system).run(np.arange(30.0), rng.standard_normal((30, 1)))
    wanted = [np.linalg.matrix_power(a, k) @ start for k in range(30)]
    np.testing.assert_allclose(found.mean, wanted, rtol=1e-9, atol=1e-15)
    assert (found.cov == 0).all()


@pytest.mark.parametrize("make", FILTERS[:4])
def test_an_exact_sensor_in_continuous_time(make):
    system = JumpDiffusion((x,), [-x], [[1]], [x], Noise(), [0.0], [[1.0]], step=0.01)
    y = np.array([[0.3], [-0.2], [0.5]])
    found = make(system).run(np.arange(3.0), y)
    np.testing.assert_allclose(found.mean, y, rtol=1e-12)


@pytest.mark.parametrize("make", FILTERS)
@pytest.mark.parametrize("prior", [1e4, 1e8, 1e12, 1e20])
def test_a_diffuse_prior(make, prior):
    """A constant, measured three times: 1 / P = 1 / P0 + k / R."""
    system = linear([[1.0]], [[0.0]], [[1.0]], [[1e-8]], [0.0], [[prior]])
    found = make(system).run(np.arange(3.0), [[5.0], [6.0], [7.0]])
    k = np.arange(1.0, 4.0)
    np.testing.assert_allclose(found.cov[:, 0, 0], 1 / (1 / prior + k / 1e-8), rtol=1e-7)
    np.testing.assert_allclose(found.mean[:, 0], [5.0, 5.5, 6.0], rtol=1e-6)


def test_a_diffuse_prior_of_several_states_and_measurements():
    """Against P - P C S⁻¹ C P in sixty digits; one direction is not measured."""
    import mpmath

    rng = np.random.default_rng(4)
    root = rng.standard_normal((3, 3))
    cov = 1e12 * (root @ root.T)
    sensor, noise = rng.standard_normal((2, 3)), 1e-6 * np.array([[2.0, 0.7], [0.7, 1.0]])
    moments = Moments(np.zeros(2), cov @ sensor.T, sensor @ cov @ sensor.T + noise)
    y = rng.standard_normal(2)
    _, found, _ = correct(np.zeros(3), cov, y, moments, noise=lambda: noise)
    with mpmath.workdps(60):
        p, c, r = (mpmath.matrix(part.tolist()) for part in (cov, sensor, noise))
        wanted = p - p * c.T * (c * p * c.T + r) ** -1 * c * p
        seen = c * wanted * c.T
        wanted, seen = (np.array(part.tolist(), dtype=float) for part in (wanted, seen))
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    # the measured directions, 24 powers of ten below the prior, to what the entries can hold
    np.testing.assert_allclose(sensor @ found @ sensor.T, seen, atol=1e-15 * np.abs(found).max())


def test_missing_parts_and_many_paths():
    system = linear(
        np.eye(2), np.zeros((2, 2)), np.eye(2), 1e-8 * np.eye(2), [0, 0], 1e12 * np.eye(2)
    )
    y = np.zeros((2, 2, 3))
    y[0, :, 0], y[0, :, 1], y[0, :, 2] = [1, np.nan], [np.nan, 2], [3, 4]
    y[1] += 5
    found = extended_kalman(system).run([0.0, 1.0], y)
    counts = np.array([[2, 1, 2], [1, 2, 2]])
    variances = np.einsum("iin->in", found.cov[1])
    np.testing.assert_allclose(variances, 1e-8 / counts, rtol=1e-7)


def test_switching_filters_hear_after_a_diffuse_prior():
    system = SwitchingSystem(
        (x,), [[x]] * 2, Noise((v,)), [[1, 0], [0, 1]], [[x + w], [x + 2 * w]],
        Noise((w,), cov=[[1e-8]]), [(0.5, [0], [[1e10]])] * 2,
    )  # fmt: skip
    y = np.array([[5.0], [6.0], [7.0]])
    for filter in (
        SwitchingFilter(system, Taylor()), SwitchingFilter(system, Cubature()),
        RaoBlackwellFilter(system),
    ):  # fmt: skip
        found = filter.run(np.arange(3.0), y)
        np.testing.assert_allclose(found.mean[:, 0], [5, 5.5, 6], rtol=1e-7)
    known = KnownModeFilter(system).run(np.arange(3.0), y, modes=np.ones(3, int))
    np.testing.assert_allclose(known.cov[:, 0, 0], 4e-8 / np.arange(1.0, 4.0), rtol=1e-7)


def test_lost_digits_that_cannot_be_found_are_said():
    """A prior of 1e30 on a bent sensor: what is not slope cannot be told from the noise."""
    cov, noise = np.array([[1e30]]), np.array([[1e-8]])
    bent = Moments(np.zeros(1), cov, cov * (1 + 2e-13))
    with pytest.warns(UserWarning, match="variance of x1 fell below 1e-12"):
        correct(np.zeros(1), cov, np.ones(1), bent, noise=lambda: noise)
    exact = Moments(np.zeros(1), cov, cov)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        correct(np.zeros(1), cov, np.ones(1), exact, noise=lambda: np.zeros((1, 1)))
