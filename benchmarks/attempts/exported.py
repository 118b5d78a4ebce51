"""Filters in C: odd measurements against Python, odd names, compilers that change numbers."""

from __future__ import annotations

import shutil
import subprocess
from functools import cache, partial
from pathlib import Path

import numpy as np

from attempts.judge import Attempt, Crashed, Refused
from attempts.targets import FILTERS, TIMES, Y, designed, table
from seedslib.extra import compiled, to_c

WRITTEN = {
    "extended": FILTERS["extended"],
    "unscented": FILTERS["unscented"],
    "cubature": FILTERS["cubature"],
    "assumed density": FILTERS["assumed density"],
    "extended, continuous": FILTERS["extended, continuous"],
    "Kalman": FILTERS["Kalman"],
    "switching": FILTERS["switching"],
    "designed": designed,
    "table": table,
}
ODD = (
    np.nan,
    np.inf,
    -np.inf,
    1e300,
    -1e300,
    1e60,
    1e15,
    -0.0,
    5e-324,
    -1e-310,
    1.7976931348623157e308,
)


def attempts() -> list[Attempt]:
    """All of them."""
    found = []
    for name in WRITTEN:
        for value in ODD:
            for row in range(len(Y)):
                y = Y.copy()
                y[row] = value
                found.append(
                    Attempt(f"{name}: {value:g} at {row}", partial(both, name, y), as_python)
                )
        for rows in range(1, 16):
            y = np.where([[rows >> k & 1] for k in range(len(Y))], np.nan, Y)
            found.append(
                Attempt(f"{name}: gaps {rows}", partial(both, name, y), as_python, legal=True)
            )
        for times in (TIMES[::-1].copy(), TIMES * np.nan, TIMES + np.inf, TIMES * 0):
            found.append(Attempt(f"{name}: times {times}", partial(timed, name, times)))
        for flags in ("-ffinite-math-only", "-ffast-math", "-Ofast"):
            found.append(Attempt(f"{name}: {flags}", partial(built, name, flags)))
        for odd in (
            "",
            "1x",
            "int",
            "a b",
            "x;",
            "x)",
            "\x00",
            "λ",
            "for",
            "a-b",
            "system(1)",
            "x" * 5000,
            None,
            1,
            b"f",
        ):
            found.append(
                Attempt(
                    f"{name}: called {odd!r}"[:60],
                    partial(to_c, WRITTEN[name](), name=odd),
                    lambda text: compiles(text),
                )
            )
        for odd in ("", "int", "half", "long double", None, 1, "double; int"):
            found.append(Attempt(f"{name}: real {odd!r}", partial(to_c, WRITTEN[name](), real=odd)))
    return found


@cache
def pair(name: str):
    made = WRITTEN[name]()
    return made, compiled(made)


def both(name: str, y: np.ndarray):
    """What Python and C say, estimates or a refusal."""
    said = []
    for filter in pair(name):
        try:
            said.append(filter.run(TIMES, y))
        except (ValueError, TypeError) as error:
            said.append(error)
    if all(isinstance(one, Exception) for one in said):
        raise said[1]
    return said


def as_python(said) -> bool:
    """The same estimates to 1e-9 of themselves, lost at the same rows; both or none refused."""
    if any(isinstance(one, Exception) for one in said):
        return False
    python, c = said
    for part in ("mean", "cov"):
        one, other = getattr(python, part), getattr(c, part)
        if one is None or other is None:
            continue
        good = np.isfinite(one)
        if (good != np.isfinite(other)).any():
            return False
        if not np.allclose(one[good], other[good], rtol=1e-9, atol=1e-9):
            return False
    return True


def timed(name: str, times: np.ndarray):
    return pair(name)[1].run(times, Y)


def built(name: str, flags: str) -> str:
    """A compiler that takes NaN for impossible must be told so."""
    Path("f.h").write_text(to_c(WRITTEN[name](), name="f"))
    Path("f.c").write_text('#include "f.h"\nint main(void) { return 0; }\n')
    done = subprocess.run(
        [shutil.which("cc") or "cc", flags, "f.c", "-o", "f", "-lm"], capture_output=True, text=True
    )
    if done.returncode == 0:
        return "compiled"
    if "#error" not in done.stderr:
        raise Crashed(done.stderr[:100])
    raise Refused("flags: wanted others, got " + flags)


def compiles(text: str) -> bool:
    """A header that is C after all."""
    Path("f.c").write_text(text + "\nint main(void) { return 0; }\n")
    done = subprocess.run(
        [
            shutil.which("cc") or "cc",
            "-std=c99",
            "-fsyntax-only",
            "-Werror",
            "-Wno-unused-function",
            "f.c",
        ],
        capture_output=True,
    )
    return done.returncode == 0
