"""Parameters of a model: numbers with a name, whose values can change without compiling again.

Some have no value of their own: inputs come with the data, and a map in discrete time is given the
length of its step. In which order functions take the numbers of all is in `seedslib.base.values`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, ClassVar

import sympy

from seedslib.base.values import in_order

if TYPE_CHECKING:
    from typing import Self


class Parameter(sympy.Symbol):
    """A real number with a name, for use in the formulas of any model.

    Parameters
    ----------
    name : str
    value : float
        Its number unless a model or a filter is bound to another, see `bind` there.
    **assumptions : bool
        As of SymPy, such as ``positive=True``.
    """

    __slots__ = ("value",)
    role: ClassVar[str] = "parameter"
    value: float

    def __new__(cls, name: str, value: float, **assumptions: bool) -> Self:
        """One parameter for each name, value and set of assumptions."""
        if value is None or isinstance(value, str | bytes):
            raise TypeError(f"value: wanted a number, got {value!r}")
        self = super().__xnew__(cls, name, real=True, **assumptions)
        self.value = float(value)
        return self

    def _hashable_content(self) -> tuple[Any, ...]:
        return (*super()._hashable_content(), self.value)

    def __getnewargs_ex__(self) -> tuple[tuple[Any, ...], dict[str, bool]]:
        given = {"positive", "nonnegative", "negative"} & set(self.assumptions0)
        return (self.name, self.value), {name: self.assumptions0[name] for name in given}


class Input(Parameter):
    """A number that comes with the data: a control, a known disturbance, a last measurement.

    It has no value of its own: records, and single steps, have it in ``inputs=``; a model may be
    bound to one. Where a model is only looked at, to check its probabilities or to know it again,
    an input is 0.37.

    Parameters
    ----------
    name : str
    **assumptions : bool
        As of SymPy, such as ``positive=True``.
    """

    __slots__ = ()
    role = "input"

    def __new__(cls, name: str, **assumptions: bool) -> Self:
        """One input for each name and set of assumptions."""
        return super().__new__(cls, name, 0.37, **assumptions)

    def __getnewargs_ex__(self) -> Any:
        return (self.name,), super().__getnewargs_ex__()[1]


class Elapsed(Input):
    """The length of the step that a map in discrete time makes; `ELAPSED` is the only one."""

    __slots__ = ()
    role = "elapsed"

    def __new__(cls) -> Self:
        """The one there is, written ``dt``; where a model is only looked at it is 1/1000."""
        return Parameter.__new__(cls, "dt", 1e-3, positive=True)

    def __getnewargs_ex__(self) -> Any:
        return (), {}


ELAPSED: Elapsed = Elapsed()
"""Time that passes in a step of a map in discrete time; a sensor has none."""


def parameters_of(expressions: Iterable[Any]) -> tuple[Parameter, ...]:
    """The parameters that expressions mention, in the order in which functions take them."""
    symbols = set().union(*(e.free_symbols for e in expressions))
    return in_order(s for s in symbols if isinstance(s, Parameter))
