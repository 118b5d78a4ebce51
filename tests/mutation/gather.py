"""Which test runs which lines of the library: one run of the tests under coverage, gathered."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from coverage import CoverageData
from mutants import ROOT

HERE = Path(__file__).parent
LEFT_OUT = (
    "bookkit", "peers", "mutation", "test_notebooks.py", "test_setup.py", "test_portable.py",
    "test_planted_faults.py",
)  # fmt: skip
"""Tests of the book, of the set-up, and against other programs: no mutant needs them."""


def run(folder: Path) -> None:
    """Run the tests with the plugin `touches`; its files go to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob(".touches.*"):
        old.unlink()
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist=loadscope", "-p", "touches",
               "-p", "no:cacheprovider", "tests"]  # fmt: skip
    command += [f"--ignore=tests/{name}" for name in LEFT_OUT]
    path = os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])
    there = {**os.environ, "PYTHONPATH": path, "TOUCHES": str(folder)}
    subprocess.run(command, cwd=ROOT, check=True, env=there)


def gathered(folder: Path) -> dict:
    """Lines, tests and seconds of all processes of a run."""
    seconds: dict[str, float] = {}
    for path in sorted(folder.glob(".touches.*.json")):
        seconds |= json.loads(path.read_text())
    tests = sorted(seconds)
    number = {test: k for k, test in enumerate(tests)}
    lines: dict[str, dict[int, set[int]]] = {}
    for path in sorted(folder.glob(".touches.*")):
        if path.suffix == ".json":
            continue
        data = CoverageData(str(path))
        data.read()
        for name in data.measured_files():
            file = name.rpartition("/seedslib/")[2]
            rows = lines.setdefault(file, {})
            for line, contexts in data.contexts_by_lineno(name).items():
                rows.setdefault(line, set()).update(number[c] for c in contexts if c in number)
    return {
        "tests": tests,
        "seconds": [round(seconds[test], 4) for test in tests],
        "lines": {f: {k: sorted(v) for k, v in rows.items()} for f, rows in lines.items()},
    }
