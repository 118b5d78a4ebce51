"""A wrong digit in a formula of the library is found by the re-run of a committed notebook."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NUMBER = "steady_optimal"
RIGHT = "solve_continuous_lyapunov(drift, -diffusion)"


def test_a_wrong_digit_in_a_formula_fails_the_re_run_and_names_the_number(tmp_path):
    shutil.copytree(ROOT / "seedslib", tmp_path / "seedslib")
    shutil.copytree(ROOT / "book" / "bookkit", tmp_path / "bookkit")
    shutil.copy(ROOT / "conftest.py", tmp_path)
    (tmp_path / "book").mkdir()
    shutil.copy(ROOT / "book" / "claims.yml", tmp_path / "book")
    (file,) = (f for f in (tmp_path / "seedslib").rglob("*.py") if RIGHT in f.read_text())
    file.write_text(file.read_text().replace(RIGHT, RIGHT.replace("-", "-1.001 * ")))
    content = json.loads((ROOT / "notebooks" / "two_step_power.ipynb").read_text())
    (last,) = (k for k, c in enumerate(content["cells"]) if NUMBER in "".join(c["source"]))
    content["cells"] = content["cells"][: last + 1]
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "notebooks" / "two_step_power.ipynb").write_text(json.dumps(content))
    (tmp_path / "pytest.ini").write_text(
        "[pytest]\naddopts = --nbval --nbval-kernel-name=python3\n"
    )
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "notebooks"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 1, done.stdout
    assert f"{NUMBER}: stored 0.1029" in done.stdout
