"""Text notebooks become executed ones, and only those whose inputs changed."""

import json
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context

import pytest

from bookkit import execution, fingerprint
from bookkit.cli import main
from bookkit.recording import read_records

pytestmark = pytest.mark.usefixtures("kernels_at_once")


@pytest.fixture
def source(project):
    return project / "notebooks" / "tiny.md"


@pytest.fixture(scope="module")
def pool():
    """Two processes that are kept: they import what executes a notebook once."""
    with ProcessPoolExecutor(max_workers=2, mp_context=get_context("spawn")) as kept:
        yield kept


@pytest.fixture
def kept(pool, monkeypatch):
    """Notebooks of this test are executed by processes that have executed others."""
    monkeypatch.setattr(execution, "ProcessPoolExecutor", lambda **_: nullcontext(pool))


def stamp_of(source):
    return json.loads(source.with_suffix(".ipynb").read_text())["metadata"]["seedslib"]


@pytest.mark.usefixtures("kept")
def test_two_runs_give_the_same_bytes_and_what_is_up_to_date_is_not_run(project, source):
    target = source.with_suffix(".ipynb")
    before = target.read_bytes()
    assert not execution.is_stale(source)
    assert execution.execute(project) == []
    execution.execute(project, force=True)
    assert target.read_bytes() == before
    records = read_records(json.loads(before))
    assert records.values == {"total": 7.0, "terms": [1.0, 2.0, 4.0]}
    assert records.claims["TS-X1"]["verdict"] == "reproduced"


@pytest.mark.parametrize("part", ["notebook", "lock", "ledger", "library", "result"])
def test_a_changed_input_makes_a_notebook_stale(project, source, part, capsys, monkeypatch, spoil):
    monkeypatch.chdir(project)
    if part == "notebook":
        source.write_text(source.read_text() + "\nMore.\n")
    elif part == "lock":
        (project / "requirements.lock").write_text("nothing==1.1\n")
    elif part == "ledger":
        spoil(project / "book" / "claims.yml", "make 7", "make seven")
    elif part == "library":
        spoil(source.with_suffix(".ipynb"), '"bookkit/recording.py"', '"bookkit/no_such_file.py"')
    else:
        source.with_suffix(".ipynb").write_text("{")
    assert execution.is_stale(source)
    assert main(["execute", "--check"]) == 1
    assert "notebooks/tiny.md: its inputs changed" in capsys.readouterr().out


def test_the_library_files_that_were_imported_are_inputs(project, source, monkeypatch):
    assert "bookkit/recording.py" in stamp_of(source)["library"]
    assert "bookkit/sweeps.py" not in stamp_of(source)["library"]
    monkeypatch.setattr(fingerprint, "PACKAGES", {"lib": project})
    hashes = []
    for text in ("1\n", "2\n", "1\n"):
        (project / "part.py").write_text(text)
        hashes.append(fingerprint.library_digest(["lib/part.py"]))
    assert hashes[0] == hashes[2] != hashes[1]


@pytest.mark.usefixtures("kept")
def test_a_data_file_that_the_notebook_names_is_an_input(project, source, spoil):
    spoil(source, "kernelspec:", "inputs: [data.csv]\nkernelspec:")
    assert "no such input: data.csv" in execution.execute(project)[0].problem
    (project / "data.csv").write_text("1\n")
    assert execution.execute(project)[0].problem == ""
    assert not execution.is_stale(source)
    (project / "data.csv").write_text("2\n")
    assert execution.is_stale(source)


CODE = "if gain == 7.0:"


@pytest.mark.usefixtures("kept")
@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("= 2.0", "= 7.0", "cell 3: ArithmeticError: seven is out of reach"),
        ("= 2.0", "= -2.0", "cell 2: ValueError: bad parameters: gain = -2.0"),
        (CODE, f"import os; os._exit(1)\n{CODE}", "cell 3: Kernel died"),
        (
            CODE,
            f"import sys; print('beware', file=sys.stderr)\n{CODE}",
            "cell 3 wrote to stderr: beware",
        ),
        ("kernelspec:", "inputs: [\nkernelspec:", "tiny.md is no text notebook"),
    ],
)
def test_a_failing_notebook_names_its_cell_and_leaves_the_old_result(
    project, source, old, new, problem, spoil
):
    target, other = source.with_suffix(".ipynb"), source.with_name("other.md")
    before = target.read_bytes()
    other.write_text("# Nothing\n")
    spoil(source, old, new)
    outcomes = {o.source.name: o.problem for o in execution.execute(project)}
    assert problem in outcomes["tiny.md"]
    assert target.read_bytes() == before
    assert outcomes["other.md"] == ""


@pytest.mark.usefixtures("kept")
@pytest.mark.parametrize("change", ["edited", "removed"])
def test_a_source_that_changes_while_it_runs_does_not_pass_for_executed(
    project, source, change, spoil
):
    wait = "import pathlib, time\npathlib.Path('../started').write_text('')\ntime.sleep(1)\n"
    spoil(source, CODE, wait + CODE)

    def act():
        while not (project / "started").exists():
            time.sleep(0.05)
        source.unlink() if change == "removed" else source.write_text(source.read_text() + "\nMore")

    thread = threading.Thread(target=act)
    thread.start()
    [outcome] = execution.execute(project)
    thread.join()
    assert ("removed" in outcome.problem) == (change == "removed")
    assert change == "removed" or execution.is_stale(source)
