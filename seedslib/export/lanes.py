"""The program of a filter for many records at once, on the vector types of GCC and clang.

A vector holds the same number of several records, its lanes. Numbers that are common to all
records, such as times, stay numbers. Choices become masks; only a look-up goes lane by lane.
"""

from __future__ import annotations

import math
import re
from importlib.resources import files
from typing import Any

from seedslib.export.c import C
from seedslib.export.step import Step
from seedslib.export.tape import Let, Load, Loop, Number, Refuse, Scalar, Store, When

RESULTS = ("mean", "cov", "loglik", "prob", "mode")
"""What is handed out of the state after each measurement; vectors in any case."""

ARGUMENTS = ("y", "indicator", "held", "u", "p")

INLINE = {"fabs", "sqrt", "floor", "ceil", "isnan", "isinf", "isfinite"}
"""Functions that `lanes.c` has by itself."""


def to_lanes(step: Step, name: str) -> str:
    """C that runs whole records of a filter; it stands behind the header of that name."""
    text, own = files("seedslib.export").joinpath("lanes.c").read_text(), _Writer(step, name)
    modes = [("prob", "F_MODES"), ("mode", "1")]
    rows = [
        f"            ROWS({part}, {part}, {size});" for part, size in modes if part in step.arrays
    ]
    for mark, lines in (
        ("FUNCTIONS", own.functions()),
        ("STATE", own.state()),
        ("STEP", own.step()),
        ("MODES", rows),
    ):
        text = text.replace(f"/* {mark} */", "\n".join(lines))
    return text


def varying(program: list[Any], arrays: list[str]) -> set[str]:
    """Names of what differs between records, given arrays that do."""
    names, count = set(arrays), -1

    def visit(block: list[Any], masked: bool) -> None:
        for statement in block:
            differs = masked or any(x.name in names for x in statement.operands if _named(x))
            match statement:
                case Let() | Load():
                    own = getattr(statement, "array", None)
                    operands = [x.name for x in statement.operands if _named(x)]
                    if not names.isdisjoint(operands) or (own and own.name in names):
                        names.add(statement.result.name)
                case Store() if differs:
                    names.add(statement.array.name)
                case When() | Loop():
                    visit(statement.block, differs)

    while len(names) > count:  # what a loop or a step stores, the next one loads
        count = len(names)
        visit(program, False)
    return names


class _Writer:
    def __init__(self, step: Step, name: str) -> None:
        self.program, self.arrays, self.prefix = step.program(), step.arrays, name
        self.varying = varying(self.program, [*RESULTS, *ARGUMENTS])
        self.masks, self.writer = 0, C(name)

    def functions(self) -> list[str]:
        """Functions of vectors that are called."""
        calls = set(re.findall(r"\bv_(\w+)\((?!.*;.*;)", "\n".join(self.step())))
        pairs = {"pow", "atan2", "hypot"}
        return [f"FUNCTION{1 + (c in pairs)}({c})" for c in sorted(calls - INLINE)]

    def state(self) -> list[str]:
        """The state of several records, and its beginning from that of one."""
        kept = [a for a in self.arrays.values() if a.owner == "state"]
        fields = [f"    {self.kind(a)} {a.name}{_sizes(a)};" for a in kept]
        starts = [
            f"    {'SPREAD' if a.name in self.varying else 'COPY'}({a.name}, {_kind(a)}, "
            f"{math.prod(a.shape)});"
            for a in kept
        ]
        head = f"static void begin(lanes *s, const {self.prefix}_state *one)"
        return ["typedef struct {", *fields, "} lanes;", "", head, "{", *starts, "}"]

    def step(self) -> list[str]:
        """Statements of one step."""
        rooms = [
            f"    {self.kind(a)} {a.name}{_sizes(a)} = {{ 0 }};"
            for a in self.arrays.values()
            if a.owner == "local"
        ]
        return [*rooms, *self.block(self.program, "", "    ")]

    def kind(self, array: Any) -> str:
        return "vec" if array.name in self.varying else _kind(array)

    def differs(self, value: Number) -> bool:
        return _named(value) and value.name in self.varying

    def text(self, value: Number) -> str:
        return value.name if _named(value) else self.writer.number(value)

    def vector(self, value: Number) -> str:
        """A value as a vector, whatever it is."""
        return self.text(value) if self.differs(value) else f"all({self.text(value)})"

    def mask(self, truth: Number) -> str:
        return self.text(truth) if self.differs(truth) else f"all_or_none({self.text(truth)})"

    def place(self, array: Any, index: tuple[Number, ...]) -> str:
        """A place in an array; in lane l where that depends on the lane."""
        apart = any(map(self.differs, index))
        text = {"state": "s->", "table": f"{self.prefix}_"}.get(array.owner, "") + array.name
        for i in index:
            lane = "[l]" if self.differs(i) else ""
            text += f"[(int){i.name}{lane}]" if _named(i) else f"[{int(i)}]"
        return text + ("[l]" if apart and array.name in self.varying else "")

    def block(self, block: list[Any], mask: str, indent: str) -> list[str]:
        """Lines of statements, done in the lanes of a mask; no name of one stands for all."""
        lines: list[str] = []
        for statement in block:
            for line in self.lines(statement, mask):
                lines.append(indent + line)
            if isinstance(statement, When | Loop):
                inner = self.masked(statement, mask)
                lines += [*self.block(statement.block, inner, indent + "    "), indent + "}"]
        return lines

    def masked(self, statement: When | Loop, mask: str) -> str:
        """The mask of what is inside of a statement, which `lines` has just begun."""
        return f"m{self.masks}" if self.differs(statement.operands[0]) else mask

    def lines(self, statement: Any, mask: str) -> list[str]:
        match statement:
            case Let(result, operation, operands):
                return [
                    f"const {self.type(result)} {result.name} = {self.value(operation, operands)};"
                ]
            case Load(result, array, operands):
                place = self.place(array, operands)
                if any(map(self.differs, operands)):
                    return [
                        f"vec {result.name};",
                        f"GATHER({result.name}, {mask or 'ALL'}, {place});",
                    ]
                return [f"const {self.type(result)} {result.name} = {place};"]
            case Store(array, (*index, value)):
                return [self.stored(array, tuple(index), value, mask)]
            case Refuse((truth,), code):
                if mask or self.differs(truth):
                    truth_text = self.mask(truth) + (f" & {mask}" if mask else "")
                    return [f"if (any({truth_text})) return {self.prefix.upper()}_{code};"]
                return [f"if ({self.text(truth)}) return {self.prefix.upper()}_{code};"]
            case When((truth,), _):
                if not self.differs(truth):
                    return [f"if ({self.text(truth)}) {{"]
                self.masks += 1
                both = f"{truth.name} & {mask}" if mask else truth.name
                return [f"const bits m{self.masks} = {both};", f"if (any(m{self.masks})) {{"]
            case Loop(index, (count,), _):
                head = f"for (double {index.name} = 0.0; @; {index.name} += 1.0) {{"
                more = f"{index.name} < {self.text(count)}"
                if not self.differs(count):
                    return [head.replace("@", more)]
                self.masks += 1
                more = f"({more})" + (f" & {mask}" if mask else "")
                return [
                    head.replace("@", f"any({more})"),
                    f"    const bits m{self.masks} = {more};",
                ]
        raise TypeError(f"statement: wanted one of a tape, got {statement!r}")

    def type(self, result: Scalar) -> str:
        kinds = {False: ("double", "int"), True: ("vec", "bits")}
        return kinds[self.differs(result)][result.kind == "truth"]

    def value(self, operation: str, operands: tuple[Number, ...]) -> str:
        """An operation on numbers or, where one of them differs between records, on vectors."""
        vectors = any(map(self.differs, operands))
        part = self.text
        if vectors and (operation.isidentifier() or operation in {"&&", "||", "!"}):
            part = self.mask if operation in {"&&", "||", "!"} else self.vector
        if operation == "choose":
            condition, first, second = operands
            arms = f"{part(first)}, {part(second)}"
            if self.differs(condition):
                return f"choose({condition.name}, {arms})"
            return f"{self.text(condition)} ? {arms.replace(', ', ' : ')}"
        if operation == "neg":
            return f"-{self.text(operands[0])}"
        if operation == "!":
            return f"{'~' if vectors else '!'}{part(operands[0])}"
        if operation.isidentifier():
            return f"{'v_' * vectors}{operation}({', '.join(map(part, operands))})"
        sign = operation[0] if vectors and operation in {"&&", "||"} else operation
        return f"{part(operands[0])} {sign} {part(operands[1])}"

    def stored(self, array: Any, index: tuple[Number, ...], value: Number, mask: str) -> str:
        place = self.place(array, index)
        if array.name not in self.varying:
            return f"{place} = {'(int)' * (array.kind == 'int')}{self.text(value)};"
        if any(map(self.differs, index)):
            return f"SCATTER({mask or 'ALL'}, {place}, {self.vector(value)});"
        given = self.vector(value)
        return f"{place} = {f'choose({mask}, {given}, {place})' if mask else given};"


def _named(value: Number) -> bool:
    return type(value) is Scalar


def _kind(array: Any) -> str:
    return "int" if array.kind == "int" else "double"


def _sizes(array: Any) -> str:
    return "".join(f"[{n}]" for n in array.shape)
