"""What one attempt came to: refused, right, flagged, silently wrong, crashed or hung."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import resource
import select
import signal
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

VERDICTS = (
    "refused",
    "right",
    "flagged",
    "silently_wrong",
    "wrongly_refused",
    "crashed",
    "hung",
)
SECONDS, BYTES = 20, 4_000_000_000
"""Of the processor, whatever else the machine does; of its clock six times as many."""
REFUSALS = (ValueError, TypeError, OSError)
"""With their subclasses: what a library may raise for input that it does not take."""

SPEAKS = re.compile(r"^\W*\w[^\n]*(: |wanted|argument)")
FOREIGN = re.compile(
    r"^(operands|matmul|shapes|could not|cannot|setting an|array must|all the input|einstein|"
    r"unsupported operand|'\w+' object|object of type|only |ufunc|index |list index|invalid lit|"
    r"float\(\)|unhashable|expected |dimensions in |Invalid |'[<>]=?' not|ufunc|Cannot |int\(\)|"
    r"must be real|bad operand|can't|'NoneType'|isfinite|iteration over|input op)"
)
"""How sentences of NumPy and Python begin, which do not know the caller's arguments."""


class Refused(ValueError):
    """A command that ended as a refusal should."""


class Crashed(Exception):
    """A command that ended in another way than it should."""


class Hung(BaseException):
    """The time or the memory of an attempt is over."""


class Attempt(NamedTuple):
    """A call with its oracle.

    ``right`` says whether the value is right; without it only a refusal or a flag will do. Where
    ``legal`` a refusal is wrong.
    """

    what: str
    call: Callable[[], object]
    right: Callable[[object], object] | None = None
    legal: bool = False


def judged(attempt: Attempt) -> tuple[str, str]:
    """Verdict and, for what should not be, how it came to it."""
    try:
        with warnings.catch_warnings(record=True) as told, np.errstate(all="ignore"):
            warnings.simplefilter("always")
            value = attempt.call()
            if attempt.right is not None and attempt.right(value):
                return "right", ""
    except REFUSALS as error:
        text = str(error)
        if not SPEAKS.match(text) or FOREIGN.match(text) or not text.strip():
            return "crashed", f"unclear {type(error).__name__}: {text[:160]}"
        return ("wrongly_refused", text[:160]) if attempt.legal else ("refused", "")
    except (MemoryError, Hung) as error:
        return "hung", type(error).__name__
    except BaseException as error:
        return "crashed", f"{type(error).__name__}: {str(error)[:160]}"
    if flagged(value) or any(issubclass(w.category, UserWarning) for w in told):
        return "flagged", ""
    return "silently_wrong", " ".join(repr(value).split())[:160]


def flagged(value: object) -> bool:
    """Whether estimates say that they diverged, and are finite where they do not."""
    lost = getattr(value, "diverged", None)
    if lost is None or not np.any(lost):
        return False
    mean = np.asarray(value.mean)
    bad = ~np.isfinite(mean).all(axis=1)
    return not (bad & ~np.broadcast_to(np.asarray(lost), bad.shape)).any()


def numbers(value: object) -> Iterator[np.ndarray]:
    """The arrays in a result."""
    if value is None or isinstance(value, str):
        return
    if isinstance(value, np.ndarray | float | int | np.generic):
        if np.asarray(value).dtype.kind != "O":
            yield np.asarray(value)
    elif isinstance(value, tuple | list):
        for part in value:
            yield from numbers(part)
    elif isinstance(value, dict):
        for part in value.values():
            yield from numbers(part)
    elif hasattr(value, "__dict__"):
        yield from numbers(list(vars(value).values()))


def equal(one: object, other: object, rtol: float = 0.0) -> bool:
    """Whether two results have the same numbers."""
    pairs = list(numbers(one)), list(numbers(other))
    return len(pairs[0]) == len(pairs[1]) and all(
        a.shape == b.shape
        and (
            np.array_equal(a, b, equal_nan=True)
            if a.dtype.kind in "bOUS" or not rtol
            else np.allclose(a, b, rtol=rtol, atol=rtol, equal_nan=True)
        )
        for a, b in zip(*pairs, strict=True)
    )


def sane(value: object) -> bool:
    """Finite numbers and no negative variance: all that can be said where nothing is known."""
    if getattr(value, "loglik", None) is not None:  # the density of what is impossible is zero
        value = value._replace(loglik=np.maximum(value.loglik, -1e308))
    parts = list(numbers(value))
    if not all(np.isfinite(part).all() for part in parts if part.dtype.kind in "fc"):
        return False
    cov = getattr(value, "cov", None) if hasattr(value, "diverged") else None
    if not isinstance(cov, np.ndarray) or cov.ndim < 3:
        return True
    return bool((np.einsum("jii...->ji...", cov) >= 0).all())


def command(main: Callable[[Sequence[str]], int], arguments: Sequence[object]) -> int:
    """Exit code 0 or 1 of a command that is run here; a refusal with one line is `Refused`."""
    said, printed = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(printed):
        try:
            code = main([str(part) for part in arguments])
        except SystemExit as left:  # argparse, after its own lines
            code = left.code
    lines = said.getvalue().strip().splitlines()
    return told(code, lines)


def told(code: int | None, lines: Sequence[str]) -> int:
    """The exit code of a command, held against what it said."""
    if "Traceback" in "".join(lines):
        raise Crashed(" ".join(lines[-2:]))
    if code == 2:
        usage = lines and lines[0].startswith("usage: ")
        if not lines or (len(lines) > 1 and not usage):
            raise Crashed(f"exit 2 with {len(lines)} lines: {' | '.join(lines)[:140]}")
        raise Refused(f"command: wanted another, got {lines[-1][:120]}")
    if code not in (0, 1):
        raise Crashed(f"exit {code}: {' | '.join(lines)[:140]}")
    if code == 1 and len(lines) != 1:
        raise Crashed(f"exit 1 with {len(lines)} lines: {' | '.join(lines)[:140]}")
    return code


def all_judged(attempts: Sequence[Attempt]) -> Iterable[tuple[Attempt, str, str]]:
    """Every attempt in a child with limits, a new one where the last one died."""
    start = 0
    while start < len(attempts):
        for index, verdict, detail in _child(attempts, start):
            yield attempts[index], verdict, detail
            start = index + 1


def _child(attempts: Sequence[Attempt], start: int) -> Iterator[tuple[int, str, str]]:
    read, write = os.pipe()
    pid = os.fork()
    if not pid:
        os.close(read)
        _serve(attempts, start, write)
    os.close(write)
    index = start
    # unbuffered: what is read early would hide from select
    with open(read, "rb", buffering=0) as lines:
        while index < len(attempts):
            if not select.select([lines], [], [], 6 * SECONDS)[0]:
                os.kill(pid, signal.SIGKILL)
                yield index, "hung", f"nothing heard for {6 * SECONDS} s"
                break
            line = lines.readline()
            if not line:
                yield index, "crashed", f"signal {os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])}"
                return
            yield index, *json.loads(line)
            index += 1
    os.waitpid(pid, 0)


def _serve(attempts: Sequence[Attempt], start: int, write: int) -> None:
    """In the child: one line an attempt, under limits of time and memory."""

    def over(*_):
        raise Hung("time")

    signal.signal(signal.SIGPROF, over)
    resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    home = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        for attempt in attempts[start:]:
            os.chdir(folder)
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            try:
                verdict, detail = judged(attempt)
            except Hung:
                verdict, detail = "hung", "time"
            signal.setitimer(signal.ITIMER_PROF, 0)
            os.write(write, (json.dumps([verdict, detail]) + "\n").encode())
            for left in Path(folder).iterdir():
                if left.is_file() or left.is_symlink():
                    left.unlink()
        os.chdir(home)
    os._exit(0)
