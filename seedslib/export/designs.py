"""Programs of designed filters: finite order, tables."""

from __future__ import annotations

from functools import reduce
from operator import and_

import numpy as np

from seedslib.base.tables import Labels
from seedslib.designed.predictors import (
    CLIP,
    FLOOR,
    AffineFit,
    Continuous,
    monomial_recipe,
    range_roots,
)
from seedslib.export.kernels import correct, map_moments
from seedslib.export.tape import choose, compared, isnan
from seedslib.linearization.moments import symmetric
from seedslib.models.kinds import switches


def places(filter, k):
    """Places in the full memory of what there is after measurement k."""
    memory, n, m = filter.memory, filter.components, filter.system.measurement_size
    return np.r_[
        : n * min(k + 1, memory.estimates),
        n * memory.estimates : n * memory.estimates + m * min(k + 1, memory.measurements),
    ]


def spread(values, where, size):
    found = np.zeros((*values.shape[:-1], size))
    found[..., where] = values
    return found


def finite_order(step):
    filter, k, t = step.filter, *step.begin()
    fits, order, start = filter.fits, filter.order, filter.start
    memory = step.array("memory", (order,), owner="state")
    shown = step.array("shown", (step.m,), owner="state")
    before, lost = step.gaps(step.any_missing())
    work = {
        name: step.array(name, shape)
        for name, shape in (
            ("z", (step.rows,)),
            ("P", (step.rows, step.rows)),
            ("l", (1,)),
            ("v", (step.m,)),
        )
    }

    def put(mean, cov, loglik, seen):
        for array, value in zip(work.values(), (mean, cov, np.array([loglik]), seen), strict=True):
            array.store(value)

    with step.when(k < 1.0):
        mean, cov, *moments = (
            step.table(f"first_{i}", part).all
            for i, part in enumerate([start.mean, start.cov, *start.moments])
        )
        put(*correct(mean, cov, step.y, moments, step.rows, filter.rules.periods))
    with step.when(k >= 1.0):
        row, u = k - 1.0, memory.all
        if isinstance(filter.predictor, Continuous):
            u = course(step, row, u)
        if type(fits[0]) is AffineFit:
            gain = step.table(
                "gain", [spread(f.gain, places(filter, i), order) for i, f in enumerate(fits)]
            )
            mean = gain[row] @ u + step.table("offset", [f.offset for f in fits])[row]
            cov = step.table("forecast_cov", [f.cov for f in fits])[row]
        else:
            mean, cov = polynomial(step, row, u)
        moments = map_moments(step, filter.linearization, filter.system.sensor, t, mean, cov)
        put(*correct(mean, cov, step.y, moments, step.rows, filter.rules.periods))
    z, P, l, v = (array.all for array in work.values())
    step.mean.store(z)
    step.cov.store(choose(lost, np.nan, P))
    step.loglik.store(choose(before, np.nan, l[0]))
    step.push(memory, z, v)
    shown.store(v)
    step.end(k)


def course(step, row, z):
    """The estimate after the Euler steps of the continuous forecast up to the measurement."""
    filter, stops = step.filter, []
    for k, fits in enumerate(filter.node_fits[: len(filter.fits)]):
        grid = [filter.times[k], *filter.node_times[k], filter.times[k + 1]]
        stops += zip(grid, np.diff(grid), fits, strict=False)
    time, size = (step.table(f"course_{i}", [row[i] for row in stops]) for i in range(2))
    parts = [
        step.table(f"course_{name}", [getattr(f, name) for *_, f in stops])
        for name in AffineFit._fields
    ]
    first = step.table(
        "course_first", np.cumsum([0, *map(len, filter.node_fits[: len(filter.fits)])]), "int"
    )
    room = step.array("moving", (len(z),))
    room.store(z)
    later = (
        step.laps.all * (filter.times[-1] - filter.times[-1 - filter.cycle])
        if filter.cycle
        else 0.0
    )
    with step.loop(first[row + 1.0] - first[row]) as i:
        j, z = first[row] + i, room.all
        gain, offset, cov = (part[j] for part in parts)
        mean = gain @ z + offset
        rate = map_moments(
            step, filter.linearization, filter.system.drift_map, time[j] + later, mean, cov, False
        )[0]
        room.store(z + size[j] * rate[: len(z)])
    return room.all


def polynomial(step, row, u):
    """Mean and covariance by polynomials in the standardised memory."""
    filter, order, first = step.filter, step.filter.order, step.filter.fits[0]
    degree = max(first.mean_degree, first.cov_degree)
    powers, full, tables = _powers(order, degree), monomial_recipe(order, degree), {}
    for i, fit in enumerate(filter.fits):
        there = places(filter, i)
        into = [powers[tuple(there[list(p)])] for p in _powers(len(there), degree)]
        square = lambda part: np.pad(part, ((0, 0), (0, len(part) - part.shape[1])))
        for name, part in (
            ("centre", spread(fit.centre, there, order)),
            ("scale", spread(fit.scale, there, order)),
            ("gain", spread(fit.gain, into[: fit.gain.shape[1]], len(full))),
            ("offset", fit.offset),
            ("cov_gain", spread(fit.cov_gain, into[: fit.cov_gain.shape[1]], len(full))),
            ("cov_offset", fit.cov_offset),
            ("residual", fit.residual),
            *zip(("root", "back"), map(square, range_roots(fit.residual)), strict=True),
        ):
            tables.setdefault(name, []).append(part)
    centre, scale, gain, offset, cov_gain, cov_offset, residual, root, back = (
        step.table(name, part)[row] for name, part in tables.items()
    )
    point = [
        np.minimum(np.maximum((a - c) * s, -CLIP), CLIP)
        for a, c, s in zip(u, centre, scale, strict=True)
    ]
    power = []
    for factor, lower in full:
        power.append(point[factor] if lower is None else point[factor] * power[lower])
    power, own = np.array(power, dtype=object), len(monomial_recipe(order, first.mean_degree))
    mean = gain[:, :own] @ power[:own] + offset
    if not first.cov_degree:
        return mean, residual
    own = len(monomial_recipe(order, first.cov_degree))
    cov = symmetric(cov_gain[:, :own] @ power[:own] + cov_offset, step.n)
    return mean, floored(step, back.T @ cov @ back, root)


def floored(step, relative, root):
    """root V max(d, floor) V' root' of a symmetric matrix V d V', by rotations of Jacobi."""
    n = step.n
    inner, axes = step.array("inner", (n, n)), step.array("axes", (n, n))
    inner.store(relative)
    axes.store(np.eye(n))
    with step.loop({1: 0.0, 2: 1.0}.get(n, 5.0 + n)):
        a, v = inner.all, axes.all
        for p, q in zip(*np.tril_indices(n, -1), strict=True):
            turn = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
            tangent = choose(turn >= 0.0, 1.0, -1.0) / (abs(turn) + np.sqrt(turn * turn + 1.0))
            tangent = choose(compared(a[p, q], "==", 0.0), 0.0, tangent)
            c = 1.0 / np.sqrt(tangent * tangent + 1.0)
            turned = np.array([[c, tangent * c], [-(tangent * c), c]], dtype=object)
            a, v = a.copy(), v.copy()
            a[:, [p, q]] = a[:, [p, q]] @ turned
            a[[p, q]] = turned.T @ a[[p, q]]
            v[:, [p, q]] = v[:, [p, q]] @ turned
        inner.store(a)
        axes.store(v)
    lengths = [np.sqrt(np.maximum(d, FLOOR)) for d in np.diagonal(inner.all)]
    bent = (root @ axes.all) * np.array(lengths, dtype=object)
    return bent @ bent.T


def _powers(size, degree):
    found = []
    for factor, lower in monomial_recipe(size, degree):
        found.append((() if lower is None else found[lower]) + (factor,))
    return {powers: number for number, powers in enumerate(found)}


def table(step):
    filter, k, _ = step.filter, *step.begin()
    system, block = filter.system, filter.memory
    decided, kept = step.modes and block.estimates > 0, block.indicators > 0
    lead = int(decided) + int(kept)
    size = (step.rows + lead) * block.estimates + (step.m + int(kept)) * block.measurements
    memory = step.array("memory", (max(size, 1),), owner="state")
    prob = filter.steps[0].shown.prob is not None
    found = step.array("found", (step.rows + prob * step.modes + 1,))
    missing = step.any_missing()
    all_missing = reduce(and_, isnan(step.y))
    partly = missing & ~all_missing
    step.refuse(missing if block.measurements else partly, "PARTLY")
    told = (
        [choose(step.indicator < 0.0, float(step.indicators), step.indicator)]
        if step.indicators
        else []
    )
    if kept:
        step.refuse(step.indicator < 0.0, "PARTLY")
    for name, which, y in (("blind", missing, ()), ("shown", None, step.y)):
        tables = [getattr(s, name) for s in filter.steps]
        with step.when(which if which is not None else ~missing):
            points = [*told, *y, *memory.all[:size]]
            values, nearest = lookup(step, name, k, tables, points, len(told) + len(y), prob)
            found.store([*values, nearest])
    *values, mode = found.all
    step.mean.store(values[: step.rows])
    cov = step.table("known_cov", filter.covariances)[k]
    lost = missing if not step.indicators else missing | (step.indicator < 0.0)
    step.cov.store(choose(step.gaps(lost)[1], np.nan, cov))
    step.loglik.store(np.nan)
    if step.modes:
        step.array("mode", (), "int", "state").store(mode)
        if prob:
            step.array("prob", (step.modes,), owner="state").store(values[step.rows :])
    if size:
        step.push(
            memory,
            values[: step.rows],
            step.y,
            [*([mode] if decided else []), *([step.indicator] if kept else [])],
        )
    step.end(k)


def lookup(step, name, k, tables, points, lead, prob):
    """Multilinear interpolation in the table of measurement k; axes not yet there have one node."""
    size, rows, flat, starts, modes = len(points), [], [], [], []
    for i, one in enumerate(tables):
        axes = list(one.axes)
        rows.append(
            [
                (a.count, 0.0, 0.0) if isinstance(a, Labels) else (a.count, a.low, 1.0 / a.step)
                for a in axes
            ]
            + [(1, 0.0, 0.0)] * (size - len(axes))
        )
        where = _axes_of(step.filter, i, lead, size, len(axes))
        rows[-1] = [rows[-1][w] if w is not None else (1, 0.0, 0.0) for w in where]
        starts.append(sum(map(len, flat)))
        values = one.estimate if not prob else np.concatenate([one.estimate, one.prob])
        flat.append(values.reshape(len(values), -1).T.ravel())
        modes.append(np.zeros(0, int) if one.mode is None else np.ravel(one.mode))
    count, low, scale = (
        step.table(f"{name}_{word}", np.array(rows)[:, :, j], "int" if j == 0 else "real")[k]
        for j, word in enumerate(("count", "low", "scale"))
    )
    width = len(values)
    index, corners, shares, near = 0.0, [0.0], [], 0.0
    kinds = [
        any(not isinstance(t.axes[w], Labels) for t, w in pairs)
        for pairs in _each_axis(step.filter, tables, lead, size)
    ]
    for j, point in enumerate(points):
        if not kinds[j]:
            part = choose(count[j] > 1.0, point, 0.0)
            index, near = index * count[j] + part, near * count[j] + part
            corners = [c * count[j] for c in corners]
            continue
        top = count[j] - 1.0
        place = np.minimum(np.maximum((point - low[j]) * scale[j], 0.0), top)
        place = choose(count[j] > 1.0, place, 0.0)
        below = np.minimum(np.floor(place), np.maximum(top - 1.0, 0.0))
        share = place - below
        index, near = (
            index * count[j] + below,
            near * count[j] + below + choose(share > 0.5, 1.0, 0.0),
        )
        up = choose(count[j] > 1.0, 1.0, 0.0)
        corners = [c * count[j] + u for c in corners for u in (0.0, up)]
        shares.append(share)
    start = step.table(f"{name}_start", starts, "int")[k]
    values = step.table(f"{name}_values", np.concatenate(flat))
    found = []
    for r in range(width):
        level = [values[start + (index + c) * float(width) + float(r)] for c in corners]
        for share in reversed(shares):
            level = [a + share * (b - a) for a, b in zip(level[::2], level[1::2], strict=True)]
        found.append(level[0])
    if not step.modes or not sum(map(len, modes)):
        return found, 0.0
    first = step.table(f"{name}_mode_start", np.cumsum([0, *map(len, modes)])[:-1], "int")[k]
    return found, step.table(f"{name}_mode", np.concatenate(modes), "int")[first + near]


def _axes_of(filter, k, lead, size, used):
    """For each argument of the full function the axis of the table of measurement k, or None."""
    block, n = filter.memory, filter.components
    extra = (1 if switches(filter.system) and block.estimates else 0) + (
        1 if block.indicators else 0
    )
    one = n + extra if block.estimates else 0
    two = (
        filter.system.measurement_size + (extra if not block.estimates else 0)
        if block.measurements
        else 0
    )
    held, seen = min(k, block.estimates), min(k, block.measurements)
    where = list(range(lead)) + [
        lead + i if i < held * one else None for i in range(block.estimates * one)
    ]
    start = lead + held * one
    return where + [start + i if i < seen * two else None for i in range(block.measurements * two)]


def _each_axis(filter, tables, lead, size):
    columns = [_axes_of(filter, i, lead, size, len(t.axes)) for i, t in enumerate(tables)]
    return [
        [(t, c[j]) for t, c in zip(tables, columns, strict=True) if c[j] is not None]
        for j in range(size)
    ]
