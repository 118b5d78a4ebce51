"""A recorded step as one C99 header."""

from __future__ import annotations

import math
import os
import re
import textwrap
from collections.abc import Callable
from importlib.resources import files
from typing import Any, ClassVar

import numpy as np

from seedslib.base.atomic import write_whole
from seedslib.designed.tables import TableFilter
from seedslib.export.programs import recorded
from seedslib.filters.covariance import CovarianceFilter
from seedslib.filters.program import Program
from seedslib.tape.tape import Array, Loop, Number, Scalar, When
from seedslib.tape.writer import Writer

WIDTH = 100
PER_LINE = 4
"""Numbers of a table in a line."""


class C(Writer):
    """How C spells a program.

    Parameters
    ----------
    name : str
        Prefix of the names of tables and types.
    """

    shapes: ClassVar[dict[str, str]] = {
        **Writer.shapes,
        **{"neg": "-{}", "!": "!{}", "choose": "{} ? {} : {}"},
    }
    end = "}"

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self.types = {"real": f"{name}_real", "time": "double", "int": "int", "truth": "int"}

    def constant(self, value: float) -> str:
        """See `Writer.constant`."""
        if math.isnan(value):
            return "(double)NAN"
        return repr(float(value)) if math.isfinite(value) else "-HUGE_VAL"[value > 0 :]

    def place(self, array: Array, index: tuple[Number, ...]) -> str:
        """See `Writer.place`; arrays of which all places are known are one variable a place."""
        if array.owner == "local" and not array.indexed:
            return self.variable(array, index)
        lead = {"state": "s->", "table": f"{self.name}_"}.get(array.owner, "")
        places = (f"(int){self.number(x)}" if type(x) is Scalar else str(int(x)) for x in index)
        return lead + array.name + "".join(f"[{place}]" for place in places)

    def let(self, result: Scalar, text: str) -> str:
        """See `Writer.let`."""
        return f"const {self.types[result.kind]} {result.name} = {text};"

    def store(self, array: Array, place: str, value: Number) -> str:
        """See `Writer.store`."""
        value = f"(int){self.number(value)}" if array.kind == "int" else self.whole(value)
        return f"{place} = {value};"

    def head(self, statement: When | Loop) -> str:
        """See `Writer.head`."""
        return f"{self.condition(statement)} {{"

    def condition(self, statement: When | Loop) -> str:
        """What a block depends on."""
        (operand,) = statement.operands
        if isinstance(statement, When):
            return f"if ({self.whole(operand)})"
        i = statement.index.name
        return f"for (double {i} = 0.0; {i} < {self.number(operand)}; {i} += 1.0)"

    def refuse(self, condition: Number, code: str) -> str:
        """See `Writer.refuse`."""
        return f"if ({self.whole(condition)}) return {self.name.upper()}_{code};"

    def local(self, array: Array) -> list[str]:
        """Declarations of memory for one step, which is zero at first."""
        kind = self.types[array.kind]
        if array.indexed:
            return [f"{kind} {array.name}{shape(array)} = {{ 0 }};"]
        places = (self.place(array, index) for index in np.ndindex(*array.shape))
        return [f"{kind} {place} = 0.0;" for place in places]

    def step(self, step: Program) -> list[str]:
        """The lines of a step: its memory, then the statements."""
        lines = self.body(step.program())
        used = set(re.findall(r"\w+", "\n".join(lines)))
        local = [a for a in step.arrays.values() if a.owner == "local"]
        memory = [line for a in local for line in self.local(a)]
        memory = [line for line in memory if re.split(r"[ \[]", line)[1] in used]
        return [f"    {line}" for line in memory] + lines


def shape(array: Array) -> str:
    """The sizes of an array in a declaration."""
    return "".join(f"[{n}]" for n in array.shape)


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


def tables(step: Program, writer: C) -> list[str]:
    """The tables of a step."""
    result = []
    for a in step.arrays.values():
        if a.owner == "table":
            written = str if a.kind == "int" else writer.constant
            values = a.values.astype(int) if a.kind == "int" else a.values
            head = f"static const {writer.types[a.kind]} {writer.name}_{a.name}{shape(a)}"
            result.append(f"{head} = {_braces(values, written)};")
    return result


def signature(step: Program, writer: C, verb: str = "step", time: str = "time") -> str:
    """Head of the step in C, or of another verb with the same arguments but for the time."""
    real = f"const {writer.types['real']} *"
    kinds = {"time": "double ", "y": real, "indicator": "int ", "held": real, "u": real, "p": real}
    given = [kinds[a] + (time if a == "time" else a) for a in arguments(step)]
    given = [f"{writer.name}_state *s", *given]
    head = f"static inline int {writer.name}_{verb}("
    lines = [head]
    for part in given:
        if len(lines[-1]) + len(part) + 2 > WIDTH:
            lines[-1] = lines[-1].rstrip()
            lines.append(" " * len(head))
        lines[-1] += part + ", "
    return "\n".join(lines)[:-2] + ")"


def arguments(step: Program) -> list[str]:
    """Names of the arguments of a step in their order."""
    known = [step.arrays.get(name) for name in ("time", "y", "indicator", "held", "u", "p")]
    return [a.name for a in known if a is not None and a.owner == "argument"]


def to_c(filter: Any, path: str | os.PathLike[str] | None = None, name: str = "filter") -> str:
    """Write a filter as a C99 header that needs <math.h> and <string.h> only.

    Tables of a design are constants, everything else is the library's own formulas, recorded.
    All functions are ``static inline``. The header holds ``<name>_state``,
    ``<name>_init(state *)`` and

    - for a designed filter ``<name>_step(state *, const real *y)``, one measurement;
    - for one that carries its distribution ``<name>_step(state *, double time, const real *y)``,
      ``<name>_after(state *, double dt, const real *y)`` for a clock that knows what has passed
      since the last measurement, and, where that is a mean and a covariance, the halves
      ``<name>_predict(state *, double time)`` and ``<name>_correct(state *, const real *y)``.

    The last arguments are, as far as the model has them, ``int indicator``, and the inputs in the
    order of their names: ``const real *held``, those since the last time, and ``const real *u``,
    those at this time. All but the first return ``<NAME>_OK`` (zero) or why they refused.

    Parameters
    ----------
    filter : FiniteOrderFilter, TableFilter, SwitchingFilter or CovarianceFilter
        With `Taylor`, `ExactGaussian`, or with one mode a rule with points.
    path : path_like, optional
        Where to write the header as well.
    name : str
        Prefix of all names.

    Returns
    -------
    str
        The header. Equal filters give equal text.

    Raises
    ------
    TypeError, ValueError
        A filter or a part of it that has no C; the message says what is wanted.
    NoClosedForm
        A mean of the model has no closed form.

    Warns
    -----
    UserWarning
        A prior so wide that a variance loses its digits in C.

    Notes
    -----
    Without contraction of products and sums (-ffp-contract=off) C and Python differ by the
    rounding of what Python leaves to BLAS and LAPACK: from one state a step is the same within
    1e-13 of the largest value, where the covariance of the measurement is far from singular.
    Along a record a difference is carried on as any error of an estimate is: a filter that
    forgets its past keeps it small, one whose sensor leaves a direction almost unseen can make it
    a million times larger in a hundred steps. The same holds in Python of records filtered alone
    and in a batch.

    The type ``<name>_real`` of all numbers but times is double; with float in its place the
    header is still correct C.

    Examples
    --------
    >>> from seedslib.export import to_c
    >>> from seedslib.filters import extended_kalman
    >>> from seedslib import zoo
    >>> text = to_c(extended_kalman(zoo.van_der_pol()), name="oscillator")
    >>> "oscillator_step" in text
    True
    """
    if path in ("float", "double"):
        raise ValueError(
            f"path: wanted a path such as filter.h, got {path!r}; the type of numbers is the "
            f"typedef {name}_real of the header"
        )
    text = header(recorded(filter), checked_name(name))
    if path is not None:
        write_whole(path, text.encode("ascii"))
    return text


def header(step: Program, name: str) -> str:
    """The header of a recorded step."""
    writer, upper = C(name), name.upper()
    state = [a for a in step.arrays.values() if a.owner == "state"]
    sizes = (f"#define {upper}_{key} {value}\n" for key, value in dimensions(step).items())
    start = (
        f"    {writer.place(step.arrays[field], index)} = {writer.constant(value)};\n"
        for field, values in step.initial.items()
        for index, value in np.ndenumerate(values)
    )
    untold = f"    if (held == NULL || u == NULL) return {upper}_UNTOLD;"
    lines = [untold] * bool(step.inputs) + writer.step(step)
    names = {"name": name, "NAME": upper}
    inputs = (f", const {name}_real *u", ", u, u") if step.inputs else ("", "")
    halves = filled("halves.h", {**names, "INPUTS": inputs[0], "PASSED": inputs[1]})
    after = {"name": name, "SIGNATURE": signature(step, writer, "after", "dt")}
    passed = ["s", "s->started ? s->t + dt : 0.0", *arguments(step)[1:]]
    timed = {"t", "started", "time"} <= step.arrays.keys() and not step.parameters
    marks = {
        **names,
        "AFTER": filled("after.h", {**after, "PASSED": ", ".join(passed)}) if timed else "",
        "SIZES": "".join(sizes),
        "TABLES": "\n".join(tables(step, writer)),
        "FIELDS": "\n".join(f"    {writer.types[a.kind]} {a.name}{shape(a)};" for a in state),
        "START": "".join(start),
        "SIGNATURE": signature(step, writer),
        "LINES": "\n".join(lines),
        "HALVES": halves if carries_cov(step) and not step.parameters else "",
    }
    words = about(step, "C").replace("@STACK", f"{stack(lines):,}")
    return words.replace("@name", name).replace("@NAME", upper) + filled("header.h", marks)


def stack(lines: list[str]) -> int:
    """Bytes of all named values of a step, in double precision."""
    names = [re.match(r"\s*(?:const )?\w+ \w+((?:\[\d+\])*) = ", line) for line in lines]
    sizes = (map(int, re.findall(r"\d+", found[1])) for found in names if found)
    return 8 * sum(math.prod(size) for size in sizes)


def filled(file: str, marks: dict[str, Any]) -> str:
    """A text of this package with its marks, such as ``@name``, filled in."""
    names = "|".join(sorted(marks, key=len, reverse=True))
    text = files("seedslib.export").joinpath(file).read_text()
    return re.sub(f"@({names})", lambda match: str(marks[match[1]]), text)


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


def dimensions(step: Program) -> dict[str, int]:
    """Sizes that a caller wants to know."""
    known = {"STATE": step.n, "MEASUREMENT": step.m, "ESTIMATE": step.rows}
    known |= {"MODES": step.modes, "INDICATORS": step.indicators, "INPUTS": len(step.inputs)}
    if step.designed:
        known |= {"TIMES": len(step.filter.times), "CYCLE": step.filter.cycle or 0}
        memory = step.arrays.get("memory")
        known["MEMORY"] = 0 if memory is None else math.prod(memory.shape)
    return {key: value for key, value in known.items() if value}


def about(step: Program, language: str) -> str:
    """The comment that a program begins with: the filter, the model, what people must know."""
    filter, which = step.filter, ", ".join(map(str, step.inputs))
    known = filled("notes.txt", {"WHICH": which}).strip().split("\n\n")
    notes = dict(paragraph.split(": ", 1) for paragraph in known)
    table = isinstance(filter, TableFilter)
    chosen = [language, "WHOLE" if table else "REDUNDANT"]
    chosen += ["MODES"] * (step.modes > 0 and not table) + ["INPUTS"] * bool(step.inputs)
    described = str(filter)
    if carries_cov(step):  # it prints as its class and its arguments
        described = f"Filter that carries mean and covariance: {filter.linearization}"
        if filter.continuous:
            described += f"\n  {filter.integrator}, steps of {filter.integration_step:g}"
    return comment([described, *(notes[name] for name in chosen)])


def carries_cov(step: Program) -> bool:
    """Whether the state of the filter is a time, a mean and a covariance."""
    return isinstance(step.filter, CovarianceFilter)


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
