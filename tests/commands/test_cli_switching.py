"""``python -m seedslib design`` and ``filter`` for systems of several modes."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.commands import words
from seedslib.commands.cli import main
from seedslib.design import grid_synthesis, stationary, synthesize
from seedslib.designed import Memory, large_order, save
from seedslib.linearization import Taylor

TARGET = """
from seedslib import zoo
system = zoo.manoeuvring_target("noisy")
times = range(4)
"""
SCALAR = """
from seedslib import zoo

def system():
    return zoo.scalar_switching("A1H")
"""
CHEAP = ["--paths", "3000", "--linearization", "taylor"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "target.py").write_text(TARGET)
    (tmp_path / "scalar.py").write_text(SCALAR)
    return tmp_path


@pytest.mark.filterwarnings("ignore:paths")
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_designed_and_run_with_indicators_some_missing(capsys, write, read):
    assert main(["design", "target.py", "--memory", "estimates=1,indicators=0,log_odds", *CHEAP,
                 "--seed", "3", "--out", "target.npz"]) == 0  # fmt: skip
    system = zoo.manoeuvring_target("noisy")
    memory = Memory(1, log_odds=True)
    expected = synthesize(system, memory, Taylor(), np.arange(4.0), paths=3000, seed=3)
    assert capsys.readouterr().out == f"{expected}\nwritten to target.npz\n"
    write("data.csv", "t,y1,j\n0,0.5,0\n1,,1\n2,-1.25,\n3,4,1\n")
    assert main(["filter", "target.npz", "data.csv", "--model", "target.py", "--out", "x.csv"]) == 0
    assert capsys.readouterr().out == "4 rows written to x.csv\n"
    found = expected.run(
        np.arange(4.0), np.array([[0.5], [np.nan], [-1.25], [4.0]]),
        indicators=np.array([0, 1, -1, 1]), covariances=True,
    )  # fmt: skip
    names, *rows = read("x.csv")
    assert names == ["t", "mode", "p1", "p2", "x1", "x2", "sd1", "sd2"]
    assert [row[1] for row in rows] == [str(mode) for mode in found.modes]
    numbers = np.array([[cell or "nan" for cell in row] for row in rows], dtype=float)
    np.testing.assert_array_equal(numbers[:, 2:4], found.mode_prob)
    np.testing.assert_array_equal(numbers[:, 4:6], found.mean)
    deviations = np.sqrt(np.diagonal(found.cov, axis1=1, axis2=2))
    np.testing.assert_allclose(numbers[:, 6:], deviations, rtol=1e-15)


def test_remembered_indicators(capsys, write, refused):
    assert main(["design", "target.py", "--memory", "measurements=1,indicators=1", *CHEAP,
                 "--out", "f.npz"]) == 0  # fmt: skip
    assert "1 measurement, 1 indicator" in capsys.readouterr().out
    write("data.csv", "t,y1,j\n0,1,\n")
    told = refused(
        capsys, main, "filter", "f.npz", "data.csv", "--model", "target.py", "--out", "x.csv"
    )
    assert "data.csv: indicator: wanted by the memory, got a missing one" in told


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_tables_without_their_model_and_filters_that_last(folder, write, read):
    grid = {"x": (-8, 8, 81), "z": (-6, 6, 31), "y": (-16, 18, 69)}
    system = zoo.scalar_switching("A1H")
    made = grid_synthesis(system, large_order(1), np.arange(3.0), **grid)
    save(made, folder / "table.npz")
    write("data.csv", "t,y1\n0,1.5\n1,\n2,-0.25\n")
    assert main(["filter", "table.npz", "data.csv", "--out", "x.csv"]) == 0
    names, *rows = read("x.csv")
    found = made.run(np.arange(3.0), np.array([[1.5], [np.nan], [-0.25]]))
    assert names[:2] == ["t", "mode"]
    assert [int(row[1]) for row in rows] == found.modes.tolist()
    at = names.index("x1")
    assert [float(row[at]) for row in rows] == found.mean[:, 0].tolist()
    lasting = synthesize(system, large_order(1), Taylor(), np.arange(8.0), paths=8000, seed=1)
    save(stationary(lasting, 0.5), folder / "lasting.npz")
    write("long.csv", "t,y1\n" + "".join(f"{t},{t % 3}\n" for t in range(12)))
    assert (
        main(["filter", "lasting.npz", "long.csv", "--model", "scalar.py", "--out", "y.csv"]) == 0
    )
    assert len(read("y.csv")) == 13


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,y1\n0,1\n", "wanted the first row t,y1,j, got t,y1"),
        ("t,y1,j\n0,1,2\n", "row 2, column j: wanted an indicator j from 0 to 1, got 2"),
        ("t,y1,j\n0,1,0.5\n", "row 2, column j: wanted an indicator j from 0 to 1, got 0.5"),
        ("t,y1,j\n0,1,0\n1,1,-1\n", "row 3, column j: wanted an indicator j from 0 to 1, got -1"),
        ("t,y1,j\n0,1,0\n0.5,,\n", "row 3: t = 0.5 is no measurement time of the design (the "
         "nearest is 0)\n"),
        ("t,y1,j\n0,1,0\n1,1,0\n2,1,0\n3,1,0\n4,1,0\n", "row 6: t = 4 is no measurement time"),
        ("t,y1,j\n0,1,0\n2,1,0\n", "row 3: t = 2 comes after the measurement time 1"),
    ],
)  # fmt: skip
def test_bad_records_are_refused_by_row(folder, capsys, text, message, write, refused):
    system = zoo.manoeuvring_target("noisy")
    made = synthesize(system, large_order(1), Taylor(), np.arange(4.0), paths=3000, seed=1)
    save(made, folder / "f.npz")
    write("data.csv", text)
    told = refused(
        capsys, main, "filter", "f.npz", "data.csv", "--model", "target.py", "--out", "x.csv"
    )
    assert message in told


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--nodes", "2"], "nodes: wanted none for a switching system"),
        (["--predictor", "affine"], "predictor: wanted none for a switching system"),
        (["--components", "1"], "components: wanted none for a switching system"),
        (["--table", "y=-1:1:3"], "table: wanted none for a switching system"),
        (["--memory", "log_odds"], "memory: wanted at least one estimate or measurement"),
        (["--memory", "indicators=1"], "memory: wanted at least one estimate or measurement"),
        (["--memory", "estimates=1,log_odds,log_odds"], "memory: wanted such as"),
    ],
)
def test_options_that_do_not_fit(capsys, options, message, refused):
    given = ["--memory", "estimates=1", *CHEAP, "--out", "f.npz", *options]
    assert message in refused(capsys, main, "design", "target.py", *given)


def test_indicators_are_not_remembered_where_there_are_none(capsys, refused):
    told = refused(
        capsys, main, "design", "scalar.py", "--memory", "estimates=1,indicators=1",
        "--times", "0:2:1", *CHEAP, "--out", "f.npz",
    )  # fmt: skip
    assert "memory: wanted no indicators" in told


def test_words_of_memories_with_modes():
    assert words.as_memory("estimates=2,indicators=1") == Memory(2, indicators=1)
    assert words.as_memory("log_odds,estimates=1") == Memory(1, log_odds=True)
