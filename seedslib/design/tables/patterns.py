"""Tables on simulated paths for a sensor whose components arrive with probabilities.

As in `seedslib.design.histories`: each class of histories has a memory of its own on all the paths,
and goes on with every pattern of what may arrive.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from seedslib.base.blocks import child
from seedslib.base.tables import Labels
from seedslib.design.histories import Histories, keep_indicators, patterns, shares
from seedslib.design.tables.carriers import Carriers, Lesson
from seedslib.designed.memory import Past
from seedslib.designed.outputs.lookup import Step, Table
from seedslib.designed.outputs.patterns import ByPattern, components
from seedslib.models.simulation import ARRIVALS, Schedule

Fit = Callable[[Lesson, list[int]], Table]
"""A function of some components of a measurement, which the lesson has still all, and the memory;
of none of them, of the memory alone."""


class PatternCarriers(Carriers):
    """Sets of design paths with a memory for each class of histories.

    Parameters
    ----------
    schedule : Schedule
        Of the components, an indicator the last one.
    *arguments
        As `Carriers`.

    Raises
    ------
    TypeError, ValueError
        As `Carriers`; measurements to be remembered, too many patterns.
    """

    def __init__(self, schedule: Schedule, *arguments: Any) -> None:
        super().__init__(*arguments)
        if not self.memory.estimates or self.memory.measurements:
            raise ValueError(
                "memory: wanted estimates alone for a sensor with a schedule or an availability, "
                f"since a measurement that is missing cannot be remembered; got {self.memory}"
            )
        mask, given = schedule
        keep_indicators(self.memory, mask, given)
        self.rates: np.ndarray = np.ones(mask.shape[1]) if given is None else given
        self.mask: np.ndarray = mask & (self.rates > 0.0)
        self.histories = Histories(self.rates, self.components)
        self.group: int = 0
        self.carried: list[Any] = [[Past()] for _ in self.sets]

    def past(self, which: int) -> Past:
        """Memory of a set, in the class that is looked at."""
        return self.carried[which][self.group]

    def in_classes(self, make: Callable[[], Table], lead: int) -> Table:
        """One table of those that are made for each class, which is its axis number `lead`."""
        found = []
        for c in range(len(self.histories.prob)):
            self.group = c
            found.append(make())
        if not len(self.histories.loose):
            return found[0]
        axes = found[0].axes
        axes = (*axes[:lead], Labels(len(found)), *axes[lead:])
        columns = zip(*(table[1:] for table in found), strict=True)
        # estimates and probabilities have an axis before those of the table
        rest = len(axes) - 1
        estimate, mode, prob = (
            None if parts[0] is None else np.stack(parts, axis=parts[0].ndim - rest + lead)
            for parts in columns
        )
        return Table(axes, estimate, mode, prob)

    def decided(self, fit: Fit, forecast: Table | None) -> Step:
        """Functions of all patterns of the next measurement, applied on all paths.

        `forecast` is that without a measurement, where it is known.
        """
        k, told, m = self.reached + 1, int(self.system.indicators > 0), len(self.sets[0][1][0])
        tables: list[Any] = []
        for number in range(2**m):
            rows = components(number, m)
            if not self.mask[k, rows].all():
                tables.append(None)
            elif number == 0 and forecast is not None:
                wide = np.repeat(forecast.estimate[:, None], len(self.histories.prob), axis=1)
                whole = Table((Labels(len(self.histories.prob)),), wide)
                tables.append(whole if len(self.histories.loose) else forecast)
            else:
                made = self.in_classes(lambda rows=rows: fit(self.lesson(), rows), told + len(rows))
                tables.append(made)
        self._take(k, tables, m)
        return Step(ByPattern(tuple(tables[1:])), tables[0])

    def _take(self, k, tables, m) -> None:
        """Apply the functions, note their errors, and put each path into a class."""
        examiner, sets = (k + 1) % len(self.sets), range(len(self.sets))
        moments, prob, pasts = {}, {}, {}
        squares, wrong = 0.0, 0.0
        for number, there, chance in patterns(self.mask[k], self.rates):
            rows = np.flatnonzero(there[:m])
            table = tables[int(there[:m] @ 2 ** np.arange(m))]
            for c in range(len(self.histories.prob)):
                self.group, cell = c, (c, number)
                prob[cell] = chance * self.histories.prob[c]
                pasts[cell] = []
                for which in sets:
                    lesson = self._lesson(which)
                    if not there[m:].all():
                        lesson = lesson._replace(indicators=None)
                    group = np.asarray(c) if len(self.histories.loose) else None
                    points = lesson._replace(measurements=lesson.measurements[rows]).points(
                        self.system, group=group
                    )
                    found = table(points).filling(lesson.states.shape[1:])
                    pasts[cell].append(self.memory.push(
                        lesson.past, estimate=found.mean, mode=found.mode,
                        indicator=lesson.indicators,
                    ))  # fmt: skip
                    if which == examiner:
                        error = lesson.states[: self.components] - found.mean
                        moments[cell] = error @ error.T / error.shape[1]
                        squares = squares + prob[cell] * error**2
                        if found.mode is not None:
                            wrong = wrong + prob[cell] * (found.mode != lesson.modes)
        self.scores.append((float(self.times[k]), squares))
        if np.ndim(wrong):
            self.wrong.append(wrong)
        self.errors.append(sum(prob[cell] * moments[cell] for cell in prob))
        classes = self.histories.take(float(self.times[k]), moments, prob)
        if len(self.histories.loose):
            self.histories.noted(moments, prob)
        for which in sets:
            rng = np.random.default_rng(child(self.streams[which], ARRIVALS, k))
            drawn = rng.random(self.sets[which].measurements.shape[-1])
            self.carried[which] = [
                _mixed(drawn, shares(members, prob), [pasts[cell][which] for cell in members])
                for members in classes.members
            ]
        self.reached = k

    def score(self, t: float, forecast: Any) -> None:
        """Note the errors of a forecast, a function of class and memory, at a node."""
        square = 0.0
        for c, chance in enumerate(self.histories.prob):
            self.group = c
            lesson = self._lesson(self.reached + 2, t)
            group = np.asarray(c) if len(self.histories.loose) else None
            found = forecast(lesson.points(self.system, group=group)).mean
            square = square + chance * (lesson.states[: self.components] - found) ** 2
        self.scores.append((float(t), square))


def _mixed(drawn, parts, pasts) -> Past:
    """Memory whose paths are those of several, by uniform numbers and their parts."""
    found = pasts[0]
    for end, other in zip(np.cumsum(parts), pasts[1:], strict=False):
        late = drawn >= end
        found = Past(*(
            tuple(np.where(late, b, a) for a, b in zip(one, two, strict=True))
            for one, two in zip(found, other, strict=True)
        ))  # fmt: skip
    return found
