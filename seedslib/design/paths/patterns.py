"""A forward pass for a sensor whose components arrive with probabilities.

What arrives is independent of state and noise: given the history of what arrived, the law of state
and filter is that of a design with this history for a schedule, whatever the probabilities are. So
none is waited for. After a measurement each class of histories goes on with every pattern of the
next one, on all the design paths at once; patterns after which the errors have almost one
covariance are put into one class, where each path draws one of them in their proportions. A class
is then a letter of the memory as a decided mode is, the paths of a class have the law of state and
memory given the letter, and forecasts fitted to them are the best that class and memory allow,
however coarse the classes are.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import partial
from itertools import product
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.checks import outside
from seedslib.base.clock import when
from seedslib.base.triangles import lower_triangle
from seedslib.design.paths.forward_pass import ForwardPass, as_read, remembered
from seedslib.designed.finite_order_rules import FiniteOrderState, Rules
from seedslib.designed.memory import Past
from seedslib.designed.patterns import PatternFit, distances, loose
from seedslib.designed.predictors import Affine
from seedslib.linearization.moments import symmetric
from seedslib.models.simulation import ARRIVALS

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

_estimate = attrgetter("mean")


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


class PatternPass(ForwardPass):
    """The pass of a design that conditions on what has arrived.

    Parameters
    ----------
    walk, rules, predictor, measured
        See `ForwardPass`.
    availability : ndarray, shape (m,)
        Probability that a component that is read arrives.
    """

    def __init__(
        self, walk: Any, rules: Any, predictor: Any, measured: np.ndarray, availability: np.ndarray
    ) -> None:
        super().__init__(walk, rules, predictor, measured)
        self.availability = availability
        self.loose = few_patterns(availability)
        self.farthest = 0.0
        self.classes: Any = None
        self.before: np.ndarray = np.empty((0, walk.n, walk.n))

    def _first(self, t, y):
        start, n = self.start, self.walk.n

        def begin(y):
            here = np.broadcast_to(start.mean[:, None], (n, y.shape[1]))
            return FiniteOrderState(0, here, start.cov, Past(), None, 0.0, None, False)

        def first(rules, state, y):
            return rules.first(state, t, y, start, spread=False)

        self._branched(0, t, y, [self.walk.each(begin, y)], [first])

    def _nodes(self, k, t, nodes):
        walk, n, found = self.walk, self.components, []
        memories = [walk.each(Rules.node_memory, self.rules, fork) for fork in self.states]
        size, classes = self._sizes(k, extra=self.extra), self.classes
        for node in nodes:
            walk.advance(t, node)
            t = node
            fits = [self._fit(Affine(), u, n, size) for u in memories]
            none = np.empty((0, n, n))
            found.append(PatternFit.of(classes.table[:1], none, classes.prob, fits))
            self._score(t, *(walk.kept(fit.mean, u) for fit, u in zip(fits, memories, strict=True)))
        return found, [walk.each(remembered, fork) for fork in self.states]

    def _tact(self, k, t, u, held):
        walk = self.walk
        walk.advance(self.scores[-1][0], t)
        size = self._sizes(k - 1)
        fits = [self._fit(self.predictor, each, walk.n, size) for each in u]
        self.fits.append(PatternFit.of(self.classes.table, self.before, self.classes.prob, fits))
        self.before = self.fits[-1].covs

        def correction(fit):
            def step(rules, state, y):
                mean, cov = fit.forecast(state.past.vector)
                state = state._replace(index=k, mean=mean, cov=cov, corrected=False)
                return rules.correct(state, t, y, spread=False)

            return step

        with held.at(k):
            self._branched(k, t, walk.measure(t), self.states, [correction(fit) for fit in fits])

    def _branched(self, k, t, y, forks, corrections):
        """Correct each class with each pattern, and find the classes that this makes."""
        walk, cells, moments, prob = self.walk, {}, {}, {}
        for c, (states, correct) in enumerate(zip(forks, corrections, strict=True)):
            for number, there, chance in patterns(self.measured[k], self.availability):

                def corrected(rules, state, y, correct=correct, there=there):
                    return correct(rules, state, as_read(there, y))

                cell = c, number
                cells[cell] = walk.kept(corrected, self.rules, states, y, array=_estimate)
                moments[cell] = self._errors(cells[cell])
                old = self.classes
                prob[cell] = chance * (1.0 if old is None else old.prob[c])
        self.classes = merged(self.classes, moments, prob, len(forks), 2 ** len(self.loose))
        self.farthest = coarseness(self.classes, t, self.farthest)
        number = walk.uniform(ARRIVALS)
        self.states = []
        for members in self.classes.members:
            share = np.array([prob[cell] for cell in members])
            mix = partial(_mixed, share / share.sum())
            self.states.append(walk.each(mix, number, *(cells[cell] for cell in members)))
        self.weights = self.classes.prob
        self._score(t, *(walk.each(_estimate, fork) for fork in self.states))

    def _errors(self, states):
        """Second moments of the errors of the estimates, (n', n')."""
        n = self.components
        rows, columns = lower_triangle(n)

        def products(x, state):
            error = x[:n] - state.mean
            return error[rows] * error[columns]

        return symmetric(self.walk.gather(products, states).mean, n)


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


def _mixed(members, number, *states):
    """State whose paths are those of several, by uniform numbers and shares that sum to one."""
    found, ends = states[0], np.cumsum(members)
    for share, other in zip(ends, states[1:], strict=False):
        late = number >= share
        measurement = np.where(late, other.measurement, found.measurement)
        found = chosen(late, found, other)._replace(measurement=measurement)
    return found


def chosen(late: np.ndarray, one: Any, other: Any) -> Any:
    """A state with the estimates and memories of another one on the paths (N,) that are marked."""

    def either(a, b):
        return np.where(late, b, a)

    past = (tuple(map(either, *blocks)) for blocks in zip(one.past, other.past, strict=True))
    return one._replace(mean=either(one.mean, other.mean), past=Past(*past))


def merged(
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
