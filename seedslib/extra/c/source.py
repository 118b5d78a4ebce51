"""Pieces of C text: constants, comments, names."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable
from string import Template

import numpy as np
from numpy.typing import ArrayLike

from seedslib.designed.identity import model_text
from seedslib.extra.c.tape import literal
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
