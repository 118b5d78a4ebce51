"""Integration of ordinary differential equations on lists of components, many paths at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from seedslib.base.clock import step_count

SMALLEST = 2.0**-20
"""Smallest adaptive step as a fraction of the interval; paths that need less become NaN."""

# Dormand and Prince, 5(4): stages, fifth-order weights are the last row, error weights below
_NODES = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0)
_STAGES = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
_ERROR = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)


def _moved(y, h, slopes, weights):
    used = [(h * w, k) for w, k in zip(weights, slopes, strict=True) if w != 0.0]
    result = []
    for i, component in enumerate(y):
        for factor, slope in used:
            component = component + factor * slope[i]
        result.append(component)
    return result


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


def adaptive(
    rate: Callable[..., Any], y: Any, start: float, stop: float, step: float, rtol: float = 1e-6,
    atol: float = 1e-9,
) -> Any:  # fmt: skip
    """Dormand-Prince 5(4) steps of a size common to all paths, at most `step`.

    The largest estimated error of any component and path stays below ``atol + rtol |y|``. A path
    that would need steps below 2**-20 of the interval is given up as NaN, so that it does not
    hold the others.
    """
    step_count(start, stop, step)  # refuses a span without end
    span = stop - start
    # two times that are told apart: smaller steps would never arrive
    least = max(min(step, 0.5 * SMALLEST * span), np.spacing(max(abs(start), abs(stop))))
    t, h = start, max(min(step, span), least)
    first = rate(t, y)
    while t < stop:
        h = min(h, stop - t)
        slopes = [first]
        for node, weights in zip(_NODES[1:], _STAGES, strict=True):
            moved = _moved(y, h, slopes, weights)
            slopes.append(rate(t + node * h, moved))
        error = _moved([0.0] * len(y), h, slopes, _ERROR)
        sizes = [
            np.abs(e) / (atol + rtol * np.maximum(np.abs(a), np.abs(b)))
            for e, a, b in zip(error, y, moved, strict=True)
        ]
        alive = np.isfinite(sum(y))
        worst = np.max(np.broadcast_arrays(*sizes), axis=0)
        worst = np.where(alive, np.where(np.isfinite(worst), worst, np.inf), 0.0)
        largest = np.max(worst)
        if largest > 1.0 and h <= max(SMALLEST * span, least):
            moved = [np.where(worst > 1.0, np.nan, part) for part in moved]
            largest = 1.0
        if largest <= 1.0:
            t = stop if h >= stop - t else t + h
            y, first = moved, slopes[-1]
        growth = 5.0 if largest == 0.0 else 0.9 * largest**-0.2
        h = max(min(step, h * min(5.0, max(0.2, growth))), least)
    return y


def finite_or_nan(advance: Callable[..., Any], rate: Any, y: Any, *given: Any) -> Any:
    """What an integrator finds; NaN where Python's numbers overflow, as arrays would go on."""
    try:
        return advance(rate, y, *given)
    except (OverflowError, ZeroDivisionError):
        return [np.full(np.shape(part), np.nan) for part in y]
