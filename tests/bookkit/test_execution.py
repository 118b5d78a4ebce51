"""Text notebooks become executed ones, and only those whose inputs changed."""

import json
import threading
import time
from pathlib import Path

import pytest

import seedslib
from bookkit import execution
from bookkit.__main__ import main
from bookkit.recording import read_records


@pytest.fixture
def source(project):
    return project / "notebooks" / "tiny.md"


def stamp_of(source):
    return json.loads(source.with_suffix(".ipynb").read_text())["metadata"]["seedslib"]


def test_two_runs_give_the_same_bytes_and_what_is_up_to_date_is_not_run(project, source):
    target = source.with_suffix(".ipynb")
    before = target.read_bytes()
    assert not execution.is_stale(source)
    assert execution.execute(project) == {}
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
        spoil(source.with_suffix(".ipynb"), '"bookkit.recording"', '"bookkit.no_such_file"')
    else:
        source.with_suffix(".ipynb").write_text("{")
    assert execution.is_stale(source)
    assert main(["execute", "--check"]) == 1
    assert "tiny.md: its inputs changed" in capsys.readouterr().out


def test_the_modules_that_were_imported_are_inputs(source):
    library = stamp_of(source)["library"]
    assert {"bookkit.recording", "seedslib.base"} <= set(library)
    assert "bookkit.sweeps" not in library
    contents = execution.library_contents()
    before = execution.library_digest(library, contents)
    assert execution.library_digest(library, contents | {"bookkit.sweeps": b""}) == before
    assert execution.library_digest(library, contents | {"bookkit.recording": b""}) != before


def test_words_of_a_module_are_no_input_and_what_it_does_is(tmp_path, monkeypatch):
    module = tmp_path / "module.py"
    monkeypatch.setattr(execution, "PACKAGES", {"package": tmp_path})

    def contents(text):
        module.write_text(text)
        return execution.library_contents()

    before = contents('"""Words."""\n\n\ndef f(x):\n    """More."""\n    return 2 * x\n')
    assert contents("def f(x):\n    return 2 * x  # no word\n") == before
    assert contents("def f(x):\n    return 3 * x\n") != before


def test_files_that_programs_are_written_with_belong_to_their_package():
    contents = execution.library_contents()
    package = Path(seedslib.__file__).parent / "export"
    assert (package / "lanes.c").read_bytes() in contents["seedslib.export.__init__"]


def test_a_data_file_that_the_notebook_names_is_an_input(project, source, spoil):
    spoil(source, "kernelspec:", "inputs: [data.csv]\nkernelspec:")
    assert "data.csv" in execution.execute(project)["tiny.md"]
    (project / "data.csv").write_text("1\n")
    assert execution.execute(project)["tiny.md"] == ""
    assert not execution.is_stale(source)
    (project / "data.csv").write_text("2\n")
    assert execution.is_stale(source)


CODE = "if gain == 7.0:"


FAILING = {  # what is put in place of what, and what is said of it
    "raises": ("= 2.0", "= 7.0", "ArithmeticError: seven is out of reach"),
    "parameter": ("= 2.0", "= -2.0", "ValueError: bad parameters: gain = -2.0"),
    "dies": (CODE, f"import os; os._exit(1)\n{CODE}", "Kernel died"),
    "warns": (
        CODE,
        f"import sys; print('beware', file=sys.stderr)\n{CODE}",
        "cell 3 wrote to stderr: beware",
    ),
    "header": ("kernelspec:", "inputs: [\nkernelspec:", "failed"),
}


def test_failing_notebooks_say_why_and_leave_the_old_results(project, source):
    text, before = source.read_text(), source.with_suffix(".ipynb").read_bytes()
    for name, (old, new, _) in FAILING.items():
        assert old in text
        source.with_name(f"{name}.md").write_text(text.replace(old, new))
        source.with_name(f"{name}.ipynb").write_bytes(before)
    source.with_name("other.md").write_text("# Nothing\n")
    outcomes = execution.execute(project)
    assert outcomes.pop("other.md") == ""
    assert set(outcomes) == {f"{name}.md" for name in FAILING}
    for name, (*_, problem) in FAILING.items():
        assert problem in outcomes[f"{name}.md"]
        assert source.with_name(f"{name}.ipynb").read_bytes() == before


def test_a_source_that_changes_while_it_runs_does_not_pass_for_executed(project, source, spoil):
    wait = "import pathlib, time\npathlib.Path('../started').write_text('')\ntime.sleep(1)\n"
    spoil(source, CODE, wait + CODE)

    def edit():
        while not (project / "started").exists():
            time.sleep(0.05)
        source.write_text(source.read_text() + "\nMore")

    thread = threading.Thread(target=edit)
    thread.start()
    assert execution.execute(project) == {"tiny.md": ""}
    thread.join()
    assert execution.is_stale(source)
