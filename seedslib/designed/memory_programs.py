"""Programs of designed filters: a forecast from a memory by a table of fits, or tables alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from seedslib.base.linalg import symmetric
from seedslib.base.tables import Labels
from seedslib.designed.memory import places
from seedslib.designed.predictors import (
    CLIP,
    FLOOR,
    AffineFit,
    Continuous,
    PolynomialFit,
    monomial_recipe,
    range_roots,
)
from seedslib.designed.program import DesignedProgram
from seedslib.filters.program import any_of
from seedslib.tape.tape import Scalar, choose, isnan


def widened(values: np.ndarray, columns: Any, size: int) -> np.ndarray:
    """An array with these columns among `size` of them, which are zero elsewhere."""
    result = np.zeros((*values.shape[:-1], size))
    result[..., columns] = values
    return result


# Finite order


def finite_order(step: DesignedProgram) -> None:
    """Record a `FiniteOrderFilter`: forecast from the memory, correction, memory.

    Raises
    ------
    TypeError, ValueError
        Forecasts of another kind than affine and polynomial.
    """
    from seedslib.filters.kernels import correct, map_moments

    filter, sensor = step.filter, step.filter.system.sensor
    _check_finite_order(filter)
    k, t = step.begin()
    gap_before, gap = step.gap(k)
    past = step.past(step.rows)

    def correction(mean: np.ndarray, cov: np.ndarray, moments: Any) -> None:
        mean, after, loglik, y = correct(step, mean, cov, moments, sensor, step.rows)
        step.mean.store(mean)
        step.claim(after, loglik, gap_before, gap)
        step.push(past, mean, y)

    with step.when(k < 1.0):
        mean, cov, *moments = (
            part.astype(object) for part in (*filter.start[:2], *filter.start.moments)
        )
        correction(mean, cov, moments)
    with step.when(k >= 1.0):
        u = past["memory"].all
        if isinstance(filter.predictor, Continuous):
            u = _moved(step, k, u)
        forecast = _affine if isinstance(filter.fits[0], AffineFit) else _polynomial
        mean, cov = forecast(step, k - 1.0, u)
        given = step, filter.linearization, sensor, t, mean, cov, step.at_time()
        correction(mean, cov, map_moments(*given))
    step.end(k)


def _check_finite_order(filter: Any) -> None:
    if filter.availability is not None:
        raise ValueError("filter: wanted a design without `availability` for C")
    kinds = {type(fit) for fit in filter.fits}
    if not kinds or not kinds <= {AffineFit, PolynomialFit}:
        raise TypeError(
            "predictor: wanted affine or polynomial forecasts for at least two measurements, got "
            f"{filter.predictor}, {len(filter.fits)} forecasts"
        )


def _fits(filter: Any) -> list[tuple[np.ndarray, Any]]:
    """Each fit, and which numbers of the full memory it is a function of."""
    sizes = filter.components, filter.system.measurement_size
    return [(places(filter.memory, *sizes, k + 1), fit) for k, fit in enumerate(filter.fits)]


def _affine(step: DesignedProgram, row: Scalar, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the forecast by an affine fit."""
    fits = _fits(step.filter)
    gain = step.table("gain", [widened(fit.gain, used, len(u)) for used, fit in fits])
    offset = step.table("offset", [fit.offset for _, fit in fits])
    cov = step.table("forecast_cov", [fit.cov for _, fit in fits])
    return gain[row] @ u + offset[row], cov[row]


def _polynomial(step: DesignedProgram, row: Scalar, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the forecast by polynomials in the standardised memory."""
    fits, size = _fits(step.filter), len(u)
    degrees = fits[0][1].mean_degree, fits[0][1].cov_degree
    mean_count, cov_count = (len(monomial_recipe(size, degree)) for degree in degrees)
    number = {powers: i for i, powers in enumerate(_monomials(size, max(degrees)))}
    tables: dict[str, list[np.ndarray]] = {}
    for used, fit in fits:
        own = [tuple(used[list(powers)]) for powers in _monomials(len(used), max(degrees))]
        columns = [number[powers] for powers in own]
        roots = [
            np.pad(root, ((0, 0), (0, step.n - root.shape[1])))
            for root in range_roots(fit.residual)
        ]
        for name, values in {
            "centre": widened(fit.centre, used, size),
            "scale": widened(fit.scale, used, size),
            "gain": widened(fit.gain, columns[: fit.gain.shape[1]], mean_count),
            "offset": fit.offset,
            "cov_gain": widened(fit.cov_gain, columns[: fit.cov_gain.shape[1]], cov_count),
            "cov_offset": fit.cov_offset,
            "residual": fit.residual,
            "root": roots[0],
            "inverse_root": roots[1],
        }.items():
            tables.setdefault(name, []).append(values)

    def part(name: str) -> np.ndarray:
        return step.table(name, tables[name])[row]

    point = [
        choose(x < -CLIP, -CLIP, choose(x > CLIP, CLIP, x))
        for x in (u - part("centre")) * part("scale")
    ]
    values: list[Any] = []
    for factor, lower in monomial_recipe(size, max(degrees)):
        values.append(point[factor] if lower is None else point[factor] * values[lower])
    monomials = np.array(values, dtype=object)
    mean = part("gain") @ monomials[:mean_count] + part("offset")
    if not cov_count:
        return mean, part("residual")
    lower = part("cov_gain") @ monomials[:cov_count] + part("cov_offset")
    return mean, _bounded_below(step, symmetric(lower, step.n), part("root"), part("inverse_root"))


def _monomials(size: int, degree: int) -> list[tuple[int, ...]]:
    """The factors of each monomial of `monomial_recipe`."""
    result: list[tuple[int, ...]] = []
    for factor, lower in monomial_recipe(size, degree):
        result.append((() if lower is None else result[lower]) + (factor,))
    return result


def _bounded_below(
    step: DesignedProgram, cov: np.ndarray, root: np.ndarray, inverse_root: np.ndarray
) -> np.ndarray:
    """See `seedslib.designed.predictors.bounded_below`; eigenvalues by rotations of Jacobi."""
    n = step.n
    matrix, axes = step.array("matrix", (n, n)), step.array("axes", (n, n))
    matrix.store(inverse_root.T @ cov @ inverse_root)
    axes.store(np.eye(n))
    with step.loop({1: 0.0, 2: 1.0}.get(n, n + 5.0)):
        a, v = matrix.all, axes.all
        for p, q in zip(*np.tril_indices(n, -1), strict=True):
            turn = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
            tangent = choose(turn >= 0.0, 1.0, -1.0) / (abs(turn) + np.sqrt(turn * turn + 1.0))
            tangent = choose(a[p, q] == 0.0, 0.0, tangent)
            cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
            sine = tangent * cosine
            rotation = np.array([[cosine, sine], [-sine, cosine]], dtype=object)
            a, v = a.copy(), v.copy()
            a[:, [p, q]] = a[:, [p, q]] @ rotation
            a[[p, q]] = rotation.T @ a[[p, q]]
            v[:, [p, q]] = v[:, [p, q]] @ rotation
        matrix.store(a)
        axes.store(v)
    lengths = [np.sqrt(choose(x < FLOOR, FLOOR, x)) for x in np.diagonal(matrix.all)]
    scaled = (root @ axes.all) * np.array(lengths, dtype=object)
    return scaled @ scaled.T


def _moved(step: DesignedProgram, k: Scalar, z: np.ndarray) -> np.ndarray:
    """The estimate after Euler's steps of the continuous forecast up to measurement k."""
    from seedslib.filters.kernels import map_moments

    filter, row = step.filter, k - 1.0
    grids = [
        [start, *nodes, stop]
        for (start, stop), nodes in zip(pairwise(filter.times), filter.node_times, strict=True)
    ]
    fits = [fit for each in filter.node_fits for fit in each]
    first = step.table("first_substep", np.cumsum([0, *map(len, filter.node_fits)]), "int")
    starts, stops = (
        step.table(f"substep_{name}", [t for grid in grids for t in grid[part]], "time")
        for name, part in (("start", slice(-1)), ("stop", slice(1, None)))
    )
    gain, offset, cov = (
        step.table(f"substep_{name}", [getattr(fit, name) for fit in fits])
        for name in AffineFit._fields
    )
    later = step.moment(row) - step.times[row] if filter.cycle else 0.0
    moving = step.array("moving", (len(z),))
    moving.store(z)
    with step.loop(first[k] - first[row]) as i:
        j, z = first[row] + i, moving.all
        t, mean = starts[j] + later, gain[j] @ z + offset[j]
        drift = filter.system.drift_map
        rate, *_ = map_moments(
            step, filter.linearization, drift, t, mean, cov[j], step.since(), spread=False
        )
        moving.store(z + (stops[j] + later - t) * rate[: len(z)])
    return moving.all


# Tables


def table(step: DesignedProgram) -> None:
    """Record a `TableFilter`: estimates and modes at a measurement and a memory, looked up."""
    filter, memory = step.filter, step.filter.memory
    k, _ = step.begin()
    gaps = step.gap(k)
    missing = isnan(step.y)
    some_missing = any_of(missing)
    step.refuse(some_missing if memory.measurements else some_missing & any_of(~missing), "PARTLY")
    if memory.indicators:
        step.refuse(step.indicator < 0.0, "PARTLY")
    past = step.past(step.rows)
    numbers, remembered = list(past["memory"].all), []
    for i in range(memory.estimates + memory.measurements):  # in the order of the axes
        remembered += [past[name][i] for name in ("modes", "indicators") if name in past]
        size = step.rows if i < memory.estimates else step.m
        remembered += [numbers.pop(0) for _ in range(size)]
    sizes = step.rows + len(past) - 1, step.m + ("indicators" in past)
    first: list[Any] = []
    if step.indicators:  # the label after the last value is a missing indicator
        first = [choose(step.indicator < 0.0, float(step.indicators), step.indicator)]
    cases = [("output", ~some_missing, [*first, *step.y], [row.update for row in filter.steps])]
    if not memory.measurements:
        cases.append(("forecast", some_missing, first, [row.forecast for row in filter.steps]))
    result = step.array("result", (step.rows + (step.modes > 0),))
    for name, condition, known, tables in cases:
        used = [
            [*range(len(known)), *(len(known) + places(memory, *sizes, row))]
            for row in range(len(tables))
        ]
        with step.when(condition):
            points = [*known, *remembered]
            result.store(_looked_up(step, name, k, tables, used, points))
    mean, mode = np.split(result.all, [step.rows])
    step.mean.store(mean)
    step.claim(step.table("error_cov", filter.covariances)[k], np.nan, *gaps)
    if step.modes:
        step.array("mode", (), "int", "state").store(mode[0])
    step.push(past, mean, step.y, mode[0] if step.modes else None)
    step.end(k)


def _looked_up(
    step: DesignedProgram,
    name: str,
    k: Scalar,
    tables: Sequence[Any],
    used: Sequence[Sequence[int]],
    points: Sequence[Scalar],
) -> list[Any]:
    """Values of table k, multilinear and constant at its ends; the mode of the nearest node.

    The axes of each table are for the points that `used` lists; one that a table does not have
    has the stride zero and its only node at zero.
    """
    low, scale, last, stride = np.zeros((4, len(tables), len(points)))
    labels = np.zeros(len(points), dtype=bool)
    for row in reversed(range(len(tables))):  # low and scale are those of the first with the axis
        axes = tables[row].axes
        for i, (axis, j) in enumerate(zip(axes, used[row], strict=True)):
            stride[row, j] = math.prod(other.count for other in axes[i + 1 :])
            labels[j] = isinstance(axis, Labels)
            if not labels[j]:
                low[: row + 1, j], scale[: row + 1, j] = axis.low, 1.0 / axis.step
                last[row, j] = math.nextafter(axis.count - 1.0, 0.0)
    low, scale, last, stride = (
        _entry(step, f"{name}_{word}", values, k)
        for word, values in (("low", low), ("scale", scale), ("last", last), ("stride", stride))
    )
    counts = [math.prod(axis.count for axis in one.axes) for one in tables]
    index = _entry(step, f"{name}_start", np.cumsum([0, *counts[:-1]]), k)
    nearest, offsets, shares = 0.0, [0.0], []
    for j, point in enumerate(points):
        if labels[j]:
            index = index + point * stride[j]
            continue
        position = (choose(point > low[j], point, low[j]) - low[j]) * scale[j]
        position = choose(position < last[j], position, last[j])
        node = np.floor(position)
        shares.append(position - node)
        index = index + node * stride[j]
        nearest = nearest + choose(shares[-1] > 0.5, stride[j], 0.0)
        offsets = [offset + up for offset in offsets for up in (0.0, stride[j])]
    flat = [one.estimate.reshape(step.rows, -1).T.ravel() for one in tables]
    nodes, width = step.table(f"{name}_values", np.concatenate(flat)), step.rows
    lowest = [(index + offset) * float(width) for offset in offsets]
    corners = [np.array([nodes[at + float(r)] for r in range(width)]) for at in lowest]
    for share in reversed(shares):
        corners = [a + share * (b - a) for a, b in zip(corners[::2], corners[1::2], strict=True)]
    if not step.modes:
        return list(corners[0])
    modes = np.concatenate([np.ravel(one.mode) for one in tables])
    return [*corners[0], step.table(f"{name}_mode", modes, "int")[index + nearest]]


def _entry(step: DesignedProgram, name: str, values: np.ndarray, k: Scalar) -> Any:
    """Entry k of a table; a constant where all entries are alike."""
    same = (values == values[0]).all()
    return values[0].astype(object) if same else step.table(name, values)[k]
