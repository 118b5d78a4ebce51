"""What all languages that programs are written in have in common."""

from __future__ import annotations

from collections import Counter
from typing import Any, ClassVar

from seedslib.tape.tape import (
    SIGNS,
    Array,
    Let,
    Load,
    Loop,
    Number,
    Refuse,
    Scalar,
    Store,
    When,
    walk,
)


class Writer:
    """How a language spells a program; each language is a class of its own.

    A value that is used once is written where it is used, if it is short.

    Attributes
    ----------
    shapes : dict
        Operations that are no calls, as formats of their operands.
    longest : int
        Characters of a value that is written where it is used.
    end : str
        The line after a block; none where it is empty.
    """

    shapes: ClassVar[dict[str, str]] = {sign: f"{{}} {sign} {{}}" for sign in SIGNS}
    longest: ClassVar[int] = 60
    end: ClassVar[str] = ""

    def __init__(self) -> None:
        self.inlined: dict[str, str] = {}
        self.compound: set[str] = set()

    def constant(self, value: float) -> str:
        """A number that is read back exactly."""
        return repr(float(value))

    def whole(self, value: Number) -> str:
        """A name, an expression in its place, or a constant."""
        if type(value) is not Scalar:
            return self.constant(value)
        return self.inlined.get(value.name, value.name)

    def number(self, value: Number) -> str:
        """The same where it is a part of an expression."""
        part = type(value) is Scalar and value.name in self.compound
        return f"({self.whole(value)})" if part else self.whole(value)

    def operation(self, operation: str, operands: tuple[Number, ...]) -> str:
        """An expression."""
        if operation in self.shapes:
            return self.shapes[operation].format(*map(self.number, operands))
        return f"{operation}({', '.join(map(self.whole, operands))})"

    def place(self, array: Array, index: tuple[Number, ...]) -> str:
        """A place in memory."""
        raise NotImplementedError

    def variable(self, array: Array, index: tuple[Number, ...]) -> str:
        """Name of a place of an array of which all places are known."""
        return "_".join([array.name, *(str(int(x)) for x in index)])

    def load(self, array: Array, index: tuple[Number, ...]) -> str:
        """A number from memory."""
        return self.place(array, index)

    def let(self, result: Scalar, text: str) -> str:
        """A named value."""
        return f"{result.name} = {text}"

    def store(self, array: Array, place: str, value: Number) -> str:
        """A value put into memory."""
        raise NotImplementedError

    def head(self, statement: When | Loop) -> str:
        """What stands before a block."""
        raise NotImplementedError

    def refuse(self, condition: Number, code: str) -> str:
        """The end of the step with a code."""
        raise NotImplementedError

    def body(self, block: list[Any]) -> list[str]:
        """The lines of a program."""
        uses = Counter(x.name for one in walk(block) for x in one.operands if type(x) is Scalar)
        self.once = {name for name, count in uses.items() if count == 1}
        return self.lines(block)

    def lines(self, block: list[Any], indent: str = "    ") -> list[str]:
        """The statements of a block."""
        result = []
        own = {
            x.name
            for one in block
            if not isinstance(one, Loop)
            for x in one.operands
            if type(x) is Scalar and x.name in self.once
        }
        for one in block:
            if isinstance(one, Let | Load):
                text = (
                    self.operation(one.operation, one.operands)
                    if isinstance(one, Let)
                    else self.load(one.array, one.operands)
                )
                fixed = isinstance(one, Let) or one.array.owner in {"argument", "table"}
                if fixed and one.result.name in own and len(text) <= self.longest:
                    self.inlined[one.result.name] = text
                    if isinstance(one, Let) and one.operation in self.shapes:
                        self.compound.add(one.result.name)
                    continue
                text = self.let(one.result, text)
            elif isinstance(one, Store):
                *index, value = one.operands
                text = self.store(one.array, self.place(one.array, tuple(index)), value)
            elif isinstance(one, Refuse):
                text = self.refuse(one.operands[0], one.code)
            else:
                result.append(f"{indent}{self.head(one)}")
                result += self.lines(one.block, indent + "    ")
                result += [indent + self.end] if self.end else []
                continue
            result.append(indent + text)
        return result
