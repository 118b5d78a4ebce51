"""A notebook run over a grid of parameters: the table, what fails, what goes on after a kill."""

import os
import signal
import subprocess
import sys
import time

import nbformat
import pytest
from dask.distributed import LocalCluster

from bookkit import execution, run_sweep


@pytest.fixture
def notebook(project):
    return project / "notebooks" / "tiny.ipynb"


@pytest.fixture(scope="module")
def scheduler():
    """Address of a scheduler with one worker, which was started by hand."""
    quiet = {"dashboard_address": None, "silence_logs": 50, "processes": False}
    quiet |= {"protocol": "tcp://", "host": "127.0.0.1"}
    with LocalCluster(n_workers=1, threads_per_worker=1, **quiet) as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def sweep(project, notebook, scheduler):
    """Function that runs the notebook over a grid."""

    def run(grid, **options):
        (project / "grid.yaml").write_text(f"grid: {grid}\n")
        options = {"scheduler": scheduler, **options}
        return run_sweep(notebook, project / "grid.yaml", project / "out", **options)

    return run


def prepend(notebook, code):
    """Put code before that of the cell that computes."""
    content = nbformat.read(notebook, as_version=4)
    content.cells[3].source = code + content.cells[3].source
    nbformat.write(content, notebook)


def test_a_sweep_makes_a_tidy_table_and_a_second_one_runs_nothing(project, sweep, capsys):
    table = sweep("{gain: [3.0], count: [2, 3]}")
    assert [*table] == ["gain", "count", "terms_0", "terms_1", "total", "terms_2", "problem"]
    known = table[["gain", "count", "total"]].to_numpy().tolist()
    assert known == [[3, 2, 4], [3, 3, 13]]
    assert table.loc[1, ["terms_0", "terms_1", "terms_2"]].tolist() == [1.0, 3.0, 9.0]
    before = (project / "out" / "results.csv").read_bytes()
    assert b"\n3.0,2,1.0,3.0,4.0,,\n" in before
    sweep("{gain: [3.0], count: [2, 3]}")
    assert "2 points, 2 already done" in capsys.readouterr().out
    assert (project / "out" / "results.csv").read_bytes() == before
    (project / "requirements.lock").write_text("")
    sweep("{gain: [1.0]}")
    assert "1 points, 0 already done" in capsys.readouterr().out


SPOILT = {  # what a point does, and what is said of it; the others go on
    7.0: ("pass", "ArithmeticError: seven is out of reach"),
    6.0: ("import os; os._exit(1)", "Kernel died"),
}


def test_points_that_fail_keep_their_message_and_run_again(notebook, sweep, capsys):
    prepend(notebook, "".join(f"if gain == {g}:\n    {code}\n" for g, (code, _) in SPOILT.items()))
    for already in (0, 1):
        table = sweep(f"{{gain: {[*SPOILT, 2.0]}, count: [1]}}")
        assert f"{already} already done" in capsys.readouterr().out
        for problem, (_, message) in zip(table["problem"], SPOILT.values(), strict=False):
            assert message in problem
        assert table["total"].isna().tolist() == [True] * len(SPOILT) + [False]
        assert table["problem"].iloc[-1] == ""


def test_a_killed_sweep_goes_on(project, notebook, sweep, capsys):
    go = project / "go"
    wait = f"if gain > 1.0 and not os.path.exists({str(go)!r}):\n    time.sleep(60)\n"
    prepend(notebook, f"import os\nimport time\n\n{wait}")
    (project / "grid.yaml").write_text("grid: {gain: [1.0, 2.0], count: [1]}")
    command = [sys.executable, "-m", "bookkit", "sweep", notebook, project / "grid.yaml"]
    first = subprocess.Popen(
        [*map(str, command), "--out", str(project / "out"), "--workers", "1"],
        cwd=project,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 300
    while not list((project / "out").glob("*.ipynb")):
        assert time.monotonic() < deadline, "no point was finished in time"
        time.sleep(0.1)
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    go.touch()
    table = sweep("{gain: [1.0, 2.0], count: [1]}")
    assert "2 points, 1 already done" in capsys.readouterr().out
    assert table["total"].tolist() == [1.0] * 2


def test_data_files_travel_with_the_notebook_and_are_part_of_a_point(project, notebook, sweep):
    source, data = notebook.with_suffix(".md"), project / "data.csv"
    data.write_text("2.5\n")
    text = source.read_text().replace("kernelspec:", "inputs: [data.csv]\nkernelspec:", 1)
    code = 'from bookkit import record\n\nrecord(read=float(open("../data.csv").read()))\n'
    source.write_text(text + "\n```{code-cell} ipython3\n" + code + "```\n")
    assert execution.execute(project) == {"tiny.md": ""}
    assert sweep("{gain: [1.0]}")["read"].tolist() == [2.5]
    data.write_text("3.5\n")
    assert sweep("{gain: [1.0]}")["read"].tolist() == [3.5]


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ("{gian: [1.0]}", "gian"),
        ("{gain: [1.0, 'two', -3.0]}", "gain = 'two'.*gain = -3.0"),
        ("{gain: [.nan]}", "gain"),
        ("{gain: [1.0]}\nnotebook: notebooks/other.md", r"other\.md"),
        ("[1.0]", "grid"),
    ],
)
def test_a_bad_grid_is_refused_before_anything_runs(project, sweep, grid, message):
    with pytest.raises(ValueError, match=message):
        sweep(grid)
    assert not (project / "out").exists()
