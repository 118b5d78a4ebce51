"""What the references are made of: 60 digits, normal distributions, integrals, small matrices, a
record.

Nothing here or in the families uses the library: only mpmath, and formulas from the definitions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import mpmath as mp

DIGITS = 60
STEP = mp.mpf(2) ** -60
"""Relative change of an argument by which a condition number is found."""

FAMILIES: dict[str, Family] = {}


class Value(NamedTuple):
    """A number and what its error is relative to."""

    number: Any
    scale: Any


class Family(NamedTuple):
    """Function of a case's arguments, which gives named values, and where its numbers come from.

    `sensitive` says whether the condition number is computed, which costs a run for each argument.
    """

    values: Callable[..., dict]
    provenance: str
    sensitive: bool


def family(name, provenance, sensitive=True):
    """Decorator that enters a function as a family."""

    def enter(values):
        FAMILIES[name] = Family(values, provenance, sensitive)
        return values

    return enter


def relative(number, *others):
    """A number whose error is relative to the largest of it and others."""
    return Value(number, max(abs(part) for part in (number, *others)))


def density(z):
    """Standard normal density."""
    return mp.exp(-z * z / 2) / mp.sqrt(2 * mp.pi)


def below(z):
    """Standard normal distribution function, relative digits in both tails."""
    return mp.erfc(-z / mp.sqrt(2)) / 2


def integral(f, points):
    """Integral over the intervals between points, checked to 30 digits of the whole."""
    points = sorted(set(points))
    middles = [(a + b) / 2 for a, b in pairwise(points) if not mp.isinf(b)]
    size = max(abs(f(middle)) for middle in middles)  # mpmath judges the error by one
    method = "tanh-sinh" if mp.isinf(points[-1]) else "gauss-legendre"
    total, doubt = mp.quad(lambda u: f(u) / size, points, error=True, method=method)
    assert doubt <= mp.mpf(10) ** -30 * abs(total), (doubt, total)
    return total * size


def about(centre, spread, *kinks):
    """Ends and divisions of an integral against N(centre, spread²), dense about kinks.

    A kink is a place and a width.
    """
    ends = centre - 17 * spread, centre + 17 * spread
    marks = [centre + k * spread for k in (-6, -2, 0, 2, 6)]
    for place, width in kinks:
        marks += [place + sign * width * k for k in (0, 1, 4, 16, 64) for sign in (-1, 1)]
    return [*ends, *(mark for mark in marks if ends[0] < mark < ends[1])]


def matrix(rows):
    """Matrix of nested sequences, or of a number."""
    return mp.matrix(rows) if isinstance(rows, Sequence) else mp.matrix([[rows]])


def column(entries):
    """Column of a sequence."""
    return mp.matrix([[entry] for entry in entries])


def dist_values(mean, cov, prefix=""):
    """Mean and covariance: means relative to their deviations at least, covariances to theirs.

    Where nothing is unknown the errors are absolute.
    """
    n, found = len(mean), {}
    root = [mp.sqrt(abs(cov[i, i])) if abs(cov[i, i]) > 1e-80 else 1 for i in range(n)]
    for i in range(n):
        found[f"{prefix}mean {i}"] = relative(mean[i], root[i])
    for i in range(n):
        for j in range(i + 1):
            found[f"{prefix}cov {i}{j}"] = Value(cov[i, j], root[i] * root[j])
    return found


def pairings(order, cov):
    """Central moment of components (with repetitions) of a Gaussian vector: Isserlis' sum."""
    if not order:
        return mp.mpf(1)
    if len(order) % 2:
        return mp.mpf(0)
    first, *rest = order
    return sum(
        cov[first, other] * pairings(rest[:k] + rest[k + 1 :], cov)
        for k, other in enumerate(rest)
        if cov[first, other] != 0
    )


def moment(powers, mean, cov):
    """E of the product of components to given powers, expanded about the mean."""
    axes = [i for i, power in enumerate(powers) for _ in range(power)]
    total = mp.mpf(0)
    for mask in range(2 ** len(axes)):
        moved = [axis for k, axis in enumerate(axes) if mask >> k & 1]
        if len(moved) % 2 == 0:
            still = mp.fprod(mean[axis] for k, axis in enumerate(axes) if not mask >> k & 1)
            total += still * pairings(moved, cov) if still else 0
    return total
