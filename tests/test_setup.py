"""The set-up says in one clear message why it could not go on; the wheel stands alone."""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import requires, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from bookkit.programs import program

ROOT = Path(__file__).resolve().parents[1]
NOWHERE = "http://127.0.0.1:9/simple"


def set_up(folder, python, **environment):
    shutil.copy(ROOT / "setup.sh", folder)
    (folder / "requirements.lock").write_text("six==1.16.0 --hash=sha256:" + "0" * 64 + "\n")
    return subprocess.run(
        ["sh", "setup.sh", str(python), ".venv"],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


def with_pip_at_hand(folder):
    """An interpreter whose environments find its own pip, which need not be unpacked for them."""
    pip = Path(importlib.util.find_spec("pip").origin).parent
    made, python = folder / "python-quick", shlex.quote(sys.executable)
    link = f"import os, sysconfig; os.symlink({str(pip)!r}, sysconfig.get_path('purelib') + '/pip')"
    made.write_text(
        f'#!/bin/sh\n[ "$1 $2" = "-m venv" ] || exec {python} "$@"\n'
        f'{python} -m venv --without-pip "$3" && exec "$3/bin/python" -c {shlex.quote(link)}\n'
    )
    made.chmod(0o755)
    return made


@pytest.mark.parametrize("tool", ["uv", "pip"])
def test_without_a_network_it_says_what_failed(tmp_path, tool):
    if tool == "uv" and not shutil.which("uv"):
        pytest.skip("uv is not on this machine")
    environment = {"UV_DEFAULT_INDEX": NOWHERE, "UV_CACHE_DIR": str(tmp_path / "cache")}
    if tool == "pip":
        bare = tmp_path / "bin"
        bare.mkdir()
        for name in ("sh", "tail", "touch"):
            (bare / name).symlink_to(shutil.which(name))
        environment = {"PATH": str(bare), "PIP_INDEX_URL": NOWHERE, "PIP_RETRIES": "0"}
    done = set_up(tmp_path, with_pip_at_hand(tmp_path), **environment)
    assert done.returncode == 2
    assert "could not be installed" in done.stderr
    assert "package index reachable" in done.stderr
    assert "six==1.16.0" in (tmp_path / ".venv" / "install.log").read_text()
    assert not (tmp_path / ".venv" / ".installed").exists()


def test_an_old_interpreter_is_named(tmp_path):
    old = tmp_path / "python-old"
    old.write_text('#!/bin/sh\n[ "$1" = --version ] && echo "Python 3.9.1" && exit 0\nexit 1\n')
    old.chmod(0o755)
    done = set_up(tmp_path, old)
    assert done.returncode == 2
    assert "wanted Python 3.11 or newer, got Python 3.9.1" in done.stderr


@pytest.mark.parametrize("tool", ["uv", "pip"])
def test_an_environment_that_cannot_be_made_is_said(tmp_path, tool):
    if tool == "uv" and not shutil.which("uv"):
        pytest.skip("uv is not on this machine")
    (tmp_path / ".venv").write_text("a file where the folder should be")
    environment = {}
    if tool == "pip":
        bare = tmp_path / "bin"
        bare.mkdir()
        (bare / "sh").symlink_to(shutil.which("sh"))
        environment = {"PATH": str(bare)}
    done = set_up(tmp_path, sys.executable, **environment)
    assert done.returncode == 2
    assert "set-up: no virtual environment could be made in .venv" in done.stderr


def pins(lock):
    """Versions of a lock file by package."""
    return dict(re.findall(r"^([\w.-]+)==([\w.]+)", (ROOT / lock).read_text(), re.M))


def test_peers_are_there_in_the_versions_of_their_lock():
    """`make test` holds the library against them, always: no test of theirs can be left out."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    group = {re.match(r"[\w.-]+", entry)[0] for entry in project["dependency-groups"]["peers"]}
    locked, others = pins("peers.lock"), pins("requirements.lock")
    assert set(locked) == group
    assert {name: version(name) for name in locked} == locked
    for name in set(locked) - {"mutmut"}:  # of which only the operators are used
        wanted = [Requirement(line) for line in requires(name) or []]
        here = [w for w in wanted if not w.marker or w.marker.evaluate({"extra": ""})]
        names = {w.name.lower().replace("_", "-") for w in here}
        assert names <= {*locked, *others}, name
    for path in (ROOT / "tests" / "peers").glob("*.py"):
        assert not re.search(r"importorskip|skip\(|skipif|xfail", path.read_text()), path


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The library's wheel, unpacked."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    shutil.copytree(ROOT / "seedslib", folder / "seedslib")
    command = ["pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", "out", "."]
    subprocess.run([sys.executable, "-m", *command], cwd=folder, check=True, timeout=120)
    (file,) = (folder / "out").glob("*.whl")
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder / "unpacked")
    return folder / "unpacked"


def test_the_wheel_holds_the_library_alone(wheel):
    tops = {path.name for path in wheel.iterdir() if path.suffix != ".dist-info"}
    assert tops == {"seedslib"}
    assert (wheel / "seedslib" / "py.typed").is_file()
    (info,) = wheel.glob("*.dist-info")
    assert "seedslib = seedslib.commands.cli:main" in (info / "entry_points.txt").read_text()
    wanted = [line for line in (info / "METADATA").read_text().splitlines() if "Dist" in line]
    assert {line.split()[1].split(">")[0] for line in wanted if "extra" not in line} == {
        "numpy", "scipy", "sympy",
    }  # fmt: skip


ALONE = """
import sys
from importlib.metadata import packages_distributions

hidden = {*packages_distributions()} - {"numpy", "scipy", "sympy", "mpmath", "seedslib"}


class Hide:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"not one of the three: {name}", name=name)


assert {"dask", "matplotlib"} < hidden
sys.meta_path.insert(0, Hide)
"""
MODEL = "from seedslib import zoo\nsystem = zoo.linear_gaussian()\n"
DESIGN = "design model.py --memory estimates=2 --times 0:1:0.5 --paths 2000 --seed 1 --out f.npz"
FILTER = "filter f.npz data.csv --model model.py --out estimates.csv"


def test_the_wheel_needs_three_packages(wheel, tmp_path):
    """The program of README and both commands, with everything else hidden."""
    (tmp_path / "model.py").write_text(MODEL)
    (tmp_path / "data.csv").write_text("t,y1\n0,1.2\n0.5,0.7\n1,\n")
    commands = f"""
from seedslib.commands.cli import main
for line in ({DESIGN!r}, {FILTER!r}):
    assert main(line.split()) == 0, line
"""
    readme = program((ROOT / "README.md").read_text()) + "\nassert (optimal < plugin).all()\n"
    text = f"{ALONE}\nsys.path.insert(0, {str(wheel)!r})\n{commands}\n{readme}"
    done = subprocess.run(
        [sys.executable, "-c", text], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "estimates.csv").read_text().count("\n") == 4
