"""Compromise between criteria, by equal or by least largest relative loss.

Of the paper on two-criteria optimisation by bisection only the end survives, with equations (18),
(19) and the proof that a point of equal losses exists; `bisect` is its method. `compromise` takes
the least largest loss on a segment, `choose` in a list of choices, such as the orders of a filter
with their errors and costs.

All criteria are losses: less is better. With the minimisers ``x_i`` the utopia is
``m_i = I_i(x_i)``, the nadir of the payoff table ``M_i = max_j I_i(x_j)``, and the relative loss
``(I_i(x) - m_i) / (M_i - m_i)``. From three criteria on, the nadir of the payoff table can differ
from the nadir of the efficient set, and equal losses of all criteria need not exist.

May import: base.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, minimize_scalar

from seedslib.base.checks import as_count, as_positive, as_real

__all__ = ["Bisection", "Compromise", "bisect", "choose", "compromise"]

Criteria = Sequence[Callable[..., Any]] | Callable[..., Any]

Function = Callable[[float], float]

PLATEAU = 1e-3  # of the segment: where a criterion is least over more, the others decide
JUMP = 1e-6  # gap of the losses at a bracketed root above which the criteria jump over it


@dataclass(frozen=True, eq=False)
class Bisection:
    """Trace of the paper's bisection: midpoints ``(r, ...)``, their gaps ``(r,)``, the last one."""

    x: float | np.ndarray
    points: np.ndarray
    gaps: np.ndarray
    losses: np.ndarray
    converged: bool


@dataclass(frozen=True, eq=False)
class Compromise:
    """Where the largest relative loss is least.

    Attributes
    ----------
    x : float or int
        A point of the segment, or the position of the choice.
    values, losses : ndarray (p,)
        Criteria at `x` and their relative losses.
    utopia, nadir : ndarray (p,)
        ``m`` and ``M`` of the payoff table.
    minimizers : ndarray (p,)
        Minimisers of each criterion (positions, for choices); ties are broken by the others.
    balanced : float or None
        The paper's point of equal losses, for two criteria on a segment; it need not be `x`,
        and is None where the criteria jump over it.
    """

    x: float | int
    values: np.ndarray
    losses: np.ndarray
    utopia: np.ndarray
    nadir: np.ndarray
    minimizers: np.ndarray
    balanced: float | None = None

    @property
    def worst(self) -> float:
        """Largest relative loss."""
        return float(self.losses.max())


def bisect(
    criteria: Criteria, start: ArrayLike, end: ArrayLike, *, tolerance: float = 1e-12, steps=60
) -> Bisection:
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
    """
    low, high = as_real("start", start), as_real("end", end)
    if low.shape != high.shape or low.ndim > 1:
        raise ValueError(f"end: wanted the shape {low.shape} of start, got {high.shape}")
    tolerance, steps = as_positive("tolerance", tolerance), as_count("steps", steps)
    point = np.copy if low.ndim else float
    at_low, at_high = _evaluate(criteria, point(low)), _evaluate(criteria, point(high))
    if at_low.size != 2:
        raise ValueError(f"criteria: wanted two for a bisection, got {at_low.size}")
    utopia, scale = np.array([at_low[0], at_high[1]]), (at_high - at_low) * [1.0, -1.0]
    if scale.min() <= 0:
        name = "start" if scale[0] <= 0 else "end"
        raise ValueError(f"{name}: wanted its criterion least there, got {at_low} and {at_high}")
    points, losses, gap = [], [], np.inf
    while len(points) < steps and abs(gap) > tolerance:
        points.append(0.5 * (low + high))
        losses.append((_evaluate(criteria, point(points[-1])) - utopia) / scale)
        gap = losses[-1][0] - losses[-1][1]
        low, high = (points[-1], high) if gap < 0 else (low, points[-1])
    gaps, met = np.subtract(*np.transpose(losses)), bool(abs(gap) <= tolerance)
    return Bisection(point(points[-1]), np.array(points), gaps, np.array(losses), met)


def compromise(criteria: Criteria, lower: float, upper: float, *, scan: int = 33) -> Compromise:
    """Point of a segment whose largest relative loss is least, with the least sum of losses.

    The second condition makes it efficient where a point of equal losses is so only weakly.

    Parameters
    ----------
    criteria : sequence of callables, or one callable that returns all values
        At least two continuous losses, functions of a float.
    lower, upper : float
        Ends of the segment.
    scan : int
        Points of a first scan; a minimum narrower than their spacing can be missed.
    """
    low, high = as_real("lower", lower, ()), as_real("upper", upper, ())
    if not low < high:
        raise ValueError(f"upper: wanted a bound above the lower, got {upper} and {lower}")
    nodes = np.linspace(low, high, as_count("scan", scan, 5))
    unit = np.ptp([_evaluate(criteria, x) for x in nodes], axis=0)
    unit[unit == 0] = 1.0

    def share(x: float) -> np.ndarray:
        return _evaluate(criteria, x) / unit

    part = [lambda x, i=i: share(x)[i] for i in range(unit.size)]
    minimizers = [_least(f, lambda x: share(x).sum(), nodes) for f in part]
    payoff = np.array([_evaluate(criteria, x) for x in minimizers])
    utopia, nadir = payoff.diagonal().copy(), payoff.max(axis=0)
    # without a range in the table (one point is best for all) losses count in units of the scan
    scale = np.where(nadir - utopia > 1e-12 * unit, nadir - utopia, unit)

    def losses(x: float) -> np.ndarray:
        return (_evaluate(criteria, x) - utopia) / scale

    balanced = []
    if unit.size == 2 and losses(minimizers[0])[1] > 0 < losses(minimizers[1])[0]:
        root = brentq(lambda x: losses(x)[0] - losses(x)[1], *minimizers, xtol=1e-15 * (high - low))
        balanced = [root] if np.ptp(losses(root)) <= JUMP else []
    x = _least(lambda x: losses(x).max(), lambda x: losses(x).sum(), nodes, balanced)
    values, minimizers = _evaluate(criteria, x), np.array(minimizers)
    return Compromise(x, values, losses(x), utopia, nadir, minimizers, *balanced)


def choose(criteria: ArrayLike) -> Compromise:
    """Choice whose largest relative loss is least, for instance the memory of a filter.

    Dominated choices do not count. An efficient but useless choice stretches the scale of its cost
    and so moves the compromise: try it without the `minimizers`. Ties go to the least sum of
    losses, then to the first.

    Parameters
    ----------
    criteria : array_like (n, p)
        Losses of the n choices.
    """
    values = as_real("criteria", criteria, (None, None))
    if values.shape[0] < 1 or values.shape[1] < 2:
        raise ValueError(f"criteria: wanted two at one choice or more, got shape {values.shape}")
    below = (values <= values[:, None]).all(axis=2) & (values < values[:, None]).any(axis=2)
    rows = np.flatnonzero(~below.any(axis=1))
    unit = np.ptp(values[rows], axis=0)
    shares = (values / np.where(unit > 0, unit, np.inf)).sum(axis=1)
    minimizers = np.array([min(rows, key=lambda i: (v[i], shares[i], i)) for v in values.T])
    utopia, nadir = values[minimizers].diagonal().copy(), values[minimizers].max(axis=0)
    losses = (values - utopia) / np.where(nadir > utopia, nadir - utopia, np.inf)
    best = int(min(rows, key=lambda i: (losses[i].max(), losses[i].sum(), i)))
    return Compromise(best, values[best], losses[best], utopia, nadir, minimizers)


def _evaluate(criteria: Criteria, x: Any) -> np.ndarray:
    values = criteria(x) if callable(criteria) else [criterion(x) for criterion in criteria]
    array = as_real("criteria", values, (None,))
    if array.size < 2:
        raise ValueError(f"criteria: wanted at least two, got {array.size}")
    return array


def _least(f: Function, tie: Function | None, nodes: np.ndarray, start=()) -> float:
    """Minimiser of `f` on a scan, best for `tie` on a plateau; the points `start` compete."""
    candidates, values = [*start], np.r_[np.inf, [f(x) for x in nodes], np.inf]
    for j in np.flatnonzero(values[1:-1] <= np.minimum(values[:-2], values[2:])):
        low, high = nodes[max(j - 1, 0)], nodes[min(j + 1, len(nodes) - 1)]
        h, options = 1e-5 * (high - low), {"xatol": 1e-12 * (high - low)}
        x = minimize_scalar(f, bounds=(low, high), method="bounded", options=options).x
        # the vertex of a parabola locates a smooth minimum to more digits than values do
        down, up = f(x - h), f(x + h)
        curvature = down - 2 * f(x) + up
        vertex = x - 0.5 * h * (up - down) / curvature if curvature > 0 else x
        candidates += [nodes[j], min(max(vertex, low), high), x]
    x = min(candidates, key=f)
    level = f(x) + 1e-15 * abs(f(x))
    low, high = (_flat_end(f, level, x, way) for way in (nodes[nodes < x][::-1], nodes[nodes > x]))
    if tie is None or high - low < PLATEAU * (nodes[-1] - nodes[0]):
        return float(x)
    return _least(tie, None, np.linspace(low, high, len(nodes)))


def _flat_end(f: Function, level: float, x: float, outward: np.ndarray) -> float:
    """Last point from `x` outward where `f` is within its least value."""
    for node in outward:
        if f(node) > level:
            return brentq(lambda y: float(f(y) > level) - 0.5, x, node)
        x = node
    return x
