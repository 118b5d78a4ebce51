"""Filters compiled behind their own verbs, against the same filters in Python."""

import os
import pickle
import subprocess
import sys
import warnings

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import grid_synthesis, stationary, synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.evaluation import compare
from seedslib.extra import CompiledFilter, compiled
from seedslib.extra.c import build
from seedslib.filters import extended_kalman, unscented_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

if build.compiler() is None:
    pytest.skip("no C compiler", allow_module_level=True)

TIMES = 0.5 * np.arange(9.0)
STEPS = np.arange(30.0)

a, b, v, w = sympy.symbols("a b v w", real=True)


def walk():
    return DiscreteSystem(
        StochasticMap((a, b), [a + b, 0.9 * b + v], Noise((v,), cov=[[0.1]])),
        StochasticMap((a, b), [sympy.sin(a) + a + w], Noise((w,), cov=[[0.2]])), [0.0, 0.1],
        0.5 * np.eye(2),
    )  # fmt: skip


def designed(**options):
    design = {"paths": 500, "seed": 1, "nodes": 2, **options}
    return synthesize(zoo.van_der_pol(), Memory(1), ExactGaussian(), TIMES, **design)


def for_ever():
    made = synthesize(walk(), Memory(1), Taylor(), np.arange(12.0), paths=1000, seed=1)
    return stationary(made, tolerance=2.0, paths=200)


MADE = {
    "designed": (designed, TIMES),
    "designed, without an end": (for_ever, STEPS),
    "table": (
        lambda: grid_synthesis(
            zoo.flip_process(), large_order(1), TIMES[:5], x=(-3.5, 3.5, 61), z=(-2.5, 2.5, 13),
            y=(-8, 8, 25), nodes=2,
        ),
        TIMES[:5],
    ),
    "extended": (lambda: extended_kalman(walk()), STEPS),
    "unscented": (lambda: unscented_kalman(walk()), STEPS),
    "extended, in continuous time": (lambda: extended_kalman(zoo.van_der_pol(), step=0.05), TIMES),
    "IMM": (lambda: SwitchingFilter(zoo.manoeuvring_target(), Taylor()), STEPS),
    "switching, designed": (
        lambda: synthesize(
            zoo.scalar_switching(), large_order(1), Taylor(), STEPS[:6], paths=500, seed=1
        ),
        STEPS[:6],
    ),
}  # fmt: skip


@pytest.fixture(scope="module", params=MADE)
def pair(request):
    """A filter, its twin in C, data."""
    make, times = MADE[request.param]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        filter = make()
    data = filter.system.simulate(times, 30, 2)
    y = data.measurements.copy()
    y[2, :, :7] = np.nan
    return filter, compiled(filter), times, y, data.indicators


def near(found, wanted, part=1e-10):
    assert (found is None) == (wanted is None)
    if wanted is None:
        return
    wanted = np.asarray(wanted, dtype=float)
    if wanted.ndim == 3 and found.ndim == 4:
        wanted = wanted[..., None] * np.ones(found.shape[-1])
    lost = ~np.isfinite(wanted)
    assert np.array_equal(np.isnan(wanted), np.isnan(found))
    size = np.abs(np.where(lost, 0.0, wanted)).max()
    np.testing.assert_allclose(found[~lost], wanted[~lost], rtol=part, atol=part * max(size, 1e-30))


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_records(pair):
    filter, twin, times, y, told = pair
    assert isinstance(twin, CompiledFilter)
    options = {} if told is None else {"indicators": told}
    more = {"covariances": True} if "covariances" in filter.takes else {}
    wanted, found = filter.run(times, y, **options, **more), twin.run(times, y, **options, **more)
    for name, part in wanted._asdict().items():
        near(getattr(found, name), part)
    both = twin.run(times, y, **options, **more, workers=2)
    near(both.mean, found.mean, 0.0)
    alone = {name: part[:, 9] for name, part in options.items()}
    near(twin.run(times, y[..., 9], **alone).mean, wanted.mean[..., 9])
    boxed = {name: part.reshape(len(times), 5, 6) for name, part in options.items()}
    found = twin.run(times, y.reshape(*y.shape[:2], 5, 6), **boxed)
    near(found.mean.reshape(wanted.mean.shape), wanted.mean)


def test_it_shows_which_filter_it_is(pair):
    filter, twin, *_ = pair
    assert repr(twin) == f"<CompiledFilter: filter {filter}>"
    assert "CompiledFilter" in twin._repr_html_()


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_step_by_step(pair):
    filter, twin, times, y, told = pair
    state, other, batch = filter.initial(), twin.initial(), twin.initial((30,))
    for k, t in enumerate(times):
        shown = () if told is None else (told[k, 3],)
        state = filter.step(state, t, y[k, :, 3], *shown)
        before, given = other, y[k, :, 3] if k % 2 else y[k, :, 3].tolist()
        other = twin.step(before, t, given, *shown)
        again = twin.step(before, t, y[k, :, 3], *shown)
        assert again.raw == other.raw  # states are left as they are
        batch = twin.step(batch, t, y[k], *(() if told is None else (told[k],)))
        said = filter.report(state)
        near(other.mean, said.mean)
        near(other.cov, np.broadcast_to(said.cov, other.cov.shape))
        near(batch.mean[..., 3], said.mean)
        if said.modes is not None:
            assert other.mode == said.modes
            near(other.mode_prob, said.mode_prob)
    near(pickle.loads(pickle.dumps(other)).mean, other.mean)


def test_halves_and_forecasts(pair):
    filter, twin, times, y, _ = pair
    if hasattr(filter.system, "modes"):
        with pytest.raises(ValueError, match="forecast: wanted a filter without modes"):
            twin.forecast(twin.initial(), 0.0)
        return
    state, other = filter.initial(), twin.initial()
    for t, shown in zip(times[:4], y[:4, :, 20], strict=True):
        state, other = filter.step(state, t, shown), twin.step(other, t, shown)
    for later in np.linspace(times[3], times[4], 4)[1:]:
        if hasattr(filter.system, "dynamics") and later < times[4]:
            continue
        near(twin.forecast(other, later).mean, filter.forecast(state, later).mean)
    if hasattr(filter, "integrator"):
        ahead, wanted = twin.predict(other, times[4]), filter.predict(state, times[4])
        near(ahead.cov, wanted.cov)
        corrected = twin.correct(ahead, y[4, :, 20])
        near(corrected.mean, filter.correct(wanted, y[4, :, 20]).mean)
        assert corrected.time == times[4]
        with pytest.raises(ValueError, match="wanted the next"):
            twin.predict(corrected, times[3])
    else:
        with pytest.raises(ValueError, match="call step"):
            twin.predict(other, times[4])


def test_refused(pair):
    filter, twin, times, y, told = pair
    state = twin.initial()
    shown = () if told is None else (0,)
    good = np.ones(y.shape[1])
    with pytest.raises(ValueError, match=r"y: wanted finite numbers"):
        twin.step(state, times[0], np.full(y.shape[1], np.inf), *shown)
    with pytest.raises(ValueError, match="y: wanted shape"):
        twin.step(state, times[0], np.ones(7), *shown)
    with pytest.raises((ValueError, TypeError), match="y: wanted"):
        twin.step(state, times[0], ["a"] * y.shape[1], *shown)
    state = twin.step(state, times[0], good, *shown)
    with pytest.raises(ValueError, match="t: wanted"):
        twin.step(state, times[0] - 1.0, good, *shown)
    if told is not None:
        for wrong, word in ((None, "wanted, the system"), (7, "or -1"), (1.5, "whole")):
            with pytest.raises((ValueError, TypeError), match=word):
                twin.step(state, times[1], good, wrong)
    else:
        with pytest.raises(ValueError, match="indicator"):
            twin.step(state, times[1], good, 0)
    with pytest.raises(ValueError, match="measurements"):
        twin.run(times, np.where(np.isfinite(y), np.inf, y))
    if hasattr(filter, "times") and filter.times is not None and not filter.cycle:
        for t, row in zip(times[1:], np.ones((len(times) - 1, y.shape[1])), strict=True):
            state = twin.step(state, t, row, *shown)
        with pytest.raises(ValueError, match="at most the last"):
            twin.step(state, times[-1] + 1.0, good, *shown)


def test_forecasts_between_measurements_in_a_record():
    filter = designed()
    grid = np.linspace(0.0, 4.0, 33)
    y = np.full((33, 2, 5), np.nan)
    y[::4] = filter.system.simulate(TIMES, 5, 3).measurements
    wanted, found = filter.run(grid, y, covariances=True), compiled(filter).run(
        grid, y, covariances=True
    )  # fmt: skip
    for name in ("mean", "cov", "loglik"):
        near(getattr(found, name), getattr(wanted, name))


def test_compare_takes_it_for_the_filter():
    filter, system = designed(), zoo.van_der_pol()
    table = compare({"python": filter, "c": compiled(filter)}, system, TIMES, 400, 1)
    np.testing.assert_allclose(table["c"].rms, table["python"].rms, rtol=1e-9)


def test_built_once(monkeypatch):
    filter = extended_kalman(walk())
    first = compiled(filter)
    monkeypatch.setattr(build.subprocess, "run", None)
    again = compiled(extended_kalman(walk()))
    assert again.initial().raw == first.initial().raw
    assert len(pickle.dumps(first)) > 0
    assert isinstance(pickle.loads(pickle.dumps(first)), CompiledFilter)


def test_a_broken_library_is_made_again():
    filter = extended_kalman(walk())
    compiled(filter)
    for path in build.cache_folder().iterdir():
        if path.suffix == ".so":
            path.unlink()
            path.write_bytes(b"no library")
    assert compiled(filter).initial().mean.shape == (2,)


def test_the_compiler_of_the_wheel_is_the_last_choice(monkeypatch):
    """It writes for any processor of a kind, not for the one at hand: the cache may be shared."""
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(build.shutil, "which", lambda name: None)
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: name == "ziglang")
    assert build.compiler() == [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"]
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: None)
    assert build.compiler() is None


def test_without_a_compiler_there_is_one_message(monkeypatch):
    monkeypatch.setattr(build, "compiler", lambda: None)
    filter = extended_kalman(walk())
    with pytest.warns(UserWarning, match="wanted a C compiler") as told:
        assert compiled(filter) is filter
    assert len(told) == 1
    assert told[0].filename == __file__


def test_a_compiler_that_fails_is_quoted(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "FLAGS", ("-no-such-flag",))
    with pytest.raises(RuntimeError, match=r"compiler: .*no-such-flag"):
        compiled(extended_kalman(walk()))
    assert not list(build.cache_folder().iterdir())


def test_two_processes_at_once(tmp_path):
    code = (
        "from seedslib.extra import compiled; from seedslib.filters import extended_kalman\n"
        "from seedslib import zoo; q = compiled(extended_kalman(zoo.van_der_pol()))\n"
        "print(q.step(q.initial(), 0.0, [1.0, 2.0]).mean)"
    )
    where = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    line = [sys.executable, "-c", code]
    both = [subprocess.Popen(line, env=where, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [each.communicate()[0] for each in both]
    assert said[0] == said[1] != ""
    assert [path.suffix for path in (tmp_path / "seedslib").iterdir()] == [".so"]


def test_a_time_that_is_none_is_named():
    quick = compiled(extended_kalman(zoo.van_der_pol()))
    for y in ([1.0, 0.5], np.array([1.0, 0.5])):
        for t in ("noon", None, [0.0, 1.0]):
            with pytest.raises((TypeError, ValueError), match="t: wanted"):
                quick.step(quick.initial(), t, y)
