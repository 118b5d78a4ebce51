"""A notebook run over a grid of parameters: the table, what fails, what goes on after a kill."""

import csv
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
        options = {"quiet": True, "scheduler": scheduler, **options}
        return run_sweep(notebook, project / "grid.yaml", project / "out", **options)

    return run


def rows(report):
    with report.table.open() as file:
        return list(csv.DictReader(file))


def prepend(notebook, code):
    """Put code before that of the cell that computes."""
    content = nbformat.read(notebook, as_version=4)
    content.cells[3].source = code + content.cells[3].source
    nbformat.write(content, notebook)


def test_a_sweep_makes_a_tidy_table_and_a_second_one_runs_nothing(project, sweep):
    report = sweep("{gain: [1.0, 3.0], count: [2, 3]}")
    assert (report.total, report.already, report.failed) == (4, 0, 0)
    table = [[float(r[name]) for name in ("gain", "count", "total")] for r in rows(report)]
    assert table == [[1, 2, 2], [1, 3, 3], [3, 2, 4], [3, 3, 13]]
    assert [float(rows(report)[3][f"terms_{k}"]) for k in range(3)] == [1.0, 3.0, 9.0]
    assert len(list((project / "out").glob("*.ipynb"))) == 4
    before = report.table.read_bytes()
    again = sweep("{gain: [1.0, 3.0], count: [2, 3]}")
    assert again.already == 4
    assert again.table.read_bytes() == before
    (project / "requirements.lock").write_text("")
    assert sweep("{gain: [1.0]}").already == 0


SPOILT = {  # what a point does, and what is said of it; the others go on
    7.0: ("pass", "ArithmeticError: seven is out of reach"),
    6.0: ("import os; os._exit(1)", "Kernel died"),
}


def test_points_that_fail_keep_their_message_and_run_again(notebook, sweep):
    prepend(notebook, "".join(f"if gain == {g}:\n    {code}\n" for g, (code, _) in SPOILT.items()))
    grid = f"{{gain: {[*SPOILT, 2.0]}, count: [1]}}"
    for already in (0, 1):
        report = sweep(grid)
        assert (report.already, report.failed) == (already, len(SPOILT))
        *bad, good = rows(report)
        for row, (gain, (_, problem)) in zip(bad, SPOILT.items(), strict=True):
            assert float(row["gain"]) == gain
            assert problem in row["problem"]
            assert row["total"] == ""
        assert (good["total"], good["problem"]) == ("1.0", "")


def test_a_killed_sweep_goes_on(project, notebook, sweep):
    go = project / "go"
    wait = f"if gain > 1.0 and not os.path.exists({str(go)!r}):\n    time.sleep(60)\n"
    prepend(notebook, f"import os\nimport time\n\n{wait}")
    (project / "grid.yaml").write_text("grid: {gain: [1.0, 2.0, 3.0], count: [1]}")
    command = [sys.executable, "-m", "bookkit", "sweep", notebook, project / "grid.yaml"]
    first = subprocess.Popen(
        [*map(str, command), "--out", str(project / "out"), "--workers", "1"],
        cwd=project,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 90
    while not list((project / "out").glob("*.ipynb")):
        assert time.monotonic() < deadline, "no point was finished in time"
        time.sleep(0.1)
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    go.touch()
    report = sweep("{gain: [1.0, 2.0, 3.0], count: [1]}")
    assert (report.total, report.already, report.failed) == (3, 1, 0)
    assert [float(r["total"]) for r in rows(report)] == [1.0] * 3


def test_data_files_travel_with_the_notebook_and_are_part_of_a_point(project, notebook, sweep):
    source, data = notebook.with_suffix(".md"), project / "data.csv"
    data.write_text("2.5\n")
    text = source.read_text().replace("kernelspec:", "inputs: [data.csv]\nkernelspec:", 1)
    code = 'from bookkit import record\n\nrecord(read=float(open("../data.csv").read()))\n'
    source.write_text(text + "\n```{code-cell} ipython3\n" + code + "```\n")
    assert [o.problem for o in execution.execute(project)] == [""]
    assert float(rows(sweep("{gain: [1.0]}"))[0]["read"]) == 2.5
    data.write_text("3.5\n")
    assert float(rows(sweep("{gain: [1.0]}"))[0]["read"]) == 3.5


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
