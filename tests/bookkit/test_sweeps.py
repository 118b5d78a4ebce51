import contextlib
import csv
import json
import os
import signal
import socket
import subprocess
import sys
import time
from types import SimpleNamespace

import nbformat
import pytest

from bookkit import execution, kept, run_sweep, sweeps
from bookkit.cli import main
from bookkit.points import execute_point

pytestmark = pytest.mark.usefixtures("kernels_at_once")

GRID = "grid:\n  gain: [1.0, 3.0]\n  count: [2, 3]\n"


def rows(table):
    with table.open() as file:
        return list(csv.DictReader(file))


@pytest.fixture
def grid(project):
    path = project / "grid.yaml"
    path.write_text(GRID)
    return path


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Address of a scheduler that was started by hand, and a worker too."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    folder = tmp_path_factory.mktemp("by_hand")
    common = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    dask = [sys.executable, "-m", "dask"]
    scheduler = subprocess.Popen(
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"], **common
    )
    alone = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--preload", "forked_kernels"]
    worker = subprocess.Popen([*dask, "worker", address, *alone], **common)
    yield address
    for process in (worker, scheduler):
        process.terminate()
        process.wait(30)


def notebook(project):
    return project / "notebooks" / "tiny.ipynb"


def test_a_sweep_makes_a_tidy_table_and_a_second_one_runs_nothing(project, grid, capsys):
    report = run_sweep(notebook(project), grid, project / "out", quiet=True)
    assert "4 points, 0 already done, 4 to run" in capsys.readouterr().out
    assert (report.total, report.already, report.failed) == (4, 0, 0)
    table = rows(report.table)
    assert [(float(r["gain"]), int(r["count"]), float(r["total"])) for r in table] == [
        (1.0, 2, 2.0),
        (1.0, 3, 3.0),
        (3.0, 2, 4.0),
        (3.0, 3, 13.0),
    ]
    assert [float(table[3][f"terms_{k}"]) for k in range(3)] == [1.0, 3.0, 9.0]
    assert len(list((project / "out").glob("*.ipynb"))) == 4
    before = report.table.read_bytes()
    again = run_sweep(notebook(project), grid, project / "out", quiet=True)
    assert "4 points, 4 already done, 0 to run" in capsys.readouterr().out
    assert again.table.read_bytes() == before


def test_a_changed_notebook_or_lock_makes_new_points(project, grid, served, capsys):
    out = project / "out"
    grid.write_text("grid: {gain: [1.0]}\n")
    run_sweep(notebook(project), grid, out, quiet=True, scheduler=served)
    (project / "requirements.lock").write_text("")
    run_sweep(notebook(project), grid, out, quiet=True, scheduler=served)
    assert capsys.readouterr().out.count("1 points, 0 already done, 1 to run") == 2


def test_a_failed_point_keeps_its_message_and_the_others_go_on(project, grid, served, capsys):
    grid.write_text("grid: {gain: [7.0, 2.0]}\n")
    out = project / "out"
    report = run_sweep(notebook(project), grid, out, quiet=True, scheduler=served)
    assert report.failed == 1
    assert [r["problem"] for r in rows(report.table)] == [
        "ArithmeticError: seven is out of reach",
        "",
    ]
    run_sweep(notebook(project), grid, out, quiet=True, scheduler=served)
    assert "2 points, 2 already done (1 of them failed), 0 to run" in capsys.readouterr().out
    run_sweep(notebook(project), grid, out, quiet=True, retry=True, scheduler=served)
    assert "2 points, 1 already done, 1 to run" in capsys.readouterr().out


def test_after_a_kill_the_finished_points_are_there(project, served, capsys, monkeypatch):
    slow, go = nbformat.read(notebook(project), as_version=4), project / "go"
    wait = f"if gain > 1.0 and not os.path.exists({str(go)!r}):\n    time.sleep(60)\n"
    slow.cells[3].source = f"import os\nimport time\n\n{wait}" + slow.cells[3].source
    nbformat.write(slow, notebook(project))
    grid = project / "grid.yaml"
    grid.write_text("grid: {gain: [1.0, 2.0, 3.0, 4.0], count: [1]}\n")
    arguments = [sys.executable, "-m", "bookkit", "sweep", str(notebook(project)), str(grid)]
    arguments += ["--out", str(project / "out"), "--workers", "1"]
    first = subprocess.Popen(
        arguments, cwd=project, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 90
    while not list((project / "out").glob("*.json")):
        assert time.monotonic() < deadline, "no point was finished in time"
        time.sleep(0.1)
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    assert len(list((project / "out").glob("*.json"))) == 1
    go.touch()
    monkeypatch.chdir(project)
    assert main([*arguments[3:-2], "--scheduler", served]) == 0
    assert "4 points, 1 already done, 3 to run" in capsys.readouterr().out
    assert [float(r["total"]) for r in rows(project / "out" / "results.csv")] == [1.0] * 4


def test_a_scheduler_and_workers_started_by_hand_serve_it(project, grid, served):
    report = run_sweep(notebook(project), grid, project / "out", scheduler=served, quiet=True)
    assert report.failed == 0
    assert float(rows(report.table)[3]["total"]) == 13.0


def test_missing_files_and_addresses_are_named(project, grid):
    with pytest.raises(ValueError, match=r"absent\.ipynb"):
        run_sweep(project / "absent.ipynb", grid, project / "out")
    with pytest.raises(ValueError, match=r"absent\.yaml"):
        run_sweep(notebook(project), project / "absent.yaml", project / "out")
    with pytest.raises(ValueError, match="workers"):
        run_sweep(notebook(project), grid, project / "out", workers=0)
    (project / "empty.ipynb").write_text("no notebook")
    with pytest.raises(ValueError, match="not a notebook"):
        run_sweep(project / "empty.ipynb", grid, project / "out")


def test_an_unreachable_scheduler_is_named(project, grid, monkeypatch):
    monkeypatch.setattr("seedslib.extra.dask_crew.CONNECT", 0.5)
    with pytest.raises(ValueError, match=r"nothing answers at tcp://127\.0\.0\.1:9"):
        run_sweep(
            notebook(project), grid, project / "out", scheduler="tcp://127.0.0.1:9", quiet=True
        )


def test_a_kernel_keeps_the_memory_of_its_arrays(project, monkeypatch):
    """What Dask tells its workers would cost a notebook full of arrays half of its speed."""
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    content = nbformat.read(notebook(project), as_version=4)
    content.cells[3].source = "import os\n\nassert 'MALLOC_TRIM_THRESHOLD_' not in os.environ"
    assert execute_point(nbformat.writes(content), {"gain": 1.0})["problem"] == ""


def test_a_point_that_cannot_start_says_why(project):
    result = execute_point("{}", {"gain": 1.0})
    assert result["problem"]
    assert json.loads(json.dumps(result)) == result


SPOILT = {
    3.0: (
        "from bookkit import record; record(total=1.0)",
        "ValueError: total is recorded twice in one notebook",
    ),
    4.0: (
        "from bookkit import record; record(gain=99.0)",
        "ValueError: gain: the name of another column of the table",
    ),
    5.0: (
        "from bookkit import record; record(terms_0=1.0)",
        "ValueError: terms_0: the name of another column of the table",
    ),
    6.0: ("import os; os._exit(1)", "DeadKernelError: Kernel died"),
}


def test_points_that_spoil_their_records_fail_alone(project, grid, served):
    content = nbformat.read(notebook(project), as_version=4)
    spoilt = [f"if gain == {gain}:\n    {code}\n" for gain, (code, _) in SPOILT.items()]
    content.cells[3].source = "".join(spoilt) + content.cells[3].source
    nbformat.write(content, notebook(project))
    grid.write_text("grid: {gain: [3.0, 4.0, 5.0, 6.0, 2.0], count: [1]}")
    report = run_sweep(notebook(project), grid, project / "out", quiet=True, scheduler=served)
    assert report.failed == 4
    table = rows(report.table)
    assert [r["problem"] for r in table] == [*(problem for _, problem in SPOILT.values()), ""]
    assert [float(r["gain"]) for r in table] == [3.0, 4.0, 5.0, 6.0, 2.0]
    assert [r["total"] for r in table] == ["", "", "", "", "1.0"]


@pytest.mark.parametrize("text", ["", "{", "{}", "[]", "null", '{"values": {}, "problem": null}'])
def test_what_is_not_whole_in_the_folder_is_not_taken_for_a_point(tmp_path, text):
    (tmp_path / "key.json").write_text(text)
    assert kept.read_entry(tmp_path, "key", {}) is None


def test_a_folder_that_cannot_hold_the_results_is_named(project, grid):
    (project / "file").write_text("")
    (project / "full" / "results.csv").mkdir(parents=True)
    for out in ("file", "file/below", "full"):
        with pytest.raises(ValueError, match=rf"{out}.*: wanted a f"):
            run_sweep(notebook(project), grid, project / out, quiet=True)


def test_a_grid_for_another_notebook_is_refused(project, grid):
    grid.write_text("notebook: notebooks/other.md\n" + GRID)
    with pytest.raises(ValueError, match=r"is for notebooks/other\.md, not for .*tiny\.ipynb"):
        run_sweep(notebook(project), grid, project / "out", quiet=True)


def test_points_that_a_lost_scheduler_cancelled_are_not_kept_as_failed(project, tmp_path):
    class Cancelled:
        def result(self):
            raise RuntimeError("scheduler-connection-lost")

        def cancelled(self):
            return True

    client = SimpleNamespace(submit=lambda *_, **__: Cancelled())
    text = notebook(project).read_text()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dask.distributed.as_completed", lambda running: list(running))
        with pytest.raises(ValueError, match="the scheduler was lost"):
            sweeps._run(client, text, {}, {"key": {"gain": 1.0}}, tmp_path, True)
    assert not list(tmp_path.glob("*.json"))


def test_another_sweep_on_this_machine_is_no_hindrance(project, grid, recwarn):
    grid.write_text("grid: {gain: [1.0]}")
    with socket.socket() as taken:
        with contextlib.suppress(OSError):
            taken.bind(("", 8787))
            taken.listen()
        report = run_sweep(notebook(project), grid, project / "out", quiet=True, workers=1)
    assert report.failed == 0
    assert [str(w.message) for w in recwarn if "already in use" in str(w.message)] == []


def test_data_files_travel_with_the_notebook(project, grid, served):
    """Named in the front matter, they are where the notebook looks for them, on any worker."""
    source = project / "notebooks" / "tiny.md"
    (project / "data").mkdir()
    (project / "data" / "terms.csv").write_text("2.5\n")
    text = source.read_text().replace("kernelspec:", "inputs: [data/terms.csv]\nkernelspec:", 1)
    code = 'from bookkit import record\n\nrecord(told=float(open("../data/terms.csv").read()))\n'
    source.write_text(text + "\n```{code-cell} ipython3\n" + code + "```\n")
    assert [o.problem for o in execution.execute(project)] == [""]
    grid.write_text("grid: {gain: [1.0]}\n")
    report = run_sweep(notebook(project), grid, project / "out", quiet=True, scheduler=served)
    assert (report.total, report.failed) == (1, 0)
    assert float(rows(report.table)[0]["told"]) == 2.5
    (project / "data" / "terms.csv").write_text("3.5\n")
    again = run_sweep(notebook(project), grid, project / "out", quiet=True, scheduler=served)
    assert again.already == 0
    assert float(rows(again.table)[0]["told"]) == 3.5
    (project / "data" / "terms.csv").unlink()
    with pytest.raises(ValueError, match=r"wanted its input data/terms\.csv"):
        run_sweep(notebook(project), grid, project / "out", quiet=True)
