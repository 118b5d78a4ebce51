"""A recorded step as one C99 header."""

from __future__ import annotations

import math
import os
import re
import textwrap
from collections.abc import Callable
from typing import Any

import numpy as np

from seedslib.base.atomic import write_whole
from seedslib.designed.identity import model_text
from seedslib.export.programs import recorded
from seedslib.export.step import CODES, Step
from seedslib.export.tape import Array, Let, Load, Loop, Number, Refuse, Scalar, Store, When
from seedslib.models.kinds import switches

WIDTH = 100
PER_LINE = 4
"""Numbers of a table in a line."""

SIGNS = frozenset("+ - * / < <= > >= == != && ||".split())
PREFIX = {"neg": "-{}", "!": "!{}", "choose": "{} ? {} : {}"}


class C:
    """How C spells a program.

    Parameters
    ----------
    name : str
        Prefix of the names of tables and types.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.types = {"real": f"{name}_real", "time": "double", "int": "int", "truth": "int"}

    def number(self, value: Number) -> str:
        """A name or a constant, which is read back exactly."""
        if type(value) is Scalar:
            return value.name
        if math.isnan(value):
            return "(double)NAN"
        return repr(float(value)) if math.isfinite(value) else "-HUGE_VAL"[value > 0 :]

    def operation(self, operation: str, operands: tuple[Number, ...]) -> str:
        """An expression."""
        parts = [self.number(x) for x in operands]
        if operation in SIGNS:
            return f"{parts[0]} {operation} {parts[1]}"
        if operation in PREFIX:
            return PREFIX[operation].format(*parts)
        return f"{operation}({', '.join(parts)})"

    def place(self, array: Array, index: tuple[Number, ...]) -> str:
        """A place in memory; arrays of which all places are known are one variable a place."""
        if array.owner == "local" and not array.indexed:
            return "_".join([array.name, *(str(int(x)) for x in index)])
        lead = {"state": "s->", "table": f"{self.name}_"}.get(array.owner, "")
        return (
            lead
            + array.name
            + "".join(f"[(int){x.name}]" if type(x) is Scalar else f"[{int(x)}]" for x in index)
        )

    def let(self, result: Scalar, text: str) -> str:
        """A named value."""
        return f"const {self.types[result.kind]} {result.name} = {text};"

    def store(self, array: Array, place: str, value: Number) -> str:
        """A value put into memory."""
        cast = "(int)" if array.kind == "int" else ""
        return f"{place} = {cast}{self.number(value)};"

    def loop(self, index: Scalar, count: Number) -> str:
        """Head of a loop."""
        i = index.name
        return f"for (double {i} = 0.0; {i} < {self.number(count)}; {i} += 1.0)"

    def local(self, array: Array) -> list[str]:
        """Declarations of room for the work, which is zero at first."""
        kind = self.types[array.kind]
        if not array.indexed:
            places = [self.place(array, index) for index in np.ndindex(*array.shape)]
            return [f"{kind} {place} = 0.0;" for place in places]
        return [f"{kind} {array.name}{sizes(array)} = {{ 0 }};"]

    def lines(self, block: list[Any], indent: str = "    ") -> list[str]:
        """The statements of a block."""
        result = []
        for one in block:
            if isinstance(one, Let):
                text = self.let(one.result, self.operation(one.operation, one.operands))
            elif isinstance(one, Load):
                text = self.let(one.result, self.place(one.array, one.operands))
            elif isinstance(one, Store):
                *index, value = one.operands
                text = self.store(one.array, self.place(one.array, tuple(index)), value)
            elif isinstance(one, Refuse):
                text = f"if ({self.number(one.operands[0])}) return {self.code(one.code)};"
            else:
                head = self.head(one)
                inner = self.lines(one.block, indent + "    ")
                result += [f"{indent}{head} {{", *inner, indent + "}"]
                continue
            result.append(indent + text)
        return result

    def head(self, statement: When | Loop) -> str:
        """What stands before a block."""
        if isinstance(statement, Loop):
            return self.loop(statement.index, statement.operands[0])
        return f"if ({self.number(statement.operands[0])})"

    def code(self, code: str) -> str:
        """Name of what a step returns."""
        return f"{self.name.upper()}_{code}"

    def body(self, step: Step) -> list[str]:
        """The lines of a step: room for the work, then the statements."""
        block = step.program()
        local = [a for a in step.arrays.values() if a.owner == "local"]
        rooms = [line for a in local for line in self.local(a)]
        lines = self.lines(block)
        used = set(re.findall(r"\w+", "\n".join(lines)))
        unused = [a for a in ("held", "u", "p") if a in step.arrays and a not in used]
        rooms = [room for room in rooms if re.split(r"[ \[]", room)[1] in used]
        return [f"    {room}" for room in rooms] + [f"    (void){a};" for a in unused] + lines


def sizes(array: Array) -> str:
    """The sizes of an array in a declaration."""
    return "".join(f"[{n}]" for n in array.shape)


def constants(kind: str, name: str, values: np.ndarray, written: Callable[[Any], str]) -> str:
    """A table."""
    dimensions = "".join(f"[{size}]" for size in values.shape)
    return f"static const {kind} {name}{dimensions} = {_braces(values, written)};"


def _braces(values: np.ndarray, written: Callable[[Any], str], indent: str = "") -> str:
    if not values.ndim:
        return written(values.item())
    inner = indent + "    "
    if values.ndim > 1:
        rows = ",\n".join(inner + _braces(part, written, inner) for part in values)
        return "{\n" + rows + "\n" + indent + "}"
    words = list(map(written, values.tolist()))
    if len(words) <= PER_LINE:
        return "{ " + ", ".join(words) + " }"
    lines = (", ".join(words[i : i + PER_LINE]) for i in range(0, len(words), PER_LINE))
    return "{\n" + ",\n".join(inner + line for line in lines) + "\n" + indent + "}"


def tables(step: Step, writer: C) -> list[str]:
    """The tables of a step."""
    result = []
    for a in step.arrays.values():
        if a.owner == "table":
            written = (lambda v: str(int(v))) if a.kind == "int" else writer.number
            kind = writer.types[a.kind]
            result.append(constants(kind, f"{writer.name}_{a.name}", a.values, written))
    return result


def signature(step: Step, writer: C) -> str:
    """The arguments of the step in C."""
    given = [f"{writer.name}_state *s"]
    if not step.designed:
        given.append("double now")
    given.append(f"const {writer.types['real']} *y")
    given += ["int indicator"] * bool(step.indicators)
    for name in ("held", "u", "p"):
        if name in step.arrays:
            given.append(f"const {writer.types['real']} *{name}")
    return ", ".join(given)


def to_c(filter: Any, path: str | os.PathLike[str] | None = None, name: str = "filter") -> str:
    """Write a filter as a C99 header that needs <math.h> and <string.h> only."""
    whole = header(recorded(filter), name)
    if path is not None:
        write_whole(path, whole.encode("ascii"))
    return whole


def header(step: Step, name: str) -> str:
    """The header of a recorded step."""
    filter, writer, upper = step.filter, C(name), name.upper()
    text = [comment([str(filter), model_lines(filter.system)])]
    text += [f"#ifndef {upper}_H\n#define {upper}_H\n", "#include <math.h>", "#include <string.h>"]
    text += [f"#define {upper}_{code} {k}" for k, code in enumerate(CODES)]
    text += [f"#define {upper}_{key} {value}" for key, value in dimensions(step).items()]
    text.append(f"typedef double {name}_real;")
    text += tables(step, writer)
    text.append("typedef struct {")
    state = [a for a in step.arrays.values() if a.owner == "state"]
    text += [f"    {writer.types[a.kind]} {a.name}{sizes(a)};" for a in state]
    text.append(f"}} {name}_state;\n")
    text.append(f"static inline void {name}_init({name}_state *s)\n{{")
    text.append("    memset(s, 0, sizeof *s);")
    for field, values in step.start().items():
        array = step.arrays[field]
        text += [
            f"    {writer.place(array, index)} = {writer.number(value)};"
            for index, value in np.ndenumerate(values)
        ]
    text.append("}\n")
    text.append(f"static inline int {name}_step({signature(step, writer)})\n{{")
    text += writer.body(step)
    text.append(f"    return {upper}_OK;\n}}\n\n#endif\n")
    return "\n".join(text)


def dimensions(step: Step) -> dict[str, int]:
    """Sizes that a caller wants to know."""
    known = {"STATE": step.n, "MEASUREMENT": step.m, "ESTIMATE": step.rows}
    known |= {"MODES": step.modes, "INDICATORS": step.indicators, "INPUTS": len(step.inputs)}
    return {key: value for key, value in known.items() if value}


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


def model_lines(system: Any) -> str:
    """The model in words."""
    parts = {**model_text(system), "initial mean": system.mean0.tolist()}
    parts["initial covariance"] = system.cov0.tolist()
    noise = system.sensor_noise if switches(system) else system.sensor.noise
    if noise.size:
        names = noise.size if noise.symbols is None else ", ".join(map(str, noise.symbols))
        parts["sensor noise"] = f"{names}: mean {noise.mean.tolist()}, cov {noise.cov.tolist()}"
    return "Model:\n" + "\n".join(f"  {key:18s} {value}" for key, value in parts.items())
