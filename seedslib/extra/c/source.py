"""Pieces of C text: constants, comments, names, single precision and its tolerances."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable
from string import Template
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.clock import ROUNDING, SAME, slack
from seedslib.base.linalg import ABSOLUTE, INDEFINITE, RELATIVE
from seedslib.designed.base import DesignedFilter
from seedslib.designed.identity import model_text
from seedslib.designed.switching.lemmas import FAINT
from seedslib.extra.c.tape import CALLS, literal
from seedslib.models.kinds import switches

WIDTH = 100


class Pattern(Template):
    """Text with ``@name``, the prefix of all C names, and ``@NAME``, that of the macros."""

    delimiter = "@"
    idpattern = "(?a:name|NAME)"


def named(text: str, name: str) -> str:
    """The text with the prefix put in."""
    return Pattern(text).substitute(name=name, NAME=name.upper())


def checked_name(name: object) -> str:
    """A prefix that C can take.

    Raises
    ------
    TypeError, ValueError
        No text, or no identifier of C.
    """
    if not isinstance(name, str):
        raise TypeError(f"name: wanted text, got {name!r}")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise ValueError(
            f"name: wanted a letter, then letters, digits and underscores, got {name!r}"
        )
    return name


def constants(name: str, values: ArrayLike, kind: str = "double") -> str:
    """A static table; the numbers are read back exactly.

    Raises
    ------
    ValueError
        A number that is not finite.
    """
    values = np.asarray(values)
    sizes = "".join(f"[{size}]" for size in values.shape)
    written = literal if kind == "double" else lambda value: str(int(value))
    return f"static const {kind} {name}{sizes} = {_braces(values, written, '')};\n"


def _braces(values: np.ndarray, written: Callable, indent: str) -> str:
    inside = indent + "    "
    if values.ndim > 1:
        rows = (inside + _braces(part, written, inside) for part in values)
        return "{\n" + ",\n".join(rows) + "\n" + indent + "}"
    flat = ", ".join(map(written, values.tolist()))
    if len(indent) + len(flat) + 4 <= WIDTH:
        return "{ " + flat + " }"
    lines = textwrap.wrap(flat, WIDTH - len(inside), break_long_words=False)
    return "{\n" + "\n".join(inside + line for line in lines) + "\n" + indent + "}"


def comment(paragraphs: list[str]) -> str:
    """A C comment of ASCII text; a paragraph's own line breaks are kept."""
    lines = []
    for paragraph in paragraphs:
        for line in paragraph.replace("±", "+-").splitlines():
            own = len(line) - len(line.lstrip())
            depth = " " * (own + 4 if own else 0)
            lines += textwrap.wrap(line, WIDTH - 4, subsequent_indent=depth) or [""]
        lines.append("")
    text = "\n".join(f" * {line}".rstrip() for line in lines[:-1])
    text = text.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")
    return "/*\n" + text.encode("ascii", "replace").decode() + "\n */\n"


def model_lines(system: object) -> str:
    """The model in words."""
    parts = {**model_text(system), "initial mean": system.mean0.tolist()}
    parts["initial covariance"] = system.cov0.tolist()
    noise = system.sensor_noise if switches(system) else system.sensor.noise
    if noise.size:
        names = noise.size if noise.symbols is None else ", ".join(map(str, noise.symbols))
        parts["sensor noise"] = f"{names}: mean {noise.mean.tolist()}, cov {noise.cov.tolist()}"
    return "Model:\n" + "\n".join(f"  {key:18s} {value}" for key, value in parts.items())


def function(head: str, lines: list[str]) -> str:
    """A static function."""
    return f"static inline {head}\n{{\n" + "\n".join(lines) + "\n}\n"


TOLERANCES = {
    "RELATIVE": (RELATIVE, 1e-6),
    "ABSOLUTE": (ABSOLUTE, float(np.finfo(np.float32).tiny)),
    "INDEFINITE": (INDEFINITE, 1e-4),
    "FAINT": (FAINT, 1e-30),
    "TURNED": (1e-36, 1e-14),
    "SAME": (SAME, 1e-4),
    "ROUND": (ROUNDING, 2.0**-21),
}
"""What counts as zero, as faint, as one time: in double, and in float."""


def tolerances(filter: Any, real: str) -> str:
    """Macros of what counts as nothing."""
    known = {name: pair[real == "float"] for name, pair in TOLERANCES.items()}
    if isinstance(filter, DesignedFilter) and filter.memory is not None:
        times, room = np.asarray(filter.times), filter.clock.tolerance
        if real == "float":
            span = float(np.diff(times).min()) if len(times) > 1 else 1.0
            room = max(room, slack(span, 0.0), min(known["ROUND"] * abs(times[-1]), 0.25 * span))
        known["SLACK"] = room
    return "".join(f"#define @NAME_{name} {literal(value)}\n" for name, value in known.items())


def single(text: str) -> str:
    """A header's C in single precision; comments are left as they are.

    Raises
    ------
    ValueError
        A number out of the range of float.
    """
    parts = re.split(r"(/\*.*?\*/)", text, flags=re.DOTALL)
    calls = "|".join(sorted({*CALLS.values(), "fmin", "fmax", "pow"}))
    for k in range(0, len(parts), 2):
        part = re.sub(r"\bdouble\b", "float", parts[k])
        part = re.sub(rf"\b({calls})\(", r"\1f(", part).replace("HUGE_VAL", "HUGE_VALF")
        number = r"(?<![\w.])(?:\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)"
        parts[k] = re.sub(number, _short, part)
    return "".join(parts)


def _short(found: re.Match) -> str:
    with np.errstate(over="ignore", under="ignore"):
        value = np.float32(found[0])
    if not np.isfinite(value):
        raise ValueError(f"constant: wanted a number in the range of float, got {found[0]}")
    if abs(value) < np.finfo(np.float32).tiny:
        return "0.0F"
    words = str(value)
    return words + ("F" if "." in words or "e" in words else ".0F")
