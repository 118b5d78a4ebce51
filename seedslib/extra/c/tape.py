"""A recorder of arithmetic: numbers that write down, as C, what is done with them.

The library's own functions are called once with such numbers. What comes out are the lines that
they run, in their order, so a compiler that keeps that order gives the same numbers.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from numbers import Real
from typing import Any, TypeAlias

import numpy as np

Number: TypeAlias = "Scalar | float"

LARGEST_POWER = 40
"""Whole powers up to this one are written as products."""

_OPERATORS = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "true_divide": operator.truediv,
    "power": operator.pow,
    "float_power": operator.pow,
    "negative": operator.neg,
    "absolute": abs,
}
_RELATIONS = {
    "less": "<",
    "less_equal": "<=",
    "greater": ">",
    "greater_equal": ">=",
    "equal": "==",
    "not_equal": "!=",
}
CALLS = {
    "sqrt": "sqrt",
    "cbrt": "cbrt",
    "exp": "exp",
    "exp2": "exp2",
    "expm1": "expm1",
    "log": "log",
    "log2": "log2",
    "log10": "log10",
    "log1p": "log1p",
    "sin": "sin",
    "cos": "cos",
    "tan": "tan",
    "arcsin": "asin",
    "arccos": "acos",
    "arctan": "atan",
    "arctan2": "atan2",
    "sinh": "sinh",
    "cosh": "cosh",
    "tanh": "tanh",
    "arcsinh": "asinh",
    "arccosh": "acosh",
    "arctanh": "atanh",
    "hypot": "hypot",
    "fabs": "fabs",
    "floor": "floor",
    "ceil": "ceil",
    "erf": "erf",
    "erfc": "erfc",
    "gammaln": "lgamma",
}
_TEMPLATES = {
    "sign": "{0} > 0.0 ? 1.0 : {0} < 0.0 ? -1.0 : {0}",
    "heaviside": "{0} > 0.0 ? 1.0 : {0} < 0.0 ? 0.0 : {0} == 0.0 ? {1} : {0}",
    "maximum": "{0} >= {1} || isnan({0}) ? {0} : {1}",
    "minimum": "{0} <= {1} || isnan({0}) ? {0} : {1}",
}


def literal(value: float) -> str:
    """A number as a C constant that is read back exactly.

    Raises
    ------
    ValueError
        A number that is neither finite nor minus infinity, the logarithm of zero.
    """
    value = float(value)
    if value == -math.inf:
        return "-HUGE_VAL"
    if not math.isfinite(value):
        raise ValueError(f"constant: wanted a finite number for C, got {value}")
    return repr(value)


def _text(value: Number) -> str:
    return value.name if isinstance(value, Scalar) else literal(value)


class Scalar:
    """A number on a tape; it takes + - * / ** and the functions of NumPy that C has.

    Attributes
    ----------
    tape : Tape
    name : str
        The C variable that holds it.
    """

    __slots__ = ("name", "tape")

    def __init__(self, tape: Tape, name: str) -> None:
        self.tape, self.name = tape, name

    def __add__(self, other: Number) -> Number:
        return self if _is(other, 0) else self.tape.infix(self, "+", other)

    def __radd__(self, other: Number) -> Number:
        return self if _is(other, 0) else self.tape.infix(other, "+", self)

    def __sub__(self, other: Number) -> Number:
        return self if _is(other, 0) else self.tape.infix(self, "-", other)

    def __rsub__(self, other: Number) -> Number:
        return -self if _is(other, 0) else self.tape.infix(other, "-", self)

    def __mul__(self, other: Number) -> Number:
        if _is(other, 0) or _is(other, 1):
            return 0.0 if _is(other, 0) else self
        return self.tape.infix(self, "*", other)

    def __rmul__(self, other: Number) -> Number:
        if _is(other, 0) or _is(other, 1):
            return 0.0 if _is(other, 0) else self
        return self.tape.infix(other, "*", self)

    def __truediv__(self, other: Number) -> Number:
        return self if _is(other, 1) else self.tape.infix(self, "/", other)

    def __rtruediv__(self, other: Number) -> Number:
        return 0.0 if _is(other, 0) else self.tape.infix(other, "/", self)

    def __neg__(self) -> Scalar:
        return self.tape.node("-{0}", self)

    def __abs__(self) -> Scalar:
        return self.tape.node("fabs({0})", self)

    def __pow__(self, power: Number) -> Number:
        if isinstance(power, Scalar) or power != int(power) or abs(power) > LARGEST_POWER:
            return self.tape.node("pow({0}, {1})", self, power)
        product = 1.0
        for _ in range(abs(int(power))):
            product = product * self
        return product if power >= 0 else 1.0 / product

    def __rpow__(self, base: Number) -> Scalar:
        return self.tape.node("pow({0}, {1})", base, self)

    def __lt__(self, other: Number) -> Scalar:
        return self.tape.infix(self, "<", other)

    def __le__(self, other: Number) -> Scalar:
        return self.tape.infix(self, "<=", other)

    def __gt__(self, other: Number) -> Scalar:
        return self.tape.infix(self, ">", other)

    def __ge__(self, other: Number) -> Scalar:
        return self.tape.infix(self, ">=", other)

    def __bool__(self) -> bool:
        raise TypeError(
            "formulas: wanted choices by one comparison each (Piecewise), which C can follow"
        )

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: object, **options: object
    ) -> object:
        name = ufunc.__name__
        if method != "__call__" or options or not all(map(_scalar, inputs)):
            return NotImplemented
        if name in _RELATIONS:
            return self.tape.infix(inputs[0], _RELATIONS[name], inputs[1])
        if name in _OPERATORS:
            return _OPERATORS[name](*map(_plain, inputs))
        if name == "square":
            return self * self
        if name == "reciprocal":
            return 1.0 / self
        if name in CALLS:
            places = ", ".join(f"{{{k}}}" for k in range(len(inputs)))
            return self.tape.node(f"{CALLS[name]}({places})", *inputs)
        if name in _TEMPLATES:
            return self.tape.node(_TEMPLATES[name], *inputs)
        raise ValueError(f"formulas: wanted functions that C99 has, got {name}")

    def __array_function__(
        self,
        function: Callable[..., Any],
        types: object,
        arguments: tuple[Any, ...],
        options: dict[Any, Any],
    ) -> Number:
        if function is not np.select:
            raise ValueError(f"formulas: wanted functions that C99 has, got {function.__name__}")
        conditions, choices, *rest = arguments
        result = rest[0] if rest else options.get("default", 0)
        for condition, choice in zip(conditions[::-1], choices[::-1], strict=True):
            if isinstance(condition, Scalar):
                result = self.tape.choose(condition, choice, result)
            elif condition:
                result = choice
        return result


def _is(value: Number, number: float) -> bool:
    return not isinstance(value, Scalar) and value == number


def _scalar(value: object) -> bool:
    return isinstance(value, Scalar | Real) or np.ndim(value) == 0


def _plain(value: Number) -> Number:
    """NumPy numbers as Python ones, which leave the arithmetic to the recorder."""
    return value if isinstance(value, Scalar) else float(value)


class Tape:
    """Lines of C in the order in which they were recorded; equal lines are kept once."""

    def __init__(self) -> None:
        self._lines: dict[str, tuple[str, str, tuple]] = {}

    def node(self, template: str, *operands: Any, kind: str = "double") -> Scalar:
        """The number that a C expression gives; ``{0}`` stands for the first operand."""
        text = template.format(*map(_text, operands))
        if text not in self._lines:
            used = tuple(part.name for part in operands if isinstance(part, Scalar))
            prefix = "x" if kind == "double" else "q"
            self._lines[text] = (f"{prefix}{len(self._lines)}", kind, used)
        return Scalar(self, self._lines[text][0])

    def macro(self, name: str) -> Scalar:
        """A number that a macro stands for."""
        return Scalar(self, f"@NAME_{name}")

    def infix(self, first: Number, sign: str, second: Number) -> Scalar:
        """Two numbers joined by a sign of C; comparisons give truths."""
        kind = "int" if sign in _RELATIONS.values() else "double"
        return self.node(f"{{0}} {sign} {{1}}", first, second, kind=kind)

    def inputs(self, pattern: str, *counts: int) -> np.ndarray:
        """Numbers read from C variables: ``inputs("y[{}]", 2)``; an array of them.

        Braces of C in the pattern are not wanted; there is one ``{}`` for each count.
        """
        found = np.empty(counts, dtype=object)
        for index in np.ndindex(*counts):
            found[index] = self.node(pattern.format(*index))
        return found

    def choose(self, condition: Scalar, first: Number, second: Number) -> Number:
        """`first` where the truth holds, else `second`."""
        if not isinstance(first, Scalar) and not isinstance(second, Scalar) and first == second:
            return first
        return self.node("{0} ? {1} : {2}", condition, first, second)

    def body(self, outputs: dict[Any, Any]) -> list[str]:
        """Lines that compute the wanted numbers and store them, in C; others are left out."""
        wanted = {value.name for value in outputs.values() if isinstance(value, Scalar)}
        kept = []
        for text, (name, kind, used) in reversed(self._lines.items()):
            if name in wanted:
                wanted.update(used)
                kept.append(f"    const {kind} {name} = {text};")
        stores = [f"    {place} = {_text(value)};" for place, value in outputs.items()]
        return [*reversed(kept), *stores]
