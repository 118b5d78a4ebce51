"""Statements of exported C as ECMAScript; loops of few passes are written out."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from seedslib.extra.js.expressions import LITERAL, Changed, Expressions
from seedslib.extra.js.tokens import NUMBERS, Type

_FEW, _MANY = 12, 64
"""Passes of a loop, and of loops in each other, that are written out."""


@dataclass(frozen=True)
class Place:
    """Where a statement is.

    Attributes
    ----------
    passes : int
        Of the loops around it that are written out.
    begin : int
        Token with which the outermost loop around it begins, or -1.
    out : bool
        Whether the nearest loop is written out.
    fixed : frozenset of str
        What is known and must stay so, as it is not certain that the statement is reached.
    """

    passes: int = 1
    begin: int = -1
    out: bool = False
    fixed: frozenset[str] = frozenset()


class Statements(Expressions):
    """A reader of tokens that translates statements."""

    def __init__(self, found: list[tuple[str, str]], macros: dict[str, float]) -> None:
        super().__init__(found, macros)
        self.place, self.end, self.size = Place(), 0, 0
        self._arrays: dict[int, int] = {}

    def block(self, indent: str) -> str:
        """Statements in braces."""
        self.want("{")
        self.scopes.append({})
        lines: list[str] = []
        while not self.take("}"):
            lines += self._lines(indent + "  ")
        self.scopes.pop()
        return _braces(lines, indent)

    def _lines(self, indent: str) -> list[str]:
        """Lines of a statement; without braces, where they hold no declarations."""
        text = self._statement(indent)
        inner = text[2:].rpartition("\n")[0] if text.startswith("{\n") else ""
        if inner and not re.search(rf"^{indent}  (const|let) ", inner, re.M):
            return [re.sub("^  ", "", inner, flags=re.M)[len(indent) :]]
        return [text] if text not in ("", ";") else []

    def _statement(self, indent: str) -> str:
        if self.at("{"):
            return self.block(indent)
        if self.take("if"):
            return self._if(indent)
        if self.take("for"):
            return self._for(indent)
        if self.take("while"):
            return f"while ({self._test()}) {self._unsure(indent, self._at)}"
        for word in ("break", "continue"):
            if self.take(word):
                if self.place.out:
                    raise Changed
                self.want(";")
                return f"{word};"
        if self.take("return"):
            text = "" if self.at(";") else f" {self.expression()[0]}"
            self.want(";")
            return f"return{text};"
        if self.is_type():
            return self._local()
        if self.take(";"):
            return ";"
        text = self._list()
        self.want(";")
        return "" if text == "undefined" else f"{text};"

    def _test(self) -> str:
        self.want("(")
        test = self.expression()[0]
        self.want(")")
        return test

    def _list(self) -> str:
        parts = [self.expression()[0]]
        while self.take(","):
            parts.append(self.expression()[0])
        return ", ".join(parts)

    def _unsure(self, indent: str, begin: int = -1) -> str:
        """A statement that may not be reached or, with the token of its loop, often."""
        held = self.place
        self.place = replace(held, fixed=frozenset(self.known))
        if begin >= 0:
            first = begin if held.begin < 0 else held.begin
            self.place = replace(self.place, begin=first, out=False)
        text = self._statement(indent) or ";"
        self.place = held
        return text

    def _if(self, indent: str) -> str:
        test = self._test()
        if not LITERAL.fullmatch(test):
            text = f"if ({test}) {self._unsure(indent)}"
            return text + f" else {self._unsure(indent)}" if self.take("else") else text
        text = self._statement(indent) if int(test) else self._pass()
        if self.take("else"):
            text += self._pass() if int(test) else self._statement(indent)
        return text

    def _pass(self) -> str:
        """Pass a statement."""
        if self.at("{"):
            self.skip()
        elif self.take("if") or self.take("for") or self.take("while"):
            self.skip()
            self._pass()
            if self.take("else"):
                self._pass()
        else:
            while not self.take(";"):
                self.next()
        return ""

    # Loops

    def _for(self, indent: str) -> str:
        begin, known, place, depth = self._at, dict(self.known), self.place, len(self.scopes)
        try:
            return self._written_out(indent)
        except Changed:
            self._at, self.known, self.place = begin, known, place
            del self.scopes[depth:]
        self.want("(")
        parts = []
        for end in ";;)":
            parts.append("" if self.at(end) else self._list())
            self.want(end)
        return f"for ({'; '.join(parts)}) {self._unsure(indent, begin)}"

    def _written_out(self, indent: str) -> str:
        """A loop of few passes, in each of which its counters are known.

        Raises
        ------
        Changed
            It is not one.
        """
        begin, place, lines = self._at, self.place, []
        test, step, body = self._parts()
        counters = self._started()
        first = begin if place.begin < 0 else place.begin
        before, passes = dict(self.known), 0
        while self._goes_on(test):
            passes += 1
            if passes > _FEW or passes * place.passes > _MANY:
                raise Changed
            self._at = step
            self._step()
        self.known = before
        self.place = replace(place, passes=passes * place.passes, begin=first, out=True)
        while self._goes_on(test):
            self._at = body
            lines += self._lines(indent + "  ")
            self._at = step
            self._step()
        self.place, self._at = place, body
        self._pass()
        for name in counters:
            value = self.known.pop(name)
            if self._read_later(name, first if place.begin >= 0 else -1):
                lines.append(f"{name} = {value};")
        return _braces(lines, indent) if lines else ""

    def _parts(self) -> tuple[int, int, int]:
        """Where the test, the step and the body of a loop are."""
        begin = self._at
        self.skip()
        ends = [i for i in range(begin, self._at) if self._all[i][1] == ";"]
        test, step, body = ends[0] + 1, ends[1] + 1, self._at
        self._at = begin
        return test, step, body

    def _started(self) -> list[str]:
        """Counters of a loop, which are known from here."""
        self.want("(")
        counters = []
        if self.at(";"):
            raise Changed
        while not self.take(";"):
            name = self.next()
            kind = self.kind(name)
            if name in self.known or kind != Type(whole=True) or not self.take("="):
                raise Changed
            value = self.expression()[0]
            if not LITERAL.fullmatch(value):
                raise Changed
            self.take(",")
            counters.append(name)
            self.known[name] = value
        return counters

    def _goes_on(self, test: int) -> bool:
        self._at = test
        if self.at(";"):
            raise Changed
        value = self.expression()[0]
        if value not in ("0", "1"):
            raise Changed
        return value == "1"

    def _step(self) -> None:
        while not self.take(")"):
            name, by = self.next(), {"++": 1, "--": -1}.get(self.next(), 0)
            self.take(",")
            if not by or name not in self.known or name in self.place.fixed:
                raise Changed
            self.known[name] = str(int(self.known[name]) + by)

    def _read_later(self, name: str, begin: int) -> bool:
        """Whether a counter may be read after its loop before it is set again."""
        for start in (self._at, begin):
            found = next(self._places(name, start), None) if start >= 0 else None
            if found is not None and self._all[found + 1][1] != "=":
                return True
        return False

    def _places(self, name: str, begin: int) -> Iterator[int]:
        return (i for i in range(begin, self.end) if self._all[i][1] == name)

    # Declarations

    def base(self) -> Type:
        """A structure or a number."""
        kind = Type()
        while self.is_type():
            word = self.next()
            if word in self.structs:
                kind = Type("struct", (), word)
            elif word in ("int", "size_t", "char"):
                kind = Type(whole=True)
        return kind

    def declared(self, base: Type) -> tuple[str, Type]:
        """Name and type of one declarator."""
        address = self.take("*")
        name, dims = self.next(), []
        while self.take("["):
            dims.append(int(self.expression()[0]))
            self.want("]")
        if address:
            return name, replace(base, kind="address")
        return name, replace(base, kind="array", dims=tuple(dims)) if dims else base

    def _local(self) -> str:
        fixed = self.at("const") and self._all[self._at + 1][1] in NUMBERS
        base, found = self.base(), []
        while True:
            begin = self._at
            name, kind = self.declared(base)
            self.scopes[-1][name] = kind
            if kind.kind in ("array", "struct"):
                count = kind.size(self.structs)
                if begin not in self._arrays:
                    self._arrays[begin] = self.size
                    self.size += count
                place = self.known[name] = str(self._arrays[begin])
                if self.take("="):
                    self.skip()
                    found.append(f"{self._called('memset', [place, '0', str(count)])};")
            elif self.take("="):
                word = "const" if fixed and kind.kind == "number" else "let"
                value = self.expression()[0]
                if word == "const" and kind.whole and LITERAL.fullmatch(value):
                    self.known[name] = value
                else:
                    found.append(f"{word} {name} = {value};")
            else:
                found.append(f"let {name} = 0;")
            if not self.take(","):
                break
        self.want(";")
        return " ".join(found)


def _braces(lines: list[str], indent: str) -> str:
    return "{\n" + "".join(f"{indent}  {line}\n" for line in lines) + indent + "}"
