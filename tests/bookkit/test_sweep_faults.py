"""A sweep loses a worker, its scheduler, the disk, or meets another one: what is finished stays."""

import csv
import errno
import json
import os
import signal
import time
from contextlib import contextmanager

import dask
import pytest

from bookkit import recording, run_sweep, sweeps
from bookkit.cli import main
from bookkit.points import library_of

pytestmark = pytest.mark.usefixtures("kernels_at_once")


def rows(folder):
    with (folder / "results.csv").open() as file:
        return [(float(r["gain"]), r["total"], r["problem"]) for r in csv.DictReader(file)]


@pytest.fixture
def sweep(project):
    """Notebook, grid of four points and folder of a sweep."""
    (project / "grid.yaml").write_text("grid: {gain: [1.0, 2.0, 3.0, 4.0]}")
    return project / "notebooks" / "tiny.ipynb", project / "grid.yaml", project / "out"


def answer(text, gain):
    """What a point brings back, without a kernel."""
    shown = {recording.MIME: {"values": {"total": 10.0 * gain}}}
    outputs = [{"output_type": "display_data", "data": shown, "metadata": {}}]
    notebook = {"cells": [{"cell_type": "code", "source": "", "outputs": outputs}]}
    library = library_of(json.loads(text))
    return {"notebook": json.dumps(notebook), "problem": "", "library": library}


WHOLE = [(gain, str(10.0 * gain), "") for gain in (1.0, 2.0, 3.0, 4.0)]


@pytest.fixture
def here(monkeypatch):
    """Points are finished here, one after the other; a test may look in between."""
    between = []

    class Future:
        def __init__(self, text, point):
            self.text, self.point = text, point

        def result(self):
            for look in between:
                look(self.point)
            return answer(self.text, self.point["gain"])

        def cancelled(self):
            return False

        def release(self):
            pass

    class Client:
        submit = staticmethod(lambda work, text, point, *_, **__: Future(text, point))

    @contextmanager
    def client(*_):
        yield Client

    monkeypatch.setattr(sweeps, "_client", client)
    monkeypatch.setattr("dask.distributed.as_completed", list)
    return between


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("name", "good"), [*(("replace", good) for good in range(10)), ("fsync", 3), ("fsync", 8)]
)
def test_a_full_disk_costs_nothing_that_was_finished(
    sweep, monkeypatch, capsys, refused, name, good
):
    done, left, out = getattr(os, name), [good], sweep[2]

    def full(*arguments):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(arguments[-1]))
        return done(*arguments)

    # two files for each point, and the table: the disk is full at each of them in turn
    monkeypatch.chdir(sweep[0].parents[1])
    monkeypatch.setattr(os, name, full)
    arguments = ["sweep", *sweep[:2], "--out", out]
    assert main([str(a) for a in arguments]) == (2 if good < 9 else 0)
    told = capsys.readouterr().err.splitlines()[-1]
    assert good == 9 or told.startswith("bookkit: [Errno 28] No space left on device")
    monkeypatch.setattr(os, name, done)
    kept = len(list(out.glob("*.json")))
    assert kept == min(4, good // 2)
    assert not [p for p in out.iterdir() if p.name.endswith(".part")]
    report = run_sweep(*sweep, quiet=True)
    assert (report.already, report.failed) == (kept, 0)
    assert rows(out) == WHOLE


def test_two_sweeps_in_one_folder(sweep, here):
    """The second begins in the middle of the first and ends before it: neither loses a point."""
    _, grid, out = sweep
    seen = []

    def other(point):
        if point["gain"] == 3.0 and not seen:
            seen.append(len(list(out.glob("*.json"))))
            report = run_sweep(*sweep, quiet=True)
            seen.append((report.total, report.already, report.failed))
            seen.append((out / "results.csv").read_bytes())

    here.append(other)
    report = run_sweep(*sweep, quiet=True)
    assert seen[:2] == [2, (4, 2, 0)]
    assert (report.total, report.failed) == (4, 0)
    assert (out / "results.csv").read_bytes() == seen[2]
    assert rows(out) == WHOLE
    grid.write_text("grid: {gain: [1.0, 2.0]}")  # and another grid in the same folder
    assert run_sweep(*sweep, quiet=True).already == 2
    assert rows(out) == WHOLE[:2]
    assert len(list(out.glob("*.json"))) == 4


def test_a_worker_that_is_lost_costs_no_other_point(sweep, tmp_path, monkeypatch):
    """Point 3 kills its worker each time, and others may wait beside it for their turn."""
    text, began = sweep[0].read_text(), tmp_path / "began"
    answers = {gain: answer(text, gain) for gain in (1.0, 2.0, 3.0, 4.0)}

    def point(text, parameters, *_):
        gain = parameters["gain"]
        with began.open("a") as file:
            file.write(f"{gain} ")
        if gain == 3.0:
            os.kill(os.getpid(), signal.SIGKILL)
        return answers[gain]

    monkeypatch.setattr(sweeps, "execute_point", point)
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        report = run_sweep(*sweep, quiet=True, workers=1)
    assert report.failed == 1
    lost = (3.0, "", "its worker was lost again and again")
    assert rows(sweep[2]) == [lost if row[0] == 3.0 else row for row in WHOLE]
    assert began.read_text().split().count("3.0") == 2


def test_a_scheduler_that_is_lost_costs_nothing_that_was_finished(sweep, monkeypatch):
    from dask.distributed import LocalCluster

    text, written = sweep[0].read_text(), sweeps.replace
    answers = {gain: answer(text, gain) for gain in (1.0, 2.0, 3.0, 4.0)}

    def point(text, parameters, *_):
        time.sleep(1.0 if parameters["gain"] == 3.0 else 0.0)
        return answers[parameters["gain"]]

    def replace(path, text):
        written(path, text)
        if path.suffix == ".json":
            cluster.scheduler.loop.add_callback(cluster.scheduler.close)

    monkeypatch.setattr(sweeps, "execute_point", point)
    monkeypatch.setattr(sweeps, "replace", replace)
    monkeypatch.setattr("seedslib.extra.dask_crew.CONNECT", 1.0)
    quiet = {"dashboard_address": None, "silence_logs": 50, "processes": False}
    hurry = dask.config.set({"distributed.comm.timeouts.connect": "1s"})
    with (
        hurry,
        LocalCluster(n_workers=1, threads_per_worker=1, **quiet) as cluster,
    ):
        address = cluster.scheduler_address
        with pytest.raises(ValueError, match="the scheduler was lost; what was finished is kept"):
            run_sweep(*sweep, quiet=True, scheduler=address)
    kept = len(list(sweep[2].glob("*.json")))
    assert 1 <= kept < 4
    left = json.loads(next(iter(sweep[2].glob("*.json"))).read_text())
    assert left["values"] == {"total": 10.0 * left["parameters"]["gain"]}
