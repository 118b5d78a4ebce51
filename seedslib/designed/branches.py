"""Moments of the branches of a switching system, as a filter of it takes them.

A function of a row gives, for each new mode, a list of `Weighted`, one for each part of the
forecast; None where the mode never switches there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from seedslib.linearization.moments import Gaussian, Linearization, Moments, Weighted
from seedslib.models.maps import StochasticMap
from seedslib.models.switching import Branch, SwitchingSystem

MomentFunction = Callable[..., Any]
"""``f(t, mean, cov, p)`` of a Gaussian state: a `Weighted`, or those of a row."""


def switch_row(system: SwitchingSystem, i: int, linearization: Linearization) -> MomentFunction:
    """Moments of a state that does not move while mode i switches, for each new mode."""
    switch = [branch and branch.switch_only for branch in system.branches[i]]
    if not all(branch is None or branch.constant for branch in switch):
        return _row([[branch and branch.map] for branch in switch], linearization)

    def row(t, mean, cov, p=()):
        unmoved = Gaussian(mean, cov), Moments(mean, cov, cov)
        return [[b and Weighted(b.probability(t, mean, p), *unmoved)] for b in switch]

    return row


def forecast_row(system: SwitchingSystem, i: int, linearization: Linearization) -> MomentFunction:
    """Moments of the next state from mode i, for each new mode, of one part."""
    branches = _branches(system, i)
    if not all(branch is None or branch.constant for branch in branches):
        return _row([[branch and branch.map] for branch in branches], linearization)
    # what does not depend on the branch is formed once
    move = next(branch.whole for branch in branches if branch is not None)
    moments = constant_moments(move, linearization)

    def row(t, mean, cov, p=()):
        w = moments(t, mean, cov, p)
        return [[branch and w._replace(mass=branch.probability(t, mean, p))] for branch in branches]

    return row


def split_row(system: SwitchingSystem, i: int, linearization: Linearization) -> MomentFunction:
    """As `forecast_row`, with a part for each value of the indicator, (6.19).

    Raises
    ------
    NoClosedForm
        No formulas for a part.
    ValueError
        An indicator whose probability depends on an input or on time.
    """
    table = [
        [branch and _with_indicator(system, branch, reading) for reading in system.readings[l]]
        for l, branch in enumerate(_branches(system, i))
    ]
    return _row(table, linearization)


def _branches(system, i):
    """Branches of a row; where the new mode drives the step, it has switched before, and stays."""
    if system.drives == "old":
        return system.branches[i]
    return [Branch(system.dynamics[i]) if l == i else None for l in range(system.modes)]


def _row(
    table: Sequence[Sequence[StochasticMap | None]], linearization: Linearization
) -> MomentFunction:
    """Moments of the parts of each new mode, None where there is no branch."""
    moments = linearization.row([map for parts in table for map in parts if map is not None])

    def row(t, mean, cov, p=()):
        each = iter(moments(t, mean, cov, p))
        return [[map and next(each) for map in parts] for parts in table]

    return row


def reading_moments(branch: Branch, linearization: Linearization) -> MomentFunction:
    """Moments of one branch with the state in it."""
    if not branch.constant:
        return linearization.weighted(branch.map)
    return constant_moments(branch.whole, linearization, branch)


def constant_moments(
    map: StochasticMap, linearization: Linearization, branch: Branch | None = None
) -> MomentFunction:
    """Moments of a map whose branch, if any, has a probability that is free of the state."""
    moments = linearization.moments(map)

    def weighted(t, mean, cov, p=()):
        mass = np.ones(mean.shape[1:]) if branch is None else branch.probability(t, mean, p)
        return Weighted(mass, Gaussian(mean, cov), moments(t, mean, cov, p))

    return weighted


def _with_indicator(system, branch, reading):
    """The moved state, weighted by the probabilities of the branch and of its reading then.

    Raises ValueError where that is no expression of the moved state alone.
    """
    if reading is None:
        return None
    move, sensor = branch.map, reading.map
    if not move.symbolic:
        raise ValueError("indicator: wanted expressions, got array functions")
    probability = reading.probability_expression
    if any(getattr(symbol, "role", None) == "input" for symbol in probability.free_symbols):
        raise ValueError("indicator: its probability depends on an input of another time")
    if probability.has(sensor.time):
        raise ValueError("indicator: its probability depends on state and time")
    next_state = dict(zip(sensor.state, move.expressions, strict=True))
    weight = move.weight_expression * probability.subs(next_state, simultaneous=True)
    both = StochasticMap(move.state, move.expressions, move.noise, weight, time=move.time)
    return both.taking(move.parameters)
