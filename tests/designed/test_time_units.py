"""Seconds since 1970, or a unit of 1e-9: a design is the same filter in every unit of time."""

import numpy as np
import pytest
import sympy

from seedslib.commands.cli import main
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.designed.between import Interval, at
from seedslib.evaluation import diff, evaluate
from seedslib.linearization import Taylor
from seedslib.models import JumpDiffusion, Noise

x1, x2, v = sympy.symbols("x1 x2 v")
SCALES = {"epoch": (1.0, 1.7e9), "small": (1e-9, 0.0), "both": (1e-3, 1.7e9)}


def oscillator(unit):
    return JumpDiffusion(
        state=(x1, x2), drift=[x2 / unit, (-x1 - 0.4 * x2) / unit],
        diffusion=[[0], [sympy.Float(unit**-0.5)]], sensor=[x1 + v],
        noise=Noise((v,), cov=[[0.25]]), mean0=[1, -0.5], cov0=[[1, 0], [0, 1]], step=0.05 * unit,
    )  # fmt: skip


def designed(unit, start, **options):
    times = start + unit * np.arange(5)
    return synthesize(
        oscillator(unit), Memory(2), Taylor(), times, paths=1000, seed=1, nodes=3, **options
    )


@pytest.fixture(scope="module")
def plain():
    return designed(1.0, 0.0)


def printed(filter):
    rows = [line.partition("|")[0].split() for line in str(filter).splitlines()]
    return [[float(cell) for cell in row[3::3]] for row in rows if row[:2] == ["t", "="]]


@pytest.mark.parametrize("name", SCALES)
def test_the_printed_errors_are_those_of_the_measurements(plain, name):
    filter = designed(*SCALES[name])
    rms = [p[:1] for p in filter.predicted.rms[::4].round(4).tolist()]
    assert [row[:1] for row in printed(filter)] == rms
    # a time stamp has seven decimals: other steps of the simulation, so other paths
    np.testing.assert_allclose(printed(filter), printed(plain), rtol=0.04)


@pytest.mark.parametrize("name", SCALES)
def test_half_steps_are_between_the_measurements(plain, name):
    unit, start = SCALES[name]
    half = np.arange(9) * 0.5
    expected = evaluate(plain, oscillator(1.0), half, 200, 3)
    found = evaluate(designed(unit, start), oscillator(unit), start + unit * half, 200, 3)
    np.testing.assert_allclose(found.average, expected.average, rtol=0.02)


@pytest.mark.parametrize("name", SCALES)
def test_designs_are_compared_at_the_times_they_share(name):
    unit, start = SCALES[name]
    one = designed(unit, start)
    other = synthesize(
        oscillator(unit), Memory(2), Taylor(), start + unit * 0.5 * np.arange(9), paths=1000,
        seed=1, nodes=0,
    )  # fmt: skip
    shared = diff(one, other).predicted.times
    # of the forecasts between, every second one is a measurement of the other
    np.testing.assert_array_equal(shared, one.predicted.times[::2])


def test_times_that_are_rounded_otherwise_are_a_record(plain):
    unit, start = 1e-3, 1.7e9
    filter, times = designed(unit, start), start + unit * np.arange(5)
    y = np.ones((5, 1))
    expected = filter.run(times, y).mean
    off = np.nextafter(times, [0, np.inf, 0, np.inf, 0])
    np.testing.assert_array_equal(filter.run(off, y).mean, expected)
    with pytest.raises(ValueError, match="is not among them"):
        filter.run(times + np.array([0, 0, 1e-5, 0, 0]), y)


def test_a_time_that_is_a_node_but_for_rounding_is_the_node():
    times = 1.7e9 + np.array([0.0, 0.25, 0.5, 1.0])
    interval = Interval(times, [np.array([k]) for k in range(4)], 2)
    for k in (1, 2):
        before = np.nextafter(times[k], 0)
        assert at(interval, before, "piecewise constant") == k
        assert at(interval, times[k] - 1e-3, "piecewise constant") == k - 1


MODEL = """
import sympy
from seedslib.models import JumpDiffusion, Noise

x, v = sympy.symbols("x v")
system = JumpDiffusion((x,), [-x], [[1]], [x + v], Noise((v,)), [1], [[1]], step=0.05)
"""


def test_the_commands_take_time_stamps(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.py").write_text(MODEL)
    grid = "1700000000:1700000000.3:0.1"
    assert main(["design", "model.py", "--memory", "estimates=1", "--times", grid, "--paths", "500",
                 "--nodes", "1", "--out", "f.npz"]) == 0  # fmt: skip
    assert "measurements 4, from" in capsys.readouterr().out
    rows = "t,y1\n1700000000,1\n1700000000.05,\n1700000000.1,1\n1700000000.2,1\n1700000000.3,1\n"
    (tmp_path / "data.csv").write_text(rows)
    assert main(["filter", "f.npz", "data.csv", "--model", "model.py", "--out", "x.csv"]) == 0
    assert capsys.readouterr().out == "5 rows written to x.csv\n"
