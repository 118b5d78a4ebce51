"""Expressions of exported C as ECMAScript, with their types."""

from __future__ import annotations

import re

from seedslib.extra.js.tokens import NUMBERS, Type

FUNCTIONS = {
    name: f"Math.{name}"
    for name in (
        "sqrt",
        "cbrt",
        "exp",
        "expm1",
        "log",
        "log2",
        "log10",
        "log1p",
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "atan2",
        "sinh",
        "cosh",
        "tanh",
        "asinh",
        "acosh",
        "atanh",
        "hypot",
        "floor",
        "ceil",
        "pow",
    )
} | {
    "fabs": "Math.abs",
    "fmin": "Math.min",
    "fmax": "Math.max",
    "isnan": "Number.isNaN",
    "isinf": "isInfinite",
    "isfinite": "Number.isFinite",
    "memcpy": "copy",
    "memmove": "move",
    "memset": "fill",
    "erf": "erf",
    "erfc": "erfc",
    "exp2": "exp2",
}
"""Functions of C, and what they are called there."""

_CONSTANTS = {"NAN": "NaN", "HUGE_VAL": "Infinity"}
_ASSIGNMENTS = ("=", "+=", "-=", "*=", "/=")
_BINARY = {
    "+",
    "-",
    "*",
    "/",
    "%",
    "<",
    ">",
    "<=",
    ">=",
    "==",
    "!=",
    "&&",
    "||",
    "&",
    "|",
    "<<",
    ">>",
}
_WHOLE = {"int", "signed", "char"}
_FEW = 12
"""Numbers that are copied one by one."""

LITERAL = re.compile(r"-?\d+")
_PRODUCT = re.compile(r"(?<![*/%] )(?<![\w.])\d+(?: [*/] \d+)+(?! [*/%])(?![\w.])")
_LITERALS = re.compile(r"-?\d+(?: (?:[-+*/<>%]|<<|[<>=!]=|&&|\|\|) -?\d+)+")


class Changed(Exception):
    """A number that was taken as known is changed."""


class Expressions:
    """A reader of tokens that translates expressions; the order of signs is that of C."""

    def __init__(self, found: list[tuple[str, str]], macros: dict[str, float]) -> None:
        self._all, self._at, self.macros = found, 0, macros
        self.structs: dict[str, dict[str, Type]] = {}
        self.scopes: list[dict[str, Type]] = [{}]
        self.known: dict[str, str] = {}
        self.called: set[str] = set()

    @property
    def now(self) -> tuple[str, str]:
        """Kind and text of the token that comes."""
        return self._all[self._at]

    def at(self, text: str) -> bool:
        """Whether this token comes."""
        return self.now[1] == text

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

    def skip(self) -> None:
        """Pass brackets and what stands between them."""
        depth = 0
        while True:
            word = self.next()
            depth += (word in "({[") - (word in ")}]")
            if not depth:
                return

    def kind(self, name: str) -> Type:
        """Type of what is declared under a name.

        Raises
        ------
        ValueError
            Nothing is.
        """
        for scope in reversed(self.scopes):
            if name in scope:
                return scope[name]
        raise ValueError(f"source: wanted a known name, got {name!r}")

    def is_type(self, ahead: int = 0) -> bool:
        """Whether a type begins here."""
        word = self._all[self._at + ahead][1]
        return word in NUMBERS or word in self.structs or word == "const"

    def expression(self) -> tuple[str, Type]:
        """What comes, with assignments."""
        text, kind = self._choice()
        if self.now[1] in _ASSIGNMENTS:
            self._changes(text)
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
        text = _PRODUCT.sub(lambda found: _folded(found[0]), text)
        if _LITERALS.fullmatch(text):
            return _folded(text), Type()
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
            return self._read(text, kind.item), kind.item
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
                if stride != 1 and not inside.isdigit():
                    inside = f"{inside if inside.isidentifier() else f'({inside})'} * {stride}"
                elif inside.isdigit():
                    inside = str(int(inside) * stride)
                elif re.search(r"[?&|<>]", inside):
                    inside = f"({inside})"
                text, kind = moved(text, inside), item
                text = self._read(text, item) if item.kind == "number" else text
            elif self.take("->") or self.take("."):
                parts, name, place = self.structs[kind.struct], self.next(), 0
                for other, part in parts.items():
                    if other == name:
                        break
                    place += part.size(self.structs)
                kind = parts[name]
                text = moved(text, str(place))
                text = self._read(text, kind) if kind.kind in ("number", "address") else text
            elif self.now[1] in ("++", "--"):
                self._changes(text)
                text += self.next()
            else:
                return text, kind

    def _primary(self) -> tuple[str, Type]:
        if self.now[0] == "number":
            return self.next().rstrip("F"), Type()
        if self.take("("):
            text, kind = self.expression()
            self.want(")")
            return (text if LITERAL.fullmatch(text) else f"({text})"), kind
        word = self.next()
        if self.take("("):
            given = []
            while not self.take(")"):
                given.append(self.expression()[0])
                self.take(",")
            return self._called(word, given), Type()
        if word in self.macros:
            return str(self.macros[word]), Type()
        if word in _CONSTANTS:
            return _CONSTANTS[word], Type()
        if word in self.known:
            kind = self.kind(word)
            return self.known[word], kind if kind.kind in ("address", "array", "struct") else Type()
        return word, self.kind(word)

    def _read(self, place: str, kind: Type) -> str:
        """What is at a place; of an integer as one, which is quicker, unless it is changed."""
        integer = kind.whole or kind.kind == "address"
        changed = self.now[1] in (*_ASSIGNMENTS, "++", "--")
        return f"(M[{place}] | 0)" if integer and not changed else f"M[{place}]"

    def _changes(self, text: str) -> None:
        """Refuse to change what is taken as known."""
        if LITERAL.fullmatch(text):
            raise Changed

    def _called(self, name: str, given: list[str]) -> str:
        """A call of a function of C."""
        if name not in FUNCTIONS:
            raise ValueError(f"formulas: wanted functions that ECMAScript has, got {name}")
        if name in ("memcpy", "memset") and given[2].isdigit() and int(given[2]) <= _FEW:
            to = [f"M[{moved(given[0], str(i))}]" for i in range(int(given[2]))]
            of = [f"M[{moved(given[1], str(i))}]" for i in range(int(given[2]))]
            if name == "memset":
                return f"{' = '.join(to)} = {given[1]}"
            return ", ".join(f"{a} = {b}" for a, b in zip(to, of, strict=True))
        self.called.add(FUNCTIONS[name])
        return f"{FUNCTIONS[name]}({', '.join(given)})"


def moved(place: str, by: str) -> str:
    """A place and a distance from it, numbers added up."""
    terms: list[str] = []
    inside = 0
    for part in f"{place} + {by}".split(" + "):
        terms = [*terms[:-1], f"{terms[-1]} + {part}"] if inside else [*terms, part]
        inside += len(re.findall(r"[(\[]", part)) - len(re.findall(r"[)\]]", part))
    number = sum(int(term) for term in terms if term.isdigit())
    rest = [term for term in terms if not term.isdigit()]
    return " + ".join([*rest, str(number)] if number or not rest else rest)


def _folded(text: str) -> str:
    """Value of a constant expression, as C has it."""
    if "-" in text and ("/" in text or "%" in text):
        return text
    for sign, word in (("/", "//"), ("&&", "and"), ("||", "or")):
        text = text.replace(sign, word)
    return str(int(eval(text, {"__builtins__": {}})))  # digits and signs of our own text
