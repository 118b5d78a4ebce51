"""The command line, run in this process, and small files in a folder of its own."""

import csv
import runpy
import sys

import numpy as np
import pytest


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(capsys, monkeypatch):
    """Run ``python -m seedslib`` with a line of words; its exit code and what it prints."""

    def run(line):
        monkeypatch.setattr(sys, "argv", ["seedslib", *line.split()])
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            runpy.run_module("seedslib", run_name="__main__")
        said = capsys.readouterr()
        return end.value.code, said.out, said.err

    return run


class Table:
    """A CSV file: names of its columns, and the columns as text and as numbers."""

    def __init__(self, path):
        with open(path, newline="", encoding="utf-8") as file:
            self.names, *self.rows = csv.reader(file)

    def text(self, name):
        return [row[self.names.index(name)] for row in self.rows]

    def numbers(self, *names):
        """Columns (J, names), NaN where a cell is empty."""
        cells = [[cell or "nan" for cell in self.text(name)] for name in names]
        return np.array(cells, dtype=float).T


@pytest.fixture
def table():
    return Table
