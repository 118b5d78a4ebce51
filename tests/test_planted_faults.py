"""A wrong digit anywhere is found: in a formula of the library, as a reader's re-run would."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
QUICK = ROOT / "tests" / "quick"
NUMBER = "steady_optimal"


@pytest.fixture
def rerun(tmp_path):
    """Re-run one committed notebook against a copy of the library that a test may spoil.

    The notebook is cut after the cell that records the number that the fault changes.
    """
    shutil.copytree(ROOT / "seedslib", tmp_path / "seedslib")
    shutil.copytree(ROOT / "book" / "bookkit", tmp_path / "bookkit")
    shutil.copy(ROOT / "conftest.py", tmp_path)
    (tmp_path / "book").mkdir()
    shutil.copy(ROOT / "book" / "claims.yml", tmp_path / "book")
    (tmp_path / "notebooks").mkdir()
    content = json.loads((ROOT / "notebooks" / "two_step_power.ipynb").read_text())
    (last,) = (k for k, c in enumerate(content["cells"]) if NUMBER in "".join(c["source"]))
    content["cells"] = content["cells"][: last + 1]
    (tmp_path / "notebooks" / "two_step_power.ipynb").write_text(json.dumps(content))
    (tmp_path / "pytest.ini").write_text(
        "[pytest]\naddopts = --nbval --nbval-kernel-name=python3\n"
    )

    def run():
        return subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "notebooks"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (tmp_path, QUICK)))},
            capture_output=True,
            text=True,
            timeout=300,
        )

    return tmp_path, run


def test_a_wrong_digit_in_a_formula_fails_the_re_run_and_names_the_number(rerun):
    folder, run = rerun
    file = folder / "seedslib" / "two_step" / "steady.py"
    text = file.read_text()
    right = "solve_continuous_lyapunov(drift, -diffusion)"
    assert right in text
    file.write_text(text.replace(right, right.replace("-diffusion", "-1.001 * diffusion")))
    done = run()
    assert done.returncode == 1, done.stdout
    assert f"{NUMBER}: stored 0.1029" in done.stdout


def test_the_unspoilt_copy_passes(rerun):
    _, run = rerun
    done = run()
    assert done.returncode == 0, done.stdout
