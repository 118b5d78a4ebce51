"""`compiled`: its library is built once and kept; states are left as they are."""

import pickle
import threading

import numpy as np
import pytest

from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.evaluation import compare
from seedslib.extra import CompiledFilter, compiled
from seedslib.filters import extended_kalman
from seedslib.linearization import Taylor
from systems import growth, oscillator, pendulum

pytestmark = pytest.mark.usefixtures("quick")
TIMES = np.arange(5.0)


def libraries(cache):
    return sorted(path.name for path in cache.iterdir())


def test_an_equal_filter_is_not_built_again(cache, monkeypatch):
    first = compiled(extended_kalman(growth()))
    before = libraries(cache)
    again = compiled(extended_kalman(growth()))
    assert libraries(cache) == before
    assert again.initial().raw == first.initial().raw
    copy = pickle.loads(pickle.dumps(first))
    assert isinstance(copy, CompiledFilter)
    assert copy.step(copy.initial(), 0.0, [1.0]).raw == first.step(first.initial(), 0.0, [1.0]).raw
    assert "CompiledFilter" in repr(first)


def test_a_broken_library_is_made_again(cache):
    filter = extended_kalman(pendulum())
    compiled(filter)
    for path in cache.iterdir():
        path.unlink()
        path.write_bytes(b"no library")
    assert compiled(filter).initial().mean.shape == (2,)


def test_builds_at_the_same_time_leave_one_library(cache, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    filter, found = extended_kalman(growth()), []
    work = [threading.Thread(target=lambda: found.append(compiled(filter))) for _ in range(3)]
    for each in work:
        each.start()
    for each in work:
        each.join()
    assert len({each.step(each.initial(), 0.0, [1.0]).raw for each in found}) == 1
    assert len(found) == 3
    (name,) = libraries(tmp_path / "seedslib")
    assert name.endswith(".so")


def test_a_home_that_cannot_be_written_to_is_passed_by(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert isinstance(compiled(extended_kalman(growth())), CompiledFilter)


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
    assert not libraries(tmp_path / "seedslib")


def test_steps_leave_states_as_they_are_and_take_lists(cache):
    quick = compiled(extended_kalman(pendulum()))
    state = quick.step(quick.initial(), 0.0, [0.5])
    raw = state.raw
    one, other = quick.step(state, 1.0, [0.3]), quick.step(state, 1.0, np.array([0.3]))
    assert state.raw == raw
    assert one.raw == other.raw == quick.step(state, 1, (0.3,)).raw
    assert state.time == 0.0
    assert quick.initial().time is None
    copy = pickle.loads(pickle.dumps(one))
    np.testing.assert_array_equal(copy.cov, one.cov)


def test_records_in_a_batch_of_two_axes_equal_those_in_one(cache):
    filter = extended_kalman(pendulum())
    y = filter.system.simulate(TIMES, 6, 1).measurements
    quick = compiled(filter)
    flat, boxed = quick.run(TIMES, y), quick.run(TIMES, y.reshape(5, 1, 2, 3))
    np.testing.assert_array_equal(boxed.mean.reshape(flat.mean.shape), flat.mean)
    np.testing.assert_array_equal(boxed.loglik.reshape(flat.loglik.shape), flat.loglik)
    assert boxed.diverged.shape == (2, 3)
    np.testing.assert_array_equal(quick.run(TIMES, y[..., 4]).cov, flat.cov[..., 4])


def test_many_records_in_blocks_equal_the_filter_and_a_lost_one_is_said(cache):
    """More than lie side by side in one block, one of them with a measurement that is absurd."""
    filter = extended_kalman(growth(), bound=1e6)
    y = filter.system.simulate(TIMES, 9000, 1).measurements
    y[2, 0, 8999] = 1e300
    with np.errstate(all="ignore"):
        wanted = filter.run(TIMES, y)
    found = compiled(filter).run(TIMES, y, workers=2)
    np.testing.assert_allclose(found.mean[..., :8999], wanted.mean[..., :8999], rtol=1e-10)
    np.testing.assert_array_equal(found.diverged, wanted.diverged)
    assert found.diverged.sum() == 1


def test_forecasts_within_a_record_equal_those_of_the_filter(cache):
    times, grid = np.arange(4.0), np.linspace(0.0, 3.0, 25)
    filter = synthesize(oscillator(0.1), Memory(1), Taylor(), times, paths=300, seed=1, nodes=2)
    y = np.full((25, 1, 3), np.nan)
    y[::8] = filter.system.simulate(times, 3, 3).measurements
    wanted = filter.run(grid, y, covariances=True)
    found = compiled(filter).run(grid, y, covariances=True)
    for name in ("mean", "cov", "loglik"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-11)


def test_compare_takes_it_for_the_filter(cache):
    filter = extended_kalman(pendulum())
    table = compare({"python": filter, "c": compiled(filter)}, filter.system, TIMES, 200, 1)
    np.testing.assert_allclose(table["c"].rms, table["python"].rms, rtol=1e-11)
