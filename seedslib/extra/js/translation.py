"""Exported C as ECMAScript: all numbers in one array, addresses are places in it.

The C that the library writes has no recursion and no heap, so that every array, those of
functions included, has a place of its own from the start.
"""

from __future__ import annotations

import re

import numpy as np

from seedslib.extra.js.expressions import Expressions
from seedslib.extra.js.tokens import NUMBERS, Type, preprocessed, tokens


class Translation(Expressions):
    """The parts of a C text, translated.

    Attributes
    ----------
    numbers : list of float
        What the array holds at the start; the places of functions come behind.
    size : int
        Places of the array.
    structs : dict
        Parts of each structure, with their types.
    lines : list of str
        Functions and the places of tables.
    called : set of str
        Functions of C that are called.

    Raises
    ------
    ValueError
        C that has no translation.
    """

    def __init__(self, text: str) -> None:
        macros, text = preprocessed(text)
        super().__init__([*tokens(text), ("end", "")], macros)
        self.numbers: list[float] = []
        self.places: dict[str, int] = {}
        self.lines: list[str] = []
        self._wanted: list[int] = []
        while self.now[0] != "end":
            self._outermost()
        places = np.cumsum([len(self.numbers), *self._wanted]).tolist()
        self.size = places[-1]
        self.lines = [re.sub("@(\\d+)@", lambda m: str(places[int(m[1])]), x) for x in self.lines]

    # Declarations

    def _base(self) -> str:
        """Name of a structure, or nothing for a number."""
        name = ""
        while self.is_type():
            word = self.next()
            name = word if word in self.structs else name
        return name

    def _declared(self, struct: str) -> tuple[str, Type]:
        """Name and type of one declarator."""
        address = self.take("*")
        name, dims = self.next(), []
        while self.take("["):
            dims.append(self._whole("]"))
            self.want("]")
        if address:
            return name, Type("address", (), struct)
        if dims:
            return name, Type("array", tuple(dims), struct)
        return name, Type("struct", (), struct) if struct else Type()

    def _whole(self, end: str) -> int:
        """A constant expression of whole numbers."""
        text, depth = "", 0
        while depth or self.now[1] != end:
            word = self.next()
            depth += (word in "([") - (word in ")]")
            text += f"{self.macros.get(word, word)} ".replace("/", "//")
        return int(eval(text, {"__builtins__": {}}))  # digits and signs of our own text

    def _outermost(self) -> None:
        if self.take("typedef"):
            self.want("struct")
            self.want("{")
            parts: dict[str, Type] = {}
            while not self.take("}"):
                struct = self._base()
                while not self.take(";"):
                    name, kind = self._declared(struct)
                    parts[name] = kind
                    self.take(",")
            self.structs[self.next()] = parts
            self.want(";")
            return
        self.want("static")
        self.take("inline")
        struct = self._base()
        name, kind = self._declared(struct)
        if self.take("="):
            self.scopes[0][name], self.places[name] = kind, len(self.numbers)
            self.numbers += self._data()
            self.lines.append(f"const {name} = {self.places[name]};")
            self.want(";")
            return
        self.want("(")
        scope: dict[str, Type] = {}
        given: list[str] = []
        self.functions.add(name)
        while not self.take(")"):
            struct = self._base()
            parameter, kind = self._declared(struct)
            if kind.kind == "array":
                kind = Type("address", kind.dims[1:], kind.struct)
            scope[parameter] = kind
            given.append(parameter)
            self.take(",")
        self.scopes.append(scope)
        body = self._block("")
        self.scopes.pop()
        # an array that is known inside of the function is quicker
        body = body.replace("{\n", "{\n  const M = H;\n", 1)
        self.lines.append(f"function {name}({', '.join(given)}) {body}")

    def _data(self) -> list[float]:
        if self.take("{"):
            found: list[float] = []
            while not self.take("}"):
                found += self._data()
                self.take(",")
            return found
        sign = -1.0 if self.take("-") else 1.0
        word = self.next()
        if word in self.places:
            return [self.places[word]]
        return [sign * (float("inf") if word == "HUGE_VAL" else float(word.rstrip("F")))]

    # Statements

    def _block(self, indent: str) -> str:
        self.want("{")
        self.scopes.append({})
        lines = []
        while not self.take("}"):
            line = self._statement(indent + "  ")
            lines += [f"{indent}  {line}\n"] if line else []
        self.scopes.pop()
        return "{\n" + "".join(lines) + indent + "}"

    def _statement(self, indent: str) -> str:
        if self.now[1] == "{":
            return self._block(indent)
        if self.take("if"):
            self.want("(")
            test = self.expression()[0]
            self.want(")")
            text = f"if ({test}) {self._statement(indent)}"
            return text + f" else {self._statement(indent)}" if self.take("else") else text
        if self.take("for"):
            self.want("(")
            parts = []
            for end in ";;)":
                parts.append("" if self.now[1] == end else self._list())
                self.want(end)
            return f"for ({'; '.join(parts)}) {self._statement(indent) or ';'}"
        if self.take("while"):
            self.want("(")
            test = self.expression()[0]
            self.want(")")
            return f"while ({test}) {self._statement(indent)}"
        for word in ("break", "continue"):
            if self.take(word):
                self.want(";")
                return f"{word};"
        if self.take("return"):
            text = "" if self.now[1] == ";" else f" {self.expression()[0]}"
            self.want(";")
            return f"return{text};"
        if self.is_type():
            return self._local()
        if self.take(";"):
            return ";"
        text = self._list()
        self.want(";")
        return "" if text == "undefined" else f"{text};"

    def _list(self) -> str:
        parts = [self.expression()[0]]
        while self.take(","):
            parts.append(self.expression()[0])
        return ", ".join(parts)

    def _local(self) -> str:
        fixed = self.now[1] == "const" and self._all[self._at + 1][1] in NUMBERS
        struct, found = self._base(), []
        while True:
            name, kind = self._declared(struct)
            self.scopes[-1][name] = kind
            if kind.kind in ("array", "struct"):
                count = kind.size(self.structs)
                self._wanted.append(count)
                place = f"@{len(self._wanted) - 1}@"
                found.append(f"const {name} = {place};")
                if self.take("="):
                    self._data()
                    found.append(f"fill({name}, 0, {count});")
            elif self.take("="):
                word = "const" if fixed and kind.kind == "number" else "let"
                found.append(f"{word} {name} = {self.expression()[0]};")
            else:
                found.append(f"let {name} = 0;")
            if not self.take(","):
                break
        self.want(";")
        return " ".join(found)
