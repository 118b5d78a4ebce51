"""The rules of a switching filter step by step: starts, gaps, memories, paths that go together."""

import pickle

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal

from seedslib.base.semidefinite import mended
from seedslib.designed import Memory, SwitchingFilter
from seedslib.designed.memory import Past
from seedslib.designed.switching.lemmas import ModeLaw, weigh
from seedslib.designed.switching.rules import SwitchingRules, compiled_rules
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor
from seedslib.models import Noise, SwitchingSystem

rng = np.random.default_rng(12)

X, V, W = sympy.symbols("x v w", real=True)
STAY = [[0.9, 0.1], [0.3, 0.7]]
LAWS = [(0.6, [0.3], [[1.2]]), (0.4, [-0.5], [[0.7]])]


def law(*shape):
    """A scalar law of modes and their parts."""
    prob = rng.dirichlet(np.ones(shape[0]), shape[1:]).T.reshape(shape)
    return ModeLaw(np.log(prob), rng.normal(size=(1, *shape)), rng.uniform(0.3, 2, (1, 1, *shape)))


def system(**more):
    return SwitchingSystem(
        (X,), [[0.9 * X + 0.4 + 0.3 * V], [0.5 * X - 0.7 + 0.8 * V]], Noise((V,)), STAY,
        [[X + 0.5 * W], [2 * X - 1 + (1 + X / 2) * W]], Noise((W,)), LAWS, **more,
    )  # fmt: skip


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_the_state_before_any_measurement(batch):
    filter = SwitchingFilter(system(), ExactGaussian())
    state = filter.initial(batch)
    assert (state.index, state.time, state.mean, state.mode) == (-1, None, None, None)
    assert state.past == Past()
    assert state.loglik == 0.0
    assert state.mended == 0
    assert state.corrected is state.gap is False
    assert state.interval is None
    assert state.group == 0
    wanted = ([0.6, 0.4], [[0.3, -0.5]], [[[1.2, 0.7]]])
    parts = state.law.prob, state.law.mean, state.law.cov
    for part, values in zip(parts, wanted, strict=True):
        values = np.array(values)
        assert part.shape == (*values.shape, 1, *batch)
        values = values.reshape(*values.shape, *(1,) * (1 + len(batch)))
        assert_allclose(part, np.broadcast_to(values, part.shape), rtol=1e-15)
    first = filter.predict(state, 2.5)
    assert (first.index, first.time, first.interval) == (0, 2.5, None)
    second = filter.predict(filter.correct(first, np.full((1, *batch), 0.4)), 3.0)
    assert (second.index, second.time, second.interval) == (1, 3.0, 0.5)
    assert second.loglik == 0.0
    assert second.mean is second.mode is None
    assert second.corrected is False


NEAR = 1 / (1 + X**2)
TELLS = [[0.2 + 0.6 * NEAR, 0.8 - 0.6 * NEAR, 0], [0, 1, 0]]


@pytest.fixture(scope="module")
def told():
    return SwitchingFilter(system(indicator=TELLS), GaussHermite(3))


@pytest.mark.parametrize("batch", [(7,), (7, 1), (1, 7)])
def test_paths_of_a_batch_do_not_know_each_other(told, batch):
    """Each value of the indicator, a missing one, and one that only one of the modes shows."""
    filter = told
    shown = np.array([0, 1, 1, -1, 1, 0, -1])
    y = np.array([0.3, -1.0, np.nan, 2.0, 0.7, np.nan, np.nan])
    state = filter.initial(batch)
    for t, turn in ((0.0, 0), (1.0, 2), (2.0, 3)):
        seen, told = np.roll(y, turn), np.roll(shown, turn)
        state = filter.step(state, t, seen.reshape(1, *batch), told.reshape(batch))
    for path in range(7):
        one = filter.initial()
        for t, turn in ((0.0, 0), (1.0, 2), (2.0, 3)):
            seen, told = np.roll(y, turn)[path], np.roll(shown, turn)[path]
            one = filter.step(one, t, [seen], told)
        assert_allclose(state.mean.reshape(1, 7)[:, path], one.mean, rtol=1e-11)
        assert_allclose(state.loglik.reshape(7)[path], one.loglik, rtol=1e-11, atol=1e-13)
        assert_allclose(state.law.prob.reshape(2, 7)[:, path], one.law.prob, rtol=1e-11)
        assert state.mode.reshape(7)[path] == one.mode


def test_a_value_that_no_mode_shows_leaves_the_forecast_and_no_likelihood(told):
    filter = told
    state = filter.predict(filter.initial((2,)), 0.0)
    y = np.array([[0.4, 0.4]])
    found = filter.correct(state, y, np.array([2, 1]))
    blind = filter.correct(state, y, np.array([-1, -1]))
    assert found.loglik[0] == -np.inf
    assert np.isfinite(found.loglik[1])
    assert_allclose(found.mean[:, 0], blind.mean[:, 0], rtol=1e-13)
    assert_allclose(found.law.prob[:, 0], blind.law.prob[:, 0], rtol=1e-13)
    alone = filter.correct(filter.predict(filter.initial(), 0.0), [0.4], 2)
    assert alone.loglik == -np.inf
    assert_allclose(alone.mean, blind.mean[:, 0], rtol=1e-13)


def test_noise_of_a_measurement_is_that_of_a_known_state():
    """(1 + x / 2)² of mode 1 at the mean of its forecast, and 1/4 of mode 0."""
    for more in ({}, {"indicator": [[0.9, 0.1], [0.2, 0.8]]}):
        for rule in (Taylor(), ExactGaussian()):
            rules = SwitchingRules(system(**more), rule)
            for batch in ((), (3,), (2, 3)):
                seen = np.zeros(batch, dtype=int) if more else None
                sensed = rules.sense(0.0, law(2, 1, *batch), seen)
                found = rules._noise(0.0, sensed)
                assert found.shape == (1, 1, 2, *batch)
                assert_allclose(found[0, 0, 0], 0.25, rtol=1e-13)
                assert_allclose(found[0, 0, 1], (1 + sensed.mean[0, 1] / 2) ** 2, rtol=1e-12)


def test_a_missing_measurement_is_remembered_as_its_mean_over_the_modes():
    """Weighed by what the modes are without it."""
    rules = SwitchingRules(system(), ExactGaussian())
    for batch in ((), (2,)):
        forecast = law(2, 1, *batch)._replace(log_prob=np.log(np.full((2, 1, *batch), 0.5)) - 3)
        state = rules.start(batch)._replace(index=0, time=0.0, law=forecast)
        y = np.full((1, *batch), np.nan)
        found = rules.correct(state, y, None, Memory(1, 1))
        x = forecast.mean[0, :, 0]
        assert_allclose(found.past.measurements[0][0], (x[0] + 2 * x[1] - 1) / 2, rtol=1e-12)
        assert_allclose(found.past.estimates[0][0], x.mean(axis=0), rtol=1e-12)
        assert_array_equal(found.past.modes[0], 0)
        seen = rules.correct(state, np.full((1, *batch), 0.7), None, Memory(0, 1))
        assert_array_equal(seen.past.measurements[0], 0.7)
        assert seen.past.estimates == ()


def test_a_memory_of_indicators_wants_them():
    rules = SwitchingRules(system(indicator=[[0.9, 0.1], [0.2, 0.8]]), Taylor())
    state = rules.start((2,))._replace(index=0, time=0.0)
    y, memory = np.zeros((1, 2)), Memory(1, indicators=1)
    with pytest.raises(ValueError, match=r"^indicator: wanted by the memory, got a missing one$"):
        rules.correct(state, y, np.array([0, -1]), memory)
    found = rules.correct(state, y, np.array([0, 1]), memory)
    assert_array_equal(found.past.indicators[0], [0, 1])
    rules.correct(state, y, np.array([0, -1]), Memory(1))


def test_rules_of_points_forgive_probabilities_that_do_not_add_up():
    """Negative weights of points may leave more or less than one."""
    y = np.array([[0.4, -2.0, np.nan]])
    for rule, forgives in ((GaussHermite(3), True), (Taylor(), False)):
        rules = SwitchingRules(system(), rule)
        assert rules.guarded is forgives
        state = rules.start((3,))._replace(index=0, time=0.0)
        scaled = state.law.log_prob + np.array([0.5, -0.7, 0.2])
        whole = rules.correct(state, y, None, None)
        found = rules.correct(
            state._replace(law=state.law._replace(log_prob=scaled)), y, None, None
        )
        assert_allclose(found.law.prob, whole.law.prob, rtol=1e-12)
        assert_allclose(found.mean, whole.mean, rtol=1e-12)
        more = 0.0 if forgives else np.array([0.5, -0.7, 0.2])
        assert_allclose(found.loglik, whole.loglik + more, atol=1e-12)
        assert found.mended == whole.mended == 0


def test_forecasts_with_negative_variances_are_mended_and_counted():
    rules = SwitchingRules(system(), GaussHermite(3))
    state = rules.start((2,))._replace(index=0, time=0.0)
    bad = state.law.cov.copy()
    bad[0, 0, 1, 0, 0] = -0.2
    found = rules.correct(
        state._replace(law=state.law._replace(cov=bad), mended=5), np.zeros((1, 2)), None, None
    )
    good, count = mended(bad)
    wanted = rules.correct(
        state._replace(law=state.law._replace(cov=good)), np.zeros((1, 2)), None, None
    )
    assert count == 1
    assert found.mended == 6 + wanted.mended
    assert_allclose(found.mean, wanted.mean, rtol=1e-12)
    assert_allclose(found.loglik, wanted.loglik, rtol=1e-12)


def test_what_rounding_leaves_of_a_state_that_is_known_is_no_fault():
    """Two components measured without noise: in units of the law before, nothing is negative."""
    other = sympy.Symbol("y", real=True)
    known = SwitchingSystem(
        (X, other), [[X, other]], Noise(()), [[1]], [[X + 2 * other, X - other]], Noise(()),
        [(1, [0, 0], np.eye(2))],
    )  # fmt: skip
    rules, root = SwitchingRules(known, Taylor()), rng.normal(size=(2, 2, 300))
    cov = np.einsum("iab...,jab...->ij...", root[:, :, None], root[:, :, None])
    start = rules.start((300,))
    state = start._replace(index=0, time=0.0, law=start.law._replace(cov=cov[:, :, None, None]))
    found = rules.correct(state, np.full((2, 300), [[3.0], [0.0]]), None, None)
    assert found.mended == 0
    assert_allclose(found.mean, 1.0, rtol=1e-6)
    assert_allclose(found.law.cov, 0.0, atol=1e-9)


def test_a_masked_indicator_is_a_missing_one(told):
    state = told.predict(told.initial((2,)), 0.0)
    y, hidden = np.array([[0.4, 0.4]]), np.ma.array([1, 1], mask=[False, True])
    found, wanted = (told.correct(state, y, shown) for shown in (hidden, np.array([1, -1])))
    assert_array_equal(found.mean, wanted.mean)
    assert_array_equal(found.loglik, wanted.loglik)
    for bad, message in (
        (np.array([3, 0]), "wanted 0 to 2, or -1 for a missing one, got 3"),
        (np.array([0.5, 0.0]), "wanted whole numbers"),
        (None, "wanted, the system has an indicator; got none"),
    ):
        with pytest.raises((TypeError, ValueError), match=f"^indicator: {message}"):
            told.correct(state, y, bad)


def test_laws_that_a_measurement_changes_by_bayes():
    """Two modes, one component, in plain numbers; and what no mode explains changes nothing."""
    rules = SwitchingRules(system(), Taylor())
    ahead = law(2, 1, 3)
    sensed = rules.sense(0.0, ahead, None)
    y = np.array([[0.4, -3.0, np.nan]])
    found, loglik = weigh(sensed, y)
    mean, cross, spread = (np.squeeze(part) for part in sensed.moments)
    density = np.exp(-((y[0] - mean) ** 2) / (2 * spread)) / np.sqrt(2 * np.pi * spread)
    density[:, 2] = 1.0
    joint = sensed.prob * density
    assert_allclose(loglik, np.log(joint.sum(axis=0)), atol=1e-13)
    assert_allclose(found.prob, joint / joint.sum(axis=0), rtol=1e-12)
    gain = np.where(np.isnan(y), 0.0, cross / spread)
    moved = ahead.mean[0, :, 0] + gain * np.nan_to_num(y[0] - mean)
    assert_allclose(found.mean[0], moved, rtol=1e-12)
    assert_allclose(found.cov[0, 0], ahead.cov[0, 0, :, 0] - gain * cross, rtol=1e-12)
    none = sensed._replace(log_prob=np.full((2, 3), -np.inf))
    lost, loglik = weigh(none, y)
    assert (loglik == -np.inf).all()
    assert (lost.log_prob == -np.inf).all()


def test_rules_are_compiled_once(told):
    known = system()
    rules = compiled_rules(known, Taylor(), "consistent", True)
    assert compiled_rules(known, Taylor(), "consistent", True) is rules
    assert SwitchingFilter(known, Taylor()).rules is rules
    assert told.rules.split is True
    assert told.rules.printed is False
    one = SwitchingSystem(
        (X,), [[X / 2 + V]], Noise((V,)), [[1]], [[X + W]], Noise((W,)), [(1, [0], [[1]])],
        indicator=[[NEAR, 1 - NEAR]],
    )  # fmt: skip
    for split in (True, False):
        rules = SwitchingRules(one, GaussHermite(3), "printed", split)
        for each in (rules, pickle.loads(pickle.dumps(rules))):
            assert each.split is each.printed is split
    blind = SwitchingRules(known, Taylor(), "printed")
    assert blind.split is blind.printed is False
    with pytest.raises(ValueError, match=r"^normalisation: wanted one of consistent, printed, got"):
        SwitchingRules(known, Taylor(), "other")
