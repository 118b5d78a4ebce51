"""One mutant against tests: a copy of the library, a process, the first failure."""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest
from mutants import ROOT

MEMORY = 4 << 30
"""Resident memory of a process that runs a mutant, in bytes."""


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant.

    Attributes
    ----------
    verdict : str
        ``killed``, ``survived`` or ``slow`` (a mutant that does not come to an end).
    by : str
        The first test that failed; ``import`` where the library or a test cannot be imported.
    tests : int
        How many tests were to be run.
    """

    verdict: str
    by: str
    tests: int


class _First:
    """Plugin that runs tests in the order given and keeps the name of the first that fails."""

    def __init__(self, path: Path, tests: Sequence[str]):
        self.path = path
        self.order = {test: k for k, test in enumerate(tests)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        items.sort(key=lambda item: self.order.get(item.nodeid, len(self.order)))

    def pytest_runtest_logreport(self, report):
        if report.failed and not self.path.exists():
            self.path.write_text(report.nodeid)

    def pytest_collectreport(self, report):
        if report.failed and not self.path.exists():
            self.path.write_text("import")


ELSEWHERE = ("tests/extra/test_cluster.py",)
"""Tests whose workers begin with the program that started them: they fail where mutants run."""

OURS = ("seedslib", "bookkit", "tests", "oracles", "mutants", "__main__")


class _Names:
    """Plugin that keeps the names of all tests."""

    names: Sequence[str] = ()

    def pytest_collection_finish(self, session):
        self.names = [item.nodeid for item in session.items]


def preload() -> set[str]:
    """Import once what every process would import: all but the library, the book and the tests.

    Returns the names of the tests that can be run here.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        try:
            quiet = os.open(os.devnull, os.O_RDWR)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            os.chdir(ROOT)
            found = _Names()
            flags = ["--collect-only", "-qq", "-n0", "-p", "no:cacheprovider"]
            pytest.main([*flags, "tests"], plugins=[found])
            with os.fdopen(writing, "w") as pipe:
                json.dump([list(sys.modules), list(found.names)], pipe)
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        modules, tests = json.load(pipe)
    os.waitpid(child, 0)
    for name in modules:
        if not name.startswith(OURS):
            with contextlib.suppress(ImportError):
                importlib.import_module(name)
    assert not any(n.startswith("seedslib") for n in sys.modules), "a mutant is imported anew"
    gc.freeze()
    return {test for test in tests if not test.startswith(ELSEWHERE)}


class Slot:
    """A copy of the library in which one file at a time is spoilt."""

    def __init__(self, folder: Path):
        self.folder = folder
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(ROOT / "seedslib", folder / "seedslib")
        self.note = folder / "first"
        self.child = 0

    def start(self, file: str, text: str, tests: Sequence[str], seconds: float) -> None:
        """Run tests with another text of a file, in a process with so many seconds of a core."""
        self.file, self.tests = file, tests
        self.note.unlink(missing_ok=True)
        (self.folder / "seedslib" / file).write_text(text)
        self.ends = time.monotonic() + 90.0 + 4.0 * seconds
        self.child = os.fork()
        if not self.child:
            self._run(seconds)

    def _run(self, seconds: float) -> None:
        code = 70
        try:
            os.setsid()
            limit = int(resource.getrusage(resource.RUSAGE_SELF).ru_utime + seconds)
            resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
            quiet = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(quiet, stream)
            os.environ["PYTHONPATH"] = os.pathsep.join(
                [str(self.folder), os.environ.get("PYTHONPATH", "")]
            )
            os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
            sys.dont_write_bytecode = True
            sys.path.insert(0, str(self.folder))
            os.chdir(ROOT)
            flags = ["-q", "-x", "-n0", "-p", "no:cacheprovider", "--no-header", "--tb=no"]
            code = int(pytest.main([*flags, *self.tests], plugins=[_First(self.note, self.tests)]))
        finally:
            os._exit(code)

    def done(self) -> Outcome | None:
        """The outcome, or None while the tests go on."""
        pid, status = os.waitpid(self.child, os.WNOHANG)
        if pid:
            outcome = self._outcome(status)
        elif time.monotonic() > self.ends or self._resident() > MEMORY:
            outcome = Outcome("slow", "", len(self.tests))
        else:
            return None
        self._tidy()
        return outcome

    def _outcome(self, status: int) -> Outcome:
        if os.WIFEXITED(status) and os.WEXITSTATUS(status) in (0, 5):
            return Outcome("survived", "", len(self.tests))
        if os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL):
            return Outcome("slow", "", len(self.tests))
        if self.note.exists():
            return Outcome("killed", self.note.read_text(), len(self.tests))
        if os.WIFSIGNALED(status):
            return Outcome("killed", "crash", len(self.tests))
        raise RuntimeError(  # such as a test that is not there any more
            f"no test failed and pytest ended with {os.WEXITSTATUS(status)}: note the tests anew"
        )

    def _resident(self) -> int:
        """Bytes in memory (an address space cannot be limited: sanitizers want terabytes of it)."""
        try:
            pages = Path(f"/proc/{self.child}/statm").read_text().split()[1]
        except (OSError, IndexError):
            return 0
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def _tidy(self) -> None:
        try:
            os.killpg(self.child, signal.SIGKILL)
            os.waitpid(self.child, 0)
        except (ProcessLookupError, ChildProcessError):
            pass
        source = ROOT / "seedslib" / self.file
        shutil.copy2(source, self.folder / "seedslib" / self.file)
        self.child = 0


def outcomes(
    jobs: Iterable[tuple[object, str, str, Sequence[str], float]], folder: Path, slots: int = 2
) -> Iterator[tuple[object, Outcome]]:
    """Run jobs ``(name, file, text, tests, seconds)`` in `slots` processes, as they end."""
    free = [Slot(folder / str(k)) for k in range(slots)]
    busy: dict[Slot, object] = {}
    waiting = iter(jobs)
    more = True
    while more or busy:
        while more and free:
            job = next(waiting, None)
            if job is None:
                more = False
                break
            name, file, text, tests, seconds = job
            slot = free.pop()
            slot.start(file, text, tests, seconds)
            busy[slot] = name
        for slot in list(busy):
            outcome = slot.done()
            if outcome is not None:
                yield busy.pop(slot), outcome
                free.append(slot)
        time.sleep(0.02)


@dataclass(frozen=True)
class Touches:
    """Which tests run which lines of the library, and their seconds.

    Attributes
    ----------
    lines : dict
        File below the library's folder: line: numbers of tests.
    tests : list of str
    seconds : list of float
    """

    lines: dict[str, dict[int, list[int]]]
    tests: list[str]
    seconds: list[float]

    @classmethod
    def read(cls, path: Path, there: set[str]) -> Touches:
        """Read what `touches` has written, of the tests that are there still."""
        found = json.loads(path.read_text())
        known = {k for k, test in enumerate(found["tests"]) if test in there}
        lines = {
            file: {int(line): [t for t in tests if t in known] for line, tests in rows.items()}
            for file, rows in found["lines"].items()
        }
        return cls(lines, found["tests"], found["seconds"])

    @cached_property
    def took(self) -> dict[str, float]:
        """Seconds by test."""
        return dict(zip(self.tests, self.seconds, strict=True))

    def of(self, file: str, first: int, last: int) -> list[str]:
        """Tests that run one of these lines, the fastest modules first."""
        rows = self.lines.get(file, {})
        return self._named({t for line in range(first, last + 1) for t in rows.get(line, ())})

    def of_file(self, file: str) -> list[str]:
        """Tests that run any line of a file, the fastest modules first."""
        return self._named({t for tests in self.lines.get(file, {}).values() for t in tests})

    def _named(self, numbers: set[int]) -> list[str]:
        whole: dict[str, float] = {}
        for t in numbers:
            whole[self._module(t)] = whole.get(self._module(t), 0.0) + self.seconds[t]

        def place(t):
            return whole[self._module(t)], self._module(t), self.seconds[t], t

        return [self.tests[t] for t in sorted(numbers, key=place)]

    def _module(self, t: int) -> str:
        return self.tests[t].partition("::")[0]

    def chosen(self, tests: Sequence[str], room: str, seconds: float, modules: int) -> list[str]:
        """Tests that fit into so many seconds and modules, those of the room and the fast first."""
        near = f"tests/{room}"
        spent, taken, used = 0.0, set(), set()
        for test in sorted(tests, key=lambda t: (not t.startswith(near), self.took[t], t)):
            module = test.partition("::")[0]
            if taken and spent + self.took[test] > seconds:
                continue
            if module not in used and len(used) >= modules:
                continue
            used.add(module)
            taken.add(test)
            spent += self.took[test]
        return [test for test in tests if test in taken]

    def spent(self, tests: Sequence[str]) -> float:
        """Seconds that tests take in all."""
        return sum(self.took[t] for t in tests)
