"""A forward pass for a sensor whose components arrive with probabilities.

Given what has arrived, the filter is one with that history for a schedule: whatever the
probabilities are, its law is that of a design for the schedule. So no pattern is drawn. Each class
of histories has one of them as its representative, for which the filter runs on all the design
paths at once; each goes on with every pattern of the next measurement, and those whose errors have
almost one covariance become one class again, whose representative is the most probable.
"""

from __future__ import annotations

import warnings
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

ALIKE = 0.04
"""Histories are of one class where the variances of their errors differ by less than this part."""

MOST = 64
"""Most classes at a step; with more, the least probable go to the nearest."""

FAR = 0.2
"""So far from its class a history is worth a warning: its deviations are off by half of that."""

LOOSE = 4
"""Most components that may be missing: each doubles the number of patterns."""

_estimate = attrgetter("mean")


class Classes(NamedTuple):
    """Classes of histories after a measurement.

    Attributes
    ----------
    table : ndarray of int, shape (classes before, patterns)
    kept : tuple of (class before, pattern)
        What each class's representative is.
    prob : ndarray, shape (classes,)
    recent : ndarray, shape (classes, depth, n', n')
        Error covariances of the representatives, newest first.
    drift : ndarray, shape (classes,)
        How far other histories of the class may be from its representative.
    worst : float
        The largest distance at which a history had to be taken in.
    """

    table: np.ndarray
    kept: tuple[tuple[int, int], ...]
    prob: np.ndarray
    recent: np.ndarray
    drift: np.ndarray
    worst: float


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
        self.loose = loose(availability)
        if len(self.loose) > LOOSE:
            raise ValueError(
                f"availability: wanted at most {LOOSE} components that may be missing, for "
                f"{2**LOOSE} patterns, got {len(self.loose)}"
            )
        self.depth = max(1, rules.memory.depth)
        self.classes, self.before = None, np.empty((0, walk.n, walk.n))

    def _patterns(self, k):
        """Numbers, components and probabilities of what may arrive at a time."""
        for bits in product((False, True), repeat=len(self.loose)):
            there = self.measured[k] & (self.availability > 0.0)
            bits = np.array(bits[::-1], dtype=bool)
            if (bits & ~there[self.loose]).any():
                continue
            may, rate = there[self.loose], self.availability[self.loose]
            chance = np.where(bits, rate, 1.0 - rate)
            there[self.loose] = bits
            yield int(bits @ 2 ** np.arange(len(bits))), there, float(np.prod(chance[may]))

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
        walk, cells, recent, prob = self.walk, {}, {}, {}
        for c, (states, correct) in enumerate(zip(forks, corrections, strict=True)):
            for number, there, chance in self._patterns(k):

                def corrected(rules, state, y, correct=correct, there=there):
                    return correct(rules, state, as_read(there, y))

                cell = c, number
                cells[cell] = walk.kept(corrected, self.rules, states, y, array=_estimate)
                newest = [self._errors(cells[cell])]
                old = self.classes
                if old is not None:
                    newest += [*old.recent[c]][: self.depth - 1]
                recent[cell] = np.stack(newest)
                prob[cell] = chance * (1.0 if old is None else old.prob[c])
        self.classes = merged(self.classes, recent, prob, len(forks), 2 ** len(self.loose))
        if self.classes.worst > FAR:
            warnings.warn(
                f"availability: {MOST} classes of histories are few at time {when(t)}; after the "
                f"least probable ones deviations are off by up to {self.classes.worst / 2:.0%}",
                stacklevel=outside(),
            )
        self.states = [cells[cell] for cell in self.classes.kept]
        self.weights = self.classes.prob
        self._score(t, *(walk.each(_estimate, fork) for fork in self.states))

    def _errors(self, states):
        """Mean product of the errors of the estimates, (n', n')."""
        n = self.components
        rows, columns = lower_triangle(n)

        def products(x, state):
            error = x[:n] - state.mean
            return error[rows] * error[columns]

        return symmetric(self.walk.gather(products, states).mean, n)


def merged(old: Classes | None, recent: dict, prob: dict, before: int, patterns: int) -> Classes:
    """Classes of the cells (class before, pattern), the most probable first.

    A cell holds the histories of its class before; how far they are from its own shrinks as the
    distance between neighbouring classes does, when both see the same pattern. A cell goes into a
    class where what this leaves of the distance, with its own, is small; so histories that differ
    a little more at each step do not end up in one class.
    """
    cells = sorted(prob, key=lambda cell: -prob[cell])
    stack = np.stack([recent[cell] for cell in cells])
    place = {cell: i for i, cell in enumerate(cells)}
    apart = np.max([distances(part, part) for part in np.moveaxis(stack, 1, 0)], axis=0)
    drift = np.array([_inherited(old, cell, place, apart) for cell in cells])
    kept, home, reach = [], np.zeros(len(cells), dtype=int), np.array(drift)
    worst = 0.0
    for i in range(len(cells)):
        near = apart[i, kept] + drift[i] if kept else np.empty(0)
        if len(kept) < MOST and not (near <= ALIKE).any():
            home[i] = len(kept)
            kept.append(i)
            continue
        home[i] = int(np.argmin(near))
        worst = max(worst, float(near[home[i]]))
        reach[kept[home[i]]] = max(reach[kept[home[i]]], near[home[i]])
    table = np.zeros((before, patterns), dtype=int)
    for c in range(before):
        for number in range(patterns):
            # a component that is not read at this time does not count
            table[c, number] = home[place[min(
                (cell for cell in cells if cell[0] == c and cell[1] & number == cell[1]),
                key=lambda cell: -cell[1],
            )]]  # fmt: skip
    chance = np.bincount(home, weights=[prob[cell] for cell in cells], minlength=len(kept))
    order = np.argsort(-chance, kind="stable")
    rank = np.argsort(order, kind="stable")
    chosen = [kept[j] for j in order]
    return Classes(
        rank[table], tuple(cells[i] for i in chosen), chance[order], stack[chosen],
        reach[chosen], worst,
    )  # fmt: skip


def _inherited(old, cell, place, apart):
    """How far the histories of a cell may be from the one that was run."""
    c, number = cell
    if old is None or not old.drift[c]:
        return 0.0
    if len(old.prob) == 1:
        return old.drift[c]
    was = np.max([distances(p[[c]], p)[0] for p in np.moveaxis(old.recent, 1, 0)], axis=0)
    was[c] = np.inf
    other = int(np.argmin(was))
    now = apart[place[cell], place[other, number]]
    return old.drift[c] * min(1.0, now / was[other])
