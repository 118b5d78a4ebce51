"""Expressions of exported C as ECMAScript, with their types."""

from __future__ import annotations

import re

from seedslib.extra.js.tokens import NUMBERS, Type

FUNCTIONS = {
    name: f"Math.{name}"
    for name in (
        "sqrt", "cbrt", "exp", "expm1", "log", "log2", "log10", "log1p", "sin", "cos", "tan",
        "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "hypot",
        "floor", "ceil", "pow",
    )
} | {
    "fabs": "Math.abs", "fmin": "Math.min", "fmax": "Math.max", "isnan": "Number.isNaN",
    "isinf": "isInfinite", "isfinite": "Number.isFinite", "memcpy": "copy", "memmove": "move",
    "memset": "fill", "erf": "erf", "erfc": "erfc", "exp2": "exp2",
}  # fmt: skip
"""Functions of C, and what they are called there."""

_CONSTANTS = {"NAN": "NaN", "HUGE_VAL": "Infinity"}
_ASSIGNMENTS = ("=", "+=", "-=", "*=", "/=")
_BINARY = {
    "+", "-", "*", "/", "%", "<", ">", "<=", ">=", "==", "!=", "&&", "||", "&", "|", "<<", ">>",
}  # fmt: skip
_WHOLE = {"int", "signed", "char"}


class Expressions:
    """A reader of tokens that translates expressions; the order of signs is that of C."""

    def __init__(self, found: list[tuple[str, str]], macros: dict[str, float]) -> None:
        self._all, self._at, self.macros = found, 0, macros
        self.structs: dict[str, dict[str, Type]] = {}
        self.scopes: list[dict[str, Type]] = [{}]
        self.functions: set[str] = set()
        self.called: set[str] = set()

    @property
    def now(self) -> tuple[str, str]:
        """Kind and text of the token that comes."""
        return self._all[self._at]

    def next(self) -> str:
        """Text of the token that comes, which is then taken."""
        self._at += 1
        return self._all[self._at - 1][1]

    def take(self, text: str) -> bool:
        """Whether this token comes; it is then taken."""
        if self.now[1] == text:
            self._at += 1
            return True
        return False

    def want(self, text: str) -> None:
        """Take this token.

        Raises
        ------
        ValueError
            Another one comes.
        """
        if not self.take(text):
            raise ValueError(f"source: wanted {text!r}, got {self.now[1]!r}")

    def is_type(self, ahead: int = 0) -> bool:
        """Whether a type begins here."""
        word = self._all[self._at + ahead][1]
        return word in NUMBERS or word in self.structs or word == "const"

    def expression(self) -> tuple[str, Type]:
        """What comes, with assignments."""
        text, kind = self._choice()
        if self.now[1] in _ASSIGNMENTS:
            sign = self.next()
            return f"{text} {sign} {self.expression()[0]}", kind
        return text, kind

    def _choice(self) -> tuple[str, Type]:
        text, kind = self._binary()
        if self.take("?"):
            first, kind = self.expression()
            self.want(":")
            return f"{text} ? {first} : {self._choice()[0]}", kind
        return text, kind

    def _binary(self) -> tuple[str, Type]:
        text, kind = self._unary()
        kinds, signs = [kind], set()
        while self.now[1] in _BINARY and self.now[0] == "sign":
            sign = self.next()
            right, kind = self._unary()
            text += f" {sign} {right}"
            kinds.append(kind)
            signs.add(sign)
        if len(kinds) == 1:
            return text, kinds[0]
        address = next((k for k in kinds if k.kind in ("address", "array")), None)
        if address is None or not signs <= {"+", "-", "*"}:
            return text, Type()
        return text, Type("address", address.item.dims, address.struct)

    def _unary(self) -> tuple[str, Type]:
        for sign in ("-", "!", "+"):
            if self.take(sign):
                text = self._unary()[0]
                return (f"{sign}({text})" if text.startswith(sign) else f"{sign}{text}"), Type()
        if self.take("&"):
            text, kind = self._unary()
            return text, Type("address", (), kind.struct)
        if self.take("*"):
            text, kind = self._unary()
            return f"M[{text}]", kind.item
        if self.take("++"):
            return f"++{self._unary()[0]}", Type()
        if self.take("sizeof"):
            return str(self._unary()[1].size(self.structs)), Type()
        if self.now[1] == "(" and self.is_type(1):
            self.next()
            words = []
            while not self.take(")"):
                words.append(self.next())
            text, kind = self._unary()
            if words == ["void"]:
                return "undefined", kind
            return (f"({text} | 0)" if _WHOLE & set(words) else text), kind
        return self._postfix()

    def _postfix(self) -> tuple[str, Type]:
        text, kind = self._primary()
        while True:
            if self.take("["):
                inside = self.expression()[0]
                self.want("]")
                item = kind.item
                stride = item.size(self.structs)
                if stride != 1:
                    inside = f"{inside if inside.isidentifier() else f'({inside})'} * {stride}"
                elif re.search(r"[?&|<>]", inside):
                    inside = f"({inside})"
                text, kind = f"{text} + {inside}", item
                text = f"M[{text}]" if item.kind == "number" else text
            elif self.take("->") or self.take("."):
                parts, name, place = self.structs[kind.struct], self.next(), 0
                for other, part in parts.items():
                    if other == name:
                        break
                    place += part.size(self.structs)
                kind = parts[name]
                text = f"{text} + {place}"
                text = f"M[{text}]" if kind.kind in ("number", "address") else text
            elif self.now[1] in ("++", "--"):
                text += self.next()
            else:
                return text, kind

    def _primary(self) -> tuple[str, Type]:
        if self.now[0] == "number":
            return self.next().rstrip("F"), Type()
        if self.take("("):
            text, kind = self.expression()
            self.want(")")
            return f"({text})", kind
        word = self.next()
        if self.take("("):
            given = []
            while not self.take(")"):
                given.append(self.expression()[0])
                self.take(",")
            return f"{self._function(word)}({', '.join(given)})", Type()
        if word in self.macros:
            return str(self.macros[word]), Type()
        if word in _CONSTANTS:
            return _CONSTANTS[word], Type()
        for scope in reversed(self.scopes):
            if word in scope:
                return word, scope[word]
        raise ValueError(f"source: wanted a known name, got {word!r}")

    def _function(self, name: str) -> str:
        if name in self.functions:
            return name
        if name not in FUNCTIONS:
            raise ValueError(f"formulas: wanted functions that ECMAScript has, got {name}")
        self.called.add(FUNCTIONS[name])
        return FUNCTIONS[name]
