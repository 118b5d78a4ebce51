"""`compiled`: its library is built once and kept; whole records, parameters, streams."""

import pickle
import threading

import numpy as np
import pytest
import sympy

from seedslib.base import Parameter
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.evaluation import fit
from seedslib.export import CompiledFilter, compiled
from seedslib.filters import KalmanFilter, extended_kalman, unscented_kalman
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap
from systems import growth, oscillator, pendulum, switching_system

pytestmark = pytest.mark.usefixtures("quick")
TIMES = np.arange(5.0)
PULL, SPREAD = Parameter("pull", 0.7), Parameter("spread", 0.5, positive=True)


def polynomial():
    """Two states with parameters in both maps; nothing but sums and products, and quotients."""
    a, b, v, w1, w2 = sympy.symbols("a b v w1 w2", real=True)
    move = [a + b / 5, PULL * b - a / 5 - a**3 / 50 + v]
    dynamics = StochasticMap((a, b), move, Noise((v,), cov=[[0.3]]))
    see = [a + b**2 / 9 + SPREAD * w1, a * b / 3 + b + w2]
    sensor = StochasticMap((a, b), see, Noise((w1, w2), cov=0.2 * np.eye(2)))
    return DiscreteSystem(dynamics, sensor, [0.5, 0.2], 0.4 * np.eye(2))


def records(system, count, times=TIMES, lost=0.2):
    """Records of which a part is missing."""
    y = system.simulate(times, count, 1).measurements.copy()
    y[np.random.default_rng(2).random(y.shape) < lost] = np.nan
    return y


def test_an_equal_filter_is_not_built_again_but_a_broken_library_is(cache, tmp_path, monkeypatch):
    def first_step(twin):
        assert isinstance(twin, CompiledFilter)
        return twin.step(twin.initial(), 0.0, [1.0]).raw

    first = compiled(extended_kalman(growth()))
    before, raw = list(cache.iterdir()), first_step(first)
    assert first_step(compiled(extended_kalman(growth()))) == raw
    assert first_step(pickle.loads(pickle.dumps(first))) == raw
    assert list(cache.iterdir()) == before
    (tmp_path / "seedslib").mkdir()
    for path in before:
        (tmp_path / "seedslib" / path.name).write_bytes(b"no library")
    for home in (tmp_path, tmp_path / "seedslib" / before[0].name):  # no folder can be made there
        monkeypatch.setenv("XDG_CACHE_HOME", str(home))
        assert first_step(compiled(extended_kalman(growth()))) == raw


def test_builds_at_the_same_time_leave_one_library(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    filter, found = extended_kalman(growth()), []
    work = [threading.Thread(target=lambda: found.append(compiled(filter))) for _ in range(3)]
    for each in work:
        each.start()
    for each in work:
        each.join()
    assert len([each.step(each.initial(), 0.0, [1.0]).raw for each in found]) == 3
    assert [path.suffix for path in (tmp_path / "seedslib").iterdir()] == [".so"]


def test_without_a_compiler_the_filter_is_left_as_it_is_with_a_warning(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC")
    filter = extended_kalman(growth())
    with pytest.warns(UserWarning, match="compiler") as warned:
        assert compiled(filter) is filter
    assert [each.filename for each in warned] == [__file__]


def test_a_compiler_that_fails_is_an_error_that_quotes_it(tmp_path, monkeypatch):
    (tmp_path / "bad").write_text("#!/bin/sh\necho out of order >&2\nexit 1\n")
    (tmp_path / "bad").chmod(0o755)
    monkeypatch.setenv("CC", str(tmp_path / "bad"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(RuntimeError, match=r"compiler.*out of order"):
        compiled(extended_kalman(growth()))
    assert not list((tmp_path / "seedslib").iterdir())


def test_steps_leave_states_as_they_are_and_take_lists():
    quick = compiled(extended_kalman(pendulum()))
    state = quick.step(quick.initial(), 0.0, [0.5])
    raw = state.raw
    one, other = quick.step(state, 1.0, [0.3]), quick.step(state, 1.0, np.array([0.3]))
    assert state.raw == raw
    assert one.raw == other.raw == quick.step(state, 1, (0.3,)).raw
    assert (quick.initial().time, state.time) == (None, 0.0)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(one)).cov, one.cov)


def test_many_records_equal_the_filter_and_a_lost_one_is_said():
    """More than lie side by side in a block, in a batch of two axes; one measurement is absurd."""
    filter = extended_kalman(growth(), bound=1e6)
    y = filter.system.simulate(TIMES, 9000, 1).measurements
    y[2, 0, 8999] = 1e300
    with np.errstate(all="ignore"):
        wanted = filter.run(TIMES, y)
    twin = compiled(filter)
    found = twin.run(TIMES, y, workers=2)
    np.testing.assert_allclose(found.mean[..., :8999], wanted.mean[..., :8999], rtol=1e-10)
    np.testing.assert_array_equal(found.diverged, wanted.diverged)
    assert found.diverged.sum() == 1
    boxed = twin.run(TIMES, y.reshape(5, 1, 90, 100))
    assert boxed.diverged[89, 99]
    np.testing.assert_array_equal(boxed.loglik.reshape(5, 9000), found.loglik)
    np.testing.assert_array_equal(twin.run(TIMES, y[..., 4]).cov, found.cov[..., 4])


@pytest.mark.parametrize("count", [1, 3, 8, 67, 130])
def test_whole_records_have_the_bits_of_the_steps_of_each(count, monkeypatch):
    """Where no function of libm comes in: all but the likelihood. As compiled for users."""
    monkeypatch.delenv("CC")
    filter = compiled(extended_kalman(polynomial()))
    y = records(filter.system, count)
    found = filter.run(TIMES, y, workers=2)
    assert found.mean.shape == (5, 2, count)
    for i in {0, count // 2, count - 1}:
        state = filter.initial()
        for k, t in enumerate(TIMES):
            state = filter.step(state, t, y[k, :, i])
            np.testing.assert_array_equal(found.mean[k, ..., i], state.mean)
            np.testing.assert_array_equal(found.cov[k, ..., i], state.cov)
            np.testing.assert_allclose(found.loglik[k, i], state.loglik, rtol=1e-14)


def test_records_may_lie_in_memory_in_any_way():
    filter = compiled(extended_kalman(polynomial()))
    y = records(filter.system, 40)
    wanted = filter.run(TIMES, y)
    turned = np.moveaxis(np.ascontiguousarray(np.moveaxis(y, -1, 0)), 0, -1)
    for other in (turned, np.concatenate([y, y], axis=-1)[..., :40], y.tolist()):
        np.testing.assert_array_equal(filter.run(TIMES, other).cov, wanted.cov)
    y[3, 1, 39] = np.inf
    with pytest.raises(ValueError, match="infinite"):
        filter.run(TIMES, y)


@pytest.mark.parametrize("make", [extended_kalman, unscented_kalman])
def test_a_compiled_filter_is_bound_to_other_numbers(make):
    """Those of a batch may differ from record to record."""
    filter = make(polynomial())
    quick = compiled(filter)
    y = records(filter.system, 9)
    own = {PULL: np.linspace(0.1, 0.9, 9), SPREAD: 0.8}
    usual = quick.run(TIMES, y).mean
    bound = quick.bind(own)
    wanted, found = filter.bind(own).run(TIMES, y), bound.run(TIMES, y)
    state = bound.initial((9,))
    for t, row in zip(TIMES, y, strict=True):
        state = bound.step(state, t, row)
    for part in ("mean", "cov", "loglik"):
        np.testing.assert_allclose(getattr(found, part), getattr(wanted, part), rtol=1e-11)
        np.testing.assert_allclose(getattr(state, part), getattr(wanted, part)[-1], rtol=1e-11)
    assert np.abs(usual - found.mean).max() > 0.01
    one, other = (
        each.step(each.step(each.initial(), 0.0, y[0, :, 0]), 1.0, [0.1, 0.2])
        for each in (quick.bind({PULL: 0.3}), filter.bind({PULL: 0.3}))
    )
    np.testing.assert_allclose(one.mean, other.mean, rtol=1e-12)


def test_a_fit_through_a_compiled_filter_is_that_of_the_filter():
    Q, R = Parameter("q", 1.0, positive=True), Parameter("r", 3.0, positive=True)
    filter, times = KalmanFilter(LinearSystem(1, Q, 1, R, 0, 1)), np.arange(60.0)
    y = filter.system.bind(q=0.2, r=1.0).simulate(times, 3, 1).measurements
    wanted, found = (fit(each, times, y, [Q, R]) for each in (filter, compiled(filter)))
    np.testing.assert_allclose(found.values, wanted.values, rtol=1e-6)
    np.testing.assert_allclose(found.loglik, wanted.loglik, rtol=1e-12)
    assert found.converged
    assert np.abs(found.values - [1.0, 3.0]).min() > 0.5


def test_modes_of_many_records_equal_those_of_the_filter():
    filter = SwitchingFilter(switching_system(inputs=False, indicator=False), Taylor())
    y = records(filter.system, 70)
    wanted, found = (each.run(TIMES, y, covariances=True) for each in (filter, compiled(filter)))
    for part in ("mean", "cov", "loglik", "mode_prob"):
        np.testing.assert_allclose(
            getattr(found, part), getattr(wanted, part), rtol=1e-10, atol=1e-12
        )
    np.testing.assert_array_equal(found.modes, wanted.modes)
    assert found.modes.dtype == wanted.modes.dtype


def test_forecasts_within_a_record_equal_those_of_the_filter():
    times, grid = np.arange(4.0), np.linspace(0.0, 3.0, 25)
    filter = synthesize(oscillator(0.1), Memory(1), Taylor(), times, paths=300, seed=1, nodes=2)
    y = np.full((25, 1, 3), np.nan)
    y[::8] = filter.system.simulate(times, 3, 3).measurements
    wanted = filter.run(grid, y, covariances=True)
    found = compiled(filter).run(grid, y, covariances=True)
    for name in ("mean", "cov", "loglik"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-11)
