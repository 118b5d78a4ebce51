"""``python -m seedslib design`` and ``filter``: what they write, and what they refuse."""

import json
import sys

import numpy as np
import pytest

from seedslib import zoo
from seedslib.commands import words
from seedslib.commands.cli import main
from seedslib.commands.models import load_model
from seedslib.design import Affine, Continuous, Polynomial, synthesize
from seedslib.designed import Memory, finite_memory, large_order, load
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Unscented

LINEAR = """
import sympy
from seedslib.models import JumpDiffusion, Noise

x, v = sympy.symbols("x v")

def system():
    return JumpDiffusion((x,), [-x], [[1]], [x + v], Noise((v,)), [1], [[1]], step=0.05)

times = [0, 0.5, 1.0]
"""
TARGET = """
from seedslib import zoo
system = zoo.van_der_pol()
"""
CHEAP = ["--paths", "600", "--nodes", "1"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "linear.py").write_text(LINEAR)
    (tmp_path / "target.py").write_text(TARGET)
    return tmp_path


@pytest.fixture
def table(folder):
    """A table of the linear model."""
    axes = ["--table", "y=-12:12:5", "z=-9:9:5"]
    assert main(["design", "linear.py", "--memory", "estimates=1", *CHEAP, *axes,
                 "--out", "table.npz"]) == 0  # fmt: skip
    return folder / "table.npz"


# The round trip


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_designed_and_run_from_the_command_line(capsys, write, read):
    code = main(
        ["design", "target.py", "--memory", "estimates=1,measurements=1", "--times", "0:1.5:0.5",
         "--linearization", "unscented:1,2,0", "--predictor", "polynomial:2,1", "--seed", "7",
         "--components", "1", "--workers", "2", *CHEAP, "--out", "target.npz"]
    )  # fmt: skip
    assert code == 0
    system = zoo.van_der_pol()
    expected = synthesize(
        system, Memory(1, 1), Unscented(1, 2, 0), 0.5 * np.arange(4), predictor=Polynomial(2, 1),
        paths=600, nodes=1, seed=7, components=1,
    )  # fmt: skip
    assert capsys.readouterr().out == f"{expected}\nwritten to target.npz\n"
    y = system.simulate([0.0, 0.25, 0.5, 1.0], 1, 3, measured=[0, 2, 3]).measurements[..., 0]
    y[2, 1] = np.nan
    cells = [["" if np.isnan(v) else repr(v) for v in row] for row in y.tolist()]
    rows = [",".join([t, *row]) for t, row in zip(("0", ".25", "0.5", "1"), cells, strict=True)]
    write("data.csv", "\n".join(["t,y1,y2", *rows]) + "\n")
    assert main(["filter", "target.npz", "data.csv", "--model", "target.py", "--out", "x.csv"]) == 0
    assert capsys.readouterr().out == "4 rows written to x.csv\n"
    found = expected.run([0.0, 0.25, 0.5, 1.0], y, covariances=True)
    names, *rows = read("x.csv")
    assert names == ["t", "x1", "sd1"]
    assert [float(row[0]) for row in rows] == [0.0, 0.25, 0.5, 1.0]
    assert [float(row[1]) for row in rows] == found.mean[:, 0].tolist()
    assert rows[1][2] == ""
    assert float(rows[0][2]) == pytest.approx(np.sqrt(found.cov[0, 0, 0]), rel=1e-15)
    # the design knows of no gaps: nothing is claimed from the first one on
    assert [rows[j][2] for j in (2, 3)] == ["", ""]


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_a_table_runs_from_its_file_alone(table, capsys, write, read, refused):
    write("data.csv", "t,y1\n0,1.5\n0.25,\n0.5,\n1,-0.25\n")
    assert main(["filter", "table.npz", "data.csv", "--out", "alone.csv"]) == 0
    assert main(["filter", "table.npz", "data.csv", "--model", "linear.py", "--out", "b.csv"]) == 0
    assert read("alone.csv") == read("b.csv")
    names, *rows = read("alone.csv")
    assert names == ["t", "x1", "sd1"]
    # everything is linear: the table gives what the filter gives
    system = load_model("linear.py").system
    plain = synthesize(system, Memory(1), ExactGaussian(), [0, 0.5, 1], paths=600, seed=0, nodes=1)
    y = np.array([[1.5], [np.nan], [np.nan], [-0.25]])
    expected = plain.run([0, 0.25, 0.5, 1], y).mean[:, 0]
    np.testing.assert_allclose([float(row[1]) for row in rows], expected, atol=1e-12)
    # a deviation is claimed at measurements, up to the first that is missing
    assert [row[2] != "" for row in rows] == [True, False, False, False]
    assert "another model" in refused(
        capsys, main, "filter", table, "data.csv", "--model", "target.py", "--out", "c.csv"
    )


def test_a_filter_that_evaluates_its_sensor_wants_the_model(capsys, write, refused):
    assert main(["design", "linear.py", "--memory", "small_order", *CHEAP, "--out", "f.npz"]) == 0
    write("data.csv", "t,y1\n0,1\n")
    told = refused(capsys, main, "filter", "f.npz", "data.csv", "--out", "x.csv")
    assert "f.npz: this filter evaluates its model" in told
    assert "--model" in told
    assert main(["filter", "f.npz", "data.csv", "--model", "linear.py", "--out", "x.csv"]) == 0


def test_files_hold_no_code(table, header):
    """The header has the model's text as a label, never read back; the rest is numbers."""
    with np.load(table, allow_pickle=False) as archive:
        parts = {name: archive[name] for name in archive.files}
    known = json.loads(parts.pop("header").tobytes())
    assert {part.dtype.str for part in parts.values()} == {"<f8", "|u1"}
    assert known["model"]["drift"] == "[-x]"
    header(table, "model", drift="[__import__('os').abort()]")
    assert load(table).order == 1
    assert load(table, load_model("linear.py").system).order == 1


def test_without_the_extras_of_the_book(folder, command, write, read):
    """Both commands work, and a command of the book says what it wants."""
    write("data.csv", "t,y1\n0,1\n0.5,0\n")
    write(
        "bare.py",
        """
import sys

for name in ("papermill", "dask", "distributed", "pydantic", "yaml", "nbformat", "nbclient",
             "jupytext", "matplotlib", "IPython", "bs4", "sklearn"):
    sys.modules[name] = None
from bookkit.cli import main as book
from seedslib.commands.cli import main

for command in (
    "design linear.py --memory finite_memory:2 --paths 600 --nodes 1 --out f.npz",
    "filter f.npz data.csv --model linear.py --out x.csv",
    "sweep a.ipynb b.yaml --out c",
):
    run = book if command.startswith("sweep") else main
    print("code", run(command.split()))
""",
    )
    done = command(folder, "bare.py")
    codes = [line for line in done.stdout.splitlines() if line.startswith("code")]
    assert codes == ["code 0", "code 0", "code 2"]
    assert done.stderr.count("\n") == 1
    assert done.stderr.endswith("is not installed; this command wants the extra 'book'\n")
    assert len(read("x.csv")) == 3


# What is refused


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "wanted the first row t,y1, got an empty file"),
        ("0,1\n", "wanted the first row t,y1, got 0,1"),
        ("t,y1,y2\n0,1,2\n", "wanted the first row t,y1, got t,y1,y2"),
        ("t,y1\n", "wanted a row for each measurement, got none"),
        ("t,y1\n0,1\n\n0.5,1,3\n", "row 4: wanted 2 cells, got 3"),
        ("t,y1\n0,one\n", "row 2, column y1: wanted a number, got 'one'"),
        ("t,y1\n0,1\n0.5,inf\n", "row 3, column y1: wanted a finite number, got 'inf'"),
        ("t,y1\n,1\n", "row 2, column t: wanted a finite number, got ''"),
        ("t,y1\n0,1\n0.5,1\n0.5,1\n", "row 4, column t: wanted a time after 0.5, got 0.5"),
        ("t,y1\n0.5,1\n", "row 2: t = 0.5 comes after the measurement time 0 of the design"),
        ("t,y1\n0,1\n1,1\n", "row 3: t = 1 comes after the measurement time 0.5 of the design"),
        ("t,y1\n0,1\n0.3,1\n", "row 3: t = 0.3 is no measurement time of the design (the "
         "nearest is 0.5)"),
        ("t,y1\n-1,\n0,1\n", "row 2: t = -1 is no measurement time"),
        ("t,y1\n0,1\n0.5,1\n1,1\n2,\n", "row 5: t = 2 is no measurement time"),
        ('t,y1\n0,"1\n', "not a CSV file"),
    ],
)  # fmt: skip
def test_bad_records_are_refused_by_row(table, capsys, text, message, write, refused):
    write("data.csv", text)
    told = refused(capsys, main, "filter", table, "data.csv", "--out", "x.csv")
    assert "data.csv" in told
    assert message in told


def test_bad_files_are_refused_by_name(table, folder, capsys, write, refused):
    write("data.csv", "t,y1\n0,1\n")
    arguments = ("data.csv", "--out", "x.csv")
    assert "none.npz" in refused(capsys, main, "filter", "none.npz", *arguments)
    assert "none.csv" in refused(capsys, main, "filter", table, "none.csv", "--out", "x.csv")
    assert "nowhere" in refused(capsys, main, "filter", table, "data.csv", "--out", "nowhere/x.csv")
    told = refused(capsys, main, "filter", "data.csv", *arguments)
    assert "data.csv: not a designed filter" in told
    assert "not a text file" in refused(capsys, main, "filter", table, table, "--out", "x.csv")
    content = table.read_bytes()
    table.write_bytes(content[: len(content) // 2])
    assert "damaged or cut short" in refused(capsys, main, "filter", table, *arguments)
    assert not (folder / "x.csv").exists()


def test_a_measurement_that_the_memory_wants(capsys, write, refused):
    axes = ["--table", "y=-6:6:5"]
    assert main(["design", "linear.py", "--memory", "measurements=1", *CHEAP, *axes,
                 "--out", "m.npz"]) == 0  # fmt: skip
    write("data.csv", "t,y1\n0,1\n0.5,\n")
    told = refused(capsys, main, "filter", "m.npz", "data.csv", "--out", "x.csv")
    assert "data.csv: y: wanted a measurement, it is to be remembered" in told


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = (", "SyntaxError: '(' was never closed (line 1)"),
        ("\n\nx = 1 / 0\n", "ZeroDivisionError: division by zero (line 3)"),
        (
            "def system():\n    return missing\n",
            "'missing' is not defined (line 2)",
        ),
        ("import no_such_thing\n", "No module named 'no_such_thing' (line 1)"),
        ("x = 1\n", "wanted a JumpDiffusion, DiscreteSystem or SwitchingSystem called"),
        ("system = 3\n", "got int"),
        (TARGET + "times = [0, 0]\n", "times: wanted strictly increasing times"),
        (TARGET, "wanted --times, or `times` in model.py; got neither"),
    ],
)
def test_bad_models_are_refused_in_one_line(capsys, text, message, write, refused):
    write("model.py", text)
    told = refused(capsys, main, "design", "model.py", "--memory", "estimates=1", "--out", "f.npz")
    assert "model.py" in told
    assert message in told


def test_a_model_may_import_its_neighbour(folder, write):
    write("neighbour.py", TARGET)
    write("model.py", "from neighbour import system\ntimes = (0, 1)\n")
    before = list(sys.path)
    system, times, *_ = load_model(folder / "model.py")
    assert sys.path == before
    assert system.state_size == 2
    assert times.tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--memory", "estimates"], "memory: wanted such as estimates=2"),
        (["--memory", "estimates=0"], "memory: wanted at least one estimate or measurement"),
        (["--memory", "large_order:0"], "l: wanted at least 1, got 0"),
        (["--linearization", "magic"], "linearization: wanted one of taylor, gaussian"),
        (["--linearization", "cubature:3"], "linearization: wanted one of"),
        (["--predictor", "polynomial:0"], "mean_degree: wanted at least 1, got 0"),
        (["--times", "0:1"], "times: wanted start:stop:step or a list"),
        (["--times", "0:1:0"], "times: wanted start:stop:step or a list"),
        (["--times", "1,0"], "times: wanted strictly increasing times"),
        (["--table", "z=0:1:3"], "table: wanted y=low:high:count too"),
        (["--table", "y=1:0:3"], "table: wanted y=low:high:count z=low:high:count"),
        (["--table", "y=0:1:3", "z=0:1:3,0:1:3"], "z: wanted 1 axes, got 2"),
        (["--components", "2"], "components: wanted 1 to 1, got 2"),
        (["--paths", "2"], "paths: wanted more than"),
        (["--seed", "-1"], "seed: wanted a whole number from 0 on, got -1"),
        (["--nodes", "-1"], "nodes: wanted at least 0, got -1"),
        (["--out", "nowhere/f.npz"], "out: no such folder as nowhere"),
    ],
)
def test_options_that_do_not_fit(capsys, options, message, refused):
    given = ["--memory", "estimates=1", *CHEAP, "--out", "f.npz", *options]
    assert message in refused(capsys, main, "design", "linear.py", *given)


def test_words():
    assert words.as_memory("estimates=2") == Memory(2)
    assert (
        words.as_memory("measurements=4") == finite_memory(4) == words.as_memory("finite_memory:4")
    )
    assert words.as_memory("measurements=1,estimates=2") == Memory(2, 1)
    assert words.as_memory("large_order:3") == large_order(3)
    assert words.as_memory("small_order") == Memory(1)
    from seedslib import design as making

    rule = words.linearization_of

    def predictor(text):
        return words.as_choice("predictor", text, words.PREDICTORS, making)

    assert rule("gauss-hermite:7") == GaussHermite(7)
    assert rule("cubature") == Cubature()
    assert rule("unscented:0.5,2,1") == Unscented(0.5, 2, 1)
    assert predictor("affine") == Affine()
    assert predictor("polynomial:3,1") == Polynomial(3, 1)
    assert predictor("continuous") == Continuous()
    assert words.as_time_grid("0:3:0.1")[-1] == pytest.approx(3.0, abs=1e-15)
    assert len(words.as_time_grid("0:3:0.1")) == 31
    assert words.as_time_grid("0:1:0.3") == pytest.approx([0, 0.3, 0.6, 0.9])
    assert words.as_time_grid("0,0.5,2").tolist() == [0, 0.5, 2]
