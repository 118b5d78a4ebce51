"""The present values of parameters and inputs: of a block of code, of paths, of times.

Nothing here needs SymPy: a filter that was read from a file runs without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_real

if TYPE_CHECKING:
    from seedslib.base.parameters import Input, Parameter

Inputs: TypeAlias = "Mapping[Input, ArrayLike]"

_CURRENT: ContextVar[Mapping[Parameter, Any]] = ContextVar("values of parameters")
_NONE: Mapping[Parameter, Any] = {}
_NOTHING: AbstractContextManager[None] = nullcontext()


@contextmanager
def assigned(values: Mapping[Parameter, Any]) -> Iterator[None]:
    """Let parameters have other values within a block of code.

    Parameters
    ----------
    values : mapping of Parameter to number or array, shape (*batch)
        An array gives each path its own value. Inputs are parameters too.
    """
    token = _CURRENT.set({**_CURRENT.get(_NONE), **values})
    try:
        yield
    finally:
        _CURRENT.reset(token)


def current(parameters: Iterable[Parameter]) -> list[Any]:
    """The present values of parameters.

    Raises
    ------
    ValueError
        An input that was not told.
    """
    table = _CURRENT.get(_NONE)
    return [table[p] if p in table else p.default() for p in parameters]


def present(parameters: Iterable[Parameter]) -> tuple[float, ...]:
    """Present values of parameters in the order of their names, a number each: a key.

    Raises
    ------
    ValueError
        A parameter that has a value for each path, an input that was not told.
    """
    known = sorted(parameters, key=str)
    values = current(known)
    for parameter, value in zip(known, values, strict=True):
        if np.ndim(value):
            raise ValueError(
                f"{parameter}: wanted one value on a grid, got {np.shape(value)}; make the filter "
                "anew for each, as fit does with a function that makes it"
            )
    return tuple(map(float, values))


def looked_at(parameters: Iterable[Parameter]) -> AbstractContextManager[None]:
    """Values for what has none of its own, where a model is looked at and not used."""
    values = {p: p.value for p in parameters if p.role != "parameter"}
    return assigned(values) if values else _NOTHING


def on_paths(shape: tuple[int, ...], chosen: Any = slice(None)) -> AbstractContextManager[None]:
    """Values of some paths of a batch laid in one row, where paths have their own.

    Parameters
    ----------
    shape : tuple of int
        Of the batch.
    chosen : slice or ndarray
        Of the paths in one row, or a mask in the shape of the batch.
    """
    table = _CURRENT.get(_NONE)
    own = {p: v for p, v in table.items() if np.ndim(v)} if table else table
    if not own:
        return _NOTHING
    if isinstance(chosen, np.ndarray) and chosen.dtype == bool:
        chosen = chosen.ravel()
    return assigned({p: np.broadcast_to(v, shape).reshape(-1)[chosen] for p, v in own.items()})


def with_values(parameters: Iterable[Any], *functions: Any) -> tuple[Any, ...]:
    """Functions that are given the present values of parameters after their other arguments.

    Parameters
    ----------
    parameters : sequence of Parameter
    *functions : callable or None

    Raises
    ------
    TypeError
        Something else among the parameters.
    """
    told = tuple(parameters)
    if not all(hasattr(p, "role") for p in told):
        raise TypeError(f"parameters: wanted a sequence of Parameter, got {parameters!r}")
    return tuple(f and partial(_given, f, told) for f in functions) if told else functions


def _given(function: Callable[..., Any], parameters: tuple[Parameter, ...], *given: Any) -> Any:
    return function(*given, *current(parameters))


def carried(work: Callable[..., Any]) -> Callable[..., Any]:
    """Work that takes the present values of all parameters with it to another process."""
    table = _CURRENT.get(_NONE)
    return partial(_worked, dict(table), work) if table else work


def _worked(values: Mapping[Parameter, Any], work: Callable[..., Any], *given: Any) -> Any:
    with assigned(values):
        return work(*given)


@dataclass(frozen=True)
class Course:
    """Inputs on a grid of times, each value held until the next time.

    Attributes
    ----------
    values : mapping of Input to ndarray, shape (K+1,) or (K+1, *batch)
    """

    values: Mapping[Input, np.ndarray] = field(default_factory=dict)

    def at(self, k: int) -> AbstractContextManager[None]:
        """Let the inputs be those of one time within a block of code."""
        if not self.values:
            return _NOTHING
        rows = ((u, v[k]) for u, v in self.values.items())
        return assigned({u: row if row.ndim else float(row) for u, row in rows})

    def of(self, paths: slice) -> Course:
        """Inputs of some of the paths, laid in one row."""
        if not self.values:
            return self
        flat = ((u, v if v.ndim == 1 else v.reshape(len(v), -1)) for u, v in self.values.items())
        return Course({u: v if v.ndim == 1 else v[:, paths] for u, v in flat})


def as_course(
    inputs: Inputs | None, wanted: frozenset[Input], count: int, batch: tuple[int, ...] = ()
) -> Course:
    """Inputs of a model on a grid of times, checked.

    Parameters
    ----------
    inputs : mapping of Input to array_like, shape (count,) or (count, *batch), or None
    wanted : frozenset of Input
        Those that the model mentions; what is `assigned` may be left out.
    count : int
        Times.
    batch : tuple of int
        Axes of paths.

    Raises
    ------
    TypeError, ValueError
        No mapping of inputs, an input that the model does not mention, one that it mentions and
        that is not told, values that are not finite or of another shape.
    """
    if inputs is None and not wanted:
        return _STILL
    inputs = {} if inputs is None else inputs
    if not isinstance(inputs, Mapping) or not all(
        getattr(u, "role", None) == "input" for u in inputs
    ):
        raise TypeError(f"inputs: wanted a mapping of Input to arrays, got {inputs!r}")
    names = ", ".join(sorted(map(str, wanted))) or "none"
    if unknown := [u for u in inputs if u not in wanted]:
        raise ValueError(f"inputs: wanted those of the model, {names}, got {unknown[0]}")
    table = _CURRENT.get(_NONE)
    if missing := [str(u) for u in wanted if u not in inputs and u not in table]:
        raise ValueError(f"inputs: wanted values of {', '.join(sorted(missing))}, got none")
    values = {}
    for u, given in inputs.items():
        values[u] = value = as_real(f"inputs[{u}]", given)
        if value.shape not in {(count,), (count, *batch)}:
            known = f"({count},)" + (f" or {(count, *batch)}" if batch else "")
            raise ValueError(f"inputs[{u}]: wanted shape {known}, got {value.shape}")
    return Course(values)


_STILL = Course()
