"""The command line, run in this process, in a folder of its own."""

import runpy
import shlex
import sys

import pytest


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(capsys, monkeypatch):
    """Run ``python -m seedslib`` with a line of words; its exit code and what it prints."""

    def run(line):
        monkeypatch.setattr(sys, "argv", ["seedslib", *shlex.split(line)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            runpy.run_module("seedslib", run_name="__main__")
        printed = capsys.readouterr()
        return end.value.code, printed.out, printed.err

    return run
