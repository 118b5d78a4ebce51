"""What all filters do with moments, recorded: maps by every rule, factor, correction, mixtures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from operator import add
from typing import Any

import numpy as np
import sympy

from seedslib.base.circle import around
from seedslib.base.conditioning import LOG_2PI, WIDE
from seedslib.base.linalg import ABSOLUTE, INDEFINITE, RELATIVE, eliminate, symmetric
from seedslib.base.values import Values
from seedslib.filters.program import Program, any_of
from seedslib.linearization.moments import Linearization
from seedslib.linearization.points import PointRule
from seedslib.models.codegen import compile_components
from seedslib.models.linear import LinearMap
from seedslib.models.maps import StochasticMap
from seedslib.tape.tape import Number, Scalar, Tape, choose, isnan, stacked

MOST_UNROLLED = 300
"""Products of points and of numbers at each up to which points are written one after another."""


def lower_of(cov: np.ndarray) -> np.ndarray:
    """Entries on and below the diagonal, row by row."""
    return cov[np.tril_indices(len(cov))]


def map_moments(
    tape: Tape,
    rule: Linearization,
    map: StochasticMap,
    t: Scalar,
    mean: np.ndarray,
    cov: np.ndarray,
    p: Values,
    spread: bool = True,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """E y (m,), cov(x, y) (n, m) and, if wanted, cov y (m, m) of a map of a Gaussian state.

    The numbers p of the map's parameters are constants or recorded themselves.
    """
    if isinstance(map, LinearMap) and not (map.symbolic and isinstance(rule, PointRule)):
        return _linear_moments(map, t, mean, cov, p)
    if isinstance(rule, PointRule):
        return _point_moments(tape, rule, map, t, mean, cov, p, spread)
    return rule.moments(map, spread)(t, mean, cov, p)


def _linear_moments(map: LinearMap, t: Scalar, mean: np.ndarray, cov: np.ndarray, p: Values) -> Any:
    """Moments of A x + b + v: A m + b, P A' and A P A' + S."""
    parts = [np.asarray(part, dtype=object) for part in map.formulas]
    entries = [entry for part in parts for entry in part.flat]
    values = stacked(entries)
    if any(hasattr(entry, "free_symbols") for entry in entries):
        values = stacked(compile_components([sympy.Symbol("t"), map.parameters], entries)(t, p))
    values = np.split(values, np.cumsum([part.size for part in parts])[:-1])
    A, S, b = (one.reshape(part.shape) for one, part in zip(values, parts, strict=True))
    cross = cov @ A.T
    return A @ mean + b, cross, symmetric(lower_of(A @ cross), map.size) + S


def cholesky(tape: Tape, cov: np.ndarray, scale: np.ndarray | None = None) -> np.ndarray:
    """Lower triangular L with L L' = P; a pivot that counts as zero gives a zero column.

    A pivot is judged by its variance, and one that is negative by `scale`, see
    `seedslib.base.linalg.cholesky`.
    """
    if scale is None:
        cov = _with_least_variances(tape, cov)
    n, rest, root = len(cov), cov.copy(), np.zeros(cov.shape, dtype=object)
    for j in range(n):
        pivot, variance = rest[j, j], abs(cov[j, j])
        regular = pivot > RELATIVE * variance + ABSOLUTE
        least = -(INDEFINITE * (variance if scale is None else scale[j]))
        zero = choose(pivot >= least, 0.0, np.nan)
        root[j, j] = choose(regular, np.sqrt(pivot), zero)
        root[j + 1 :, j] = rest[j + 1 :, j] * choose(regular, 1.0 / root[j, j], zero)
        for k in range(j + 1, n):
            rest[k, j + 1 : k + 1] = rest[k, j + 1 : k + 1] - root[k, j] * root[j + 1 : k + 1, j]
    return root


def _with_least_variances(tape: Tape, cov: np.ndarray) -> np.ndarray:
    """The same with the least variances of components without, which may covary with others.

    See `seedslib.base.linalg.cholesky`.
    """
    n = len(cov)
    zero = np.array([np.less_equal(abs(x), ABSOLUTE) for x in np.diagonal(cov)], dtype=object)
    if not any(type(x) is Scalar or x for x in zero):
        return cov
    raised = tape.array("raised", (n * (n + 1) // 2,))
    raised.store(lower_of(cov))
    with tape.when(any_of(zero)):  # which is rare
        others = choose(zero[:, None] | zero, 0.0, cov)
        root = cholesky(tape, others, np.abs(np.diagonal(cov)))
        slope = choose(~zero[:, None] & zero, cov, 0.0)
        for j in range(n):  # L W = C
            for k in range(j):
                slope[j] = slope[j] - root[j, k] * slope[k]
            slope[j] = slope[j] * choose(root[j, j] == 0.0, 0.0, 1.0 / root[j, j])
        raised.store(lower_of(choose(zero[:, None] & zero, slope.T @ slope, cov)))
    return symmetric(raised.all, n)


def without_rounding(tape: Tape, cov: np.ndarray, before: np.ndarray) -> np.ndarray:
    """A corrected covariance without what rounding has left of directions known exactly."""
    root = cholesky(tape, cov, np.diagonal(before))
    singular = any_of([r == 0.0 for r in np.diagonal(root)])
    return choose(singular, root @ root.T, cov)


def _at_points(map: StochasticMap) -> tuple[Sequence[Any], np.ndarray, Any]:
    """What is evaluated at a point: mean and covariance of y there, and the noise points cover."""
    try:
        mean, cov, _ = map.conditional_expressions
    except ValueError:
        return map.expressions, np.zeros((map.size, map.size), dtype=object), map.noise
    return mean, np.asarray(cov, dtype=object), None


def _point_moments(
    tape: Tape,
    rule: PointRule,
    map: StochasticMap,
    t: Scalar,
    mean: np.ndarray,
    cov: np.ndarray,
    p: Values,
    spread: bool,
    root: np.ndarray | None = None,
) -> Any:
    n, m = map.state_size, map.size
    root = cholesky(tape, cov) if root is None else root
    expressions, noise_cov, noise = _at_points(map)
    unit, weight, centred = rule.rule(n + (0 if noise is None else noise.size))
    arguments = [map.time, tuple(map.state)]
    points = unit.T
    if noise is not None:
        arguments.append(tuple(noise.symbols))
        points = np.hstack([unit[:n].T, (noise.mean[:, None] + noise.root @ unit[n:]).T])
    arguments.append(map.parameters)
    evaluate = compile_components(arguments, [*expressions, *lower_of(noise_cov)])

    def at(point: np.ndarray) -> np.ndarray:
        x = list(mean + root @ point[:n])
        return stacked(evaluate(t, x, *([] if noise is None else [list(point[n:])]), p))

    if len(weight) * (n + m) > MOST_UNROLLED:
        h, slope, square = _looped(tape, map, at, points, weight, centred)
        return h, root @ slope, symmetric(square, m) if spread else None
    values = np.array([at(point) for point in points], dtype=object).T
    y = values[:m]
    for k, period in map.period:
        y[k, 1:] = [around(part, y[k, 0], period) for part in y[k, 1:]]
    h = y[:, 0] + (y - y[:, :1]) @ weight
    deviation = y - h[:, None]
    cross = root @ ((unit[:n] * centred) @ deviation.T)
    if not spread:
        return h, cross, None
    noise_part = stacked([row[0] if _alike(row) else row @ weight for row in values[m:]])
    return h, cross, (deviation * centred) @ deviation.T + symmetric(noise_part, m)


def _looped(
    tape: Tape,
    map: StochasticMap,
    at: Callable[[np.ndarray], np.ndarray],
    points: np.ndarray,
    weight: np.ndarray,
    centred: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """Sums over many points, in loops: E y, its slope and its covariance on and below the diagonal.

    Without loops a rule of 81 points has 100,000 characters of C.
    """
    count, n, m = len(points), map.state_size, map.size
    points, weight, centred = (
        tape.table(name, part)
        for name, part in (("points", points), ("weights", weight), ("centred_weights", centred))
    )
    values = tape.array("values", (count, m + m * (m + 1) // 2))
    sizes = {"sum_mean": (m,), "sum_slope": (n, m), "sum_square": (m * (m + 1) // 2,)}
    mean, slope, square = (tape.array(name, size) for name, size in sizes.items())
    for array in (mean, slope, square):
        array.store(np.zeros(array.shape))
    with tape.loop(count) as p:
        values.store(at(points[p]), p)
    first = values[0][:m]
    with tape.loop(count) as p:
        y = values[p][:m]
        for k, period in map.period:
            y[k] = around(y[k], first[k], period)
            values.store(y[k], p, k)
        mean.store(mean.all + (y - first) * weight[p])
    h = first + mean.all
    with tape.loop(count) as p:
        deviation = values[p][:m] - h
        scaled = deviation * centred[p]
        slope.store(slope.all + np.outer(points[p][:n], scaled))
        products = lower_of(np.outer(scaled, deviation))
        square.store(square.all + (products + values[p][m:] * weight[p]))
    return h, slope.all, square.all


def _alike(row: Sequence[Number]) -> bool:
    name = [value.name if type(value) is Scalar else value for value in row]
    return all(one == name[0] for one in name)


def moment_rates(
    tape: Tape, rule: PointRule, system: Any, p: Values
) -> Callable[[Scalar, Sequence[Any]], Sequence[Any]]:
    """Rates of mean and covariance by points, ``f(t, components) -> components``."""
    n = system.state_size

    def rates(t: Scalar, z: Sequence[Any]) -> list[Any]:
        mean, cov = unpacked(stacked(z), n)
        given = t, mean, cov, p, False, cholesky(tape, cov)
        b, cross, _ = _point_moments(tape, rule, system.drift_map, *given)
        spread = _point_moments(tape, rule, system.spread_map, *given)[0]
        return [*b, *(lower_of(cross + cross.T) + spread)]

    return rates


def correct(
    step: Program,
    mean: np.ndarray,
    cov: np.ndarray,
    moments: Any,
    sensor: StochasticMap,
    rows: int | None = None,
) -> tuple[np.ndarray, np.ndarray, Number, np.ndarray]:
    """Correct the leading rows by a measurement of which components may be missing (NaN).

    A missing component has a zero innovation and a unit pivot, which leaves it out exactly. A
    component that those before it determine has the gain zero; one whose variance given them is
    clearly negative gives NaN. Where the noise is lost beside a variance the filter's arrays have
    it apart: the step is left to them.

    Returns
    -------
    mean, cov : ndarray, shapes (rows,) and (rows, rows)
    loglik : Scalar
    filled : ndarray, shape (m,)
        The measurement, missing components replaced by their predictions.
    """
    (predicted, cross, spread), y = moments, step.y.copy()
    m, rows = len(y), len(mean) if rows is None else rows
    for k, period in sensor.period:
        y[k] = around(y[k], predicted[k], period)
    observed = ~isnan(y)
    innovation = list(choose(observed, y - predicted, 0.0))
    cross = choose(observed, cross[:rows], 0.0).tolist()
    spread = [
        [choose(observed[i] & observed[j], spread[i, j], float(i == j)) for j in range(i + 1)]
        for i in range(m)
    ]
    regular = []

    def reciprocal(pivot: Number, variance: Number) -> tuple[Number, Number]:
        least = ABSOLUTE if pivot is variance else RELATIVE * variance + ABSOLUTE
        regular.append(pivot > least)
        redundant = choose(pivot >= -(INDEFINITE * variance + ABSOLUTE), 0.0, np.nan)
        return choose(regular[-1], 1.0 / pivot, redundant), choose(regular[-1], pivot, 1.0)

    mean, lower = list(mean[:rows]), [list(cov[k, : k + 1]) for k in range(rows)]
    terms, pivots = eliminate(mean, lower, innovation, cross, spread, reciprocal)
    if np.any(sensor.noise.cov):
        step.defer(any_of([lower[k][k] < WIDE * cov[k, k] for k in range(rows)]))
    counted = [choose(a & b, 1.0, 0.0) for a, b in zip(observed, regular, strict=True)]
    terms += [*map(np.log, pivots), reduce(add, counted) * LOG_2PI]
    cov = symmetric(stacked([e for row in lower for e in row]), rows)
    return stacked(mean), cov, -0.5 * reduce(add, terms), choose(observed, y, predicted)


def unpacked(components: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance from the components of both."""
    return components[:n], symmetric(components[n:], n)
