"""Designs that know what may be missing: classes of histories, written out record by record."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal

from oracles.linear import corrected
from seedslib.design import Polynomial, synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

pytestmark = pytest.mark.filterwarnings("ignore:availability", "ignore:paths. .* too few paths")
x, y, v, w, p, q, r = sympy.symbols("x y v w p q r", real=True)
TIMES = np.arange(4.0)
RATES = np.array([0.6, 1.0, 0.3])
MOVE, SHIFT, SPREAD = np.array([[0.9, 0.3], [-0.2, 0.8]]), [0.1, 0.0], np.diag([0.05, 0.4])
LOOK, NOISE = np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 2.0]]), np.diag([0.5, 0.2, 0.9])


def pair():
    moved = [0.9 * x + 0.3 * y + 0.1 + v, -0.2 * x + 0.8 * y + w]
    shown = [x + p, y + 0.5 * x + q, 2 * y + r]
    return DiscreteSystem(
        StochasticMap([x, y], moved, Noise((v, w), cov=SPREAD)),
        StochasticMap([x, y], shown, Noise((p, q, r), cov=NOISE)),
        [0.2, -0.3],
        [[1.0, 0.2], [0.2, 0.7]],
    )


def record(paths, steps, size=3, rates=RATES, seed=2):
    rng = np.random.default_rng(seed)
    shown = rng.normal(size=(steps, size, paths))
    shown[rng.random(shown.shape) > np.array(rates)[:size, None]] = np.nan
    return shown


@pytest.fixture(scope="module")
def linear():
    return synthesize(
        pair(), Memory(1), Taylor(), TIMES, paths=400, seed=1, availability=RATES.tolist()
    )


def test_run_of_a_linear_system_is_its_classes_written_out(linear):
    """The class of a record is a table of the one before it and the pattern of what arrived."""
    filter, times, shown = linear, TIMES, record(12, 4)
    found = filter.run(times, shown, covariances=True)
    for path in range(12):
        group = 0
        state = filter.step(filter.initial(), 0.0, shown[0, :, path])
        for k, fit in enumerate(linear.fits, start=1):
            here = ~np.isnan(shown[k - 1, :, path])
            number = int(here[0]) + 2 * int(here[2])
            group = fit.table[group, number]
            mean = fit.fits.gain[group] @ found.mean[k - 1, :, path] + fit.fits.offset[group]
            mean, cov, loglik = corrected(
                mean, fit.fits.cov[group], shown[k, :, path], LOOK, np.zeros(3), NOISE
            )
            assert_allclose(found.mean[k, :, path], mean, rtol=1e-9, atol=1e-12)
            assert_allclose(found.cov[k, :, :, path], cov, rtol=1e-9, atol=1e-12)
            assert_allclose(found.loglik[k, path], loglik, rtol=1e-9, atol=1e-11)
            state = filter.step(state, times[k], shown[k, :, path])
            assert_allclose(state.mean, mean, rtol=1e-9, atol=1e-12)
            assert_allclose(state.cov, cov, rtol=1e-9, atol=1e-12)
    alone = filter.run(times, shown[..., 3], covariances=True)
    assert_allclose(alone.cov, found.cov[..., 3], rtol=1e-9, atol=1e-12)
    plane = filter.run(times, shown.reshape(-1, 3, 4, 3))
    assert_allclose(plane.mean.reshape(found.mean.shape), found.mean, rtol=1e-12)


def test_classes_of_polynomial_forecasts_and_their_mean_covariance():
    """Covariances depend on the memory and on the class."""
    filter = synthesize(
        pair(),
        Memory(1),
        ExactGaussian(),
        TIMES,
        predictor=Polynomial(2, 1),
        paths=600,
        seed=1,
        availability=RATES,
    )
    shown = record(6, 4)
    state, group = filter.initial((6,)), np.zeros(6, dtype=int)
    for k in range(3):
        state = filter.step(state, TIMES[k], shown[k])
        here = ~np.isnan(shown[k])
        fit, group = filter.fits[k], filter.fits[k].table[group, here[0] + 2 * here[2]]
        assert_array_equal(state.history, group)
        ahead = filter.predict(state, TIMES[k + 1])
        for path in range(6):
            one = fit.one(group[path])
            mean, cov = one.forecast(state.mean[:, path : path + 1])
            assert_allclose(ahead.mean[:, path], mean[:, 0], rtol=1e-12)
            assert_allclose(ahead.cov[..., path], cov[..., 0], rtol=1e-12)
        weighed = sum(share * fit.one(c).cov for c, share in enumerate(fit.prob))
        assert_allclose(fit.cov, weighed, rtol=1e-12)


def test_what_is_sure_and_missing_is_a_gap(linear):
    """What may be missing is none; from the gap on nothing is claimed, means go on."""
    shown = record(5, 4)
    shown[2, 1, 3] = np.nan
    with pytest.warns(UserWarning, match="1 of 5 records have gaps, from 2 on"):
        found = linear.run(TIMES, shown, covariances=True)
    assert np.isfinite(found.mean).all()
    lost = np.isnan(found.cov).any(axis=(1, 2))
    assert_array_equal(np.argwhere(lost), [[2, 3], [3, 3]])
    assert_array_equal(np.argwhere(np.isnan(found.loglik)), [[3, 3]])
    state = linear.initial((5,))
    for k, now in enumerate(TIMES):
        state = linear.step(state, now, shown[k])
        assert_allclose(state.loglik, found.loglik[k], rtol=1e-9, atol=1e-12)
        cov = np.broadcast_to(state.cov.reshape(2, 2, -1), (2, 2, 5))
        assert_allclose(cov, found.cov[k], rtol=1e-9)


# Modes

CHAIN, TELLS = np.array([[0.9, 0.1], [0.3, 0.7]]), np.array([[0.8, 0.2], [0.3, 0.7]])


def modes():
    moved = [[0.9 * x + 0.3 * y + v, -0.2 * x + 0.8 * y + w], [x / 2 + 2 * v, y / 3 + 1 + w]]
    return SwitchingSystem(
        (x, y),
        moved,
        Noise((v, w), cov=SPREAD),
        CHAIN.tolist(),
        [[x + p, x / 2 + y + q], [x + 2 * p, y + q]],
        Noise((p, q), cov=NOISE[:2, :2]),
        [(0.6, [0.2, -0.3], np.eye(2)), (0.4, [-1, 0.5], [[0.5, 0.1], [0.1, 2]])],
        indicator=TELLS.tolist(),
    )


def test_missing_indicator_is_a_gap_for_a_memory_and_none_for_a_bank():
    shown = np.random.default_rng(3).normal(size=(4, 2, 5))
    told = np.random.default_rng(4).integers(0, 2, (4, 5))
    told[1, 2] = -1
    made = synthesize(modes(), Memory(1), Taylor(), TIMES, paths=4000, seed=1)
    with pytest.warns(UserWarning, match="1 of 5 records have gaps, from 1 on"):
        found = made.run(TIMES, shown, indicators=told, covariances=True)
    lost = np.isnan(found.cov).all(axis=(1, 2))
    assert_array_equal(np.argwhere(lost), [[1, 2], [2, 2], [3, 2]])
    assert_array_equal(np.argwhere(np.isnan(found.loglik)), [[2, 2], [3, 2]])
    assert np.isfinite(found.mean).all()
    state = made.initial((5,))
    for k, now in enumerate(TIMES):
        if k:
            claims = np.isnan(made.forecast(state, now).cov).any(axis=(0, 1))
            assert_array_equal(claims, lost[k - 1])
        state = made.step(state, now, shown[k], told[k])
        assert_allclose(state.loglik, found.loglik[k], rtol=1e-11)
        assert_allclose(made.report(state).cov, found.cov[k], rtol=1e-11)
    plain = SwitchingFilter(modes(), Taylor()).run(TIMES, shown, indicators=told, covariances=True)
    assert np.isfinite(plain.cov).all()
    assert np.isfinite(plain.loglik).all()
