"""A forward pass for a sensor whose components arrive with probabilities.

No pattern is waited for: each class of histories goes on with every pattern of the next
measurement on all the design paths at once. Patterns after which the errors are alike are put into
one class, where each path draws one of them in their proportions; so the paths of a class have the
law of state and memory given the class. See `seedslib.design.histories`.
"""

from __future__ import annotations

from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from seedslib.base.semidefinite import lower_triangle
from seedslib.design.histories import Histories, patterns, shares
from seedslib.design.paths.forward_pass import ForwardPass, as_read, remembered
from seedslib.designed.finite_order_rules import FiniteOrderState, Rules
from seedslib.designed.memory import Past
from seedslib.designed.patterns import PatternFit
from seedslib.designed.predictors import Affine
from seedslib.linearization.moments import symmetric
from seedslib.models.simulation import ARRIVALS

_estimate = attrgetter("mean")


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
        self.histories = Histories(availability, walk.n)
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
        size, classes = self._sizes(k, extra=self.extra), self.histories.classes
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
        classes = self.histories.classes
        self.fits.append(PatternFit.of(classes.table, self.before, classes.prob, fits))
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
                moments[cell] = second_moments(walk, self.components, cells[cell])
                prob[cell] = chance * self.histories.prob[c]
        number = walk.uniform(ARRIVALS)
        self.states = []
        for members in self.histories.take(t, moments, prob).members:
            mix = partial(_mixed, shares(members, prob))
            self.states.append(walk.each(mix, number, *(cells[cell] for cell in members)))
        self.weights = self.histories.prob
        self._score(t, *(walk.each(_estimate, fork) for fork in self.states))


def second_moments(walk: Any, n: int, states: Any) -> np.ndarray:
    """Second moments of the errors of the estimates of n components, (n, n)."""
    rows, columns = lower_triangle(n)

    def products(x, state):
        error = x[:n] - state.mean
        return error[rows] * error[columns]

    return symmetric(walk.gather(products, states).mean, n)


def _mixed(members, number, *states):
    """State whose paths are those of several, by uniform numbers and shares that sum to one."""
    found, ends = states[0], np.cumsum(members)
    for share, other in zip(ends, states[1:], strict=False):
        late = number >= share
        measurement = np.where(late, other.measurement, found.measurement)
        found = where_late(late, found, other)._replace(measurement=measurement)
    return found


def where_late(late: np.ndarray, one: Any, other: Any) -> Any:
    """A state with the estimates and memories of another one on the paths (N,) that are marked."""

    def either(a, b):
        return np.where(late, b, a)

    past = (tuple(map(either, *blocks)) for blocks in zip(one.past, other.past, strict=True))
    return one._replace(mean=either(one.mean, other.mean), past=Past(*past))
