"""What goes wrong while a command runs is said in one line: divergence, a model that exits."""

import csv

import numpy as np
import pytest

from seedslib.commands.cli import main

SCALAR = """
import sympy as sp
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, v, w = sp.symbols("x v w")
system = DiscreteSystem(
    StochasticMap((x,), [x + sp.sin(x) / 2 + v], Noise((v,), cov=[[.3]])),
    StochasticMap((x,), [sp.exp(x) + w], Noise((w,))), [0], [[1]],
)
times = [0, 1, 2, 3, 4]
"""
MODES = """
import sympy as sp
from seedslib.models import Noise, SwitchingSystem

x, v, w = sp.symbols("x v w")
system = SwitchingSystem(
    (x,), [[x + sp.sin(x) / 2 + v]] * 2, Noise((v,), cov=[[.3]]), [[.9, .1], [.1, .9]],
    [[sp.exp(x) + w], [x + w]], Noise((w,)), [(.5, [0], [[1]])] * 2,
)
times = [0, 1, 2, 3, 4]
"""
RECORD = "t,y1\n0,.9\n1,{}\n2,.2\n3,.3\n4,.1\n"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scalar.py").write_text(SCALAR)
    (tmp_path / "modes.py").write_text(MODES)
    return tmp_path


def designed(model, *options):
    arguments = ["--memory", "estimates=1", "--paths", "2000"]
    assert main(["design", f"{model}.py", *arguments, *options, "--out", "f.npz"]) == 0


def filtered(model, outlier, capsys):
    with open("o.csv", "w") as file:
        file.write(RECORD.format(outlier))
    capsys.readouterr()
    code = main(["filter", "f.npz", "o.csv", "--model", f"{model}.py", "--out", "x.csv"])
    with open("x.csv", newline="") as file:
        return code, capsys.readouterr(), list(csv.DictReader(file))


def test_a_filter_that_diverges_says_so(capsys, recwarn):
    designed("scalar", "--nodes", "0")
    code, told, rows = filtered("scalar", "1e6", capsys)
    empty = [row["t"] for row in rows if row["x1"] == ""]
    assert empty
    assert empty == [row["t"] for row in rows][-len(empty) :]
    assert code == 1
    assert told.out == "5 rows written to x.csv\n"
    assert told.err == (
        f"seedslib: o.csv: the filter diverged: {len(empty)} of 5 rows are no numbers, the first "
        f"at t = {float(empty[0]):g}\n"
    )
    assert not [w for w in recwarn if issubclass(w.category, RuntimeWarning)]
    code, told, rows = filtered("scalar", "1.1", capsys)
    assert (code, told.err) == (0, "")
    assert all(np.isfinite(float(row["x1"])) for row in rows)


@pytest.mark.filterwarnings("ignore:paths", "ignore:covariances")
def test_and_so_does_a_filter_of_modes(capsys):
    designed("modes", "--linearization", "taylor")
    code, told, rows = filtered("modes", "1e200", capsys)
    empty = [row for row in rows if row["x1"] == ""]
    assert empty
    assert code == 1
    assert f"the filter diverged: {len(empty)} of 5 rows are no numbers" in told.err
    assert told.err.count("\n") == 1
    assert all(row["mode"] == row["p1"] == row["p2"] == "" for row in empty)
    code, told, rows = filtered("modes", "1.1", capsys)
    assert (code, told.err) == (0, "")
    assert all(row["mode"] in "01" for row in rows)


@pytest.mark.parametrize("leave", ["sys.exit(3)", "raise SystemExit('no')", "exit(3)", "quit()"])
def test_a_model_that_ends_the_program_is_a_fault_of_the_model(folder, capsys, refused, leave):
    (folder / "bad.py").write_text(f"import sys\n{leave}\n")
    told = refused(capsys, main, "design", "bad.py", "--memory", "estimates=1", "--out", "f.npz")
    assert "bad.py: wanted a file that runs to its end, got sys.exit(" in told
    assert "(line 2)" in told


@pytest.mark.parametrize("cell", ["1_000", "1_0.5", "_1"])
def test_a_number_with_an_underscore_is_none(folder, capsys, refused, cell):
    designed("scalar", "--nodes", "0")
    (folder / "o.csv").write_text(RECORD.format(cell))
    told = refused(
        capsys, main, "filter", "f.npz", "o.csv", "--model", "scalar.py", "--out", "x.csv"
    )
    assert f"o.csv, row 3, column y1: wanted a number, got '{cell}'" in told
