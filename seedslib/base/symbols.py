"""Symbols of a model: parameters, whose numbers can change without compiling again, and checks.

Some parameters have no value of their own: inputs come with the data, and a map in discrete time is
given the length of its step. In which order functions take the numbers of all is in
`seedslib.base.values`.

What comes from outside has one meaning for each symbol, and expressions that mean a number. No text
is ever evaluated: SymPy would run a string as a program.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import sympy
from sympy.core.function import AppliedUndef

from seedslib.base.checks import brief
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

    def __getnewargs_ex__(self) -> tuple[tuple[str, ...], dict[str, bool]]:
        return (self.name,), super().__getnewargs_ex__()[1]


class Elapsed(Input):
    """The length of the step that a map in discrete time makes; `ELAPSED` is the only one."""

    __slots__ = ()
    role = "elapsed"

    def __new__(cls) -> Self:
        """The one there is, written ``dt``; where a model is only looked at it is 1/1000."""
        return Parameter.__new__(cls, "dt", 1e-3, positive=True)

    def __getnewargs_ex__(self) -> tuple[tuple[str, ...], dict[str, bool]]:
        return (), {}


ELAPSED: Elapsed = Elapsed()
"""Time that passes in a step of a map in discrete time; a sensor has none."""


def parameters_of(expressions: Iterable[sympy.Expr]) -> tuple[Parameter, ...]:
    """The parameters that expressions mention, in the order in which functions take them."""
    symbols = set().union(*(e.free_symbols for e in expressions))
    return in_order(s for s in symbols if isinstance(s, Parameter))


# without `doit()` these are names of a value, which generated code cannot compute
UNFINISHED = (
    sympy.Sum,
    sympy.Product,
    sympy.Integral,
    sympy.Derivative,
    sympy.Subs,
    sympy.Limit,
)
LARGEST = sympy.Float(sys.float_info.max)


def as_expression(name: str, value: object) -> sympy.Expr:
    """A SymPy expression or a number as an expression; never text.

    Raises
    ------
    TypeError
        A string, or what SymPy cannot take as an expression.
    """
    if isinstance(value, str):
        raise TypeError(
            f"{name}: wanted SymPy expressions, got the string {value!r}; strings are not evaluated"
        )
    try:
        expression = sympy.sympify(value, strict=True)
    except (sympy.SympifyError, TypeError, ValueError) as error:
        raise TypeError(f"{name}: wanted SymPy expressions, got {brief(value)}") from error
    # means of formulas are taken of what can be multiplied in any order
    kinds = sympy.Lambda, sympy.UnevaluatedExpr
    if not isinstance(expression, sympy.Expr) or expression.has(*kinds):
        raise TypeError(f"{name}: wanted SymPy expressions, got {brief(value)}")
    return expression


def as_symbols(name: str, value: object) -> tuple[sympy.Symbol, ...]:
    """Tuple of symbols; a single symbol, a string or a number is refused.

    Raises
    ------
    TypeError
        No sequence, or an entry that is no symbol.
    """
    several = not isinstance(value, sympy.Basic) or isinstance(
        value, (sympy.Tuple, sympy.MatrixBase)
    )
    if isinstance(value, str) or not several or not isinstance(value, Iterable):
        raise TypeError(f"{name}: wanted a sequence of SymPy symbols, got {brief(value)}")
    symbols = tuple(value)
    for symbol in symbols:
        if not isinstance(symbol, sympy.Symbol):
            raise TypeError(f"{name}: wanted SymPy symbols, got {symbol!r}")
    return symbols


def require_distinct(**groups: Sequence[sympy.Symbol] | None) -> None:
    """Refuse a symbol that would have two meanings in one model.

    Parameters
    ----------
    **groups : sequence of symbols, or None
        By role: state, noise, marks, time, parameters. None where a role has no names.

    Raises
    ------
    TypeError
        An entry that is no symbol.
    ValueError
        A symbol twice, in one role or in two.
    """
    roles: dict = {}
    for role, group in groups.items():
        for symbol in as_symbols(role, () if group is None else group):
            if symbol in roles:
                both = ", ".join(dict.fromkeys((roles[symbol], role)))
                raise ValueError(f"{both}: wanted distinct symbols, got {symbol} twice")
            roles[symbol] = role


def require_known(
    name: str, expressions: Iterable[sympy.Expr], known: Iterable[sympy.Symbol], advice: str = ""
) -> None:
    """Refuse symbols that a model does not have.

    Raises
    ------
    ValueError
        Another symbol, or one with the name of a known symbol and other assumptions.
    """
    known = set(known)
    unknown = set().union(*(e.free_symbols for e in expressions)) - known
    unknown = {s for s in unknown if not isinstance(s, Parameter)}
    if {str(s) for s in unknown} & {str(s) for s in known}:
        advice = "; a Symbol of one name but another real=True is another symbol"
    if "dt" in {str(s) for s in unknown}:
        advice = "; the length of a step is ELAPSED of seedslib.base, which is written dt"
    if unknown:
        names = ", ".join(sorted(map(str, unknown)))
        raise ValueError(f"{name}: wanted known symbols, got {names}{advice}")


def require_number(name: str, expression: sympy.Expr) -> None:
    """Refuse an expression that does not stand for a finite real number.

    Raises
    ------
    ValueError
        It has an infinity, NaN, the imaginary unit, a number beyond float64, a function without
        a definition, or a sum or an integral that was not carried out.
    """
    if expression.has(sympy.nan, sympy.oo, -sympy.oo, sympy.zoo, sympy.I):
        raise ValueError(f"{name}: wanted real finite values, got {expression}")
    for number in expression.atoms(sympy.Number):
        if abs(number) > LARGEST:
            raise ValueError(f"{name}: wanted numbers in the range of float64, got one beyond it")
    for part in expression.atoms(AppliedUndef):
        raise ValueError(f"{name}: wanted numbers and known functions, got {part} in {expression}")
    for part in expression.atoms(*UNFINISHED):
        raise ValueError(
            f"{name}: wanted an expression that was carried out, got {part}; see doit() of SymPy"
        )


def named_model(
    state: Any, time: Any, parameters: Mapping[Any, Any] | None, **noises: Sequence[sympy.Symbol]
) -> tuple[Any, ...]:
    """State symbols, symbol of the time (``t`` where None) and values of the parameters.

    Raises
    ------
    TypeError, ValueError
        A name that is no symbol, a value that is no expression, or one symbol with two meanings;
        `noises` are the symbols of each noise, by role.
    """
    state, values = as_symbols("state", state), {} if parameters is None else dict(parameters)
    as_symbols("parameters", values.keys())
    values = {s: as_expression(f"parameters[{s}]", value) for s, value in values.items()}
    time = sympy.Symbol("t") if time is None else time
    require_distinct(state=state, **noises, time=(time,), parameters=values)
    return state, time, values


def real_part(expression: sympy.Expr) -> sympy.Expr:
    """Real part of an expression in real symbols, written without the imaginary unit.

    Means of sines and cosines come as sums of complex exponentials whose imaginary parts cancel.
    """
    return _split(expression)[0]


def _split(expression: sympy.Expr) -> tuple[sympy.Expr, sympy.Expr]:
    if not expression.has(sympy.I):
        return expression, sympy.S.Zero
    if expression == sympy.I:
        return sympy.S.Zero, sympy.S.One
    if expression.is_Add:
        real, imaginary = zip(*map(_split, expression.args), strict=True)
        return sympy.Add(*real), sympy.Add(*imaginary)
    if isinstance(expression, sympy.exp):
        a, b = _split(expression.args[0])
        return sympy.exp(a) * sympy.cos(b), sympy.exp(a) * sympy.sin(b)
    if expression.is_Pow and expression.exp.is_Integer and expression.exp > 0:
        factors = [expression.base] * int(expression.exp)
    elif expression.is_Mul:
        factors = expression.args
    else:
        return expression.as_real_imag()
    real, imaginary = sympy.S.One, sympy.S.Zero
    for factor in factors:
        a, b = _split(factor)
        real, imaginary = real * a - imaginary * b, real * b + imaginary * a
    return real, imaginary
