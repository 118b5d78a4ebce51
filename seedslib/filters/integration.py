"""Integration of ordinary differential equations on lists of components, many paths at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from seedslib.base.clock import step_count


def euler(rate: Callable[..., Any], y: Any, start: float, stop: float, step: float) -> Any:
    """Explicit Euler steps of at most `step`; see `rk4`."""
    return _steps(euler_step, rate, y, start, stop, step)


def euler_step(rate: Callable[..., Any], t: float, y: Any, h: float) -> Any:
    """One explicit Euler step of size h."""
    return [a + h * b for a, b in zip(y, rate(t, y), strict=True)]


def rk4(rate: Callable[..., Any], y: Any, start: float, stop: float, step: float) -> Any:
    """Classical Runge-Kutta steps of at most `step`.

    Parameters
    ----------
    rate : callable
        ``rate(t, components) -> list`` of derivatives.
    y : list
        Components at `start`: numbers or arrays over paths.
    start, stop, step : float
    """
    return _steps(rk4_step, rate, y, start, stop, step)


def _steps(one, rate, y, start, stop, step):
    """As few equal steps as are not longer than `step`."""
    steps = step_count(start, stop, step)
    h = (stop - start) / steps
    for k in range(steps):
        y = one(rate, start + k * h, y, h)
    return y


def rk4_step(rate: Callable[..., Any], t: float, y: Any, h: float) -> Any:
    """One classical Runge-Kutta step of size h."""
    k1 = rate(t, y)
    k2 = rate(t + 0.5 * h, [a + (0.5 * h) * b for a, b in zip(y, k1, strict=True)])
    k3 = rate(t + 0.5 * h, [a + (0.5 * h) * b for a, b in zip(y, k2, strict=True)])
    k4 = rate(t + h, [a + h * b for a, b in zip(y, k3, strict=True)])
    return [
        a + (h / 6.0) * (b + 2.0 * (c + d) + e)
        for a, b, c, d, e in zip(y, k1, k2, k3, k4, strict=True)
    ]


def finite_or_nan(advance: Callable[..., Any], rate: Any, y: Any, *given: Any) -> Any:
    """What an integrator finds; NaN where Python's numbers overflow, as arrays would go on."""
    try:
        return advance(rate, y, *given)
    except (OverflowError, ZeroDivisionError):
        return [np.full(np.shape(part), np.nan) for part in y]
