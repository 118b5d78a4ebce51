"""The paper's bisection between two minimisers, as it stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_count, as_positive, as_real
from seedslib.pareto.result import Criteria, Evaluated


@dataclass(frozen=True, eq=False)
class Bisection:
    """Trace of the paper's bisection: midpoints ``(r, ...)``, their gaps ``(r,)``, the last one."""

    x: float | np.ndarray
    points: np.ndarray
    gaps: np.ndarray
    losses: np.ndarray
    converged: bool


def bisect(
    criteria: Criteria, start: ArrayLike, end: ArrayLike, *, tolerance: float = 1e-12,
    steps: int = 60,
) -> Bisection:  # fmt: skip
    """The paper's method: halve the segment between two minimisers until the losses are equal.

    Its convergence follows from the nested segments and continuity. ``|Delta|`` need not fall at
    every step, and on a segment in several variables the limit need not be efficient.

    Parameters
    ----------
    criteria : two callables, or one callable that returns two values
        Continuous functions of a number, or of an array ``(d,)``.
    start, end : float or array_like (d,)
        Minimisers of the first and of the second criterion (Delta is -1 and +1 there).
    tolerance : float
        Stop when ``|Delta|`` is at most this.
    steps : int
        Largest number of halvings.

    Raises
    ------
    TypeError, ValueError
        Criteria that are not two callables, not finite or not repeatable; `start` or `end`
        not the better one for its criterion; bounds or counts out of range.
    """
    low, high = as_real("start", start), as_real("end", end)
    if low.shape != high.shape or low.ndim > 1:
        raise ValueError(f"end: wanted the shape {low.shape} of start, got {high.shape}")
    tolerance = as_positive("tolerance", tolerance)
    steps = as_count("steps", steps)
    unwrap = (lambda point: point.copy()) if low.ndim else float
    evaluate = Evaluated(criteria, unwrap(low))
    at_low, at_high = evaluate(unwrap(low)), evaluate(unwrap(high))
    if at_low.size != 2:
        raise ValueError(f"criteria: wanted two for a bisection, got {at_low.size}")
    utopia, spread = np.array([at_low[0], at_high[1]]), (at_high - at_low) * [1.0, -1.0]
    if spread.min() <= 0:
        i = int(np.argmin(spread))
        raise ValueError(
            f"{('start', 'end')[i]}: wanted the point where criteria[{i}] is less than at the "
            f"other end, got {at_low[i]:.6g} at start and {at_high[i]:.6g} at end"
        )
    points, losses = [], []
    while len(points) < steps:
        middle = 0.5 * (low + high)
        points.append(middle)
        losses.append((evaluate(unwrap(middle)) - utopia) / spread)
        gap = losses[-1][0] - losses[-1][1]
        if abs(gap) <= tolerance:
            break
        low, high = (middle, high) if gap < 0 else (low, middle)
    trace = np.array(losses)
    gaps = trace[:, 0] - trace[:, 1]
    return Bisection(
        unwrap(points[-1]), np.array(points), gaps, trace, bool(abs(gaps[-1]) <= tolerance)
    )
