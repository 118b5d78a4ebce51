"""The set-up says why it could not go on, and the wheel stands alone."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from bookkit.programs import program

ROOT = Path(__file__).resolve().parents[1]


def test_a_set_up_that_cannot_go_on_says_why(tmp_path):
    shutil.copy(ROOT / "setup.sh", tmp_path)
    (tmp_path / "requirements.lock").write_text("six==1.16.0 --hash=sha256:" + "0" * 64 + "\n")
    nowhere = "http://127.0.0.1:9/simple"
    environment = {"UV_DEFAULT_INDEX": nowhere, "PIP_INDEX_URL": nowhere, "PIP_RETRIES": "0"}
    environment = os.environ | environment | {"UV_CACHE_DIR": str(tmp_path / "cache")}
    old = tmp_path / "python-old"
    old.write_text('#!/bin/sh\n[ "$1" = --version ] && echo "Python 3.9.1" && exit 0\n')
    old.chmod(0o755)
    for python, message in ((old, "3.11"), (sys.executable, "package index reachable")):
        done = subprocess.run(
            ["sh", "setup.sh", str(python), ".venv"],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == 2
        assert message in done.stderr
        assert not (tmp_path / ".venv" / ".installed").exists()


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
DESIGN = "design model.py memory=Memory(2) times=np.arange(3)/2 paths=2000 seed=1 --out f.npz"
FILTER = "filter f.npz data.csv --system model.py --out estimates.csv"


def test_the_wheel_holds_the_library_alone_and_needs_three_packages(wheel, tmp_path):
    """The program of the README and a design, with everything else hidden; tables want pandas."""
    assert {path.name for path in wheel.iterdir() if path.suffix != ".dist-info"} == {"seedslib"}
    assert (wheel / "seedslib" / "py.typed").is_file()
    (tmp_path / "model.py").write_text(MODEL)
    (tmp_path / "data.csv").write_text("t,y1\n0,1.2\n0.5,0.7\n1,\n")
    commands = f"""
from seedslib.commands import main
assert main({DESIGN!r}.split()) == 0
assert main({FILTER!r}.split()) == 2
"""
    readme = program((ROOT / "README.md").read_text())
    text = f"{ALONE}\nsys.path.insert(0, {str(wheel)!r})\n{commands}\n{readme}"
    done = subprocess.run(
        [sys.executable, "-c", text], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert "pandas: wanted this package, which is not installed" in done.stderr
    assert (tmp_path / "f.npz").is_file()
