"""Joint law of state and memory where components of a measurement arrive with probabilities.

What arrives is independent of state and noise. So the law of state and memory splits by the
pattern of what was seen, and is mixed again, by the probabilities of the patterns, in classes of
histories after which the errors have almost one variance: see `seedslib.design.histories`. A
class is a letter of the memory, and the law is normalised in each, so that rare ones are known as
well as others.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from seedslib.base.tables import Labels
from seedslib.design.histories import Histories, keep_indicators, patterns, shares
from seedslib.design.law.joint import LARGEST, JointLaw
from seedslib.design.law.recursion import NEGLIGIBLE, Seen, conditional, seen
from seedslib.designed.outputs.lookup import Output, Step, Table
from seedslib.designed.outputs.patterns import ByPattern, components
from seedslib.models.simulation import Schedule


class PatternLaw(JointLaw):
    """Joint law of state, memory and class of histories, carried through the patterns.

    Parameters
    ----------
    arguments : tuple
        As `JointLaw`.
    schedule : Schedule
        Of the components, the indicator the last one.

    Attributes
    ----------
    joint : ndarray, shape (classes * cells, S)
        Probabilities given the class; those of each sum to one.
    histories : Histories

    Raises
    ------
    ValueError
        As `JointLaw`; measurements to be remembered, or indicators that may be missing; too many
        patterns.
    """

    def __init__(self, arguments: tuple[Any, ...], schedule: Schedule) -> None:
        super().__init__(*arguments)
        if not self.memory.estimates:
            raise ValueError(
                "memory: wanted estimates for a sensor with a schedule or an availability, since a "
                f"measurement that is missing cannot be remembered; got {self.memory}"
            )
        size = schedule.mask.shape[1]
        given = schedule.availability
        keep_indicators(self.memory, schedule.mask, given)
        self.rates: np.ndarray = np.ones(size) if given is None else given
        self.mask: np.ndarray = schedule.mask & (self.rates > 0.0)
        cells = float(self.letters) ** self.depth * self.values.shape[1]
        self.histories = Histories(self.rates, 1)
        self.histories.most = max(1, int(LARGEST / cells))

    @property
    def blocks(self) -> np.ndarray:
        """The law in each class, (classes, cells, S)."""
        return self.joint.reshape(len(self.histories.prob), -1, self.joint.shape[1])

    def renew(self) -> None:
        """Give the law of each class its mass again."""
        whole = self.blocks / self.blocks.sum(axis=(1, 2), keepdims=True)
        self.joint = whole.reshape(self.joint.shape)

    def marginal(self) -> Any:
        """Law of the state alone, (S,)."""
        return self.histories.prob @ self.blocks.sum(axis=1)

    @property
    def class_axis(self) -> tuple[Labels, ...]:
        """The class as an axis of tables; none where there is but one."""
        return (Labels(len(self.histories.prob)),) if len(self.histories.loose) else ()

    def given(self) -> np.ndarray:
        """Law of the state in each class and cell, (classes * cells, S)."""
        return np.concatenate([conditional(block) for block in self.blocks])

    def forecast(self, t: float) -> Table:
        """As `JointLaw.forecast`, for each class."""
        means = self.given() @ self.values[0]
        mass = self.blocks.sum(axis=2)
        explained = self.histories.prob @ (mass * means.reshape(mass.shape) ** 2).sum(axis=1)
        self.scores.append((t, self.marginal() @ self.values[0] ** 2 - explained))
        return Table.of(self.class_axis + self.memory_axes, Output(means))

    def decided(self, k: int, t: float, sight: Seen, probabilities: bool = False) -> Step:
        """Optimal functions of all patterns at measurement k; the joint law after it."""
        given, held = self.given(), self.class_axis + self.memory_axes
        values, axes = self.chain.indicators, self.measurement_axes[-self._size :]
        views = self._views(float(t), sight, self.mask[k])
        found: dict[Any, Output] = {}
        for key, view in views.items():
            found[key] = self.posterior(view.relative, given)
        if k == 0 and not self.switching:
            found[0, False] = Output(np.full_like(found[0, False].mean, self.system.mean0[0]))
        tables: list[Any] = []
        for number in range(2**self._size):
            if (number, False) not in views:
                tables.append(None)
                continue
            output = found[number, False]
            if values:
                pairs = zip(found[number, True], output, strict=True)
                output = Output(*(np.concatenate(pair, axis=-2) for pair in pairs))
            shown = tuple(axes[i] for i in components(number, self._size))
            known = (Labels(values + 1),) if values else ()
            tables.append(Table.of(known + shown + held, output, probabilities))
        self._take(k, float(t), views, found)
        return Step(ByPattern(tuple(tables[1:])), tables[0])

    @property
    def _size(self) -> int:
        """Components of a measurement, without the indicator."""
        return len(self.measurement_axes) - (self.chain.indicators > 0)

    def _views(self, t: float, sight: Seen, read: np.ndarray) -> dict[Any, Seen]:
        """Likelihoods of what may be seen: by the number of a pattern, and with the indicator."""
        values, size = self.chain.indicators, self._size
        told = self.chain.told(t) if self.switching else np.ones((1, self.values.shape[1]))
        none = np.zeros(told.shape[1])
        whole, found = {False: sight}, {(0, False): Seen(told[-1:], told[-1:], none)}
        if values:
            y = self.shown[1:, : len(self.weights) // values]
            missing = np.concatenate([np.full((1, y.shape[1]), -1.0), y])
            unseen = seen(self.chain.log_likelihood(t, missing), self.weights[: y.shape[1]])
            whole = {False: unseen, True: sight}
            found[0, True] = Seen(told[:-1], told[:-1], none)
        for number in range(1, 2**size):
            rows = components(number, size)
            if read[rows].all():
                for known, full in whole.items():
                    found[number, known] = self._partly(full, rows, values if known else 0)
        return found

    def _partly(self, full: Seen, rows: list[int], values: int) -> Seen:
        """Likelihood of some components, by summing over the others."""
        if len(rows) == self._size:
            return full
        counts = [axis.count for axis in self.measurement_axes[-self._size :]]
        lead = [values] if values else []
        mass = full.mass.reshape(*lead, *counts, -1)
        others = tuple(len(lead) + i for i in range(self._size) if i not in rows)
        mass = mass.sum(axis=others).reshape(-1, full.mass.shape[1])
        peak = mass.max(axis=1, keepdims=True)
        relative = np.divide(mass, peak, out=np.zeros_like(mass), where=peak > NEGLIGIBLE)
        return full._replace(relative=relative, mass=mass)

    def _ways(self, k: int) -> Iterator[tuple[int, Any, float]]:
        """Number among those that may be missing, key of the view, and probability of a pattern."""
        size = self._size
        for number, there, chance in patterns(self.mask[k], self.rates):
            bits = int(there[:size] @ 2 ** np.arange(size))
            yield number, (bits, bool(there[size:].any())), chance

    def _take(self, k: int, t: float, views, found) -> None:
        """Score what was found, and let the memory and the class take it."""
        blocks, cells = self.blocks, self.joint.shape[0] // len(self.histories.prob)
        scores, moments, prob, kept = {}, {}, {}, {}
        for number, key, chance in self._ways(k):
            means, modes, _ = found[key]
            told = None
            if self.memory.indicators:  # which are all there
                values = self.chain.indicators
                told = np.repeat(np.arange(values), means.shape[1] // values)
            for c, block in enumerate(blocks):
                here = slice(c * cells, (c + 1) * cells)
                own = None if modes is None else modes[:, here]
                score, mass = self.judged(block, means[:, :, here], views[key], own)
                cell = c, number
                scores[cell], prob[cell] = score, chance * self.histories.prob[c]
                moments[cell] = np.array([[score[0]]])
                kept[cell] = means[:, :, here], views[key], own, mass, told
        joint = []
        for members in self.histories.take(t, moments, prob).members:
            share = shares(members, prob)
            joint.append(sum(
                part * self.remembered(blocks[cell[0]], *kept[cell])
                for part, cell in zip(share, members, strict=True)
            ))  # fmt: skip
        if len(self.histories.loose):
            self.histories.noted(moments, prob)
        self.joint = np.concatenate(joint)
        weights = np.array([prob[cell] for cell in scores])
        columns = map(np.array, zip(*scores.values(), strict=True))
        self.noted(k, tuple(None if c[0] is None else float(weights @ c) for c in columns))
