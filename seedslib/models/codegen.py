"""SymPy expressions to NumPy functions on lists of components.

A vector is a list (or an array) of components; a component is a number or an array over paths.
The generated code is straight-line arithmetic with common subexpressions computed once and
integer powers written as products, which is faster than `**` and gives the same bits on every
processor.
"""

from __future__ import annotations

import builtins
import re
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from itertools import count
from typing import Any

import numpy as np
import sympy
from scipy import special
from sympy.codegen.rewriting import create_expand_pow_optimization
from sympy.printing.codeprinter import PrintMethodNotImplementedError
from sympy.printing.numpy import SciPyPrinter

from seedslib.base.checks import require_shape
from seedslib.base.correction import joint_shape
from seedslib.base.parameters import parameters_of
from seedslib.base.symbols import as_expression, require_distinct, require_known, require_number
from seedslib.base.values import current
from seedslib.gaussian.means.normal_cdf import difference, tilted_cdf
from seedslib.models.sinc import sinc_ratio, with_ratios

LARGEST_POWER = 40
OWN = {"sinc_ratio": sinc_ratio, "difference": difference, "tilted_cdf": tilted_cdf}
MODULES = [OWN, "scipy", "numpy"]

_products = create_expand_pow_optimization(LARGEST_POWER, base_req=lambda base: True)


class _Printer(SciPyPrinter):
    """NumPy code with divisions, roots and products in the place of floating-point powers."""

    def _print_Pow(self, expr: sympy.Pow, rational: bool = False) -> str:
        if expr.exp == -1:
            return f"(1.0/({self._print(expr.base)}))"
        plain = expr.base.is_Symbol or abs(expr.exp) == sympy.S.Half
        if expr.exp.is_Rational and expr.exp.q == 2 and plain:
            base = self._print(expr.base)
            product = "*".join([f"numpy.sqrt({base})", *[f"({base})"] * (abs(expr.exp.p) // 2)])
            return f"(1.0/({product}))" if expr.exp.is_negative else f"({product})"
        return super()._print_Pow(expr, rational=rational)

    def _print_SincRatio(self, expr: sympy.Expr) -> str:
        k, x = expr.args
        return f"sinc_ratio({k}, {self._print(x)})"

    def _print_KroneckerDelta(self, expr: sympy.Expr) -> str:
        return self._print(expr.rewrite(sympy.Piecewise))

    def _print_Float(self, expr: sympy.Float) -> str:
        return repr(float(expr))


def fold(expression: sympy.Expr) -> sympy.Expr:
    """Numbers such as pi**2/100 as one constant, so that arrays are multiplied once."""
    parts = dict.fromkeys(sympy.preorder_traversal(expression))
    values = {p: _in_range(p) for p in parts if p.is_number and p.is_real}
    return expression.xreplace({p: sympy.Float(v) for p, v in values.items() if not p.is_Rational})


def _in_range(constant: sympy.Expr) -> float:
    try:
        value = float(constant)
    except OverflowError:
        value = np.inf
    if not np.isfinite(value) or (value == 0.0 and not constant.is_zero):
        raise ValueError(f"expressions: wanted numbers in the range of float64, got {constant}")
    return value


def _share(expressions: Sequence, named: Sequence = ()) -> tuple[list, list]:
    """Common subexpressions first, then products for powers: the other order hides powers.

    `named` are pairs of a symbol in the expressions and what it stands for.
    """
    parts = [fold(e) for e in (*(part for _, part in named), *expressions)]
    assignments, results = sympy.cse(parts, order="none")
    results = [_products(r) for r in results]
    assignments = [(name, _products(part)) for name, part in assignments]
    if named:
        names = [name for name, _ in named]
        assignments = _in_order([*assignments, *zip(names, results, strict=False)])
    return assignments, results[len(named) :]


def _in_order(assignments: Sequence[tuple]) -> list[tuple]:
    """The same assignments, each after those it needs."""
    waiting, ordered = dict(assignments), {}
    stack = list(reversed(waiting))
    while stack:
        name = stack[-1]
        needed = [s for s in waiting[name].free_symbols if s in waiting and s not in ordered]
        if needed:
            stack.extend(sorted(needed, key=str))
            continue
        ordered.setdefault(stack.pop(), waiting[name])
    return list(ordered.items())


def as_expressions(name: str, value: object) -> np.ndarray:
    """Array (dtype object) of SymPy expressions from a nested list or a SymPy matrix.

    Raises
    ------
    TypeError
        An entry that is a string, or that SymPy cannot take as an expression.
    """
    if isinstance(value, sympy.MatrixBase):
        value = value.tolist()
    try:
        array = np.array(value, dtype=object)
    except ValueError as error:
        raise TypeError(f"{name}: wanted SymPy expressions, got {value!r}") from error
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
    arguments: Sequence[object], expressions: Sequence[sympy.Expr],
    named: Sequence[tuple[Any, ...]] = (),
) -> Callable[..., list[Any]]:  # fmt: skip
    """Function of the arguments that returns the list of the expressions' values.

    Parameters
    ----------
    arguments : sequence
        Each entry a symbol or a sequence of symbols (a vector given by its components).
    expressions : sequence of SymPy expressions
    named : sequence of (symbol, expression)
        Symbols of the expressions that stand for others, evaluated once.

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
    known = {*listed, *(name for name, _ in named)}
    expressions = [as_expression("expressions", e) for e in expressions]
    require_known("expressions", [*expressions, *(part for _, part in named)], known)
    # lambdify would rename dummies, which makes powers of the products again
    taken = {str(s) for s in known if not isinstance(s, sympy.Dummy)}
    free = (name for k in count() if (name := f"u{k}_") not in taken)
    parameters = parameters_of([*expressions, *(part for _, part in named)])
    every = [*expressions, *(part for _, part in named)]
    dummies = [s for s in listed if isinstance(s, sympy.Dummy) or _hides(s, every)]
    dummies += list(parameters)
    plain = {s: sympy.Symbol(next(free), **s.assumptions0) for s in dummies}
    arguments = [
        tuple(plain.get(s, s) for s in a) if isinstance(a, tuple) else plain.get(a, a)
        for a in arguments
    ]
    expressions = [e.xreplace(plain) for e in expressions]
    named = [(name, part.xreplace(plain)) for name, part in named]
    if parameters:
        arguments.append(tuple(plain[p] for p in parameters))
    function = _lambdified(tuple(arguments), tuple(expressions), tuple(named))
    return function if not parameters else lambda *given: function(*given, current(parameters))


def _hides(symbol: sympy.Symbol, expressions: Sequence[sympy.Expr]) -> bool:
    """Whether a symbol has the name of something that the code of the expressions calls."""
    known = symbol.name in ("numpy", "scipy", "math")
    if not (known or any(hasattr(module, symbol.name) for module in (np, builtins, special))):
        return False
    printer, other = _Printer({"fully_qualified_modules": False}), sympy.Dummy("other")
    try:
        code = " ".join(printer.doprint(e.xreplace({symbol: other})) for e in expressions)
    except (PrintMethodNotImplementedError, ValueError):  # it is told where it is compiled
        return False
    return symbol.name in re.findall(r"[^\W\d]\w*", code)


@lru_cache(maxsize=512)
def _lambdified(arguments: tuple, expressions: tuple, named: tuple) -> Callable[..., list[Any]]:
    """The compiled function, once for equal expressions: a system is often made again."""
    printer = _Printer({"fully_qualified_modules": False, "inline": True, "user_functions": {}})
    try:
        share = partial(_share, named=named)
        return sympy.lambdify(arguments, list(expressions), MODULES, printer=printer, cse=share)
    except (PrintMethodNotImplementedError, ValueError):
        _require_code(printer, [*expressions, *(part for _, part in named)])
        raise


def _require_code(printer: _Printer, expressions: Sequence[sympy.Expr]) -> None:
    """Name the first part of the expressions that has no NumPy code."""
    for expression in expressions:
        for part in sympy.postorder_traversal(expression):
            try:
                if isinstance(part, sympy.Expr):
                    printer.doprint(part)
            except (PrintMethodNotImplementedError, ValueError):
                raise ValueError(
                    f"expressions: wanted functions with NumPy code, got {part} in {expression}; "
                    "where it is the derivative of a step (sign, Heaviside, floor, Mod), take a "
                    "rule with points such as Unscented or GaussHermite"
                ) from None


def batch_shape(*arguments: object) -> tuple[int, ...]:
    """Broadcast shape of the components of vectors (lists or arrays, components first)."""
    shapes: list[tuple[int, ...]] = []
    for argument in arguments:
        if isinstance(argument, np.ndarray) and argument.dtype != object and len(argument):
            shapes.append(argument.shape[1:])  # those of its components, looked at once
        else:
            shapes += [np.shape(c) for c in argument]
    return joint_shape(*shapes)


def stack(
    components: Sequence[Any], shape: tuple[int, ...], batch: tuple[int, ...] | None = None
) -> Any:
    """Array of the given component shape; batch axes last, those of the components by default."""
    if batch is None:
        batch = joint_shape(*[np.shape(c) for c in components])
    result = np.empty((len(components), *batch))
    for slot, component in enumerate(components):
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
        batch = batch_shape(*(values[k] for k in vectors))
        return stack(function(*values), expressions.shape, batch)

    return evaluate
