"""Least value of a function on a segment or in a box, ties broken by a second function.

The tie is what makes a payoff table well defined (a criterion may be least on a whole interval)
and what turns a weakly efficient minimax point into an efficient one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.optimize import OptimizeResult, minimize, minimize_scalar

EQUAL = 1e-12  # two minima are equal within this part of the range of the scanned values
SAME_TIE = 1e-9  # improvement of the tie, in its range, that is none
FLAT = 1e-3  # a minimum is a plateau if flat over more than this part of the segment
ROUNDING = 4 * np.finfo(float).eps
DEGREE = 10  # of the interpolant whose derivative locates a smooth minimum
STARTS = 4  # best points of a scan from which a search in a box starts
SLACK = 1e-10  # of the first stage's value, allowed in the second stage
GAIN = 1e-6  # improvement of the tie that counts as real

SEARCH = {"method": "SLSQP", "jac": "3-point", "options": {"ftol": 1e-15, "maxiter": 400}}

Function = Callable[[np.ndarray | float], float]


def least_on_segment(
    f: Function, tie: Function | None, nodes: Sequence[float], extra: Sequence[float] = ()
) -> float:
    """Global minimiser of `f` as seen on sorted `nodes`, best for `tie` among the minimisers.

    A local minimum narrower than the spacing of the nodes can be missed. Points `extra` compete
    with the minima found, and are preferred to equal ones.
    """
    nodes = np.asarray(nodes)
    values = np.array([f(x) for x in nodes.tolist()])
    left, right = np.r_[np.inf, values[:-1]], np.r_[values[1:], np.inf]
    candidates = list(extra)
    for j in np.flatnonzero((values <= left) & (values <= right)):
        lower, upper = float(nodes[max(j - 1, 0)]), float(nodes[min(j + 1, len(nodes) - 1)])
        node = float(nodes[j])
        flat = left[j] == values[j] == right[j]
        candidates.append(node if flat else _polished(f, node, lower, upper))
    found = np.array([f(x) for x in candidates])
    level = found.min() + EQUAL * (values.max() - found.min()) + ROUNDING * abs(found.min())
    least = [x for x, value in zip(candidates, found, strict=True) if value <= level]
    if tie is None:
        return least[0]
    margin = SAME_TIE * np.ptp([tie(x) for x in nodes.tolist()])
    ends = [_best_on_plateau(f, tie, x, nodes) for x in least]
    best = ends[0]
    for x in ends[1:]:
        if tie(x) < tie(best) - margin:
            best = x
    return best


def _polished(f: Function, node: float, lower: float, upper: float) -> float:
    """Local minimiser in a cell around `node`, to more digits than values of `f` can show.

    Values locate a smooth minimum only to the root of the rounding error; the derivative of an
    interpolant locates it almost to the rounding error, and is taken if `f` does not object.
    """
    spread = upper - lower
    search = minimize_scalar(
        f, bounds=(lower, upper), method="bounded", options={"xatol": 1e-10 * spread}
    )
    x = min((node, float(search.x)), key=f)  # a bounded search never returns an end
    if x in (lower, upper):
        return x
    found = [x]
    a, b = max(lower, x - 0.25 * spread), min(upper, x + 0.25 * spread)
    interpolant = Chebyshev.interpolate(
        lambda points: np.array([f(float(point)) for point in points]), DEGREE, domain=[a, b]
    )
    roots = interpolant.deriv().roots()
    real = roots.real[(abs(roots.imag) <= 1e-6 * spread) & (a <= roots.real) & (roots.real <= b)]
    if real.size:
        found.insert(0, float(real[np.argmin(abs(real - x))]))
    bracket = (x - 1e-6 * spread, x, x + 1e-6 * spread)
    if min(f(bracket[0]), f(bracket[2])) > f(x):  # at a kink golden sections reach all digits
        options = {"xtol": 1e-15, "maxiter": 60}
        found.append(float(minimize_scalar(f, bracket, method="golden", options=options).x))
    least = min(map(f, found))
    noise = ROUNDING * abs(least) + 1e-13 * (max(f(lower), f(upper)) - least)
    # where f is a difference of larger numbers its values are rougher than they are large
    close = np.clip(x * (1.0 + np.finfo(float).eps * np.arange(-4, 5)), lower, upper)
    noise = max(noise, 2.0 * float(np.ptp([f(y) for y in close.tolist()])))
    return next(x for x in found if f(x) <= least + noise)


def _best_on_plateau(f: Function, tie: Function, x: float, nodes: np.ndarray) -> float:
    """Best minimiser for `tie` around x, where `f` is flat over a part of the segment."""
    level = f(x) + ROUNDING * abs(f(x))
    step = 0.5 * FLAT * float(nodes[-1] - nodes[0])
    near = [y for y in (x - step, x + step) if nodes[0] <= y <= nodes[-1]]
    if all(f(y) > level for y in near):
        return x
    low = _flat_end(f, level, x, nodes[nodes < x][::-1])
    high = _flat_end(f, level, x, nodes[nodes > x])
    if high - low <= FLAT * (nodes[-1] - nodes[0]):
        return x
    return least_on_segment(tie, None, np.linspace(low, high, len(nodes)))


def _flat_end(f: Function, level: float, x: float, outward: np.ndarray) -> float:
    """Last point from `x` outward, node after node, where `f` stays within `level`."""
    inside = x
    for node in outward:
        if f(float(node)) > level:
            outside = float(node)
            while abs(outside - inside) > 1e-13 * max(abs(outside), abs(inside), 1e-300):
                middle = 0.5 * (inside + outside)
                if middle in (inside, outside):
                    break
                if f(middle) <= level:
                    inside = middle
                else:
                    outside = middle
            break
        inside = float(node)
    return inside


def box_scan(lower: np.ndarray, upper: np.ndarray, count: int) -> np.ndarray:
    """Evenly spread points of a box, the centre first, ``(count, d)``.

    Steps by powers of the generalised golden ratio (the root of ``x^(d+1) = x + 1``), modulo one.
    """
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (len(lower) + 1))
    steps = ratio ** -np.arange(1.0, len(lower) + 1)
    points = (0.5 + np.arange(count)[:, None] * steps) % 1.0
    return lower + points * (upper - lower)


def least_in_box(
    f: Function, tie: Function, lower: np.ndarray, upper: np.ndarray, scan: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Minimiser of a smooth `f` in a box (several starts), best for `tie`; and success.

    The second stage, least `tie` where `f` is least, runs only if different starts end in
    different points of equal value: at a sharp minimum its slack would cost digits.
    """
    # starting points: of equal ones the first, and every end is compared again below
    order = np.argsort([f(x) for x in scan], kind="stable")[:STARTS]
    point, box = _unit_box(lower, upper)
    scale = max(abs(f(scan[order[-1]]) - f(scan[order[0]])), abs(f(scan[order[0]])), 1e-300)

    def scaled(z: np.ndarray) -> float:
        return f(point(z)) / scale

    first = [
        minimize(scaled, (scan[j] - lower) / (upper - lower), bounds=box, **SEARCH) for j in order
    ]
    best = min(first, key=lambda end: end.fun)
    equal = [end for end in first if end.fun <= best.fun + 1e-9]
    if max(np.abs(end.x - best.x).max() for end in equal) > FLAT:
        rule = {"type": "ineq", "fun": lambda z, level=best.fun + SLACK: level - scaled(z)}
        second = [
            minimize(lambda z: tie(point(z)), end.x, bounds=box, constraints=[rule], **SEARCH)
            for end in equal
        ]
        equal += [end for end in second if scaled(end.x) <= best.fun + 1e-9]
        best = min(equal, key=lambda end: tie(point(end.x)))
    return point(best.x), _ended(best)


def _unit_box(lower: np.ndarray, upper: np.ndarray) -> tuple[Callable, list]:
    """From the unit box to the points of a box, and the bounds of the former."""
    size = upper - lower
    return lambda z: lower + np.clip(z, 0.0, 1.0) * size, [(0.0, 1.0)] * len(lower)


def _ended(search: OptimizeResult) -> bool:
    """Whether a search went as far as it could: status 8 is a step lost in rounding."""
    return bool(search.success or search.status == 8)


def minimax_in_box(
    losses: Callable[[np.ndarray], np.ndarray],
    lower: np.ndarray,
    upper: np.ndarray,
    starts: Sequence[np.ndarray],
) -> tuple[np.ndarray, bool, bool]:
    """Chebyshev point: least bound on all `losses`, then least sum of losses under that bound.

    Returns the point, whether the first stage succeeded, whether the second did.
    """
    point, box = _unit_box(lower, upper)

    def at(z: np.ndarray) -> np.ndarray:
        return losses(point(z))

    # least t with losses <= t: the epigraph form, in the variables (z, t)
    above = {"type": "ineq", "fun": lambda zt: zt[-1] - at(zt[:-1])}
    open_box = [*box, (None, None)]
    ends = []
    for start in starts:
        z = (start - lower) / (upper - lower)
        zt = np.r_[z, at(z).max()]
        ends.append(minimize(itemgetter(-1), zt, bounds=open_box, constraints=[above], **SEARCH))
    best = min(ends, key=lambda end: at(end.x[:-1]).max())
    z = best.x[:-1]
    bound = at(z).max()
    below = {"type": "ineq", "fun": lambda z: bound + SLACK - at(z)}
    repaired = minimize(lambda z: at(z).sum(), z, bounds=box, constraints=[below], **SEARCH)
    settled, again = _ended(repaired), at(repaired.x)
    if settled and again.max() <= bound + 1e-9 and again.sum() < at(z).sum() - GAIN:
        z = repaired.x
    return point(z), _ended(best), settled
