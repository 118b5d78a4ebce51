"""Nodes, horizons and states of finite-order filters: where they begin, and what lies at an end."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from seedslib import zoo
from seedslib.design import Continuous, stationary, synthesize
from seedslib.designed import Memory
from seedslib.designed.memory import Past
from seedslib.linearization import Taylor

TIMES = np.arange(3.0)
Y = np.random.default_rng(3).normal(size=(5, 1, 4))


def design(memory=None, times=TIMES, **options):
    return synthesize(
        zoo.linear_gaussian(), memory or Memory(1), Taylor(), times, paths=300, seed=1, step=0.25,
        **options,
    )  # fmt: skip


def stepped(filter, count, y=Y, batch=True):
    state = filter.initial((4,) if batch else ())
    for t, shown in zip(filter.times[:count], y if batch else y[..., 0], strict=False):
        state = filter.step(state, t, shown)
    return state


@pytest.mark.parametrize("options", [{"nodes": 0}, {"nodes": 2}, {"predictor": Continuous()}])
def test_without_a_horizon_the_last_estimate_is_the_end(options):
    filter = design(**options)
    state = stepped(filter, 3)
    assert filter.horizon == filter.reach[1] == 2.0
    assert filter.reach[0] == 0.0
    times, values, end = filter.nodes(state)
    assert times == [2.0]
    assert values == [state.mean]
    assert end is None
    for kind in ("interpolated", "piecewise constant", "constant"):
        assert_array_equal(filter.forecast(state, 2.0, kind).mean, state.mean)
    with pytest.raises(ValueError, match=r"^t: wanted a time from 2 to 2, got 2\.25$"):
        filter.forecast(state, 2.25)


@pytest.mark.parametrize("predictor", [None, Continuous()])
def test_a_horizon_of_one_node(predictor):
    """The last forecast is that of the horizon itself, alone and in a batch."""
    options = {"nodes": 0} if predictor is None else {"predictor": predictor}
    filter = design(horizon=2.25, **options)
    assert filter.node_times[2].tolist() == [2.25]
    assert filter.horizon == filter.reach[1] == 2.25
    state, (fit,) = stepped(filter, 3), filter.node_fits[2]
    if predictor is None:
        wanted = fit.mean(state.past.vector)
    else:
        law = fit.gain @ state.mean + fit.offset[:, None]
        wanted = state.mean + 0.25 * np.stack([law[1], -law[0] - 0.4 * law[1]])
    times, values, end = filter.nodes(state)
    assert times == [2.0, 2.25]
    assert end is None
    assert_allclose(values[1], wanted, rtol=1e-12, atol=1e-14)
    assert_array_equal(filter.forecast(state, 2.25).mean, values[1])
    lone = filter.forecast(stepped(filter, 3, batch=False), 2.25).mean
    assert_allclose(lone, wanted[:, 0], rtol=1e-12, atol=1e-14)
    found = filter.run([*TIMES, 2.25], np.concatenate([Y[:3], np.full((1, 1, 4), np.nan)]))
    assert_allclose(found.mean[3], wanted, rtol=1e-12, atol=1e-14)


def test_nodes_of_an_interval_and_its_end():
    filter = design(Memory(2), nodes=2)
    state = stepped(filter, 2)
    times, values, (end, last) = filter.nodes(state)
    assert_allclose(times, [1.0, 4 / 3, 5 / 3], rtol=1e-14)
    assert values[0] is state.mean
    for value, fit in zip(values[1:], filter.node_fits[1], strict=True):
        assert_array_equal(value, fit.mean(state.past.vector))
    assert end == 2.0
    assert_array_equal(last, filter.fits[1].mean(state.past.vector))
    # where the next measurement is not wanted, the nodes alone
    again, others, none = filter.nodes(state, end=False)
    assert none is None
    assert again == times
    assert_array_equal(others, values)
    known = filter.interval(state)
    assert_array_equal(known.times, [*times, 2.0])
    assert known.nodes == 2
    assert known.last[0] == 0.0
    assert known.last_node[0] == pytest.approx(2 / 3)
    first = filter.interval(stepped(filter, 1))
    assert first.last is None
    assert first.last_node is None


def test_the_end_of_an_interval_is_of_the_components_that_are_estimated():
    filter = design(nodes=0, components=1)
    state = stepped(filter, 1)
    _, values, (end, last) = filter.nodes(state)
    assert values == [state.mean]
    assert end == 1.0
    assert_array_equal(last, filter.fits[0].mean(state.mean)[:1])
    middle = filter.forecast(state, 0.25).mean
    assert_allclose(middle, 0.75 * state.mean + 0.25 * last, rtol=1e-13)


def test_nodes_of_a_continuous_forecast_lead_to_the_next_measurement():
    """Euler's steps, the last of which ends there, and its estimate is what is forecast from."""
    filter = design(predictor=Continuous())
    state = stepped(filter, 2)
    z = state.mean
    for fit in filter.node_fits[1]:
        law = fit.gain @ z + fit.offset[:, None]
        z = z + 0.25 * np.stack([law[1], -law[0] - 0.4 * law[1]])
    times, values, (end, last) = filter.nodes(state)
    assert times == [1.0, 1.25, 1.5, 1.75]
    assert len(values) == 4
    assert end == 2.0
    assert_allclose(last, z, rtol=1e-12)
    ahead = filter.predict(state, 2.0)
    assert_allclose(ahead.mean, filter.fits[1].gain @ z + filter.fits[1].offset[:, None])


def test_intervals_beyond_the_design_are_its_last_ones_moved():
    """With their nodes, at times of their own."""
    filter = stationary(design(times=np.arange(4.0), nodes=1), tolerance=10.0)
    state = filter.initial((4,))
    for k in range(5):
        state = filter.step(state, float(k), Y[k])
    times, values, (end, last) = filter.nodes(state)
    assert_allclose(times, [4.0, 4.5], rtol=1e-14)
    assert_array_equal(values[1], filter.node_fits[-1][0].mean(state.past.vector))
    assert end == 5.0
    assert_array_equal(last, filter.fits[-1].mean(state.past.vector))
    assert_allclose(filter.forecast(state, 4.75).mean, (values[1] + last) / 2, rtol=1e-13)
    assert filter.horizon == np.inf
    assert filter.reach == (0.0, filter.times[-1])


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_the_state_before_any_measurement(batch):
    filter = design(nodes=0)
    state = filter.initial(batch)
    assert state.index == -1
    assert state.mean.shape == (2, *batch)
    mean = filter.start.mean.reshape(2, *(1,) * len(batch))
    assert_array_equal(state.mean, np.broadcast_to(mean, (2, *batch)))
    assert_array_equal(state.cov, filter.start.cov)
    assert state.past == Past()
    assert state.measurement is state.before is None
    assert state.loglik == 0.0
    assert state.corrected is state.gap is False
    assert state.group == 0
    first = filter.predict(state, 0.0)
    assert first.index == 0
    assert first[1:5] == state[1:5]
    assert_array_equal(filter.expect(first).cov, filter.start.moments.cov)
    assert filter.expect(first).mean.shape == (1,) * (1 + len(batch))


def test_a_forecast_remembers_what_it_comes_from():
    filter = design(Memory(1, 1), nodes=0)
    one = stepped(filter, 1)
    two = filter.predict(one, 1.0)
    mean, cov = filter.fits[0].forecast(one.past.vector)
    assert two.index == 1
    assert_array_equal(two.mean, mean)
    assert_array_equal(two.cov, cov)
    assert two.past is one.past
    assert two.measurement is one.measurement
    assert two.loglik == 0.0
    assert two.before.index == 0
    assert two.before.before is None
    assert two.corrected is False
    assert two.gap is False
    three = filter.predict(filter.correct(two, Y[1]), 2.0)
    assert three.before.index == 1
    assert three.before.before is None
    assert_array_equal(three.past.vector, [*three.before.mean, *Y[1]])
