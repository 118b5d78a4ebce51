import json
import os
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context

import pytest

from bookkit import execution, files, fingerprint
from bookkit.recording import read_records

pytestmark = pytest.mark.usefixtures("kernels_at_once")


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


def test_two_runs_give_the_same_bytes(project):
    target = source(project).with_suffix(".ipynb")
    before = target.read_bytes()
    execution.execute(project, force=True)
    assert target.read_bytes() == before
    assert "version" not in json.loads(before)["metadata"]["language_info"]


def test_what_is_up_to_date_is_not_executed(project):
    assert not execution.is_stale(source(project))
    assert execution.execute(project) == []


@pytest.mark.parametrize("part", ["notebook", "lock", "library list", "result"])
def test_a_changed_input_makes_it_stale(project, part):
    target = source(project).with_suffix(".ipynb")
    if part == "notebook":
        source(project).write_text(source(project).read_text() + "\nMore.\n")
    elif part == "lock":
        (project / "requirements.lock").write_text("nothing==1.1\n")
    elif part == "library list":
        notebook = json.loads(target.read_text())
        notebook["metadata"]["seedslib"]["library"].append("no_such_file.py")
        target.write_text(json.dumps(notebook))
    else:
        target.write_text("{")
    assert execution.is_stale(source(project))


@pytest.mark.usefixtures("kept")
def test_a_data_file_that_the_notebook_names_is_an_input(project):
    text = source(project).read_text().replace("kernelspec:", "inputs: [data.csv]\nkernelspec:")
    source(project).write_text(text)
    (project / "data.csv").write_text("1\n")
    assert execution.execute(project)[0].problem == ""
    assert not execution.is_stale(source(project))
    (project / "data.csv").write_text("2\n")
    assert execution.is_stale(source(project))


def test_the_library_files_that_were_imported_are_inputs(project):
    stamp = json.loads(source(project).with_suffix(".ipynb").read_text())["metadata"]["seedslib"]
    assert "bookkit/recording.py" in stamp["library"]
    assert "bookkit/sweeps.py" not in stamp["library"]


@pytest.mark.usefixtures("kept")
def test_a_failing_notebook_names_its_cell_and_leaves_the_old_result(project):
    target = source(project).with_suffix(".ipynb")
    before = target.read_bytes()
    source(project).write_text(
        source(project).read_text().replace("gain: float = 2.0", "gain: float = 7.0")
    )
    [outcome] = execution.execute(project)
    assert outcome.problem == "failed: cell 3: ArithmeticError: seven is out of reach"
    assert target.read_bytes() == before


@pytest.mark.usefixtures("kept")
def test_bad_parameters_fail_with_one_clear_message(project):
    text = source(project).read_text().replace("gain: float = 2.0", "gain: float = -2.0")
    source(project).write_text(text.replace("count: int = 3", "count: int = 9"))
    [outcome] = execution.execute(project)
    assert "cell 2: ValueError: bad parameters: gain = -2.0" in outcome.problem
    assert "count = 9" in outcome.problem


@pytest.mark.usefixtures("kept")
def test_noise_on_stderr_is_refused(project):
    text = (
        source(project)
        .read_text()
        .replace("total = sum", "import sys; print('beware', file=sys.stderr)\ntotal = sum")
    )
    source(project).write_text(text)
    assert "wrote to stderr: beware" in execution.execute(project)[0].problem


def test_a_missing_notebook_is_named(project):
    with pytest.raises(ValueError, match=r"absent\.md"):
        execution.execute(project, [str(project / "notebooks" / "absent.ipynb")])


def test_records_survive_execution(project):
    notebook = json.loads(source(project).with_suffix(".ipynb").read_text())
    records = read_records(notebook)
    assert records.values == {"total": 7.0, "terms": [1.0, 2.0, 4.0]}
    assert records.claims["TS-X1"]["verdict"] == "reproduced"


def test_the_commands_say_what_is_stale(project, command):
    assert "up to date" in command(project, "-m", "bookkit", "execute", "--check").stdout
    (project / "requirements.lock").write_text("")
    done = command(project, "-m", "bookkit", "execute", "--check")
    assert done.returncode == 1
    assert "notebooks/tiny.md: its inputs changed" in done.stdout


def test_outside_a_project_the_command_says_so(tmp_path, command):
    done = command(tmp_path, "-m", "bookkit", "execute")
    assert done.returncode == 2
    assert done.stderr.startswith("bookkit: no requirements.lock")


def insert(project, code):
    text = source(project).read_text()
    source(project).write_text(text.replace("if gain == 7.0:", code + "\nif gain == 7.0:"))


def while_running(project, action):
    """Run the notebook, and do something to its project in the middle of it."""
    insert(
        project, "import pathlib, time\npathlib.Path('../started').write_text('')\ntime.sleep(2)"
    )

    def act():
        while not (project / "started").exists():
            time.sleep(0.05)
        action()

    thread = threading.Thread(target=act)
    thread.start()
    [outcome] = execution.execute(project)
    thread.join()
    return outcome.problem


@pytest.mark.usefixtures("kept")
def test_a_source_that_is_edited_while_it_runs_is_stale_afterwards(project):
    def edit():
        source(project).write_text(source(project).read_text() + "\nMore.\n")

    assert while_running(project, edit) == ""
    assert execution.is_stale(source(project))


def test_a_library_that_is_edited_while_it_runs_is_stale_afterwards(project, monkeypatch):
    (project / "lib").mkdir()
    (project / "lib" / "part.py").write_text("1\n")
    monkeypatch.setattr(fingerprint, "PACKAGES", {"lib": project / "lib"})
    at_start = execution._inputs(source(project))
    (project / "lib" / "part.py").write_text("2\n")
    now = execution._inputs(source(project))
    assert at_start(["lib/part.py"]) != now(["lib/part.py"])
    (project / "lib" / "part.py").write_text("1\n")
    assert at_start(["lib/part.py"]) == execution._inputs(source(project))(["lib/part.py"])
    (project / "lib" / "part.py").unlink()
    assert at_start(["lib/part.py"]) != execution._inputs(source(project))(["lib/part.py"])


@pytest.mark.usefixtures("kept")
def test_a_source_that_is_removed_while_it_runs_is_said(project):
    target = source(project).with_suffix(".ipynb")
    before = target.read_bytes()
    assert while_running(project, source(project).unlink) == (
        "failed: its source was removed while it ran"
    )
    assert target.read_bytes() == before


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("kernelspec:", "inputs: data.csv\nkernelspec:", "wanted a list of file names"),
        ("kernelspec:", "inputs: [data.csv]\nkernelspec:", "no such input: data.csv"),
        ("kernelspec:", "inputs: [\nkernelspec:", "tiny.md is no text notebook"),
    ],
)
@pytest.mark.usefixtures("kept")
def test_a_faulty_header_is_the_outcome_of_that_notebook_alone(project, old, new, message):
    text = source(project).read_text()
    other = source(project).with_name("other.md")
    other.write_text(text + "\nMore.\n")
    source(project).write_text(text.replace(old, new))
    assert execution.is_stale(source(project))
    outcomes = {o.source.name: o.problem for o in execution.execute(project)}
    assert message in outcomes["tiny.md"]
    assert outcomes["other.md"] == ""


@pytest.mark.usefixtures("kept")
def test_a_kernel_that_dies_is_named_with_its_cell(project):
    insert(project, "import os; os._exit(1)")
    assert execution.execute(project)[0].problem == "failed: cell 3: Kernel died"


def test_a_cell_that_takes_too_long_is_named(project, monkeypatch):
    monkeypatch.setattr(execution, "TIMEOUT", 2)
    insert(project, "import time; time.sleep(60)")
    assert execution._execute_one(source(project)) == "failed: cell 3: took longer than 2 s"


def test_two_processes_may_write_the_same_file(tmp_path, monkeypatch):
    replace, target = os.replace, tmp_path / "x.txt"

    def other_first(*names):
        monkeypatch.setattr(os, "replace", replace)
        monkeypatch.setattr(os, "getpid", lambda: 1)
        files.replace(target, "theirs")
        replace(*names)

    monkeypatch.setattr(os, "replace", other_first)
    files.replace(target, "ours")
    assert target.read_text() == "ours"
    assert list(tmp_path.iterdir()) == [target]
