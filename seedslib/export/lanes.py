"""The program of a filter for whole records, several at once on vector types of GCC and clang.

A vector holds the same number of several records, its lanes. What is common to all records, such
as times, stays a number. Choices and blocks become masks; only look-ups go lane by lane.
"""

from __future__ import annotations

import math
import re
from importlib.resources import files
from typing import Any

import numpy as np

from seedslib.export.c import C, shape
from seedslib.filters.program import Program
from seedslib.tape.tape import SIGNS, Array, Let, Load, Loop, Number, Scalar, Store, When

RESULTS = ("mean", "cov", "loglik", "prob", "mode")
"""What is handed out of the state after each measurement; vectors in any case."""

GIVEN = ("y", "indicator", "held", "u", "p")
"""Arguments that each record has its own of."""

INLINE = {"fabs", "sqrt", "floor", "ceil", "isnan", "isinf", "isfinite"}
"""Functions of vectors that `lanes.c` has by itself."""

TWO_ARGUMENTS = {"pow", "atan2", "hypot"}


class Lanes(C):
    """How C with vectors spells a program.

    Parameters
    ----------
    step : Program
    name : str
        Prefix of the names of the header.
    """

    def __init__(self, step: Program, name: str) -> None:
        super().__init__(name)
        self.varying = varying(step.program())
        self.mask, self.inner, self.masks = "ALL", "", 0

    def differs(self, *values: Number) -> bool:
        """Whether one of them is a vector."""
        return any(type(x) is Scalar and x.name in self.varying for x in values)

    def vector(self, value: Number) -> str:
        """A value as a vector of numbers, whatever it is."""
        text = self.number(value)
        if not self.differs(value):
            return f"all({text})"
        return f"as_numbers({text})" if value.kind == "truth" else text

    def truth(self, value: Number) -> str:
        """A truth as a mask."""
        text = self.number(value)
        return text if self.differs(value) else f"all_or_none({text})"

    def operation(self, operation: str, operands: tuple[Number, ...]) -> str:
        """See `C.operation`."""
        if not self.differs(*operands):
            return super().operation(operation, operands)
        if operation == "!":
            return f"~{self.truth(operands[0])}"
        if operation in {"&&", "||"}:
            return f"{self.truth(operands[0])} {operation[0]} {self.truth(operands[1])}"
        if operation == "choose":
            condition, *arms = operands[0], *map(self.vector, operands[1:])
            if self.differs(condition):
                return f"choose({self.number(condition)}, {', '.join(arms)})"
            return f"{self.number(condition)} ? {arms[0]} : {arms[1]}"
        parts = [self.vector(x) for x in operands]
        if operation in SIGNS:
            return f"{parts[0]} {operation} {parts[1]}"
        return f"-{parts[0]}" if operation == "neg" else f"v_{operation}({', '.join(parts)})"

    def load(self, array: Array, index: tuple[Number, ...]) -> str:
        """See `C.load`; where the place differs between records, lane by lane."""
        if not self.differs(*index):
            return super().load(array, index)
        lead = {"state": "s->", "table": f"{self.name}_"}.get(array.owner, "")
        places, text = "", lead + array.name
        for k, x in enumerate(index):
            if self.differs(x):
                places += f"const vec i{k} = {self.number(x)}; "
            text += f"[(int)i{k}[l]]" if self.differs(x) else f"[(int){self.number(x)}]"
        text += "[l]" * (array.name in self.varying)
        return f"({{ vec r; {places}EACH r[l] = ({self.mask})[l] ? (double){text} : 0.0; r; }})"

    def let(self, result: Scalar, text: str) -> str:
        """See `C.let`."""
        if not self.differs(result):
            return super().let(result, text)
        return f"const {'bits' if result.kind == 'truth' else 'vec'} {result.name} = {text};"

    def store(self, array: Array, place: str, value: Number) -> str:
        """See `C.store`."""
        if array.name not in self.varying:
            return super().store(array, place, value)
        text = self.vector(value)
        if self.mask != "ALL":
            text = f"choose({self.mask}, {text}, {place})"
        return f"{place} = {text};"

    def refuse(self, condition: Number, code: str) -> str:
        """See `C.refuse`; of all records if one of them is refused."""
        if self.mask == "ALL" and not self.differs(condition):
            return super().refuse(condition, code)
        return f"if (any({self.truth(condition)} & {self.mask})) return {self.name.upper()}_{code};"

    def condition(self, statement: When | Loop) -> str:
        """See `C.condition`."""
        (operand,) = statement.operands
        if not self.differs(operand):
            return super().condition(statement)
        self.masks += 1
        mask = self.inner = f"m{self.masks}"
        if isinstance(statement, When):
            lanes = f"{self.truth(operand)} & {self.mask}"
            return f"const bits {mask} = {lanes}; if (any({mask}))"
        i = statement.index.name
        more = f"{mask} = (all({i}) < {self.vector(operand)}) & {self.mask}"
        return f"bits {mask}; for (double {i} = 0.0; any({more}); {i} += 1.0)"

    def lines(self, block: list[Any], indent: str = "    ") -> list[str]:
        """See `C.lines`; those of an inner block hold for the lanes of its mask."""
        outer, self.mask, self.inner = self.mask, self.inner or self.mask, ""
        result = super().lines(block, indent)
        self.mask = outer
        return result

    def local(self, array: Array) -> list[str]:
        """See `C.local`."""
        if array.name not in self.varying:
            return super().local(array)
        if array.indexed:
            return [f"vec {array.name}{shape(array)} = {{ {{ 0 }} }};"]
        return [f"vec {self.place(array, at)} = {{ 0 }};" for at in np.ndindex(*array.shape)]

    def state(self, step: Program) -> str:
        """The state of several records, and its beginning from that of one."""
        arrays = [a for a in step.arrays.values() if a.owner == "state"]
        kinds = ["vec" if a.name in self.varying else self.types[a.kind] for a in arrays]
        lines = ["typedef struct {"]
        lines += [f"    {kind} {a.name}{shape(a)};" for a, kind in zip(arrays, kinds, strict=True)]
        lines += ["} lanes;", f"static void begin(lanes *s, const {self.name}_state *one)", "{"]
        for a in arrays:
            own = f"SPREAD({a.name}, {self.types[a.kind]}, {math.prod(a.shape)})"
            lines.append(f"    {own if a.name in self.varying else f'COPY({a.name})'};")
        return "\n".join([*lines, "}"])


def varying(program: list[Any]) -> set[str]:
    """Names of numbers and arrays that differ between records, by what each record is given."""
    names, count = {*RESULTS, *GIVEN}, -1

    def visit(block: list[Any], masked: bool) -> None:
        for one in block:
            operands = {x.name for x in one.operands if type(x) is Scalar}
            differs = not names.isdisjoint(operands)
            if isinstance(one, Load):
                differs = differs or one.array.name in names
            if isinstance(one, Let | Load) and differs:
                names.add(one.result.name)
            elif isinstance(one, Store) and (differs or masked):
                names.add(one.array.name)
            elif isinstance(one, When | Loop):
                visit(one.block, masked or differs)

    while len(names) > count:  # what a loop or a step stores, the next one loads
        count = len(names)
        visit(program, False)
    return names


def to_lanes(step: Program, name: str) -> str:
    """C that runs whole records of a filter; it stands behind the header of that name."""
    text, own = files("seedslib.export").joinpath("lanes.c").read_text(), Lanes(step, name)
    body = "\n".join(own.step(step))
    called = sorted(set(re.findall(r"\bv_(\w+)\(", body)) - INLINE)
    modes = [("prob", "F_MODES"), ("mode", "1")]
    for mark, part in (
        ("FUNCTIONS", "\n".join(f"FUNCTION{1 + (f in TWO_ARGUMENTS)}({f})" for f in called)),
        ("STATE", own.state(step)),
        ("STEP", body),
        ("MODES", "\n".join(f"ROWS({p}, {p}, {n});" for p, n in modes if p in step.arrays)),
    ):
        text = text.replace(f"/* {mark} */", part)
    return text
