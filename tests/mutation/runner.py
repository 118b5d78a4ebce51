"""Mutants against tests: a copy of the library for each process, and the first test that fails."""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import pytest
from mutants import LIBRARY, ROOT, Mutant, located

MEMORY = 4 << 30
"""Bytes in memory that a process may have; with a mutant it may want more and more."""
SECONDS = 120.0
"""Seconds of tests that a mutant meets, those of its line that are over soonest first."""
ELSEWHERE = ("tests/bookkit", "tests/peers", "tests/mutation", "tests/extra/test_cluster.py")
"""Tests that say nothing of a mutant, or whose workers start with the program that runs here."""
QUIET = ["-q", "-n0", "-p", "no:cacheprovider"]


class Touches:
    """Which tests run which lines of the library, from one run of them under coverage."""

    def __init__(self, tests: Sequence[str]):
        from coverage import CoverageData

        self.seconds: dict[str, float] = {}
        self.lines: dict[str, dict[int, set[str]]] = {}
        with tempfile.TemporaryDirectory() as folder:
            path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
            options = ["-q", "-n2", "--dist=loadscope", "-p", "touches", "-p", "no:cacheprovider"]
            options += [f"--ignore={name}" for name in ELSEWHERE]
            subprocess.run(
                [sys.executable, "-m", "pytest", *options, *tests],
                cwd=ROOT,
                env={**os.environ, "PYTHONPATH": path, "TOUCHES": folder},
                check=True,
                stdout=subprocess.DEVNULL,
            )
            for file in Path(folder).glob("touches.*.json"):
                self.seconds |= json.loads(file.read_text())
            for file in set(Path(folder).glob("touches.*")) - set(Path(folder).glob("*.json")):
                data = CoverageData(str(file))
                data.read()
                for name in data.measured_files():
                    rows = self.lines.setdefault(name.rpartition("/seedslib/")[2], {})
                    for line, contexts in data.contexts_by_lineno(name).items():
                        rows.setdefault(line, set()).update(set(contexts) & set(self.seconds))

    def near(self, file: str, first: int, last: int) -> list[str]:
        """Tests that run one of these lines (or the file, where none does), soonest over first."""
        rows = self.lines.get(file, {})
        tests = set().union(*(rows.get(line, ()) for line in range(first, last + 1)))
        tests = tests or set().union(*rows.values())
        whole: dict[str, float] = {}
        for test in tests:
            module = test.partition("::")[0]
            whole[module] = whole.get(module, 0.0) + self.seconds[test]
        order = sorted(tests, key=lambda t: (whole[t.partition("::")[0]], self.seconds[t], t))
        spent, chosen = 0.0, []
        for test in order:
            spent += self.seconds[test]
            if chosen and spent > SECONDS:
                break
            chosen.append(test)
        return chosen


class _First:
    """Plugin that runs tests in the order given and writes down the first that fails."""

    def __init__(self, path: Path, tests: Sequence[str]):
        self.path, self.order = path, {test: k for k, test in enumerate(tests)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        items.sort(key=lambda item: self.order.get(item.nodeid, len(self.order)))

    def pytest_runtest_logreport(self, report):
        if report.failed and not self.path.exists():
            self.path.write_text(report.nodeid)

    def pytest_collectreport(self, report):
        if report.failed and not self.path.exists():
            self.path.write_text("import")


def preload(tests: Sequence[str]) -> None:
    """Import once what the tests import: all but the library, the book and the tests."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        _silence()
        os.chdir(ROOT)
        pytest.main([*QUIET, "--collect-only", *tests])
        with os.fdopen(writing, "w") as pipe:
            json.dump(list(sys.modules), pipe)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        modules = json.load(pipe)
    os.waitpid(child, 0)
    for name in modules:
        if not name.startswith(("seedslib", "bookkit", "tests", "oracles", "systems", "__main__")):
            with contextlib.suppress(ImportError):
                importlib.import_module(name)
    assert not any(name.startswith("seedslib") for name in sys.modules)
    gc.freeze()


def _silence() -> None:
    quiet = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(quiet, stream)


class Slot:
    """A copy of the library in which one file at a time is spoilt, and a process that tests it."""

    def __init__(self, folder: Path):
        self.folder, self.note = folder, folder / "first"
        shutil.copytree(LIBRARY, folder / "seedslib")

    def start(self, mutant: Mutant, file: str, text: str, tests: Sequence[str], limit: float):
        self.mutant, self.file, self.ends = mutant, file, time.monotonic() + 90.0 + 4.0 * limit
        self.note.unlink(missing_ok=True)
        (self.folder / "seedslib" / file).write_text(text)
        self.child = os.fork()
        if not self.child:
            try:
                self._test(tests, limit)
            finally:
                os._exit(70)

    def _test(self, tests: Sequence[str], limit: float) -> None:
        os.setsid()
        used = int(resource.getrusage(resource.RUSAGE_SELF).ru_utime + limit)
        resource.setrlimit(resource.RLIMIT_CPU, (used, used + 5))
        _silence()
        path = os.pathsep.join([str(self.folder), os.environ.get("PYTHONPATH", "")])
        os.environ.update(PYTHONPATH=path, PYTHONDONTWRITEBYTECODE="1")
        sys.dont_write_bytecode = True
        sys.path.insert(0, str(self.folder))
        os.chdir(ROOT)
        os._exit(int(pytest.main([*QUIET, "-x", *tests], plugins=[_First(self.note, tests)])))

    def verdict(self) -> tuple[str, str] | None:
        """What became of the mutant and the test that failed; None while the tests go on."""
        pid, status = os.waitpid(self.child, os.WNOHANG)
        if pid:
            code = os.waitstatus_to_exitcode(status)
            if self.note.exists():
                outcome = "killed", self.note.read_text()
            elif code in (-signal.SIGXCPU, -signal.SIGKILL):
                outcome = "killed", "endless"
            elif code < 0:
                outcome = "killed", "crash"
            else:
                outcome = ("survived" if code in (0, 5) else "not run"), ""
        elif time.monotonic() > self.ends or self._resident() > MEMORY:
            outcome = "killed", "endless"
        else:
            return None
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            os.killpg(self.child, signal.SIGKILL)
            os.waitpid(self.child, 0)
        shutil.copy2(LIBRARY / self.file, self.folder / "seedslib" / self.file)
        return outcome

    def _resident(self) -> int:
        try:
            pages = Path(f"/proc/{self.child}/statm").read_text().split()[1]
        except (OSError, IndexError):
            return 0
        return int(pages) * os.sysconf("SC_PAGE_SIZE")


def judged(mutants: Iterable[Mutant], touches: Touches) -> Iterator[tuple[Mutant, str, str]]:
    """Every mutant with its verdict and the test that failed, as they come, two at a time.

    Verdicts are ``killed``, ``survived``, ``untouched`` (no test runs the file), ``gone`` (the
    lines are not in the library any more) and ``not run``.
    """
    preload(sorted({test.partition("::")[0] for test in touches.seconds}))
    waiting, more, busy = iter(mutants), True, []
    with tempfile.TemporaryDirectory() as folder:
        free = [Slot(Path(folder) / str(k)) for k in range(2)]
        while more or busy:
            while more and free:
                mutant = next(waiting, None)
                if mutant is None:
                    more = False
                    break
                place = located(mutant)
                if place is None:
                    yield mutant, "gone", ""
                    continue
                file, first, text = place
                tests = touches.near(file, first, first + mutant.before.rstrip().count("\n"))
                if not tests:
                    yield mutant, "untouched", ""
                    continue
                busy.append(free.pop())
                limit = 10.0 + 6.0 * sum(touches.seconds[test] for test in tests)
                busy[-1].start(mutant, file, text, tests, limit)
            for slot in list(busy):
                if (outcome := slot.verdict()) is not None:
                    yield slot.mutant, *outcome
                    busy.remove(slot)
                    free.append(slot)
            time.sleep(0.02)
