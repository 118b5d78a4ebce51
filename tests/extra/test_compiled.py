"""`compiled`: its library is built once and kept; whole records, states left as they are."""

import pickle
import threading

import numpy as np
import pytest

from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.extra import CompiledFilter, compiled
from seedslib.filters import extended_kalman
from seedslib.linearization import Taylor
from systems import growth, oscillator, pendulum

pytestmark = pytest.mark.usefixtures("quick")
TIMES = np.arange(5.0)


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


def test_forecasts_within_a_record_equal_those_of_the_filter():
    times, grid = np.arange(4.0), np.linspace(0.0, 3.0, 25)
    filter = synthesize(oscillator(0.1), Memory(1), Taylor(), times, paths=300, seed=1, nodes=2)
    y = np.full((25, 1, 3), np.nan)
    y[::8] = filter.system.simulate(times, 3, 3).measurements
    wanted = filter.run(grid, y, covariances=True)
    found = compiled(filter).run(grid, y, covariances=True)
    for name in ("mean", "cov", "loglik"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-11)
