"""``seedslib design`` for sensors that are not always there."""

import numpy as np
import pytest

from seedslib.commands.cli import main
from seedslib.commands.models import load_model
from seedslib.commands.schedules import as_schedule
from seedslib.design import synthesize
from seedslib.designed import Memory, load
from seedslib.linearization import Taylor

PAIR = """
import sympy as sp
from seedslib.models import DiscreteSystem, Noise, StochasticMap
x, q, v, w = sp.symbols("x q v w")
system = DiscreteSystem(
    StochasticMap([x], [.9 * x + q], Noise([q])),
    StochasticMap([x], [x + v, x - w], Noise([v, w])), [0], [[1]],
)
times = range(6)
"""
MODES = "from seedslib import zoo\nsystem = zoo.manoeuvring_target('noisy')\n"
TOLD = ["--memory", "estimates=1", "--linearization", "taylor", "--paths", "1000", "--out", "f.npz"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pair.py").write_text(PAIR)
    (tmp_path / "modes.py").write_text(MODES)


def test_the_design_is_that_of_python_and_its_records_have_deviations(tmp_path, capsys):
    more = ["--availability", "0.8,1", "--measured", "y2=0:4:2"]
    assert main(["design", "pair.py", *TOLD, *more]) == 0
    said = capsys.readouterr().out
    assert "schedule     9 of 12 components are read" in said
    assert "availability 0.8, 1; up to" in said
    system = load_model("pair.py").known
    mask = np.ones((6, 2), dtype=bool)
    mask[[1, 3, 5], 1] = False
    other = synthesize(system, Memory(1), Taylor(), range(6), paths=1000, seed=0, measured=mask,
                       availability=[0.8, 1.0])  # fmt: skip
    made = load("f.npz", system)
    assert np.array_equal(made.measured, mask)
    assert all(np.array_equal(a.covs, b.covs) for a, b in zip(made.fits, other.fits, strict=True))
    (tmp_path / "d.csv").write_text("t,y1,y2\n0,1,2\n1,,\n2,,1\n3,1,\n4,0,0\n5,1,\n")
    assert main(["filter", "f.npz", "d.csv", "--model", "pair.py", "--out", "x.csv"]) == 0
    rows = [line.split(",") for line in (tmp_path / "x.csv").read_text().splitlines()]
    deviation = [name.startswith("sd") for name in rows[0]].index(True)
    assert all(float(row[deviation]) > 0 for row in rows[1:])


def test_modes_and_one_schedule_for_all():
    told = ["--times", "0:1:1", "--availability", "0.9"]
    assert main(["design", "modes.py", *TOLD, *told]) == 0
    system = load_model("modes.py").known
    assert load("f.npz", system).availability.tolist() == [0.9, 0.9]
    times = np.arange(4.0)
    assert as_schedule(["0:3:2"], times, system).tolist() == [[True] * 2, [False] * 2] * 2
    found = as_schedule(["indicator=0,3", "y1=1,2"], times, system)
    assert found.T.tolist() == [[False, True, True, False], [True, False, False, True]]


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (["--availability", "often"], "availability: wanted a probability such as 0.9"),
        (["--availability", "0.9,1.2"], "availability: wanted a probability such as 0.9"),
        (["--availability", "0.9,1,1"], "availability: wanted a probability, or 2 of them"),
        (["--measured", "y3=0:4:2"], "measured: wanted times for all, or once for some of y1, y2"),
        (["--measured", "0:4:2", "y1=0,1"], "measured: wanted times for all, or once for some"),
        (["--measured", "y1=0:4"], "measured: times: wanted start:stop:step"),
        (["--measured", "0,2.5"], "measured: wanted measurement times of the design, got 2.5"),
        (["--availability", "0.9", "--table", "y=-3:3:9"], "table: wanted without availability"),
    ],
)
def test_what_does_not_fit_is_refused(told, said, capsys):
    assert main(["design", "pair.py", *TOLD, *told]) != 0
    assert said in capsys.readouterr().err
