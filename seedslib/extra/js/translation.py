"""Exported C as ECMAScript: all numbers in one array, addresses are places in it.

The C that the library writes has no recursion and no heap, so that every array, those of
functions included, has a place of its own from the start. A function is translated once for every
set of whole numbers that it is called with: its short loops can then be written out.
"""

from __future__ import annotations

import re
from dataclasses import replace

from seedslib.extra.js.expressions import LITERAL
from seedslib.extra.js.statements import Place, Statements
from seedslib.extra.js.tokens import Type, preprocessed, tokens


class Translation(Statements):
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
    places : dict of str
        Where the arguments lie whose places are the same in all calls from outside.
    calls : dict of str
        How the wanted functions are called.

    Parameters
    ----------
    text : str
        From `to_c`.
    wanted : tuple of str, optional
        Functions that are called from outside; all, if there are none.
    places : dict, optional
        Arguments of theirs that are always the same place, which is quicker, with what lies there:
        the name of a structure, or of a macro that says how many numbers, the first there is.

    Raises
    ------
    ValueError
        C that has no translation.
    """

    def __init__(
        self, text: str, *wanted: str, places: dict[str, tuple[str, ...]] | None = None
    ) -> None:
        macros, text = preprocessed(text)
        super().__init__([*tokens(text), ("end", "")], macros)
        self.numbers: list[float] = []
        self.tables: dict[str, int] = {}
        self.lines: list[str] = []
        self.functions: dict[str, int] = {}
        self._made: set[str] = set()
        while self.now[0] != "end":
            self._outermost()
        self.size = len(self.numbers)
        self.places: dict[str, str] = {}
        for name, size in (places or {}).items():
            self.places[name], self.size = str(self.size), self.size + self._room(size)
        self.calls = {
            name: self.version(name)
            for name in wanted or tuple(self.functions)
            if name in self.functions
        }

    def _room(self, names: tuple[str, ...]) -> int:
        name = next(name for name in names if name in self.structs or name in self.macros)
        if name in self.structs:
            return Type("struct", (), name).size(self.structs)
        return int(self.macros[name])

    def _outermost(self) -> None:
        if self.take("typedef"):
            self.want("struct")
            self.want("{")
            parts: dict[str, Type] = {}
            while not self.take("}"):
                base = self.base()
                while not self.take(";"):
                    name, kind = self.declared(base)
                    parts[name] = kind
                    self.take(",")
            self.structs[self.next()] = parts
            self.want(";")
            return
        self.want("static")
        self.take("inline")
        name, kind = self.declared(self.base())
        if self.take("="):
            self.scopes[0][name], self.tables[name] = kind, len(self.numbers)
            self.numbers += self._data()
            self.lines.append(f"const {name} = {self.tables[name]};")
            self.want(";")
            return
        self.functions[name] = self._at
        self.skip()
        self.skip()

    def _data(self) -> list[float]:
        if self.take("{"):
            found: list[float] = []
            while not self.take("}"):
                found += self._data()
                self.take(",")
            return found
        sign = -1.0 if self.take("-") else 1.0
        word = self.next()
        if word in self.tables:
            return [self.tables[word]]
        return [sign * (float("inf") if word == "HUGE_VAL" else float(word.rstrip("F")))]

    # Functions

    def version(self, name: str, given: list[str] | None = None) -> str:
        """Call of a function, translated for the whole numbers among its arguments."""
        held = self._at, self.scopes, self.known, self.place, self.end
        self._at, self.known, self.place = self.functions[name], {}, Place()
        self.skip()
        self.skip()
        self.end, self._at = self._at, self.functions[name]
        called, scope, left = name, {}, []
        self.want("(")
        while not self.take(")"):
            parameter, kind = self.declared(self.base())
            if kind.kind == "array":
                kind = replace(kind, kind="address", dims=kind.dims[1:])
            scope[parameter] = kind
            text = given[len(scope) - 1] if given else self.places.get(parameter, parameter)
            fixed = kind == Type(whole=True) or kind.kind == "address"
            if fixed and LITERAL.fullmatch(text) and not self._set(parameter):
                self.known[parameter] = text
                called = f"{called}${text.replace('-', 'm')}"
            else:
                left.append((parameter, text))
            self.take(",")
        if called not in self._made:
            self._made.add(called)
            self.scopes = [held[1][0], scope]
            body = self.block("")
            # an array that is known inside of the function is quicker
            body = _without_unused(body.replace("{\n", "{\n  const M = H;\n", 1))
            names = ", ".join(parameter for parameter, _ in left)
            self.lines.append(f"function {called}({names}) {body}")
        self._at, self.scopes, self.known, self.place, self.end = held
        return f"{called}({', '.join(text for _, text in left)})"

    def _set(self, name: str) -> bool:
        """Whether a parameter changes in its function."""
        signs = ("=", "+=", "-=", "*=", "++", "--")
        return any(self._all[i + 1][1] in signs for i in self._places(name, self._at))

    def _called(self, name: str, given: list[str]) -> str:
        if name in self.functions:
            return self.version(name, given)
        return super()._called(name, given)


def _without_unused(body: str) -> str:
    """A function without the variables that writing out has left over."""
    for name in re.findall(r"let (\w+) = 0;", body):
        if len(re.findall(rf"\b{name}\b", body)) == 1:
            body = re.sub(rf" ?let {name} = 0;", "", body)
    return re.sub(r"\n\s*(?=\n)", "", body)
