"""What the tests of several rooms share: files and designs, command lines."""

import csv
import gc
import os
import re
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

import pytest

from seedslib import zoo

LONGEST = (
    "export/test_export",
    "extra/test_cluster",
    "bookkit/test_sweeps",
    "linearization/test_branches",
    "gaussian/test_expectation",
    "gaussian/test_covariance",
    "gaussian/test_mean_square_errors",
    "bookkit/test_execution",
    "filters/test_filter",
    "linearization/test_exact_gaussian",
)
"""Modules that take longest, the longest first; the order of the others does not matter."""


def pytest_collection_modifyitems(items):
    """Long modules and notebooks first, so that two processes end at the same time."""
    root = Path(__file__).parent
    order = {root / f"{name}.py": k for k, name in enumerate(LONGEST)}
    notebooks = len(LONGEST)

    def place(item):
        return notebooks if item.path.suffix == ".ipynb" else order.get(item.path, notebooks + 1)

    items.sort(key=place)


def pytest_collection_finish():
    """What was imported stays: to look through it, and formulas, again and again takes time."""
    gc.freeze()
    gc.set_threshold(100_000, 20, 100)


@pytest.fixture(scope="module", autouse=True)
def environment_as_it_was():
    """What a module does to the environment, such as a cluster of Dask, is not for the next one."""
    with patch.dict(os.environ):
        yield


@pytest.fixture(scope="module")
def oscillator():
    return zoo.van_der_pol()


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

    def refused(capsys, main, *arguments):
        capsys.readouterr()
        assert main([str(a) for a in arguments]) == 2
        told = capsys.readouterr()
        assert told.out == ""
        assert re.match("(seedslib|bookkit): ", told.err)
        assert told.err.count("\n") == 1
        return told.err

    return refused
