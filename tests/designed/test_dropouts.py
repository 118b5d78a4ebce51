"""Designed filters and measurements that are missing: means go on, claims of accuracy do not."""

import warnings

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.filters import extended_kalman
from seedslib.linearization import ExactGaussian
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, w, v = sympy.symbols("x w v")
TIMES = np.arange(12.0)


@pytest.fixture(scope="module")
def walk():
    return DiscreteSystem(
        StochasticMap([x], [x + w], Noise([w])), StochasticMap([x], [x + v], Noise([v])),
        [0.0], [[1.0]],
    )  # fmt: skip


@pytest.fixture(scope="module", params=["estimates", "measurements"])
def filter(request, walk):
    memory = {"estimates": Memory(1), "measurements": Memory(0, 2)}[request.param]
    return synthesize(walk, memory, ExactGaussian(), TIMES, paths=20_000, seed=1)


def with_gaps(walk, paths=6):
    """Paths 0 and 3 without the measurements at 4 to 6 and at 9."""
    y = walk.simulate(TIMES, paths, 3).measurements.copy()
    y[4:7, :, 0] = np.nan
    y[9, :, 3] = np.nan
    return y


def test_nothing_is_claimed_from_a_gap_on(filter, walk):
    y = with_gaps(walk)
    with pytest.warns(UserWarning, match="2 of 6 records have gaps, from 4 on") as heard:
        found = filter.run(TIMES, y, covariances=True)
    assert len(heard) == 1
    lost = np.zeros((12, 6), dtype=bool)
    lost[4:, 0] = lost[9:, 3] = True
    assert np.array_equal(np.isnan(found.cov[:, 0, 0]), lost)
    after = np.zeros_like(lost)
    after[5:, 0] = after[10:, 3] = True
    assert np.array_equal(np.isnan(found.loglik), after)
    assert found.loglik[4, 0] == 0.0
    # what is left is what it was: the paths do not know each other
    whole = filter.run(TIMES, walk.simulate(TIMES, 6, 3).measurements, covariances=True)
    kept = ~lost
    assert np.array_equal(found.cov[:, 0, 0][kept], whole.cov[:, 0, 0][kept])
    assert np.array_equal(found.mean[:, 0][kept], whole.mean[:, 0][kept])


def test_means_go_on_by_the_recursion_written_out(walk):
    """Z forecast from the memory, corrected where there is a measurement: no covariance needed."""
    filter = synthesize(walk, Memory(1), ExactGaussian(), TIMES, paths=20_000, seed=1)
    y = with_gaps(walk)
    with pytest.warns(UserWarning, match="gaps"):
        found = filter.run(TIMES, y)
    start = filter.start
    z = start.mean[0] + start.moments.cross[0, 0] / start.moments.cov[0, 0] * (
        y[0, 0] - start.moments.mean[0]
    )
    np.testing.assert_allclose(found.mean[0, 0], z, rtol=1e-12)
    for k, fit in enumerate(filter.fits, start=1):
        ahead = fit.gain[0, 0] * z + fit.offset[0]
        gain = fit.cov[0, 0] / (fit.cov[0, 0] + 1.0)
        z = np.where(np.isnan(y[k, 0]), ahead, ahead + gain * (y[k, 0] - ahead))
        np.testing.assert_allclose(found.mean[k, 0], z, rtol=1e-11, atol=1e-12)


def test_what_was_claimed_was_not_what_it_had(walk):
    """After three missing measurements the error is that of a Kalman filter or worse."""
    filter = synthesize(walk, Memory(1), ExactGaussian(), TIMES, paths=20_000, seed=1)
    data = walk.simulate(TIMES, 4000, 5)
    y = data.measurements.copy()
    y[4:7] = np.nan
    with pytest.warns(UserWarning, match="4000 of 4000"):
        found = filter.run(TIMES, y, covariances=True)
    error = (found.mean - data.states)[7, 0]
    right = extended_kalman(walk).run(TIMES, y).cov[7, 0, 0]
    assert error.var() > right.flat[0] * (1 - 4 * np.sqrt(2 / 4000))
    # the law of the design would say this, which is far too little
    assert error.var() > 1.3 * filter.predicted.rms[7, 0] ** 2
    assert np.isnan(found.cov[7]).all()


def test_steps_claim_what_the_run_claims(filter, walk):
    y = with_gaps(walk)
    with pytest.warns(UserWarning, match="gaps"):
        found = filter.run(TIMES, y, covariances=True)
    state, single = filter.initial((6,)), filter.initial()
    for k, t in enumerate(TIMES):
        state, single = filter.step(state, t, y[k]), filter.step(single, t, y[k, :, 0])
        cov = np.broadcast_to(state.cov.reshape(1, 1, -1), (1, 1, 6))
        np.testing.assert_allclose(cov, found.cov[k], rtol=1e-12)
        np.testing.assert_allclose(state.mean, found.mean[k], rtol=1e-12)
        np.testing.assert_allclose(state.loglik, found.loglik[k], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(single.cov, found.cov[k, ..., 0], rtol=1e-12)
        np.testing.assert_allclose(single.loglik, found.loglik[k, 0], rtol=1e-10, atol=1e-12)
    after = filter.predict(filter.step(filter.initial(), 0.0, [np.nan]), 1.0)
    assert np.isnan(filter.expect(after).cov).all()
    assert np.isfinite(filter.expect(after).mean).all()


def test_times_between_measurements_are_no_gaps(walk):
    filter = synthesize(zoo.linear_gaussian(), Memory(1), ExactGaussian(), [0, 1, 2], paths=500,
                        seed=1, nodes=1)  # fmt: skip
    grid = np.arange(5) / 2
    y = filter.system.simulate(grid, 3, 1, measured=[0, 2, 4]).measurements
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = filter.run(grid, y, covariances=True)
    assert np.isfinite(found.cov[::2]).all()
    assert np.isnan(found.cov[1::2]).all()
    assert np.isfinite(found.loglik).all()


def test_tables_claim_nothing_after_a_gap_either():
    flip, times = zoo.flip_process(), np.arange(4) * 0.25
    axes = {"x": (-3.5, 3.5, 71), "z": (-3, 3, 61), "y": (-8, 8, 61)}
    table = grid_synthesis(flip, Memory(1), times, **axes)
    y = flip.simulate(times, 4, 1).measurements.copy()
    y[1, :, 2] = np.nan
    with pytest.warns(UserWarning, match=r"1 of 4 records have gaps, from 0\.25 on"):
        found = table.run(times, y, covariances=True)
    assert np.array_equal(np.isnan(found.cov[:, 0, 0]).sum(axis=1), [0, 1, 1, 1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert table.run(times, y).cov is None  # nothing is claimed, so nothing is wrong
    state = table.initial((4,))
    for k, t in enumerate(times):
        state = table.step(state, t, y[k])
        cov = np.broadcast_to(state.cov.reshape(1, 1, -1), (1, 1, 4))
        np.testing.assert_array_equal(cov, found.cov[k])


@pytest.mark.parametrize("missing", ["measurement", "indicator"])
def test_a_switching_filter_with_a_memory_knows_the_law_of_its_design_only(missing):
    system, times = zoo.manoeuvring_target("noisy"), np.arange(6.0)
    data = system.simulate(times, 5, 3)
    y, shown = data.measurements.copy(), data.indicators.copy()
    if missing == "measurement":
        y[2, :, 1] = np.nan
    else:
        shown[2, 1] = -1
    made = synthesize(system, Memory(1), ExactGaussian(), times, paths=4000, seed=1)
    with pytest.warns(UserWarning, match="1 of 5 records have gaps, from 2 on"):
        found = made.run(times, y, indicators=shown, covariances=True)
    lost = np.zeros((6, 5), dtype=bool)
    lost[2:, 1] = True
    assert np.array_equal(np.isnan(found.cov).all(axis=(1, 2)), lost)
    assert np.array_equal(np.isnan(found.cov).any(axis=(1, 2)), lost)
    assert np.array_equal(np.isnan(found.loglik).sum(axis=1), [0, 0, 0, 1, 1, 1])
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.mode_prob).all()
    state = made.initial((5,))
    for k, t in enumerate(times):
        if k == 4:
            assert np.isnan(made.forecast(state, t).cov).any(axis=(0, 1)).tolist() == [
                False, True, False, False, False,
            ]  # fmt: skip
        state = made.step(state, t, y[k], shown[k])
        np.testing.assert_allclose(state.mean, found.mean[k], rtol=1e-12)
        np.testing.assert_allclose(state.loglik, found.loglik[k], rtol=1e-12, atol=1e-12)
        assert np.array_equal(np.isnan(state.law.cov).reshape(-1, 5).any(axis=0), lost[k])
    # the laws of all modes know what they have seen
    bank = SwitchingFilter(system, ExactGaussian())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isfinite(bank.run(times, y, indicators=shown, covariances=True).cov).all()
