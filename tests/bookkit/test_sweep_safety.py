"""A sweep listens to this machine only, and takes nothing into its table that is not its own."""

import ipaddress
import json
import os
import socket
from pathlib import Path

import nbformat
import pytest
from attempts.sockets import family, is_local, listening

from bookkit import kept, recording, run_sweep, sweeps

pytestmark = pytest.mark.usefixtures("kernels_at_once")

linux = pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="the sockets of Linux")


@linux
def test_the_look_at_sockets_sees_an_open_door():
    with socket.socket() as door, socket.socket(socket.AF_INET6) as other:
        door.bind(("0.0.0.0", 0))
        door.listen()
        other.bind(("::1", 0))
        other.listen()
        found = listening([os.getpid()])
        assert ipaddress.ip_address("0.0.0.0") in found
        assert ipaddress.ip_address("::1") in found
        assert [is_local(a) for a in map(ipaddress.ip_address, ("127.0.0.1", "::", "::1"))] == [
            True, False, True,
        ]  # fmt: skip


@linux
def test_a_sweep_listens_on_the_loopback_only(recwarn):
    before = len(listening([os.getpid()]))
    with sweeps._client(None, 2) as client:
        client.wait_for_workers(2)
        pids = family(os.getpid())
        found = listening(pids)
        assert len(pids) >= 3
        assert len(found) >= before + 4  # scheduler, workers and the page of each
        assert [str(address) for address in found if not is_local(address)] == []
    assert [str(w.message) for w in recwarn if "already in use" in str(w.message)] == []


# What is taken into the table


@pytest.fixture
def notebook(project):
    return project / "notebooks" / "tiny.ipynb"


@pytest.fixture
def grid(project):
    path = project / "grid.yaml"
    path.write_text("grid: {gain: [1.0, 3.0], count: [2]}")
    return path


@pytest.mark.parametrize(
    ("payload", "problem"),
    [
        ([1, 2], "wanted a mapping, got [1, 2]"),
        ("text", "wanted a mapping"),
        ({"values": [1]}, "values: wanted a mapping"),
        ({"claims": {"A": 1}}, "claim A: wanted a mapping"),
        ({"values": {"deep": {"a": 1}}}, "deep: wanted a number"),
        ({"values": {"nested": [[1]]}}, "nested: wanted a number"),
    ],
)
def test_a_record_of_another_shape_is_the_problem_of_its_point(payload, problem):
    result = {"notebook": json.dumps(recorded(payload)), "problem": ""}
    entry = kept.entry_of({"gain": 1.0}, result)
    assert entry["values"] == {}
    assert entry["problem"].startswith("ValueError: a record of another shape: ")
    assert problem in entry["problem"]


def recorded(payload):
    outputs = [{"output_type": "display_data", "data": {recording.MIME: payload}, "metadata": {}}]
    return {"cells": [{"cell_type": "code", "source": "", "outputs": outputs}]}


def test_and_the_other_points_go_on(project, grid, notebook):
    content = nbformat.read(notebook, as_version=4)
    content.cells[3].source = (
        "if gain == 3.0:\n    from IPython.display import display\n"
        f"    display({{{recording.MIME!r}: {{'values': [1]}}}}, raw=True)\n"
        + content.cells[3].source
    )
    nbformat.write(content, notebook)
    report = run_sweep(notebook, grid, project / "out", quiet=True, workers=1)
    assert report.failed == 1
    lines = report.table.read_text().splitlines()
    assert lines[1].startswith("1.0,2,")
    assert "a record of another shape: values: wanted a mapping" in lines[2]


def test_points_that_were_changed_by_hand_are_refused(project, grid, notebook):
    out = project / "out"
    run_sweep(notebook, grid, out, quiet=True, workers=1)
    table = (out / "results.csv").read_bytes()
    one, other = sorted(out.glob("*.json"))
    texts = [one.read_text(), other.read_text()]

    def again(wrong):
        with pytest.raises(ValueError, match=wrong):
            run_sweep(notebook, grid, out, quiet=True, workers=1)
        assert (out / "results.csv").read_bytes() == table
        one.write_text(texts[0])
        other.write_text(texts[1])

    one.write_text(texts[1])
    other.write_text(texts[0])
    again(r"\.json: wanted the point \{.*\}, got another; remove the file")
    edited = json.loads(texts[0])
    edited["parameters"]["gain"] = 2.0
    one.write_text(json.dumps(edited))
    again("wanted the point")
    edited = json.loads(texts[0])
    edited["values"]["total"] += 1e-9
    one.write_text(json.dumps(edited))
    again("was changed after the point was run; remove the file")
    edited["values"]["total"] = float("nan")
    one.write_text(json.dumps(kept.sealed(edited)))
    again("total: wanted a finite number, got nan; remove the file")
    report = run_sweep(notebook, grid, out, quiet=True, workers=1)
    assert (report.already, report.failed) == (2, 0)
    assert (out / "results.csv").read_bytes() == table
