"""Parameters of a model: numbers with a name, whose values can change without compiling again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import sympy

_CURRENT: ContextVar[Mapping[Parameter, Any]] = ContextVar("values of parameters")


class Parameter(sympy.Symbol):
    """A real number with a name, for use in the formulas of any model.

    Parameters
    ----------
    name : str
    value : float
        What it is unless `assigned` says otherwise.
    **assumptions : bool
        As of SymPy, such as ``positive=True``.
    """

    __slots__ = ("value",)
    value: float

    def __new__(cls, name: str, value: float, **assumptions: bool) -> Parameter:
        """One parameter for each name, value and set of assumptions."""
        self = super().__xnew__(cls, name, real=True, **assumptions)
        self.value = float(value)
        return self

    def _hashable_content(self) -> tuple[Any, ...]:
        return (*super()._hashable_content(), self.value)

    def __getnewargs_ex__(self) -> tuple[tuple[Any, ...], dict[str, bool]]:
        given = {"positive", "nonnegative", "negative"} & set(self.assumptions0)
        return (self.name, self.value), {name: self.assumptions0[name] for name in given}


@contextmanager
def assigned(values: Mapping[Parameter, Any]) -> Iterator[None]:
    """Let parameters have other values within a block of code.

    Parameters
    ----------
    values : mapping of Parameter to number or array, shape (*batch)
        An array gives each path its own value.
    """
    token = _CURRENT.set({**_CURRENT.get({}), **values})
    try:
        yield
    finally:
        _CURRENT.reset(token)


def current(parameters: tuple[Parameter, ...]) -> list[Any]:
    """The present values of parameters."""
    table = _CURRENT.get({})
    return [table.get(p, p.value) for p in parameters]


def parameters_of(expressions: Any) -> tuple[Parameter, ...]:
    """The parameters that expressions mention, in the order of their names."""
    found = set().union(*(e.free_symbols for e in expressions))
    return tuple(sorted((s for s in found if isinstance(s, Parameter)), key=str))
