"""Classes of histories of what has arrived: few, and those of one class have errors alike.

What arrives is independent of state and noise: given the history of what arrived, the law of state
and filter is that of a design with this history for a schedule, whatever the probabilities are. So
a design waits for none. After a measurement each class of histories goes on with every pattern of
the next one; patterns after which the errors have almost one covariance are put into one class, in
their proportions. A class is a letter of the memory as a decided mode is, and functions fitted to
it are the best that class and memory allow, however coarse the classes are.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.checks import outside
from seedslib.base.clock import when
from seedslib.designed.arrivals import Arrivals
from seedslib.designed.patterns import distances, loose

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
    """Classes of histories along a design, and what a filter keeps of them.

    Parameters
    ----------
    rates : ndarray, shape (m,)
        Probabilities that the components arrive.
    size : int
        Of an estimate.

    Attributes
    ----------
    loose : ndarray of int
        Numbers of the components that may be missing.
    classes : Classes or None
        Those after the last measurement; None before the first.
    prob : ndarray, shape (classes,)
        Their probabilities; one before the first measurement.
    arrivals : list of Arrivals
        Of the measurements that were `noted`.
    most : int or None
        Most classes, where it is less than `MOST`.

    Raises
    ------
    ValueError
        Too many components that may be missing.
    """

    def __init__(self, rates: np.ndarray, size: int) -> None:
        self.loose: np.ndarray = few_patterns(rates)
        self.classes: Any = None
        self.prob: np.ndarray = np.ones(1)
        self.arrivals: list[Arrivals] = []
        self.most: int | None = None
        self._covs: np.ndarray = np.zeros((1, size, size))
        self._farthest: float = 0.0

    def take(self, t: float, moments: dict[Any, np.ndarray], prob: dict[Any, float]) -> Classes:
        """Classes after the measurement at t, from second moments and probabilities of the cells.

        A cell is a class before it and the number of a pattern. Warns where the classes are few.
        """
        count = 2 ** len(self.loose)
        found = classes_of(self.classes, moments, prob, len(self.prob), count, self.most)
        self._farthest = coarseness(found, t, self._farthest)
        self.classes, self.prob = found, found.prob
        return found

    def noted(
        self, moments: dict[Any, np.ndarray], prob: dict[Any, float],
        claimed: dict[Any, np.ndarray] | None = None,
    ) -> None:  # fmt: skip
        """Add what a filter keeps of the classes that were taken last; arguments as `take`.

        `claimed` are the variances (n,) that a filter claims in the cells, unless these are its
        errors' own.
        """
        claimed = claimed or {cell: np.diagonal(part) for cell, part in moments.items()}
        self.arrivals.append(arrivals_of(self.classes, moments, prob, claimed, self._covs))
        self._covs = self.arrivals[-1].after


def few_patterns(availability: np.ndarray) -> np.ndarray:
    """Numbers of the components that may be missing, refused where they are many.

    Raises
    ------
    ValueError
        More than `LOOSE`.
    """
    found = loose(availability)
    if len(found) > LOOSE:
        raise ValueError(
            f"availability: wanted at most {LOOSE} components that may be missing, for "
            f"{2**LOOSE} patterns, got {len(found)}"
        )
    return found


def keep_indicators(memory: Any, read: np.ndarray, rates: np.ndarray | None) -> None:
    """Refuse that an indicator, the last component, is missing where the memory keeps it.

    Raises
    ------
    ValueError
        It may be.
    """
    for name, sure in (
        ("measured", read[:, -1].all()), ("availability", rates is None or rates[-1] == 1.0)
    ):  # fmt: skip
        if memory.indicators and not sure:
            raise ValueError(f"{name}: wanted every indicator that the memory keeps")


def patterns(read: np.ndarray, availability: np.ndarray) -> Iterator[tuple[int, Any, float]]:
    """Numbers, components (m,) and probabilities of what may arrive of those that are read."""
    may = loose(availability)
    for bits in product((False, True), repeat=len(may)):
        there = read & (availability > 0.0)
        bits = np.array(bits[::-1], dtype=bool)
        if (bits & ~there[may]).any():
            continue
        here, rate = there[may], availability[may]
        chance = np.where(bits, rate, 1.0 - rate)
        there[may] = bits
        yield int(bits @ 2 ** np.arange(len(bits))), there, float(np.prod(chance[here]))


def coarseness(classes: Classes, t: float, before: float) -> float:
    """How far histories of a class have been apart, with a warning where that is far at last."""
    if classes.tolerance > FAR >= before:
        warnings.warn(
            f"availability: {len(classes.prob)} classes of histories are few at time {when(t)}, "
            f"and some hold histories whose deviations differ by {classes.tolerance / 2:.0%}",
            stacklevel=outside(),
        )
    return max(before, classes.tolerance)


def classes_of(
    old: Classes | None, moments: dict[Any, np.ndarray], prob: dict[Any, float], before: int,
    patterns: int, most: int | None = None,
) -> Classes:  # fmt: skip
    """Classes of the cells (class before, pattern), the most probable first.

    A net over the covariances: one cell after another goes into the nearest class that is near
    enough, or begins a new one. Those of a single silence come first, for long ones should be
    known well though they are rare, then the more probable ones, which make do with less where
    there would be too many classes. A silence that goes on changes a little at each step: it must
    not end in the class that it was in, unless that hardly matters.
    """
    changes, run = {}, {}
    for c, number in prob:
        last = patterns - 1 if old is None else old.members[c][0][1]
        same = number == last
        changes[c, number] = (0 if old is None else int(old.changes[c])) + (not same)
        # everything has arrived: errors come from the noise, not from the time that it took
        lasts = 1 + (int(old.run[c]) if old is not None and same else 0)
        run[c, number] = number + patterns * lasts * (number != patterns - 1)
    cells = sorted(prob, key=lambda cell: (changes[cell] > BURST, -prob[cell]))
    stack = np.stack([moments[cell] for cell in cells])
    apart = distances(stack, stack)
    label, several = (np.array([part[cell] for cell in cells]) for part in (run, changes))
    apart[label[:, None] != label] *= STRICT
    most = MOST if most is None else min(most, MOST)
    tolerance, kept, home = ALIKE, [], []
    while not kept or len(kept) > most:
        limit = np.where(several <= BURST, np.maximum(ALIKE, tolerance / STRICT), tolerance)
        kept, home = [], []
        for i, near in enumerate(apart):
            if not kept or near[kept].min() > limit[i]:
                kept.append(i)
            home.append(int(np.argmin(near[kept])))
        tolerance *= 1.25
    place = dict(zip(cells, home, strict=True))
    table = np.zeros((before, patterns), dtype=int)
    for c in range(before):
        for number in range(patterns):
            # a component that is not read now does not count
            table[c, number] = place[max(x for x in cells if x[0] == c and x[1] & ~number == 0)]
    chance = np.bincount(home, weights=[prob[cell] for cell in cells])
    order = np.argsort(-chance, kind="stable")
    chosen = [kept[j] for j in order]
    members = tuple(tuple(x for x in cells if place[x] == j) for j in order)
    return Classes(
        np.argsort(order)[table], members, chance[order],
        several[chosen], label[chosen] // patterns, tolerance / 1.25,
    )  # fmt: skip


def shares(members: Any, prob: dict[Any, float]) -> np.ndarray:
    """Parts of a class that its members are; they sum to one."""
    found = np.array([prob[cell] for cell in members])
    return found / found.sum()


def arrivals_of(
    classes: Classes, moments: dict[Any, np.ndarray], prob: dict[Any, float],
    claimed: dict[Any, np.ndarray], before: np.ndarray,
) -> Arrivals:  # fmt: skip
    """What a filter keeps of the classes about a measurement; arguments as `classes_of`.

    `claimed` are variances in the cells; `before` are the covariances of the classes before it,
    (classes before, n, n).
    """
    covs = np.empty((*classes.table.shape, *before.shape[1:]))
    for c, number in np.ndindex(covs.shape[:2]):
        # a component that is not read now does not count
        covs[c, number] = moments[max(x for x in moments if x[0] == c and x[1] & ~number == 0)]
    after, told = (
        np.stack([
            np.tensordot(shares(members, prob), [part[cell] for cell in members], 1)
            for members in classes.members
        ])
        for part in (moments, claimed)
    )  # fmt: skip
    return Arrivals(classes.table, covs, before, after, classes.prob, told)
