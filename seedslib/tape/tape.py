"""Numbers that write down what is done with them: formulas of the library become a program.

A tape holds statements: a value with a name, a store into an array, a choice of blocks, a loop, a
refusal. A `seedslib.tape.writer.Writer` spells them in a language.
"""

from __future__ import annotations

import math
import sys
from collections import ChainMap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

Number: TypeAlias = "Scalar | float"

RELATIONS = {"less": "<", "less_equal": "<=", "greater": ">", "greater_equal": ">="}
RELATIONS |= {"equal": "==", "not_equal": "!="}
ARITHMETIC = {"add": "+", "subtract": "-", "multiply": "*", "divide": "/"}
LOGIC = {"bitwise_and": "&&", "logical_and": "&&", "bitwise_or": "||", "logical_or": "||"}
SIGNS = frozenset([*RELATIONS.values(), *ARITHMETIC.values(), *LOGIC.values()])
"""Operations that stand between their operands."""

SAME_NAME = (
    *("sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "hypot"),
    *("sin", "cos", "tan", "sinh", "cosh", "tanh", "erf", "erfc", "floor", "ceil", "fabs"),
    *("isnan", "isinf", "isfinite"),
)
INVERSES = ("sin", "cos", "tan", "tan2", "sinh", "cosh", "tanh")
OPERATIONS = {
    **{name: name for name in SAME_NAME},
    **{f"arc{name}": f"a{name}" for name in INVERSES},
    **RELATIONS,
    **ARITHMETIC,
    **LOGIC,
    **{"negative": "neg", "absolute": "fabs", "invert": "!", "logical_not": "!"},
    "gammaln": "lgamma",
}
"""Functions of NumPy and SciPy that C99 has: their names, or signs, there."""

COMPOSED = {
    "square": lambda a: a * a,
    "reciprocal": lambda a: 1.0 / a,
    "power": lambda a, b: _power(a, b),
    "float_power": lambda a, b: _power(a, b),
    "maximum": lambda a, b: choose((a >= b) | isnan(a), a, b),
    "minimum": lambda a, b: choose((a <= b) | isnan(a), a, b),
    "sign": lambda a: choose(a > 0.0, 1.0, choose(a < 0.0, -1.0, a)),
    "heaviside": lambda a, b: choose(a > 0.0, 1.0, choose(a < 0.0, 0.0, choose(a == 0.0, b, a))),
}
"""Functions of NumPy that are made of others."""

TRUTHS = frozenset([*RELATIONS.values(), *LOGIC.values(), "!", "isnan", "isinf", "isfinite"])
"""Operations that give a truth."""

LARGEST_POWER = 40
"""Whole powers up to this one are written as products."""


class Scalar(NDArrayOperatorsMixin):
    """A number of a program: the result of an operation, with the name that holds it.

    Operators and functions of NumPy are recorded; so are ``&``, ``|`` and ``~`` of truths.

    Attributes
    ----------
    tape : Tape
    name : str
    kind : {"real", "time", "truth"}
        Sums, differences and products with a time are kept as exactly as a time is.
    """

    __slots__ = ("kind", "name", "tape")

    def __init__(self, tape: Tape, name: str, kind: str) -> None:
        self.tape, self.name, self.kind = tape, name, kind

    def __repr__(self) -> str:
        return self.name

    def __bool__(self) -> bool:
        raise TypeError(
            "formulas: wanted choices by one comparison each (Piecewise), which C can follow"
        )

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        name = ufunc.__name__
        if method != "__call__" or options:
            return NotImplemented
        if any(isinstance(x, np.ndarray) and x.ndim for x in inputs):  # element by element
            return each(ufunc, *inputs)
        inputs = tuple(x if type(x) is Scalar else float(x) for x in inputs)
        if name in COMPOSED:
            return COMPOSED[name](*inputs)
        if name in OPERATIONS:
            return self.tape.node(OPERATIONS[name], *inputs)
        raise ValueError(f"formulas: wanted functions that C99 has, got {name}")

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        if function is np.shape:
            return ()
        if function is not np.select:
            raise ValueError(f"formulas: wanted functions that C99 has, got {function.__name__}")
        conditions, choices, *rest = arguments
        result = rest[0] if rest else options.get("default", 0)
        for condition, choice in zip(conditions[::-1], choices[::-1], strict=True):
            result = choose(condition, choice, result)
        return result


def _power(base: Any, power: Any) -> Any:
    whole = type(power) is not Scalar and power == int(power) and abs(power) <= LARGEST_POWER
    if not whole:
        return next(x for x in (base, power) if type(x) is Scalar).tape.node("pow", base, power)
    product = math.prod([base] * abs(int(power)), start=1.0)
    return product if power >= 0 else 1.0 / product


def _simplified(operation: str, first: Number, second: Number) -> Number | None:
    """The result of an operation with a zero, a one or a known truth; None where it must be done.

    Zero times anything is zero: what a model does not couple costs nothing.
    """
    if operation in {"&&", "||"}:
        for known, other in ((first, second), (second, first)):
            if type(known) is not Scalar:
                return other if bool(known) == (operation == "&&") else float(bool(known))
        return first if first.name == second.name else None
    a, b = (None if type(x) is Scalar else x for x in (first, second))
    if (operation in {"+", "-"} and b == 0.0) or (operation in {"*", "/"} and b == 1.0):
        return first
    if (operation == "*" and 0.0 in (a, b)) or (operation == "/" and a == 0.0):
        return 0.0
    if (operation == "+" and a == 0.0) or (operation == "*" and a == 1.0):
        return second
    return -second if operation == "-" and a == 0.0 else None


def _boxed(value: Any) -> Any:
    """A Scalar as an array without axes, which NumPy pairs with the elements of another array."""
    if type(value) is not Scalar:
        return value
    box = np.empty((), dtype=object)
    box[()] = value
    return box


def each(function: Callable[..., Any], *parts: Any) -> np.ndarray:
    """A function element by element of arrays.

    By hand: ``np.frompyfunc`` warns of flags of the processor that others have left.
    """
    arrays = np.broadcast_arrays(*map(_boxed, parts))
    rows = zip(*(array.ravel().tolist() for array in arrays), strict=True)
    return stacked([function(*row) for row in rows]).reshape(arrays[0].shape)


def stacked(values: Sequence[Any]) -> np.ndarray:
    """One-dimensional array of numbers."""
    result = np.empty(len(values), dtype=object)
    result[:] = values
    return result


def _choose(condition: Any, first: Number, second: Number) -> Number:
    if type(condition) is not Scalar:
        return first if condition else second
    if type(first) is type(second) is Scalar and first.name == second.name:
        return first
    if type(first) is not Scalar and type(second) is not Scalar and first == second:
        return first
    return condition.tape.node("choose", condition, first, second)


def choose(condition: Any, first: Any, second: Any) -> Any:
    """`first` where the truth holds, else `second`; element by element of arrays."""
    if any(isinstance(part, np.ndarray) for part in (condition, first, second)):
        return each(_choose, condition, first, second)
    return _choose(condition, first, second)


def _truth_of(name: str) -> Any:
    known = getattr(math, name)
    one = lambda x: x.tape.node(name, x) if type(x) is Scalar else known(x)  # noqa: E731
    return lambda x: each(one, x) if isinstance(x, np.ndarray) else one(x)


isnan, isinf, isfinite = map(_truth_of, ("isnan", "isinf", "isfinite"))


@dataclass
class Array:
    """Numbers in memory.

    Attributes
    ----------
    owner : {"state", "argument", "table", "local"}
        Kept between steps, given with each step, constant, or for the work of one step.
    kind : {"real", "time", "int"}
    indexed : bool
        Whether a place of it is known only when the program runs.
    values : ndarray or None
        Of a table.
    """

    tape: Tape = field(repr=False)
    name: str
    shape: tuple[int, ...]
    kind: str = "real"
    owner: str = "local"
    values: np.ndarray | None = field(default=None, repr=False)
    version: int = 0
    indexed: bool = False

    def __getitem__(self, index: Any) -> Any:
        """Scalar, or array of them, at leading indices, which may be Scalars."""
        index = index if isinstance(index, tuple) else (index,)
        result = np.empty(self.shape[len(index) :], dtype=object)
        for rest in np.ndindex(*result.shape):
            result[rest] = self.tape.load(self, (*index, *rest))
        return result if result.ndim else result[()]

    @property
    def all(self) -> Any:
        """The numbers in it now, in its shape."""
        return self[()]

    def store(self, values: Any, *index: Any) -> None:
        """Put numbers in it at leading indices."""
        values = np.asarray(values, dtype=object)
        for rest in np.ndindex(*values.shape):
            self.tape.store(self, (*index, *rest), values[rest])


@dataclass(frozen=True)
class Let:
    """A named value of an operation."""

    result: Scalar
    operation: str
    operands: tuple[Number, ...]


@dataclass(frozen=True)
class Load:
    """A named value from an array."""

    result: Scalar
    array: Array
    operands: tuple[Number, ...]


@dataclass(frozen=True)
class Store:
    """A value put into an array; the last operand is the value, the others are its place."""

    array: Array
    operands: tuple[Number, ...]


@dataclass(frozen=True)
class Refuse:
    """The end of the step with a code where a truth holds."""

    operands: tuple[Number]
    code: str


@dataclass(frozen=True)
class When:
    """Statements for where a truth holds."""

    operands: tuple[Number]
    block: list[Any]


@dataclass(frozen=True)
class Loop:
    """Statements for each whole number below a count."""

    index: Scalar
    operands: tuple[Number]
    block: list[Any]


class Tape:
    """A program in the order in which it was recorded; equal values of a block are kept once.

    Parameters
    ----------
    limit : int
        Named values that it may have.

    Attributes
    ----------
    block : list of Let, Load, Store, Refuse, When, Loop
    arrays : dict of Array by name
    """

    def __init__(self, limit: int = sys.maxsize) -> None:
        self.limit = limit
        self.block: list[Any] = []
        self.arrays: dict[str, Array] = {}
        self._known: ChainMap[Any, Scalar] = ChainMap()
        self._count = 0

    def array(
        self, name: str, shape: tuple[int, ...] = (), kind: str = "real", owner: str = "local"
    ) -> Array:
        """Memory for numbers; that of one step is used again where name and shape are the same."""
        known = self.arrays.get(name)
        if known is not None and (known.shape, known.owner) == (tuple(shape), "local"):
            return known
        name = self._unused(name)
        self.arrays[name] = Array(self, name, tuple(shape), kind, owner)
        return self.arrays[name]

    def table(self, name: str, values: Any, kind: str = "real") -> Array:
        """Constants, of which a place may be known only when the program runs."""
        values = np.asarray(values)
        known = self.arrays.get(name)
        if known is not None and np.array_equal(known.values, values):
            return known
        name = self._unused(name)
        result = self.arrays[name] = Array(self, name, values.shape, kind, "table", values)
        return result

    def _unused(self, name: str) -> str:
        names = (name, *(f"{name}{k}" for k in range(2, len(self.arrays) + 3)))
        return next(one for one in names if one not in self.arrays)

    def name(self, kind: str) -> Scalar:
        """A new name.

        Raises
        ------
        ValueError
            More than the program may have.
        """
        self._count += 1
        if self._count > self.limit:
            raise ValueError(f"filter: wanted a program of at most {self.limit:,} values")
        return Scalar(self, f"{'q' if kind == 'truth' else 'x'}{self._count}", kind)

    def node(self, operation: str, *operands: Any) -> Any:
        """The result of an operation."""
        if len(operands) == 2:
            simple = _simplified(operation, *operands)
            if simple is not None:
                return simple
        key = (operation, *map(_key, operands))
        if key not in self._known:
            kinds = {x.kind for x in operands if type(x) is Scalar}
            exact = "time" in kinds and operation in {"+", "-", "*", "/", "neg"}
            kind = "truth" if operation in TRUTHS else "time" if exact else "real"
            self._known[key] = self.name(kind)
            self.block.append(Let(self._known[key], operation, operands))
        return self._known[key]

    def load(self, array: Array, index: tuple[Any, ...]) -> Scalar:
        """The number at a place of an array."""
        array.indexed |= any(type(x) is Scalar for x in index)
        key = ("load", array.name, array.version, *map(_key, index))
        if key not in self._known:
            self._known[key] = self.name("time" if array.kind == "time" else "real")
            self.block.append(Load(self._known[key], array, index))
        return self._known[key]

    def store(self, array: Array, index: tuple[Any, ...], value: Any) -> None:
        """Put a number at a place of an array."""
        array.indexed |= any(type(x) is Scalar for x in index)
        value = value if type(value) is Scalar else float(value)
        self.block.append(Store(array, (*index, value)))
        array.version += 1

    @contextmanager
    def _inner(self, statement: Any) -> Iterator[None]:
        outer, self.block = self.block, statement.block
        self._known = self._known.new_child()
        self._forget()
        yield
        self.block, self._known = outer, self._known.parents
        self._forget()
        self.block.append(statement)

    def _forget(self) -> None:
        for array in self.arrays.values():
            array.version += array.owner in {"state", "local"}

    @contextmanager
    def when(self, condition: Any) -> Iterator[None]:
        """``with tape.when(truth):`` what is done where it holds; arrays carry what comes of it."""
        with self._inner(When((condition,), [])):
            yield

    @contextmanager
    def loop(self, count: Any) -> Iterator[Scalar]:
        """``with tape.loop(count) as k:`` what is done for each k; only arrays are carried on."""
        index = self.name("real")
        with self._inner(Loop(index, (count,), [])):
            yield index

    def refuse(self, condition: Scalar, code: str) -> None:
        """End the step with a code where a truth holds."""
        self.block.append(Refuse((condition,), code))

    def program(self) -> list[Any]:
        """The statements without those that nothing is made of."""
        block, loaded = self.block, None
        while loaded != (now := {_place(one) for one in walk(block) if isinstance(one, Load)}):
            block, loaded = _alive(block, set(), now), now
        return block


def _key(operand: Any) -> Any:
    return operand.name if type(operand) is Scalar else repr(float(operand))


def walk(block: list[Any]) -> Iterator[Any]:
    """All statements, those of inner blocks too."""
    for statement in block:
        yield statement
        if isinstance(statement, When | Loop):
            yield from walk(statement.block)


def _place(statement: Load | Store) -> Any:
    """What names a place in memory: the array, and the index where all of them are known."""
    array, index = statement.array, statement.operands[: len(statement.array.shape)]
    return array.name, () if array.indexed else tuple(index)


def _alive(block: list[Any], wanted: set[str], loaded: set[Any]) -> list[Any]:
    alive = []
    for statement in reversed(block):
        if isinstance(statement, When | Loop):
            inner = _alive(statement.block, wanted, loaded)
            if not inner:
                continue
            statement = type(statement)(**{**vars(statement), "block": inner})
        needed = True
        if isinstance(statement, Let | Load):
            needed = statement.result.name in wanted
        elif isinstance(statement, Store) and statement.array.owner == "local":
            needed = _place(statement) in loaded
        if not needed:
            continue
        alive.append(statement)
        wanted.update(x.name for x in statement.operands if type(x) is Scalar)
    return alive[::-1]
