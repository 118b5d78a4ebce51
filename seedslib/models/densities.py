"""Densities of maps that can be solved for their noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from seedslib.models.maps import StochasticMap


def noise_of(map: StochasticMap) -> tuple[Any, list[Any], Any] | None:
    """The noise that makes y of x, for a map that is affine in it and can be solved for it.

    Returns
    -------
    y : tuple of SymPy symbols
    noise : list of SymPy expressions
        In the time, the state and y.
    volume : SymPy expression
        Determinant of the map's derivative by the noise. None for a map of another kind.
    """
    if not map.symbolic or map.size != map.noise.size:
        return None
    import sympy

    y = sympy.symbols(f"y:{map.size}", cls=sympy.Dummy, real=True)
    value = sympy.Matrix(map.expressions)
    slope = value.jacobian(map.noise.symbols)
    volume = slope.det()
    if volume == 0:
        return None
    still = value.subs(dict.fromkeys(map.noise.symbols, 0))
    return y, list(slope.LUsolve(sympy.Matrix(y) - still)), volume


def by_noise(map: StochasticMap) -> Callable[..., Any] | None:
    """Log-density (t, y, x) of y from that of the noise, by the change of variables."""
    found = noise_of(map)
    if map.noise.log_density is None or map.period or found is None:
        return None
    import sympy

    from seedslib.models.codegen import compile_array

    y, noise, volume = found
    solved = compile_array((map.time, map.state, y), [*noise, sympy.Abs(volume)])

    def log_density(t: float, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        parts = solved(t, x, y)
        batch = np.broadcast_shapes(np.shape(y)[1:], np.shape(x)[1:])
        with np.errstate(divide="ignore"):
            return map.noise.log_density(np.broadcast_to(parts[:-1], (map.size, *batch))) - np.log(
                parts[-1]
            )

    return log_density
