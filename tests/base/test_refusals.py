"""What every package refuses alike: symbols of two meanings, text, masks, what has no room."""

import logging
import os
import stat
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp

from seedslib import zoo
from seedslib.base import Axis, Input, Nodes, Parameter, interpolate, update
from seedslib.base.progress import followed
from seedslib.design import synthesize
from seedslib.designed import Memory, load, save
from seedslib.evaluation import compare, fit
from seedslib.filters import KalmanFilter, extended_kalman
from seedslib.gaussian import expectation, expectation_function
from seedslib.linearization import Moments, Taylor
from seedslib.models import (
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
    grid_chain,
)
from seedslib.two_step import LinearDiffusion

X, V, K = sp.symbols("x v k")
AXIS = Axis(0.0, 1.0, 3)
LINEAR = zoo.linear_gaussian()


def flow(drift=-X, **options):
    return JumpDiffusion([X], [drift], [[1]], [X + V], Noise([V]), [0], [[1]], **options)


def corrected(**changes):
    moments = {"m_mean": np.zeros(3), "cross": np.ones((2, 3)), "m_cov": np.eye(3)}
    plain = {"mean": np.zeros(2), "cov": np.eye(2), "y": np.zeros(3)}
    for name, part in changes.items():
        (moments if name in moments else plain)[name] = part
    return update(**plain, moments=Moments(*moments.values()))


ROWS = [
    (lambda: corrected(y=[0.0, np.inf, 0.0]), ValueError, "y"),
    (lambda: corrected(y=[0.0]), ValueError, "y"),
    (lambda: Axis(0, 1, 1), ValueError, "count"),
    (lambda: Axis(0, 1, True), TypeError, "count"),
    (lambda: Axis(1, 0, 5), ValueError, "low, high"),
    (lambda: Nodes([1.0, 0.0]), ValueError, "nodes"),
    (lambda: Nodes([0.0, 1.0], [1.0, -1.0]), ValueError, "weights"),
    (lambda: interpolate(np.zeros((1, 4)), [AXIS], [0.5]), ValueError, "table"),
    (lambda: interpolate(np.zeros((1, 3)), [AXIS], []), ValueError, "points"),
    (lambda: grid_chain(flow(), 5), TypeError, "axes"),
    (lambda: grid_chain(flow(), (1, 0, 5)), ValueError, "axes: low, high"),
    (lambda: Noise([V, K], cov=[[1, 0.5], [0.4, 1]]), ValueError, "cov"),
    (
        lambda: LinearDiffusion(-np.eye(2), np.eye(2), np.eye(2), np.eye(3), [0, 0], np.eye(2)),
        ValueError,
        "sensor",
    ),
    (lambda: flow(K * X), ValueError, "drift"),
    (lambda: flow(sp.Symbol("t", real=True)), ValueError, "drift"),
    (lambda: flow(sp.I * X), ValueError, "drift"),
    (lambda: flow(sp.Integer(10) ** 400), ValueError, "drift"),
    (lambda: flow(sp.exp(1000) * X).drift(0.0, np.ones((1, 2))), ValueError, "expressions"),
    (lambda: flow(sp.Function("f")(X)), ValueError, "drift"),
    (lambda: flow(parameters={K: "2"}), TypeError, "parameters"),
    (lambda: flow(time="t"), TypeError, "time"),
    (lambda: expectation_function(X, [X, X]), ValueError, "variables"),
    (lambda: LINEAR.simulate([0.0, np.datetime64("2020-01-01")], 1, 1), TypeError, "times"),
    (lambda: LINEAR.simulate([-1.0, 0.0], 1, 1), ValueError, "times"),
    (lambda: LINEAR.simulate([0.0, 1e12], 1, 1), ValueError, "times"),
    (lambda: extended_kalman(LINEAR).run([0.0, 1e12], np.zeros((2, 1))), ValueError, "times"),
]


@pytest.mark.parametrize(("call", "error", "name"), ROWS)
def test_wrong_arguments_are_refused_by_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()


@pytest.mark.parametrize(
    "use",
    [
        lambda text: flow(text),
        lambda text: flow(parameters={text: 1}),
        lambda text: StochasticMap((text,), [X]),
        lambda text: StochasticMap((X,), [X], weight=text),
        lambda text: Noise(text),
        lambda text: expectation(text, [X], [0], sp.eye(1)),
        lambda text: expectation(X, [X], [text], sp.eye(1)),
    ],
)
def test_no_string_is_run(use, tmp_path):
    """The text would make a file if anything evaluated it."""
    proof = tmp_path / "run"
    with pytest.raises(TypeError):
        use(f"__import__('pathlib').Path({str(proof)!r}).touch()")
    assert not proof.exists()


# Files and logs


def test_a_file_is_replaced_as_a_whole_or_not_at_all(tmp_path, monkeypatch):
    """What fails on the way leaves the old design; a link stays one, and so do permissions."""
    designs = [
        synthesize(LINEAR, Memory(k), Taylor(), range(3), exact_moments=True, nodes=0)
        for k in (1, 2)
    ]
    path, link = tmp_path / "f.npz", tmp_path / "link.npz"
    save(designs[0], path)
    path.chmod(0o604)
    link.symlink_to(path.name)
    old = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            save(designs[1], path)
    assert path.read_bytes() == old
    assert sorted(os.listdir(tmp_path)) == ["f.npz", "link.npz"]
    save(designs[1], link)
    assert link.is_symlink()
    assert stat.S_IMODE(path.stat().st_mode) == 0o604
    assert load(path, LINEAR).order == designs[1].order
    with pytest.raises(FileNotFoundError):
        save(designs[0], tmp_path / "none" / "f.npz")


def test_long_work_is_logged_where_somebody_listens(caplog):
    def work():
        return synthesize(LINEAR, Memory(1), Taylor(), range(4), paths=300, seed=1)

    quiet = work()
    assert not caplog.records
    with caplog.at_level(logging.INFO, logger="seedslib"):
        told = work()
    assert "all 3 steps" in caplog.records[-1].getMessage()
    np.testing.assert_array_equal(quiet.predicted.rms, told.predicted.rms)


def test_long_work_has_a_bar_in_a_terminal_where_tqdm_is(monkeypatch):
    bars = []
    fake = SimpleNamespace(tqdm=lambda steps, what, *count, **options: bars.append(what) or steps)
    monkeypatch.setitem(sys.modules, "tqdm", fake)
    assert list(followed(range(3), "work")) == [0, 1, 2]
    assert not bars
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(isatty=lambda: True))
    assert list(followed(range(3), "work")) == [0, 1, 2]
    assert bars == ["work"]
    for workers in (1, 2):
        compare({"EKF": extended_kalman(LINEAR)}, LINEAR, [0.0, 1.0], 3000, 0, workers=workers)
    fit(KalmanFilter(LEVEL), MANY, np.zeros((101, 1)), [Q])
    assert bars == ["work", "compare", "compare", "fit"]
    monkeypatch.setitem(sys.modules, "tqdm", None)
    assert list(followed(range(3), "work")) == [0, 1, 2]


Q = Parameter("q", 0.1, positive=True)
LEVEL = LinearSystem(1, Q, 1, 1, 0, 1)
MANY = np.arange(101.0)
PUSHED = LinearSystem(1, 1, 1, 1, 0, 1, b=[Input("u")])
DT = sp.Symbol("dt", real=True)


def moved(*rows):
    noises = Noise([V]), [[0.5, 0.5]] * 2, [[X]] * 2, Noise()
    return SwitchingSystem([X], [*rows], *noises, [(0.5, [0], [[1]])] * 2)


SENTENCES = [
    (lambda: flow(period=6.28), r"period: wanted a mapping .* \{0: 2 \* pi\}, got 6\.28"),
    (lambda: flow(period=[None, 6.28]), r"period: wanted a mapping .* got \[None, 6\.28\]"),
    (lambda: flow(period={0: "2 pi"}), r"period\[0\]: wanted a number, got '2 pi'"),
    (lambda: LinearSystem(1, 1, 1, 1, 0, 0, diffuse=True), r"diffuse: .* got True; .* range\(1\)"),
    (lambda: LinearSystem(1, 1, 1, 1, 0, 0, diffuse="all"), r"diffuse: .* got 'all'; .* range"),
    (lambda: LinearSystem(10**400, 1, 1, 1, 0, 1), r"F: wanted numbers in the range of float64"),
    (lambda: LinearSystem(1, 1, 1, 1, 0, None), r"cov0: wanted real numbers, got None"),
    (lambda: Noise([V], cov=[[Q * K]]), r"cov: wanted real numbers, got formulas of k, q"),
    (lambda: moved([X + DT * V], [X]), r"dynamics: .* got dt; .* ELAPSED"),
    (lambda: moved([X + V], [X, X]), r"dynamics: wanted rows of one length, got rows of 1, 2"),
    (lambda: fit(LEVEL, MANY, MANY[:, None], [Q]), r"filter: .* KalmanFilter.* got LinearSystem"),
    (lambda: fit(KalmanFilter(LEVEL), MANY, MANY[:, None], Q), r"free: .* got q; write \[q\]"),
    (
        lambda: KalmanFilter(PUSHED).run(MANY, MANY[:, None], inputs={"u": MANY}),
        r"inputs: wanted a mapping of Input to arrays, got a mapping of 'u'$",
    ),
    (
        lambda: KalmanFilter(PUSHED).run(MANY, MANY[:, None], inputs=MANY),
        r"inputs: wanted a mapping of Input to arrays, got an array of shape \(101,\)$",
    ),
    (
        lambda: grid_chain(flow(), MANY),
        r"axes: wanted an Axis or \(low, high, count\), got an array of shape \(101,\)$",
    ),
    (lambda: LINEAR.simulate(MANY, 1, 1, measured=0.5 * MANY), r"measured: .* got an array of sh"),
]


@pytest.mark.parametrize(("call", "sentence"), SENTENCES)
def test_a_natural_wrong_call_is_answered_by_what_was_got_and_what_is_wanted(call, sentence):
    with pytest.raises((TypeError, ValueError), match=f"^{sentence}"):
        call()


def test_arrays_of_objects_that_are_numbers_are_numbers():
    """As they come where some matrices of a model have formulas and others do not."""
    matrix = np.zeros((2, 2), dtype=object)
    matrix[0, 0] = 0.5
    system = LinearSystem(matrix, np.eye(2), np.eye(2), np.eye(2), [0, 0], np.eye(2))
    np.testing.assert_array_equal(system.dynamics.slope_at(0.0, ()), [[0.5, 0.0], [0.0, 0.0]])
