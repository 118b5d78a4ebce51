"""What all linearizations that are formulas share: from SymPy moments to compiled functions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import sympy

from seedslib.base.linalg import symmetric
from seedslib.base.values import Values
from seedslib.gaussian.algebra import NoClosedForm
from seedslib.linearization.moments import (
    TINY,
    Gaussian,
    Linearization,
    Moments,
    Weighted,
    refuse_weight,
)
from seedslib.models.codegen import batch_of, compile_components, stack
from seedslib.models.maps import StochasticMap
from seedslib.tape.tape import choose

Parts: TypeAlias = tuple[sympy.Matrix, sympy.Matrix, sympy.Matrix | None]
"""E y (m, 1), cov(x, y) (n, m) and cov y (m, m) or None."""


def mentions(expression: sympy.Expr, symbols: Iterable[sympy.Symbol]) -> bool:
    """Whether an expression contains one of the symbols."""
    return bool(sympy.sympify(expression).free_symbols & set(symbols))


class BranchFormulas(NamedTuple):
    """SymPy mass of a branch, moments of the state in it, and moments of y with it."""

    mass: object
    mean: object
    cov: object
    value: object
    cross: object
    spread: object


class Formulas(Linearization):
    """A linearization given by SymPy formulas in the mean and the covariance of the state.

    A new one is a frozen dataclass: what is derived is stored by the rule and its maps.
    """

    def formulas(
        self, map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix, spread: bool = True
    ) -> Parts:
        """SymPy E y (m, 1), cov(x, y) (n, m) and cov y (m, m) at given mean and covariance."""
        raise NotImplementedError

    def rate_formulas(
        self, system: object, mean: Sequence[Any], cov: sympy.Matrix
    ) -> tuple[sympy.Matrix, sympy.Matrix]:
        """SymPy rates of the mean (n, 1) and the covariance (n, n) of a jump-diffusion."""
        velocity, cross, _ = self.formulas(system.drift_map, mean, cov, spread=False)
        lower, _, _ = self.formulas(system.spread_map, mean, cov, spread=False)
        return velocity, cross + cross.T + sympy.Matrix(symmetric(list(lower), len(mean)))

    def moments(self, map: StochasticMap, spread: bool = True) -> Callable[..., Moments]:
        """See `Linearization.moments`.

        Raises
        ------
        NoClosedForm
            The map is given by array functions, or a mean has no closed form.
        """
        refuse_weight(map)
        return _derived_once(Formulas._moments, self, map, spread)

    def _moments(self, map: StochasticMap, spread: bool) -> Callable[..., Moments]:
        arguments, mean, cov = _arguments(map, type(self).__name__)
        parts = self.formulas(map, mean, cov, spread)
        evaluate = _compiled(arguments, parts if spread else parts[:2])
        n, m = map.state_size, map.size

        def f(t: float, mean: np.ndarray, cov: np.ndarray, p: Values = ()) -> Moments:
            lower = _lower(cov)
            y, cross, *square = evaluate(t, mean, lower, p)
            batch = batch_of(mean, lower)
            own = None if batch else ()  # covariances may lack the axes of a batch
            cross, cov = stack(cross, (n, m), own), stack(*square, (m, m), own) if spread else None
            return Moments(stack(y, (m,), batch), cross, cov)

        return f

    def branch(self, map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix) -> BranchFormulas:
        """SymPy moments of a branch at given mean and covariance of the state."""
        raise NotImplementedError

    def row(self, maps: Sequence[StochasticMap]) -> Callable[..., list[Weighted]]:
        """See `Linearization.row`; one compiled function, in which branches share what they can.

        Raises
        ------
        NoClosedForm
            As `moments`.
        ValueError
            Maps of different states.
        """
        return _derived_once(Formulas._row, self, tuple(maps))

    def _row(self, maps: tuple[StochasticMap, ...]) -> Callable[..., list[Weighted]]:
        arguments, mean, cov = _arguments(maps[0], type(self).__name__)
        if any((m.state, m.time) != (maps[0].state, maps[0].time) for m in maps):
            raise ValueError("maps: wanted maps of the same state and time")
        branches = [self.branch(map, mean, cov) for map in maps]
        # equal moments of several branches are evaluated and stored once
        wanted = [
            [(slot in (0, 2), sympy.ImmutableMatrix(part)) for slot, part in enumerate(branch[1:])]
            for branch in branches
        ]
        parts = list(dict.fromkeys(part for row in wanted for part in row))
        places = [[parts.index(part) for part in row] for row in wanted]
        masses = [branch.mass for branch in branches]
        evaluate = _compiled(arguments, [masses, *(part for _, part in parts)])

        def f(t: float, mean: np.ndarray, cov: np.ndarray, p: Values = ()) -> list[Weighted]:
            lower = _lower(cov)
            batch = batch_of(mean, lower)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                masses, *values = evaluate(t, mean, lower, p)
            arrays = [
                stack(value, part.shape[:1], batch) if vector else stack(value, part.shape)
                for value, (vector, part) in zip(values, parts, strict=True)
            ]
            return [
                _weighted(stack([mass], (), batch), [arrays[k] for k in row])
                for mass, row in zip(masses, places, strict=True)
            ]

        return f

    def rate(self, system: object) -> Callable[..., list[Any]]:
        """See `Linearization.rate`."""
        arguments, vector, cov = _arguments(system.drift_map, type(self).__name__)
        time, mean, lower, parameters = arguments
        velocity, change = self.rate_formulas(system, vector, cov)
        rates = [*velocity, *_lower(change)]
        evaluate = compile_components((time, (*mean, *lower), parameters), rates)
        return lambda t, components, p=(): evaluate(t, components, p)


def _derived_once(derive: Callable[..., Any], rule: Formulas, *arguments: Any) -> Any:
    """What is derived from a rule and its maps: several filters are made of one system.

    A rule that may change, being no frozen dataclass of its own, derives it whenever it is asked.
    """
    settings = vars(type(rule)).get("__dataclass_params__")
    frozen = getattr(settings, "frozen", False)
    return (_derived if frozen else _derived.__wrapped__)(derive, rule, *arguments)


@lru_cache(maxsize=256)
def _derived(derive: Callable[..., Any], *arguments: Any) -> Any:
    return derive(*arguments)


def _arguments(map: StochasticMap, name: str) -> tuple[tuple, list[sympy.Symbol], sympy.Matrix]:
    """Arguments (t, mean, lower covariance, p) and the SymPy mean and covariance of them."""
    if not map.symbolic:
        raise NoClosedForm(
            f"{name}: wanted a symbolic map, got array functions; use Unscented, Cubature or "
            "GaussHermite"
        )
    n = map.state_size
    mean = sympy.symbols(f"m:{n}", cls=sympy.Dummy, real=True)
    lower = sympy.symbols(f"P:{n * (n + 1) // 2}", cls=sympy.Dummy, real=True)
    arguments = map.time, mean, lower, map.parameters
    return arguments, list(mean), sympy.Matrix(symmetric(lower, n))


def _lower(cov: Any) -> list[Any]:
    """Entries on and below the diagonal, row by row."""
    return [cov[i, j] for i in range(cov.shape[0]) for j in range(i + 1)]


def _compiled(arguments: tuple, parts: Sequence) -> Callable[..., list]:
    """Function that returns the component lists of several matrices, evaluated together."""
    sizes = np.cumsum([len(part) for part in parts])[:-1]
    function = compile_components(arguments, [e for part in parts for e in part])

    def evaluate(*values: object) -> list:
        flat = function(*values)
        return [flat[a:b] for a, b in zip([0, *sizes], [*sizes, None], strict=True)]

    return evaluate


def _weighted(mass: np.ndarray, moments: list[np.ndarray]) -> Weighted:
    """Zero for the mass of an empty branch (rounding may be negative), NaN for its moments."""
    if mass.dtype == object:  # of a program
        mass = choose(mass[()] < TINY, 0.0, mass[()])
        return Weighted(mass, Gaussian(*moments[:2]), Moments(*moments[2:]))
    empty = mass < TINY
    if empty.any():
        moments = [np.where(empty, np.nan, part) for part in moments]
        mass = np.where(empty, 0.0, mass)
    return Weighted(mass, Gaussian(*moments[:2]), Moments(*moments[2:]))
