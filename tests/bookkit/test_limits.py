"""What a file, a grid and a notebook may take, and what is said of one that takes more."""

import json
import random
import re
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import nbformat
import pytest

from bookkit import execution, run_sweep
from bookkit.cli import main
from bookkit.files import DEEPEST, LARGEST, read_yaml
from bookkit.grids import Grid, read_grid
from bookkit.limits import Limits
from bookkit.points import execute_point
from bookkit.streams import merged, shown

pytestmark = pytest.mark.usefixtures("kernels_at_once")

LAUGHS = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 99))


# Files of YAML


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        (LAUGHS, r"wanted every value written out, got the alias \*a0"),
        ("grid: &g [*g]", r"wanted every value written out, got the alias \*g"),
        ("[" * 10**5, "wanted at most 20 levels"),
        ("{a: " * 10**5, "wanted at most 20 levels"),
        ("[" * (DEEPEST + 1) + "]" * (DEEPEST + 1), "wanted at most 20 levels"),
        ("#" * (LARGEST + 1), "wanted at most 1 MB"),
        ("a: " + "9" * 5000, "not YAML: Exceeds the limit"),
        ("a: 2020-13-45", "not YAML: month must be in 1..12"),
    ],
)
def test_a_file_that_has_no_end_is_refused(tmp_path, text, wrong):
    path = tmp_path / "file.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"^{path}: {wrong}"):
        read_yaml(path, "grid file")


def test_what_is_within_the_limits_is_read(tmp_path):
    path = tmp_path / "file.yaml"
    for text, wanted in (
        ("[" * DEEPEST + "]" * DEEPEST, str([])),
        ("a: &named 1", "{'a': 1}"),
        ("a:\r\n- é\r\n", "{'a': ['é']}"),
        ("#" * LARGEST, "None"),
    ):
        path.write_bytes(text.encode())
        assert wanted in str(read_yaml(path, "grid file"))
    many = {f"k{i}": 1 for i in range(3000)}
    path.write_text(json.dumps(many))
    assert read_yaml(path, "grid file") == many
    if Path("/dev/zero").exists():
        with pytest.raises(ValueError, match="wanted at most 1 MB"):
            read_yaml(Path("/dev/zero"), "grid file")


# Grids


def test_a_grid_of_too_many_points_is_refused_before_they_are_made(tmp_path):
    path = tmp_path / "grid.yaml"
    values = list(range(10))
    path.write_text(json.dumps({"grid": dict.fromkeys("abcdefgh", values)}))
    wanted = "wanted at most 10000 points, got 100000000; the option --points allows more"
    with pytest.raises(ValueError, match=wanted):
        read_grid(path).points()
    four = Grid(grid={"a": [1, 2], "b": [1, 2]})
    assert len(four.points(4)) == 4
    with pytest.raises(ValueError, match="wanted at most 3 points, got 4"):
        four.points(3)


def test_the_command_says_it_in_a_line(project, capsys, refused):
    notebook, grid = project / "notebooks" / "tiny.ipynb", project / "grid.yaml"
    sweep = ["sweep", notebook, grid, "--out", project / "out"]
    grid.write_text("grid: {gain: [1.0, 2.0], count: [1, 2]}")
    for options, wrong in (
        (["--points", "3"], "grid: wanted at most 3 points, got 4"),
        (["--seconds", "0"], "seconds: wanted a positive number, got 0.0"),
        (["--seconds", "nan"], "seconds: wanted a positive number, got nan"),
        (["--memory", "-1"], "memory: wanted a positive number, got -1.0"),
    ):
        assert wrong in refused(capsys, main, *sweep, *options)
    for text in (LAUGHS, "[" * 10**5):
        grid.write_text(text)
        assert str(grid) in refused(capsys, main, *sweep)
    assert not (project / "out").exists()


# What a cell prints


def test_streams_are_merged_as_a_terminal_shows_them():
    plain = re.compile(r".*\r(?=[^\n])")  # what nbclient takes, in the square of a line's length
    draw = random.Random(1)
    for _ in range(2000):
        text = "".join(draw.choices("ab\r\n", k=draw.randrange(9)))
        assert shown(text) == plain.sub("", text), repr(text)
    assert shown("x" * 10**7 + "\ry" + "z" * 10**7) == "y" + "z" * 10**7

    def out(name, text):
        return {"output_type": "stream", "name": name, "text": text}

    picture = {"output_type": "display_data", "data": {}}
    given = [out("stderr", "e\r"), out("stdout", "a"), picture, out("stdout", "b")]
    given.append(out("stderr", "f"))
    wanted = [out("stdout", "ab"), out("stderr", "f"), picture]
    assert merged(given) == wanted
    assert merged([picture, out("stdout", "\r")]) == [picture, out("stdout", "\r")]


# What a point takes


@pytest.mark.parametrize(
    ("code", "limits", "problem"),
    [
        ("import time; time.sleep(60)", {"seconds": 1.0}, "took longer than 1 s, which is"),
        ("while True: print('x' * 10**5)", {"shown": 5.0}, "showed more than 5 MB, which is"),
        ("a = bytearray(10**10)", {"memory": 1.0}, "MemoryError: .*a point may take 1 GB"),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are those of Linux")
def test_a_point_that_takes_more_fails_with_a_sentence(project, code, limits, problem):
    content = nbformat.read(project / "notebooks" / "tiny.ipynb", as_version=4)
    content.cells[3].source = code
    result = execute_point(nbformat.writes(content), {"gain": 1.0}, None, Limits(**limits))
    assert re.match(problem, result["problem"])
    assert len(result["notebook"]) < 10**7


def test_a_sweep_hands_its_limits_to_the_points(project, monkeypatch):
    (project / "grid.yaml").write_text("grid: {gain: [1.0]}")
    seen = []
    monkeypatch.setattr("bookkit.sweeps._client", lambda *_: nullcontext(None))
    monkeypatch.setattr("bookkit.sweeps._run", lambda *all: seen.append(all[-1]))
    sweep = [project / "notebooks" / "tiny.ipynb", project / "grid.yaml", "--out", project / "o"]
    monkeypatch.chdir(project)
    assert main(["sweep", *map(str, sweep), "--seconds", "7", "--memory", "2"]) == 1
    run_sweep(*sweep[:2], sweep[3], quiet=True)
    assert seen == [Limits(7.0, 2.0), Limits(3600.0, 4.0)]


# Signals


def children(pid):
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found += [int(child), *children(int(child))]
    return found


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="processes as Linux lists them")
def test_a_terminated_execution_leaves_no_process_behind(project):
    source = project / "notebooks" / "tiny.md"
    deaf = "import pathlib, signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
    wait = deaf + "pathlib.Path('../started').write_text('')\ntime.sleep(60)\nif gain == 7.0:"
    source.write_text(source.read_text().replace("if gain == 7.0:", wait))
    process = subprocess.Popen(
        [sys.executable, "-m", "bookkit", "execute"], cwd=project, stderr=subprocess.DEVNULL
    )
    while not (project / "started").exists():
        assert process.poll() is None
        time.sleep(0.05)
    family = children(process.pid)
    assert len(family) >= 2  # a worker and its kernel
    process.send_signal(signal.SIGTERM)
    assert process.wait(10) == -signal.SIGTERM
    deadline = time.monotonic() + 10
    while any(map(alive, family)):
        assert time.monotonic() < deadline, "a process is left"
        time.sleep(0.05)


def test_an_interrupted_execution_kills_its_workers(project, monkeypatch):
    ended = []

    class Worker:
        kill = staticmethod(lambda: ended.append(1))

    class Pool:
        submit = staticmethod(lambda *_: object())

    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(execution, "ProcessPoolExecutor", lambda **_: nullcontext(Pool))
    monkeypatch.setattr(execution, "as_completed", interrupted)
    monkeypatch.setattr(execution, "active_children", lambda: [Worker, Worker])
    monkeypatch.chdir(project)
    assert main(["execute", "--force"]) == 130
    assert len(ended) == 2
