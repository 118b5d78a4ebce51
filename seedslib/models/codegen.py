"""SymPy expressions to NumPy functions on lists of components.

A vector is a list (or an array) of components; a component is a number or an array over paths.
The generated code is straight-line arithmetic with common subexpressions computed once and
integer powers written as products, which is faster than `**` and gives the same bits on every
processor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
import sympy
from sympy.printing.codeprinter import PrintMethodNotImplementedError
from sympy.printing.numpy import SciPyPrinter

from seedslib.base.arrays import batch_shape
from seedslib.base.checks import brief, require_shape
from seedslib.base.symbols import as_expression, require_distinct, require_known, require_number
from seedslib.gaussian.algebra import difference

LARGEST_POWER = 40
TERMS = 14
"""Terms of the series within two of zero: the next one is below rounding."""


class SincRatio(sympy.Function):
    """j_k(x) / x**k of spherical Bessel functions: sinc for k = 0, and even in x.

    The derivative is -x times the next one, so none of them divides by x.
    """

    nargs = (2,)

    @classmethod
    def eval(cls, k: Any, x: Any) -> Any:
        """Numbers are evaluated."""
        return sympy.Float(float(sinc_ratio(int(k), float(x)))) if x.is_number else None

    def fdiff(self, argindex: int = 2) -> Any:
        """Derivative by x."""
        parts: Any = self.args
        return -parts[1] * SincRatio(parts[0] + 1, parts[1])

    def _eval_is_extended_real(self) -> Any:
        return self.args[1].is_extended_real

    def _numpycode(self, printer: Any) -> str:
        return f"sinc_ratio({', '.join(printer._print(part) for part in self.args)})"

    def _sympystr(self, printer: Any) -> str:
        k, x = (printer._print(part) for part in self.args)
        return f"sinc({x})" if k == "0" else f"sinc_ratio({k}, {x})"


def with_ratios(expression: Any) -> Any:
    """The same expression with `SincRatio` in place of SymPy's sinc."""
    if not expression.has(sympy.sinc):
        return expression
    return expression.replace(sympy.sinc, lambda x: SincRatio(0, x))


def sinc_ratio(k: int, x: Any) -> Any:
    """Values of `SincRatio`: the power series within two of zero, the recurrence elsewhere."""
    near = x * x < 4.0
    square, series = np.select([near], [x * x], 0.0), 1.0
    for m in range(TERMS, 0, -1):
        series = 1.0 - series * square / (2 * m * (2 * (k + m) + 1))
    away = np.select([near], [2.0], x)
    before, ratio = np.cos(away), np.sin(away) / away
    for j in range(k):
        before, ratio = ratio, ((2 * j + 1) * ratio - before) / (away * away)
    return np.select([near], [series / math.prod(range(1, 2 * k + 2, 2))], ratio)


OWN = {"sinc_ratio": sinc_ratio, "difference": difference}
MODULES = [OWN, "scipy", "numpy"]


class _Printer(SciPyPrinter):
    """NumPy code with all digits of its numbers, and with products in place of powers."""

    def _print_Float(self, expr: sympy.Float) -> str:
        return repr(float(expr))

    def _print_Pow(self, expr: sympy.Pow, rational: bool = False) -> str:
        power = expr.exp
        if not (power.is_Rational and power.q <= 2 and abs(power) <= LARGEST_POWER):
            return super()._print_Pow(expr, rational=rational)
        base = f"({self._print(expr.base)})"
        root = [f"numpy.sqrt({base})"] * (power.q == 2)
        product = "*".join([*root, *[base] * (abs(power.p) // power.q)])
        return f"(1.0/({product}))" if power.is_negative else f"({product})"


def fold(expression: sympy.Expr) -> sympy.Expr:
    """Numbers such as pi**2/100 as one constant, so that arrays are multiplied once."""
    values, visited, waiting = {}, set(), [expression]
    while waiting:
        part = waiting.pop()
        if part in visited:
            continue
        visited.add(part)
        if part.is_number and part.is_real:
            values[part] = float(part)
        else:
            waiting.extend(part.args)
    if not np.isfinite(list(values.values())).all():
        raise ValueError(f"wanted numbers in the range of float64, got {expression}")
    return expression.xreplace({p: sympy.Float(v) for p, v in values.items() if not p.is_Rational})


def as_expressions(name: str, value: object) -> np.ndarray:
    """Array (dtype object) of SymPy expressions from a nested list or a SymPy matrix.

    Raises
    ------
    TypeError
        An entry that is a string, or that SymPy cannot take as an expression.
    ValueError
        Rows of different lengths.
    """
    if isinstance(value, sympy.MatrixBase):
        value = value.tolist()
    try:
        array = np.array(value, dtype=object)
    except ValueError as error:
        raise TypeError(f"{name}: wanted SymPy expressions, got {brief(value)}") from error
    rows = [row for row in array.flat if isinstance(row, list | tuple)]
    if rows:
        lengths = ", ".join(str(len(row)) for row in rows)
        raise ValueError(f"{name}: wanted rows of one length, got rows of {lengths}")
    result = np.empty(array.shape, dtype=object)
    result.ravel()[:] = [with_ratios(as_expression(name, entry)) for entry in array.ravel()]
    return result


def known_expressions(
    name: str, value: Any, shape: tuple[int | None, ...], values: Any, allowed: Any
) -> np.ndarray:
    """Expressions of a wanted shape with parameters put in and no unknown symbol left.

    Parameters
    ----------
    name : str
        The caller's name of the argument.
    value : nested sequence of SymPy expressions
    shape : tuple of int or None
        Wanted lengths; None leaves one free.
    values : dict
        Values of the parameters, from `seedslib.base.symbols.parameter_values`.
    allowed : set of SymPy symbols

    Raises
    ------
    TypeError, ValueError
        No expressions, another shape, an unknown symbol, a parameter that is one of `allowed`,
        or no finite real number.
    """
    array = as_expressions(name, value)
    require_shape(name, array, shape)
    require_distinct(model=allowed, parameters=values)
    array.ravel()[:] = [entry.subs(values) for entry in array.ravel()]
    require_known(name, array.ravel(), allowed, "; see parameters")
    for entry in array.ravel():
        require_number(name, entry)
    return array


def compile_components(
    arguments: Sequence[object], expressions: Sequence[sympy.Expr]
) -> Callable[..., list[Any]]:
    """Function of the arguments that returns the list of the expressions' values.

    Parameters
    ----------
    arguments : sequence
        Each entry a symbol or a sequence of symbols (a vector given by its components); parameters
        of a model are one of them.
    expressions : sequence of SymPy expressions

    Returns
    -------
    callable
        Called with a number or component for each symbol and a list or array of components for
        each sequence; constants come back as plain numbers, not spread over the paths.

    Raises
    ------
    ValueError
        A symbol that is not among the arguments, or a function that has no NumPy code.
    """
    arguments = [tuple(a) if isinstance(a, Sequence | np.ndarray) else a for a in arguments]
    listed = [s for a in arguments for s in (a if isinstance(a, tuple) else (a,))]
    expressions = [as_expression("expressions", e) for e in expressions]
    require_known("expressions", expressions, listed)
    # names that no function has; equal expressions are compiled once, whatever their symbols are
    plain = {s: sympy.Symbol(f"u{k}_", **s.assumptions0) for k, s in enumerate(listed)}
    return _lambdified(
        tuple(tuple(plain[s] for s in a) if isinstance(a, tuple) else plain[a] for a in arguments),
        tuple(e.xreplace(plain) for e in expressions),
    )


@lru_cache(maxsize=512)
def _lambdified(arguments: tuple, expressions: tuple) -> Callable[..., list[Any]]:
    """The compiled function, once for equal expressions: a system is often made again."""
    printer = _Printer({"fully_qualified_modules": False, "inline": True, "user_functions": {}})
    try:
        folded = [fold(e) for e in expressions]
        return sympy.lambdify(
            arguments, folded, MODULES, printer=printer, cse=partial(sympy.cse, order="none")
        )
    except (PrintMethodNotImplementedError, ValueError, OverflowError) as error:
        raise ValueError(
            f"expressions: wanted functions with NumPy code, got {error}; "
            "where it is the derivative of a step (sign, Heaviside, floor, Mod), take a rule with "
            "points such as Unscented or GaussHermite"
        ) from None


def batch_of(*arguments: object) -> tuple[int, ...]:
    """Broadcast shape of the components of vectors (lists or arrays, components first)."""
    shapes: list[tuple[int, ...]] = []
    for argument in arguments:
        if isinstance(argument, np.ndarray) and argument.dtype != object and len(argument):
            shapes.append(argument.shape[1:])  # those of its components, looked at once
        else:
            shapes += [() if isinstance(c, float) else np.shape(c) for c in argument]
    return batch_shape(*shapes)


def stack(
    components: Sequence[Any], shape: tuple[int, ...], batch: tuple[int, ...] | None = None
) -> Any:
    """Array of the given component shape; batch axes last, those of the components by default."""
    if batch is None:
        batch = batch_shape(*[np.shape(c) for c in components])
    result = np.empty((len(components), *batch))
    for slot, component in enumerate(components):
        try:
            result[slot] = component
        except TypeError:  # a number of a program
            result = result.astype(object)
            result[slot] = component
    return result.reshape((*shape, *batch))


def compile_array(arguments: Sequence[object], expressions: object) -> Callable[..., np.ndarray]:
    """Function that returns one array, components first and the batch axes of its arguments last.

    Parameters
    ----------
    arguments : sequence
        As in `compile_components`.
    expressions : nested sequence of SymPy expressions
        Its shape is the shape of the components of the result.
    """
    expressions = as_expressions("expressions", expressions)
    function = compile_components(arguments, expressions.ravel().tolist())
    vectors = [k for k, a in enumerate(arguments) if isinstance(a, Sequence | np.ndarray)]

    def evaluate(*values) -> np.ndarray:
        batch = batch_of(*(values[k] for k in vectors))
        return stack(function(*values), expressions.shape, batch)

    return evaluate
