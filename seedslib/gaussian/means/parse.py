"""From a SymPy function to its terms: checks of symbols, real stand-ins, caching."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import sympy as sp

from seedslib.base.symbols import as_expression, as_symbols, require_known, require_number
from seedslib.gaussian.means.classes import Terms, folded
from seedslib.gaussian.means.reader import Reader


class Parsed(NamedTuple):
    """A function of p values in the algebra: its own real symbols and one term sum each."""

    symbols: tuple[sp.Symbol, ...]
    parameters: tuple[sp.Symbol, ...]
    components: tuple[Terms, ...]
    scalar: bool


def components_of(f: object) -> tuple[tuple[sp.Expr, ...], bool]:
    """Components of a scalar expression, a list or a column of expressions; whether scalar."""
    if isinstance(f, sp.MatrixBase):
        if 1 not in f.shape:
            raise ValueError(f"f: wanted a scalar or a vector, got a matrix of shape {f.shape}")
        return tuple(f), False
    if isinstance(f, (list, tuple)):
        if not f:
            raise ValueError("f: wanted at least one component, got an empty list")
        return tuple(as_expression("f", item) for item in f), False
    return (as_expression("f", f),), True


def parse(f: object, variables: Sequence[sp.Symbol], parameters: Sequence[Any] = ()) -> Parsed:
    """Read a scalar or vector function of `variables`; cached by (expressions, symbols).

    Raises
    ------
    ValueError
        Repeated variables, unknown symbols in f, a complex or infinite value.
    TypeError
        Variables that are no symbols.
    NoClosedForm
        A term is outside the class.
    """
    expressions, scalar = components_of(f)
    variables, parameters = as_symbols("variables", variables), as_symbols("parameters", parameters)
    return Parsed(*_parse(expressions, variables, parameters), scalar)


def check_symbols(
    expressions: Sequence[sp.Expr], variables: tuple[sp.Symbol, ...],
    parameters: tuple[Any, ...] = (),
) -> None:  # fmt: skip
    """Refuse repeated or missing variables, unknown symbols and values that are not real."""
    known = (*variables, *parameters)
    if not variables or len(set(known)) < len(known):
        raise ValueError(f"variables: wanted distinct symbols, at least one, got {known}")
    require_known("f", expressions, known, f"; the variables are {known}")
    for expression in expressions:
        require_number("f", expression)


@lru_cache(maxsize=256)
def _parse(expressions: tuple, variables: tuple, parameters: tuple) -> tuple:
    check_symbols(expressions, variables, parameters)
    # real stand-ins let SymPy evaluate moduli and roots whatever the caller assumed
    real = {s: sp.Dummy(s.name, real=True) for s in (*variables, *parameters)}
    symbols = tuple(real[s] for s in variables)
    reader = Reader(symbols, {stand_in: own for own, stand_in in real.items()})
    components = []
    for expression in expressions:
        terms = folded(reader.read(expression.xreplace(real)))
        for key, poly in terms.items():
            if key.norm is not None and (key.exponent or key.plane or poly.total_degree() > 0):
                raise reader.refuse(expression, "wanted a constant multiple of a norm")
        components.append(terms)
    return symbols, tuple(real[s] for s in parameters), tuple(components)
