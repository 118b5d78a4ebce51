"""States of many data sets: estimates that are followed, merging, what is missing in some."""

import numpy as np
import pytest
from scipy.stats import norm

from oracles import piecewise_routes as routes
from seedslib.piecewise import PiecewiseLinearFilter, examples
from seedslib.piecewise.merging import merge


@pytest.mark.parametrize(
    "system", [routes.wave(6, support="estimate"), examples.falling_body(5, support="estimate")]
)
def test_estimates_are_followed_data_set_by_data_set(system):
    filter_ = PiecewiseLinearFilter(system)
    y = system.simulate(3, 4, 1).measurements
    table = filter_.run(3, y.reshape(4, 1, 2, 2))
    for n in range(4):
        alone = filter_.run(3, y[..., n])
        i, j = divmod(n, 2)
        np.testing.assert_allclose(table.mean[..., i, j], alone.mean, rtol=1e-11, atol=1e-13)
        np.testing.assert_allclose(table.cov[..., i, j], alone.cov, rtol=1e-9, atol=1e-20)
        np.testing.assert_allclose(table.loglik[..., i, j], alone.loglik, rtol=1e-11, atol=1e-13)


def test_the_distance_of_a_state_grows_by_what_its_merging_added():
    system = routes.tent()
    y = system.simulate(5, 4, 6).measurements.reshape(6, 1, 2, 2)
    merged, whole = PiecewiseLinearFilter(system, merge=0.3), PiecewiseLinearFilter(system)
    state = merged.predict(merged.initial((2, 2)), 0.0)
    for k in range(1, 6):
        full, state_before = whole.step(state, k, y[k]), state
        state = merged.step(state, k, y[k])
        with np.errstate(divide="ignore"):
            log_weight = np.log(full.weights.reshape(-1, 4))
        branches, weight, added = merge(full.branches, log_weight, 0.3)
        wanted = state_before.distance + added.reshape(2, 2)
        np.testing.assert_allclose(state.distance, wanted, rtol=1e-9, atol=1e-12)
        assert state.weights.shape == (len(branches.cell), 2, 2)
        np.testing.assert_allclose(
            state.weights, np.exp(weight).reshape(-1, 2, 2), rtol=1e-9, atol=1e-14
        )
        # what is reported is that of the law before merging
        np.testing.assert_allclose(state.mean, full.mean, rtol=1e-13)
        np.testing.assert_allclose(state.mode_prob, full.mode_prob, rtol=1e-13, atol=1e-300)
    assert (state.distance > 0.0).all()
    assert not state.lost.any()


def test_the_lost_mass_of_data_sets_that_miss_a_measurement():
    """It grows by the neglected share; the peak of the likelihood is one where nothing is seen."""
    system = routes.tent(sensor_noise=[[0.6]])
    y = np.array([[[np.nan] * 3], [[0.3, np.nan, 0.8]], [[np.nan] * 3], [[np.nan, 0.2, 0.4]]])
    filter_ = PiecewiseLinearFilter(system, keep=1000, neglect=1e-3)
    lost = np.zeros(3)
    for state, now in zip(filter_.states(3, y), y[:, 0], strict=True):
        peak = np.where(np.isnan(now), 1.0, norm(0, 0.6).pdf(0))
        lost = (lost * peak / np.exp(state.loglik) + 1e-3) / (1 - 1e-3)
        np.testing.assert_allclose(state.lost, lost, rtol=1e-12)
