"""The example of the piecewise-linear paper."""

from __future__ import annotations

import numpy as np
import sympy
from numpy.typing import ArrayLike

from seedslib.base.checks import as_count
from seedslib.piecewise import PiecewiseLinearSystem


def falling_body(
    cells: int = 100,
    *,
    partition: str = "gradient",
    span: tuple[float, float] = (5.0, 50.0),
    support: str | ArrayLike = "centroid",
    sensor_noise: float = 1e-3,
    deviation: float = 11.25,
    speed: float = 0.0,
) -> PiecewiseLinearSystem:
    """Body in free fall from rest, of which only the elevation angle is measured.

    The example (24) to (30) of the piecewise-linear paper: the range X1 (in km) stays, the small
    angle falls, X2 <- X2 - g (t + 1/2) / X1 in the second after t = 0, 1, ... s, and Y = X2 + H V.

    Parameters
    ----------
    cells : int
        Number n of cells of the range.
    partition : {"gradient", "curvature"}
        The slope g (t + 1/2) / x² of the tangents takes n intervals of equal length, the paper's
        (27), or its change over a cell spreads the error of the tangents evenly, which makes
        the edges equidistant in x^(-1/2).
    span : (float, float)
        First and last edge in km; the outer cells are extended to infinity.
    support : str or array_like
        As in `PiecewiseLinearSystem.from_functions`.
    sensor_noise : float
        H in radians.
    deviation : float
        Standard deviation of the range in the prior, in km; illegible in the paper.
    speed : float
        Speed downwards at t = 0, in units of g times one second: the angle falls by
        g (t + 1/2 + speed) / X1 in the second after t. The paper's K_t = g (t - 1/2) is free fall
        from rest (0) where t is the end of that second, and -1 where it is the beginning.

    Returns
    -------
    PiecewiseLinearSystem
        Prior N((27.5, 0.1), diag(deviation², 1e-12)); its `discrete` has the nonlinear maps.
    """
    (low, high), power = span, {"gradient": -2.0, "curvature": -0.5}[partition]
    share = np.arange(as_count("cells", cells) + 1) / cells
    edges = ((1.0 - share) * low**power + share * high**power) ** (1.0 / power)
    x1, x2, v, t = sympy.symbols("x1 x2 v t")
    fall = (t + sympy.Rational(1, 2) + sympy.Rational(speed)) / 100  # g t, in km/s
    return PiecewiseLinearSystem.from_functions(
        state=(x1, x2),
        dynamics=[x1, x2 - fall / x1],
        sensor=[x2 + sensor_noise * v],
        noise=[v],
        breakpoints=edges,
        support=support,
        time=t,
        initial=([27.5, 0.1], np.diag([deviation**2, 1e-12])),
    )
