"""Moments of the branches of a switching system, as a filter of it takes them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from seedslib.designed.identity import probe_points
from seedslib.linearization.moments import Gaussian, Linearization, Moments, Weighted
from seedslib.models.kinds import AnySystem
from seedslib.models.maps import StochasticMap
from seedslib.models.switching import Branch


def switch_row(system: AnySystem, i: int, linearization: Linearization) -> Callable[..., Any]:
    """Moments of a state that stands still while mode i switches, for each new mode."""
    switch = [branch and branch.still for branch in system.branches[i]]
    if not all(branch is None or branch.constant for branch in switch):
        found = _row_moments(switch, linearization)
        return lambda t, mean, cov, p=(): [[w] for w in found(t, mean, cov, p)]

    def row(t, mean, cov, p=()):
        stays = Gaussian(mean, cov), Moments(mean, cov, cov)
        return [[b and Weighted(b.probability(t, mean, p), *stays)] for b in switch]

    return row


def forecast_row(system: AnySystem, i: int, linearization: Linearization) -> Callable[..., Any]:
    """Moments of the next state in mode i, ``f(t, mean, cov, p)``: one part for each new mode."""
    found = _row_moments(_branches(system, i), linearization)
    return lambda t, mean, cov, p=(): [[w] for w in found(t, mean, cov, p)]


def _branches(system, i):
    """Branches of a row; where the new mode drives the step, it has switched before, and stays."""
    if system.drives == "old":
        return system.branches[i]
    return [Branch(system.dynamics[i]) if l == i else None for l in range(system.modes)]


def split_row(system: AnySystem, i: int, linearization: Linearization) -> Callable[..., Any]:
    """As `forecast_row`, with a part for each value of the indicator, (6.19).

    Raises
    ------
    ValueError
        No formulas for a part; an indicator whose probability depends on an input or on time.
    """
    table = [
        [branch and _seen_branch(system, branch, reading) for reading in system.readings[l]]
        for l, branch in enumerate(_branches(system, i))
    ]
    found = _each_moments([map for row in table for map in row], linearization)
    width = len(table[0])

    def row(t, mean, cov, p=()):
        flat = found(t, mean, cov, p)
        return [flat[a : a + width] for a in range(0, len(flat), width)]

    return row


def _row_moments(branches, linearization):
    """Moments in each branch of a row; what does not depend on the branch is found once."""
    if all(branch is None or branch.constant for branch in branches):
        found = [branch for branch in branches if branch is not None]
        whole = plain_moments(found[0].whole, 1.0, linearization)

        def row(t, mean, cov, p=()):
            w = whole(t, mean, cov, p)
            return [
                branch and w._replace(mass=branch.probability(t, mean, p)) for branch in branches
            ]

        return row
    return _each_moments([branch and branch.map for branch in branches], linearization)


def _each_moments(maps, linearization):
    """Moments of several branches of one state, None where there is no branch."""
    moments = linearization.row([map for map in maps if map is not None])

    def row(t, mean, cov, p=()):
        found = iter(moments(t, mean, cov, p))
        return [map and next(found) for map in maps]

    return row


def alone_moments(branch: Any, linearization: Linearization) -> Callable[..., Any]:
    """Moments of one branch with the state in it."""
    if not branch.constant:
        return linearization.weighted(branch.map)
    return plain_moments(branch.whole, branch, linearization)


def plain_moments(
    map: StochasticMap, share: Any, linearization: Linearization
) -> Callable[..., Any]:
    """Moments of a map that applies with a probability that does not depend on the state."""
    moments = linearization.moments(map)

    def f(t, mean, cov, p=()):
        mass = np.ones(mean.shape[1:]) if share == 1.0 else share.probability(t, mean, p)
        return Weighted(mass, Gaussian(mean, cov), moments(t, mean, cov, p))

    return f


def _seen_branch(system, branch, reading):
    """Move to the next state together with what the indicator will show there."""
    if reading is None:
        return None
    move, shown = branch.map, reading.map
    told = None
    if move.symbolic:
        with suppress(ValueError):  # none has a closed form where the noise decides
            told = reading.probability_expression
    symbols = shown.mentions if told is None else told.free_symbols
    if any(getattr(symbol, "role", None) == "input" for symbol in symbols):
        raise ValueError("indicator: its probability depends on an input of another time")
    moving = told.has(shown.time) if told is not None else _moves(system, reading)
    if moving:
        raise ValueError("indicator: its probability depends on state and time")
    if told is None:
        return StochasticMap.from_functions(
            move.state_size,
            move.size,
            lambda t, x, v, *p: move.value(t, x, v, p),
            move.noise,
            weight=lambda t, x, v, *p: (
                move.weight(t, x, v, p) * reading.probability(t, move.value(t, x, v, p), p)
            ),
            parameters=move.parameters,
        )
    there = dict(zip(shown.state, move.expressions, strict=True))
    weight = move.weight_expression * told.subs(there, simultaneous=True)
    made = StochasticMap(move.state, move.expressions, move.noise, weight, time=move.time)
    return made.taking(move.parameters)


def _moves(system, reading):
    """Whether a probability without a formula changes with time, at states about the first law.

    What cannot be asked at all times depends on them.
    """
    times = (0.0, 1e-3, 0.37, 1.0, 7.3, 100.0)
    states = probe_points(system, 0.0, 1.0)[1:]
    try:
        with np.errstate(all="ignore"):
            p = system.nominal_values()
            first, *others = (reading.probability(t, states, p) for t in times)
    except Exception:
        return True
    return not all(np.array_equal(first, other, equal_nan=True) for other in others)
