"""Compromise of continuous criteria on a segment or in a box."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from seedslib.base.checks import as_count, as_real
from seedslib.pareto.least import box_scan, least_in_box, least_on_segment, minimax_in_box
from seedslib.pareto.result import Compromise, Criteria, Evaluated, efficiency

DEGENERATE = 1e-12  # a payoff range below this part of the range of the scan is none
ROUNDING = 64 * np.finfo(float).eps  # and one below this part of the values
SMALLEST = 1e-300  # range of a criterion below which it counts as constant
JUMP = 1e-6  # |Delta| at a bracketed root above which the criteria are said to jump


def compromise(
    criteria: Criteria, lower: ArrayLike, upper: ArrayLike, *, scan: int = 33
) -> Compromise:
    """Point whose largest relative loss is least, among such points an efficient one.

    On a segment all minima are found on a scan that includes both end points; for two criteria
    the points of equal losses are bracketed on the scan and found by Brent's method. For three
    criteria or more, or in a box, the least largest loss is found directly (Chebyshev's
    problem; in a box by sequential quadratic programming in epigraph form). A second stage takes,
    among the points of least largest loss, one with the least sum of losses: such a point is
    efficient, while a point of equal losses may be efficient only weakly.

    Parameters
    ----------
    criteria : sequence of callables, or one callable that returns all values
        At least two losses, functions of a float, or of an array ``(d,)`` in a box; continuous,
        and in a box smooth.
    lower, upper : float or array_like (d,)
        Bounds of the segment or of the box.
    scan : int
        Points of the scan. A minimum or a pair of roots narrower than the spacing can be missed.

    Returns
    -------
    Compromise

    Raises
    ------
    TypeError, ValueError
        Fewer than two criteria, values that are not finite or not the same on a second call (a
        noisy criterion), bounds not finite or not increasing, a scan of fewer than 5 points, or
        a criterion without a range in the payoff table.
    """
    low, high = as_real("lower", lower), as_real("upper", upper)
    if low.shape != high.shape or low.ndim > 1 or low.size == 0:
        raise ValueError(f"upper: wanted the shape {low.shape} of lower, got {high.shape}")
    if not (low < high).all():
        raise ValueError(f"upper: wanted upper bounds above the lower, got {upper} and {lower}")
    scan = as_count("scan", scan, 5)
    if low.ndim == 0:
        nodes = np.linspace(float(low), float(high), scan)
        return _on_segment(Evaluated(criteria, float(nodes[0])), nodes)
    points = box_scan(low, high, scan)
    return _in_box(Evaluated(criteria, points[0]), low, high, points)


def _payoff(
    evaluate: Evaluated, minimizers: list, seen: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int | None]:
    """Utopia, nadir, and scale of the losses; and which minimiser, if any, is ideal."""
    table = np.array([evaluate(x) for x in minimizers])
    utopia, nadir = np.diag(table).copy(), table.max(axis=0)
    least_range = DEGENERATE * np.ptp(seen, axis=0) + ROUNDING * np.abs(seen).max(axis=0)
    least_range = np.maximum(least_range, SMALLEST)
    best_for_all = (table - utopia <= least_range).all(axis=1)
    if best_for_all.any():
        return utopia, nadir, np.ones_like(utopia), int(np.argmax(best_for_all))
    none = nadir - utopia <= least_range
    lost = none & (np.ptp(seen, axis=0) > least_range)
    if lost.any():
        i = int(np.argmax(lost))
        raise ValueError(
            f"criteria[{i}]: wanted a range in the payoff table, got {utopia[i]:.6g} at the "
            "minimisers of all criteria"
        )
    return utopia, nadir, np.where(none, np.inf, nadir - utopia), None


def _others(evaluate: Evaluated, i: int, seen: np.ndarray) -> Callable:
    """Sum of the other criteria, each in units of its range: breaks ties of criterion i."""
    unit = np.ptp(seen, axis=0)
    seen = unit > SMALLEST  # a smaller one has no inverse
    weight = np.where(seen, 1.0 / np.where(seen, unit, 1.0), 0.0)
    weight[i] = 0.0
    return lambda x: float(evaluate(x) @ weight)


def _on_segment(evaluate: Evaluated, nodes: np.ndarray) -> Compromise:
    nodes = nodes.tolist()
    seen = np.array([evaluate(x) for x in nodes])
    count = seen.shape[1]
    minimizers = [
        least_on_segment(lambda x, i=i: evaluate(x)[i], _others(evaluate, i, seen), nodes)
        for i in range(count)
    ]
    utopia, nadir, scale, ideal = _payoff(evaluate, minimizers, seen)

    def losses(x: float) -> np.ndarray:
        return (evaluate(x) - utopia) / scale

    def gap(x: float) -> float:
        return float(losses(x)[0] - losses(x)[1])

    roots, balanced, status, unimodal = [], None, "minimax", True
    nodes = sorted({*nodes, *minimizers})
    if ideal is not None:
        x, status = minimizers[ideal], "ideal point"
    else:
        if count == 2:
            roots, unimodal = _equal_losses(gap, nodes, *minimizers)
        x = least_on_segment(
            lambda x: float(losses(x).max()), lambda x: float(losses(x).sum()), nodes, roots
        )
    if roots:
        balanced = min(roots, key=lambda root: losses(root).max())
        if abs(gap(balanced)) > JUMP:
            balanced, status, unimodal = None, "no bracket", False
        else:
            unimodal &= bool(losses(balanced).max() <= losses(x).max() + JUMP)
    if ideal is None and status != "no bracket" and np.ptp(losses(x)) <= JUMP:
        status = "equal losses"
    evaluate.repeat(x)
    known = evaluate.seen()
    return Compromise(
        x=x, index=None, values=evaluate(x), losses=losses(x) if ideal is None else 0.0 * utopia,
        utopia=utopia, nadir=nadir, minimizers=np.array(minimizers), status=status,
        efficiency=efficiency(evaluate(x), known), balanced=balanced,
        balanced_efficiency="" if balanced is None else efficiency(evaluate(balanced), known),
        unimodal=unimodal, evaluations=len(known),
    )  # fmt: skip


def _equal_losses(
    gap: Callable[[float], float], nodes: list[float], first: float, second: float
) -> tuple[list[float], bool]:
    """Points where the losses are seen to be equal; whether the gap is strictly monotone."""
    gaps = np.array([gap(x) for x in nodes])
    roots = [x for x, value in zip(nodes, gaps, strict=True) if value == 0]
    for j in np.flatnonzero(gaps[:-1] * gaps[1:] < 0):
        width = nodes[j + 1] - nodes[j]
        roots.append(brentq(gap, nodes[j], nodes[j + 1], xtol=1e-15 * width, rtol=1e-15))
    ends = sorted((nodes.index(first), nodes.index(second)))
    steps = np.diff(gaps[ends[0] : ends[1] + 1])
    strict = (steps > 0).all() if first < second else (steps < 0).all()
    between = [x for x in roots if min(first, second) <= x <= max(first, second)]
    return roots, bool(strict and len(between) == 1)


def _in_box(
    evaluate: Evaluated, lower: np.ndarray, upper: np.ndarray, points: np.ndarray
) -> Compromise:
    seen = np.array([evaluate(x) for x in points])
    minimizers, good = [], True
    for i in range(seen.shape[1]):
        x, found = least_in_box(
            lambda x, i=i: evaluate(x)[i], _others(evaluate, i, seen), lower, upper, points
        )
        minimizers.append(x)
        good &= found
    utopia, nadir, scale, ideal = _payoff(evaluate, minimizers, seen)

    def losses(x: np.ndarray) -> np.ndarray:
        return (evaluate(x) - utopia) / scale

    checked = True
    if ideal is not None:
        x, status, at_x = minimizers[ideal], "ideal point", 0.0 * utopia
    else:
        worst = [losses(x).max() for x in points]
        starts = [*minimizers, np.mean(minimizers, axis=0), points[int(np.argmin(worst))]]
        x, found, checked = minimax_in_box(losses, lower, upper, starts)
        at_x = losses(x)
        status = "equal losses" if np.ptp(at_x) <= JUMP else "minimax"
        good &= found
    evaluate.repeat(x)
    known = evaluate.seen()
    return Compromise(
        x=x, index=None, values=evaluate(x), losses=at_x, utopia=utopia, nadir=nadir,
        minimizers=np.array(minimizers), status=status if good else "not converged",
        efficiency=efficiency(evaluate(x), known) if checked else "unknown",
        evaluations=len(known),
    )  # fmt: skip
