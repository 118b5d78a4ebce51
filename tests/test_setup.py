"""The set-up says in one clear message why it could not go on."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

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
    done = set_up(tmp_path, sys.executable, **environment)
    assert done.returncode == 2
    assert "could not be installed" in done.stderr
    assert "package index reachable" in done.stderr
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
