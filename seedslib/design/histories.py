"""Classes of histories of what has arrived: few, and those of one class have errors alike.

What arrives is independent of state and noise: given the history of what arrived, the distribution
of state and filter is that of a design with this history for a schedule, whatever the
probabilities are. So a design waits for none. After a measurement each class of histories goes on
with every pattern of the next one; patterns after which the errors have almost one covariance are
put into one class, in their proportions. A class is a discrete part of the memory as a decided
mode is, and functions fitted to it are the best that class and memory allow, however coarse the
classes are.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.checks import outside
from seedslib.base.clock import when
from seedslib.designed.arrivals import uncertain

ALIKE = 0.04
"""Histories are of one class where the variances of their errors differ by less than this part."""

STRICT = 10.0
"""By so much less where a silence lasted longer in one than in the other."""

BURST = 2
"""Changes of the pattern in a silence and its end: such histories have the best classes."""

MOST = 64
"""Most classes at a step; with more, what differs by more than `ALIKE` is of one class."""

FAR = 0.2
"""A difference that is worth a warning: of deviations it is half as large."""

LOOSE = 4
"""Most components that may be missing: each doubles the number of patterns."""


class Classes(NamedTuple):
    """Classes of histories after a measurement.

    Attributes
    ----------
    table : ndarray of int, shape (classes before, patterns)
    members : tuple of tuple of (class before, pattern)
        What each class is made of; the first is its representative.
    prob : ndarray, shape (classes,)
    changes, run : ndarray of int, shape (classes,)
        How often the representative's pattern has changed, and how long the last one has lasted.
    tolerance : float
        How far histories may be from the representative.
    """

    table: np.ndarray
    members: tuple[tuple[tuple[int, int], ...], ...]
    prob: np.ndarray
    changes: np.ndarray
    run: np.ndarray
    tolerance: float


class Histories:
    """Classes of histories along a design.

    Parameters
    ----------
    rates : ndarray, shape (m,)
        Probabilities that the components arrive.

    Attributes
    ----------
    classes : Classes or None
        Those after the last measurement; None before the first.
    prob : ndarray, shape (classes,)
        Their probabilities; one before the first measurement.

    Raises
    ------
    ValueError
        Too many components that may be missing.
    """

    def __init__(self, rates: np.ndarray) -> None:
        self.count = 2 ** len(uncertain(rates))
        if self.count > 2**LOOSE:
            raise ValueError(
                f"availability: wanted at most {LOOSE} components that may be missing, for "
                f"{2**LOOSE} patterns, got {len(uncertain(rates))}"
            )
        self.classes: Any = None
        self.prob: np.ndarray = np.ones(1)
        self._coarsest = 0.0

    def take(self, t: float, moments: dict[Any, np.ndarray], prob: dict[Any, float]) -> Classes:
        """Classes after the measurement at t, from second moments and probabilities of the cells.

        A cell is a class before it and the number of a pattern. Warns where the classes are few.
        """
        classes = classes_of(self.classes, moments, prob, len(self.prob), self.count)
        if classes.tolerance > FAR >= self._coarsest:
            warnings.warn(
                f"availability: {len(classes.prob)} classes of histories are few at time "
                f"{when(t)}, and some hold histories whose deviations differ by "
                f"{classes.tolerance / 2:.0%}",
                stacklevel=outside(),
            )
        self._coarsest = max(self._coarsest, classes.tolerance)
        self.classes, self.prob = classes, classes.prob
        return classes


def certain(schedule: Any) -> tuple[np.ndarray, np.ndarray | None]:
    """Components that may be measured, (K+1, m), and their probabilities, None where all are sure.

    What never arrives is not measured.
    """
    mask, rates = schedule
    if rates is None:
        return mask.copy(), None
    return mask & (rates > 0.0), rates.copy() if len(uncertain(rates)) else None


def patterns(read: np.ndarray, availability: np.ndarray) -> Iterator[tuple[int, Any, float]]:
    """Numbers, components (m,) and probabilities of what may arrive of those that are read."""
    may = uncertain(availability)
    for bits in product((False, True), repeat=len(may)):
        arrived = read & (availability > 0.0)
        bits = np.array(bits[::-1], dtype=bool)
        if (bits & ~arrived[may]).any():
            continue
        possible, rate = arrived[may], availability[may]
        chance = np.where(bits, rate, 1.0 - rate)
        arrived[may] = bits
        yield int(bits @ 2 ** np.arange(len(bits))), arrived, float(np.prod(chance[possible]))


def classes_of(
    old: Classes | None,
    moments: dict[Any, np.ndarray],
    prob: dict[Any, float],
    before: int,
    patterns: int,
) -> Classes:
    """Classes of the cells (class before, pattern), the most probable first.

    One cell after another goes into the class with the nearest covariance, if that is near
    enough, or begins a new one. Histories of a single gap come first, for long gaps should be
    known well though they are rare, then the more probable ones, which have a larger tolerance
    where there would be too many classes. A gap that goes on changes the errors a little at each
    step: it must not stay in its class, unless that hardly matters.
    """
    changes, length = {}, {}
    for c, number in prob:
        last = patterns - 1 if old is None else old.members[c][0][1]
        same = number == last
        changes[c, number] = (0 if old is None else int(old.changes[c])) + (not same)
        # everything has arrived: errors come from the noise, not from the time that it took
        steps = 1 + (int(old.run[c]) if old is not None and same else 0)
        length[c, number] = number + patterns * steps * (number != patterns - 1)
    cells = sorted(prob, key=lambda cell: (changes[cell] > BURST, -prob[cell]))
    covs = np.stack([moments[cell] for cell in cells])
    distance = distances(covs, covs)
    label, several = (np.array([part[cell] for cell in cells]) for part in (length, changes))
    distance[label[:, None] != label] *= STRICT
    first, members = [], []  # cell that begins a class, and class of each cell
    tolerance = ALIKE
    while not first or len(first) > MOST:
        limit = np.where(several <= BURST, np.maximum(ALIKE, tolerance / STRICT), tolerance)
        first, members = [], []
        for i, row in enumerate(distance):
            if not first or row[first].min() > limit[i]:
                first.append(i)
            members.append(int(np.argmin(row[first])))
        tolerance *= 1.25
    class_of = dict(zip(cells, members, strict=True))
    table = np.zeros((before, patterns), dtype=int)
    for c, number in np.ndindex(before, patterns):
        # a component that is not read now does not count
        table[c, number] = class_of[max(x for x in cells if x[0] == c and x[1] & ~number == 0)]
    chance = np.bincount(members, weights=[prob[cell] for cell in cells])
    order = np.argsort(-chance, kind="stable")
    chosen = [first[j] for j in order]
    return Classes(
        np.argsort(order)[table],
        tuple(tuple(x for x in cells if class_of[x] == j) for j in order),
        chance[order],
        several[chosen],
        label[chosen] // patterns,
        tolerance / 1.25,
    )


def distances(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """How far covariances (a, n, n) are from others (b, n, n), shape (a, b).

    The largest |log r| of the ratios r of the variances of any linear function under the two: it
    does not depend on the basis. What is below 1e-9 of their mean covariance is not compared.
    """
    mean = np.concatenate([one, other]).mean(axis=0)
    scale = np.sqrt(np.diagonal(mean))
    scale = np.outer(scale, scale)
    scale[scale == 0.0] = 1.0
    floor = 1e-9 * np.eye(len(mean))
    one, other = one / scale + floor, other / scale + floor
    root = np.linalg.cholesky(other)
    half = np.linalg.solve(root[None], one[:, None])
    ratio = np.linalg.solve(root[None], np.swapaxes(half, -1, -2))
    ratio = (ratio + np.swapaxes(ratio, -1, -2)) / 2.0
    values = np.linalg.eigvalsh(ratio)
    return np.abs(np.log(np.maximum(values, 1e-12))).max(axis=-1)


def shares(members: tuple[tuple[int, int], ...], prob: dict[Any, float]) -> np.ndarray:
    """Parts of a class that its members are; they sum to one."""
    chances = np.array([prob[cell] for cell in members])
    return chances / chances.sum()
