"""What a map gives at a fixed state: moments in formulas, and densities."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from seedslib.models.maps import StochasticMap


def conditional_formulas(map: StochasticMap) -> tuple[np.ndarray, np.ndarray, Any]:
    """SymPy mean (size,), covariance (size, size) and weight of y given x, in its branch."""
    import sympy

    average, y = map.noise.expectation, map.expressions
    joint = map.weight_expression.free_symbols & set(map.noise.symbols)
    w = map.weight_expression if joint else sympy.Integer(1)
    mass = average(w)
    mean = [average(sympy.expand(w * part)) / mass for part in y]
    # in a branch the means are quotients, which only their names keep from being multiplied out
    named = sympy.symbols(f"mean:{map.size}", cls=sympy.Dummy, real=True) if joint else mean
    means = dict(zip(named, mean, strict=True))
    cov = np.empty((map.size, map.size), dtype=object)
    for i in range(map.size):
        for j in range(i + 1):
            spread = average(sympy.expand(w * (y[i] - named[i]) * (y[j] - named[j])))
            spread = sympy.expand(spread) if not joint else spread.xreplace(means) / mass
            cov[i, j] = cov[j, i] = spread
    return np.array(mean, dtype=object), cov, mass if joint else map.weight_expression


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


def told(log_density: Callable[..., Any], t: float, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The given log-density; zero where the whole measurement is missing (NaN), log 1.

    Parameters
    ----------
    log_density : callable
        ``log_density(t, y, x) -> (*batch)``.
    t : float
    y, x : ndarray, shapes (m, *batch) and (n, *batch)

    Raises
    ------
    ValueError
        A part of a measurement is missing, and the function gives no number at any state.
    """
    y, gaps = np.asarray(y, dtype=float), np.isnan(y)
    if not gaps.any():
        return log_density(t, y, x)
    with np.errstate(invalid="ignore"):
        found = np.where(gaps.all(axis=0), 0.0, log_density(t, y, x))
    partly = np.broadcast_to(gaps.any(axis=0) & ~gaps.all(axis=0), found.shape)
    if partly.any() and np.isnan(found[partly]).all():
        raise ValueError(
            "log_density: wanted numbers where a part of the measurement is missing (NaN), got "
            "NaN; it must integrate over that part, or the measurement be missing as a whole"
        )
    return found
