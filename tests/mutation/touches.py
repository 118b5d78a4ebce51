"""Plugin of pytest: which test runs which lines of the library, and how long it takes."""

import json
import os
import time
from pathlib import Path

import coverage
import pytest

FOLDER = Path(os.environ.get("TOUCHES", "."))
measured = coverage.Coverage(
    data_file=str(FOLDER / f"touches.{os.getpid()}"),
    source=["seedslib"],
    config_file=False,
    messages=False,
)
seconds = {}


def pytest_configure():
    measured.start()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item):
    measured.switch_context(item.nodeid)
    began = time.perf_counter()
    result = yield
    seconds[item.nodeid] = time.perf_counter() - began
    return result


def pytest_unconfigure():
    measured.stop()
    if seconds:
        measured.save()
        (FOLDER / f"touches.{os.getpid()}.json").write_text(json.dumps(seconds))
