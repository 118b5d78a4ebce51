"""Rules with few points on a tape: what a point leaves at zero costs nothing."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from seedslib.extra.c.tape import Number, Scalar, Tape
from seedslib.linearization.points import PointRule
from seedslib.models.codegen import compile_components
from seedslib.models.maps import StochasticMap

MOST = 300
"""Products of points and numbers at each, up to which they are written one after another."""


def point_space(map: StochasticMap) -> tuple[Any, Any, Any]:
    """What is evaluated at a point: its mean there, its covariance, and the noise points cover."""
    try:
        mean, cov, _ = map.conditional_expressions
    except ValueError:
        return map.expressions, np.zeros((map.size, map.size), dtype=object), map.noise
    return mean, cov, None


def few_points(rule: PointRule, map: StochasticMap) -> bool:
    """Whether a map's moments are short enough to be written without loops."""
    noise = point_space(map)[2]
    size = map.state_size + (0 if noise is None else noise.size)
    return len(rule.rule(size)[1]) * (map.state_size + map.size) <= MOST


def unrolled_factor(tape: Tape, lower: Sequence[Any], n: int) -> list[list[Number]]:
    """Triangular factor of a covariance, by the lines of `seedslib.base.linalg.cholesky`."""
    entries = iter(lower)
    rest = [[next(entries) for _ in range(k + 1)] for k in range(n)]
    variances = [rest[k][k] for k in range(n)]
    relative, absolute, indefinite = map(tape.macro, ("RELATIVE", "ABSOLUTE", "INDEFINITE"))
    for j in range(n):
        pivot, variance = rest[j][j], np.abs(variances[j])
        regular = tape.infix(pivot, ">", relative * variance + absolute)
        zero = tape.node("{0} >= {1} ? 0.0 : (double)NAN", pivot, -(indefinite * variance))
        root = tape.choose(regular, np.sqrt(pivot), zero)
        inverse = tape.choose(regular, 1.0 / root, zero)
        rest[j][j] = root
        for k in range(j + 1, n):
            rest[k][j] = rest[k][j] * inverse
            for q in range(j + 1, k + 1):
                rest[k][q] = rest[k][q] - rest[k][j] * rest[q][j]
    return rest


def unrolled_moments(
    tape: Tape,
    rule: PointRule,
    map: StochasticMap,
    mean: Sequence[Any],
    lower: Sequence[Any],
    spread: bool,
) -> tuple[Any, ...]:
    """E y, cov(x, y) and cov y of a symbolic map, recorded; the last None without `spread`."""
    n, m = map.state_size, map.size
    values, cov, noise = point_space(map)
    unit, weight, square = rule.rule(n + (0 if noise is None else noise.size))
    root, t = unrolled_factor(tape, lower, n), tape.inputs("t")[()]
    given, covers = [map.time, tuple(map.state)], np.empty((0, len(weight)))
    if noise is not None:
        given.append(tuple(noise.symbols))
        covers = noise.mean[:, None] + noise.root @ unit[n:]
    flat = [cov[i, j] for i in range(m) for j in range(i + 1)]
    evaluate = compile_components(tuple(given), [*values, *flat])
    y, given_cov = [], []
    for unit_p, cover in zip(unit[:n].T, covers.T, strict=True):
        x = [
            mean[i] + _sum(root[i][j] * u for j, u in enumerate(unit_p[: i + 1]) if u)
            for i in range(n)
        ]
        found = evaluate(t, x, *([cover.tolist()] if noise is not None else []))
        y.append(found[:m])
        given_cov.append(found[m:])
    for k, period in map.period:
        for row in y[1:]:
            row[k] = row[k] - period * np.floor((row[k] - y[0][k]) / period + 0.5)
    h = [
        y[0][i] + _sum((row[i] - y[0][i]) * w for row, w in zip(y, weight, strict=True) if w)
        for i in range(m)
    ]
    apart = [[row[i] - h[i] for i in range(m)] for row in y]
    slope = [
        [
            _sum(u * c * a[i] for u, c, a in zip(unit[j], square, apart, strict=True) if u)
            for i in range(m)
        ]
        for j in range(n)
    ]
    cross = [
        [_sum(root[k][j] * slope[j][i] for j in range(k + 1)) for i in range(m)] for k in range(n)
    ]
    if not spread:
        return np.array(h, dtype=object), np.array(cross, dtype=object), None
    cov = np.empty((m, m), dtype=object)
    for k, (i, j) in enumerate(zip(*np.tril_indices(m), strict=True)):
        own = [row[k] for row in given_cov]
        alike = all(_name(part) == _name(own[0]) for part in own)
        own = own[0] if alike else _sum(c * w for c, w in zip(own, weight, strict=True))
        cov[i, j] = cov[j, i] = own + _sum(
            a[i] * c * a[j] for a, c in zip(apart, square, strict=True) if c
        )
    return np.array(h, dtype=object), np.array(cross, dtype=object), cov


def _name(value: Number) -> object:
    return value.name if isinstance(value, Scalar) else value


def _sum(terms: Any) -> Number:
    return reduce(add, terms, 0.0)
