"""Deterministic synthesis of filters of scalar switching systems: theorem 2 on a grid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.design.law.recursion import conditional, seen
from seedslib.designed.finite_order_rules import Design
from seedslib.designed.lookup import ModeTable, StepTables, step_axes
from seedslib.designed.prediction import SwitchingPrediction
from seedslib.designed.switching_table import SwitchingTableFilter
from seedslib.filters.weights import most_probable

BY_GRID = Design(0, 0, 0, (), 0, True)
METHOD = "density recursion"


class Optimal(NamedTuple):
    """What is optimal at one measurement, on the grid of measurements and memory.

    Attributes
    ----------
    held : int
        Blocks in the memory.
    law : ndarray, shape (cells, S)
        Of the chain in each cell of the memory.
    means : ndarray, shape (1, Y, cells)
    modes : ndarray of int8, shape (Y, cells)
    prob : ndarray, shape (L, Y, cells)
    mass : ndarray, shape (Y, cells)
        Probability of measurement and memory.
    """

    held: int
    law: np.ndarray
    means: np.ndarray
    modes: np.ndarray
    prob: np.ndarray
    mass: np.ndarray


def optimal_steps(law):
    """The alternation of theorem 2: at each measurement what is optimal, then the joint law.

    Parameters
    ----------
    law : JointLaw
        Of a system of either kind; it is moved on.

    Yields
    ------
    Optimal
    """
    for k, t in enumerate(law.times):
        sight = law.look(t)
        held, given = law.held, conditional(law.joint)
        found = _decided(law, sight.relative, given)
        mass = law.take(k, found[0], sight, found[1] if law.switching else None)
        yield Optimal(held, given, *found, mass)
        if k + 1 < len(law.times):
            law.move(t, law.times[k + 1])
    law.look_at_memory()


def switching_synthesis(law, probabilities) -> SwitchingTableFilter:
    """Filter of tables from the joint law of a switching system; see `grid_synthesis`."""
    steps, changes, before = [], [], None
    for t, found in zip(law.times, optimal_steps(law), strict=True):
        changes.append(_change(before, found))
        steps.append(_tables(law, float(t), found, probabilities))
        before = found
    return SwitchingTableFilter(
        system=law.system, memory=law.memory, times=law.times, tables=tuple(steps), method=METHOD,
        predicted=prediction(law.risk()), changes=np.array(changes).T, covariances=law.errors(),
        design=BY_GRID,
    )  # fmt: skip


def _change(before, now):
    """How far estimates and modes are from those before, over the law of their arguments."""
    if before is None or before.means.shape != now.means.shape:
        return np.nan, np.nan
    square = np.vdot(now.mass, (now.means[0] - before.means[0]) ** 2)
    return np.sqrt(square), now.mass[now.modes != before.modes].sum()


def prediction(risk) -> SwitchingPrediction:
    """A deterministic risk as what a design says about its accuracy."""
    rms = np.sqrt(np.maximum(risk.mse, 0.0))[:, None]
    none = np.zeros(len(rms))
    return SwitchingPrediction(risk.times, rms, np.zeros_like(rms), risk.mode_error, none)


def _tables(law, t, optimal, probabilities):
    """Tables of a step: on the grid, with the indicator missing, with the measurement missing."""
    given, found = optimal.law, (optimal.means, optimal.modes, optimal.prob)
    system, memory, axes = law.system, law.memory, law.measurement_axes
    if law.chain.indicators:
        axes, y = axes[1:], law.shown[1:, : len(law.weights) // law.chain.indicators]
        unseen = law.chain.log_likelihood(t, np.concatenate([np.full((1, y.shape[1]), -1.0), y]))
        more = _decided(law, seen(unseen, law.weights[: y.shape[1]]).relative, given)
        found = tuple(np.concatenate(pair, axis=-2) for pair in zip(found, more, strict=True))
    letters = axes if memory.measurements else law.letter_axes[-1:]
    shown, blind = step_axes(system, memory, axes, letters, optimal.held)

    def table(axes, found):
        shape = tuple(axis.count for axis in axes)
        means, modes, prob = found
        prob = prob.reshape(len(prob), *shape) if probabilities else None
        return ModeTable(axes, means.reshape(1, *shape), modes.reshape(shape), prob)

    return StepTables(table(shown, found), table(blind, _decided(law, law.chain.told(t), given)))


def _decided(law, relative, given):
    means, prob = law.posterior(relative, law=given)
    return means, most_probable(prob).astype(np.int8), prob
