"""What the tests of the harness share: a small project to plant faults in, and the command line."""

import csv
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from seedslib.experiments import execution
from seedslib.experiments.cli import main

ROOT = Path(__file__).resolve().parents[2]

TINY = """---
jupytext:
  text_representation:
    extension: .md
    format_name: myst
kernelspec:
  display_name: Python 3
  language: python
  name: python3
---

# A small notebook

```{code-cell} ipython3
:tags: [parameters]

gain: float = 2.0  # what the input is multiplied with
count: int = 3  # how many terms
```

```{code-cell} ipython3
from seedslib.experiments import check, integer, real

check(globals(), gain=real(gt=0, le=10), count=integer(ge=1, le=5))
```

```{code-cell} ipython3
from seedslib.experiments import claim, record

if gain == 7.0:
    raise ArithmeticError("seven is out of reach")
total = sum(gain**k for k in range(count))
record(total=total, terms=[gain**k for k in range(count)])
claim("TS-X1", computed=total, printed=7.0, tolerance=1e-9)
```
"""

LEDGER = """- id: TS-X1
  paper: two-step
  place: example 0
  statement: The three terms of the sum make 7.
  kind: number
  notebook: notebooks/tiny.md
  test: tests/test_tiny.py::test_sum
  expected: 7.0
  tolerance: 1.0e-9
  verdict: reproduced
"""


@pytest.fixture(scope="session")
def executed_project(tmp_path_factory):
    """The small project with its notebook executed; not to be changed."""
    root = tmp_path_factory.mktemp("project")
    for folder in ("notebooks", "book", "tests"):
        (root / folder).mkdir()
    (root / "requirements.lock").write_text("nothing==1.0\n")
    (root / "notebooks" / "tiny.md").write_text(TINY)
    (root / "book" / "claims.yml").write_text(LEDGER)
    (root / "tests" / "test_tiny.py").write_text("def test_sum():\n    assert 1 + 2 + 4 == 7\n")
    shutil.copy(ROOT / "conftest.py", root)
    (root / "pytest.ini").write_text("[pytest]\naddopts = --nbval --nbval-kernel-name=python3\n")
    assert execution.execute(root) == [execution.Outcome(root / "notebooks" / "tiny.md", "")]
    return root


@pytest.fixture
def project(executed_project, tmp_path):
    """A copy of the small project that a test may spoil."""
    return shutil.copytree(executed_project, tmp_path / "project")


@pytest.fixture
def command():
    """Run a Python command line in a folder; returns the finished process with its text."""

    def run(folder, *arguments, timeout=120, env=None):
        return subprocess.run(
            [sys.executable, *map(str, arguments)],
            cwd=folder,
            env=env,
            capture_output=True,
            text=True,
            timeout=timeout,
        )

    return run


@pytest.fixture
def write():
    """Write a small text file by its name."""

    def write(name, text):
        Path(name).write_text(text, encoding="utf-8")

    return write


@pytest.fixture
def read():
    """Rows of a CSV file by its name."""

    def read(name):
        with open(name, newline="", encoding="utf-8") as file:
            return list(csv.reader(file))

    return read


@pytest.fixture
def refused():
    """The one line on stderr of a command that ends with code 2."""

    def refused(capsys, *arguments):
        capsys.readouterr()
        assert main([str(a) for a in arguments]) == 2
        told = capsys.readouterr()
        assert told.out == ""
        assert told.err.startswith("seedslib: ")
        assert told.err.count("\n") == 1
        return told.err

    return refused
