"""Numbers of parameters and inputs, and the order in which functions of a model take them.

Every array function of a model takes them as one argument p, a tuple of numbers or of arrays
(*batch), in the order of the model's `parameters`: parameters, inputs, and last the elapsed time.
Nothing here needs SymPy: a filter that was read from a file runs without it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_real, brief
from seedslib.base.objects import changed

if TYPE_CHECKING:
    from typing import Self

    from seedslib.base.symbols import Input, Parameter

Inputs: TypeAlias = "Mapping[Input, ArrayLike]"

Values: TypeAlias = tuple[Any, ...]
"""A number or an array (*batch) of each parameter of a model, in its order."""

ROLES = "parameter", "input", "elapsed"


def in_order(parameters: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """Distinct parameters in the order in which functions take their numbers.

    Raises
    ------
    TypeError, ValueError
        Something else among them; two of one name.
    """
    parameters = tuple(parameters)
    for p in parameters:
        if getattr(p, "role", None) not in ROLES:
            raise TypeError(f"parameters: wanted a sequence of Parameter, got {p!r}")
    distinct = sorted(set(parameters), key=lambda p: (ROLES.index(p.role), str(p), p.value))
    named = {str(p): p for p in distinct}
    for p in distinct:
        if named[str(p)] is not p:
            raise ValueError(
                f"parameters: wanted one of each name, got two {p}, of the values {p.value:g} and "
                f"{named[str(p)].value:g}"
            )
    return tuple(distinct)


def require_no_step(name: str, parameters: Iterable[Parameter]) -> None:
    """Refuse the elapsed time where no step is made: in a sensor, or in continuous time.

    Raises
    ------
    ValueError
    """
    if any(p.role == "elapsed" for p in parameters):
        raise ValueError(f"{name}: wanted no elapsed time; only a map in discrete time has it")


class Parametrized:
    """A model that has parameters and carries their numbers.

    Attributes
    ----------
    parameters : tuple of Parameter
        What its formulas mention: parameters, inputs, elapsed time.
    numbers : mapping of Parameter to number or ndarray, shape (*batch)
        Those that were bound; the others have the value that they were made with.
    """

    parameters: tuple[Parameter, ...] = ()
    numbers: Mapping[Parameter, ArrayLike] = {}

    def bind(
        self, values: Mapping[Parameter, ArrayLike] | None = None, /, **named: ArrayLike
    ) -> Self:
        """The same model with other numbers; nothing is compiled again.

        Parameters
        ----------
        values : mapping of Parameter to number or array_like, shape (*batch), optional
            An array gives each record or path its own number. An input may be bound too, where
            it is the same at all times.
        **named : number or array_like
            The same by the names of the parameters.

        Raises
        ------
        TypeError, ValueError
            What the model does not mention; no numbers.
        """
        own = {str(p): p for p in self.parameters if p.role != "elapsed"}
        wanted = f"wanted parameters of the model, {', '.join(own) or 'none'}"
        values = {} if values is None else values
        if not isinstance(values, Mapping):
            raise TypeError(
                f"values: wanted a mapping of Parameter to numbers, got {brief(values)}"
            )
        if unknown := named.keys() - own.keys():
            raise ValueError(f"{min(unknown)}: {wanted}, got another name")
        given = {**values, **{own[name]: value for name, value in named.items()}}
        for p in given.keys() - own.values():
            got = f"the key {p!r}; names are given as {next(iter(own), 'q')}=..."
            if hasattr(p, "role"):
                got = "another of that name" if str(p) in own else "another name"
            raise ValueError(f"{p}: {wanted}, got {got}")
        numbers = {  # by the model's own objects, which are found sooner than equal ones
            own[str(p)]: as_real(str(p), v, nan=True, infinite=True)[()] for p, v in given.items()
        }
        return changed(self, numbers={**self.numbers, **numbers})

    def values(self, inputs: Inputs | None = None, dt: float = math.nan) -> Values:
        """What p is in a step of length `dt`, with some inputs; a sensor has no such length.

        Raises
        ------
        ValueError
            An input without a value, or one that the model does not mention.
        """
        table = {**self.numbers, **inputs} if inputs else self.numbers
        known = [table.get(p) for p in self.parameters]
        if inputs and sum(value is not None for value in known) < len(table):
            for u in inputs:
                if u not in self.parameters:
                    raise ValueError(f"inputs: wanted those of the model, got {u}")
        values = zip(self.parameters, known, strict=True)
        return tuple(_own_value(p, dt) if value is None else value for p, value in values)

    def __repr__(self) -> str:
        sizes = f"state_size={self.state_size}, measurement_size={self.measurement_size}"
        return f"{type(self).__name__}({sizes})"

    def nominal_values(self) -> Values:
        """What p is where the model is only looked at: any input, step or path will do."""
        known = ((p, self.numbers.get(p, p.value)) for p in self.parameters)
        return tuple(p.value if np.ndim(value) else value for p, value in known)


def _own_value(p: Parameter, dt: float) -> float:
    if p.role == "input":
        raise ValueError(f"{p}: wanted a value of this input, got none; see inputs= and bind")
    return dt if p.role == "elapsed" else p.value


def of_paths(p: Values, batch: tuple[int, ...], chosen: slice | np.ndarray = slice(None)) -> Values:
    """Numbers of some paths of a batch laid in one row, where paths have their own.

    Parameters
    ----------
    p : tuple
    batch : tuple of int
        Shape of the batch.
    chosen : slice or ndarray
        Of the paths in one row, or a mask in the shape of the batch.
    """
    if all(np.ndim(value) == 0 for value in p):
        return p
    if isinstance(chosen, np.ndarray) and chosen.dtype == bool:
        chosen = chosen.ravel()
    return tuple(
        np.broadcast_to(value, batch).reshape(-1)[chosen] if np.ndim(value) else value
        for value in p
    )


@dataclass(frozen=True)
class InputTrajectory:
    """Inputs on a grid of times, each value held until the next time.

    Attributes
    ----------
    values : mapping of Input to ndarray, shape (K+1,) or (K+1, *batch)
    constant : mapping of Parameter to ndarray, shape (*batch)
        Parameters that were bound to a number of each path, and so are cut with the batch.
    """

    values: Mapping[Input, np.ndarray] = field(default_factory=dict)
    constant: Mapping[Parameter, np.ndarray] = field(default_factory=dict)

    def at(self, k: int) -> dict[Parameter, Any]:
        """Values at one time, as `Parametrized.values` takes them."""
        rows = ((u, value[k]) for u, value in self.values.items())
        return {**self.constant, **{u: row if row.ndim else float(row) for u, row in rows}}

    def of(self, paths: slice) -> InputTrajectory:
        """Inputs of some of the paths, laid in one row."""
        values = {
            u: v if v.ndim == 1 else v.reshape(len(v), -1)[:, paths] for u, v in self.values.items()
        }
        return InputTrajectory(values, {p: v.ravel()[paths] for p, v in self.constant.items()})


def as_trajectory(
    model: Parametrized, inputs: Inputs | None, count: int, batch: tuple[int, ...] = ()
) -> InputTrajectory:
    """Inputs of a model on a grid of times, checked, and what is bound to a number of each path.

    Parameters
    ----------
    model : Parametrized
        What is bound may be left out.
    inputs : mapping of Input to array_like, shape (count,) or (count, *batch), or None
    count : int
        Times.
    batch : tuple of int
        Axes of paths.

    Raises
    ------
    TypeError, ValueError
        No mapping of inputs, an input that the model does not mention, one that it mentions and
        that has no value, values that are not finite or of another shape.
    """
    constant = {}
    for p, value in model.numbers.items():
        if np.ndim(value):
            if value.shape != batch:
                raise ValueError(f"{p}: wanted a number or shape {batch}, got {value.shape}")
            constant[p] = value
    wanted = {p for p in model.parameters if p.role == "input"}
    return InputTrajectory(input_values(inputs, wanted, model.numbers, count, batch), constant)


def input_values(
    inputs: Inputs | None,
    wanted: Iterable[Input],
    bound: Iterable[Parameter],
    count: int,
    batch: tuple[int, ...] = (),
) -> dict[Input, np.ndarray]:
    """Values of the wanted inputs, (count,) or (count, *batch); those that are bound may lack.

    Raises
    ------
    TypeError, ValueError
        As `as_trajectory`.
    """
    inputs = {} if inputs is None else inputs
    if not isinstance(inputs, Mapping) or not all(
        getattr(u, "role", None) == "input" for u in inputs
    ):
        raise TypeError(f"inputs: wanted a mapping of Input to arrays, got {brief(inputs)}")
    names = ", ".join(sorted(map(str, wanted))) or "none"
    if unknown := [u for u in inputs if u not in wanted]:
        raise ValueError(f"inputs: wanted those of the model, {names}, got {unknown[0]}")
    if missing := [str(u) for u in wanted if u not in inputs and u not in bound]:
        raise ValueError(f"inputs: wanted values of {', '.join(sorted(missing))}, got none")
    values = {}
    for u, given in inputs.items():
        values[u] = value = as_real(f"inputs[{u}]", given)
        if value.shape not in {(count,), (count, *batch)}:
            known = f"({count},)" + (f" or {(count, *batch)}" if batch else "")
            raise ValueError(f"inputs[{u}]: wanted shape {known}, got {value.shape}")
    return values
