"""Moments of the branches of a switching system, as a filter of it takes them."""

from __future__ import annotations

import numpy as np

from seedslib.linearization.moments import Gaussian, Weighted
from seedslib.models.maps import StochasticMap


def row_moments(branches, linearization):
    """Moments in each branch of a row; what does not depend on the branch is found once."""
    if all(branch is None or branch.constant for branch in branches):
        found = [branch for branch in branches if branch is not None]
        whole = plain_moments(found[0].whole, 1.0, linearization)

        def row(t, mean, cov):
            w = whole(t, mean, cov)
            return [branch and w._replace(mass=branch.probability(t, mean)) for branch in branches]

        return row
    return each_moments([branch and branch.map for branch in branches], linearization)


def each_moments(maps, linearization):
    """Moments of several branches of one state, None where there is no branch."""
    moments = linearization.row([map for map in maps if map is not None])

    def row(t, mean, cov):
        found = iter(moments(t, mean, cov))
        return [map and next(found) for map in maps]

    return row


def alone_moments(branch, linearization):
    """Moments of one branch with the state in it."""
    if not branch.constant:
        return linearization.weighted(branch.map)
    return plain_moments(branch.whole, branch, linearization)


def plain_moments(map, share, linearization):
    """Moments of a map that applies with a probability that does not depend on the state."""
    moments = linearization.moments(map)

    def f(t, mean, cov):
        mass = np.ones(mean.shape[1:]) if share == 1.0 else share.probability(t, mean)
        return Weighted(mass, Gaussian(mean, cov), moments(t, mean, cov))

    return f


def _told(reading):
    """SymPy probability of an indicator's value given the state, None without a closed form."""
    try:
        return reading.probability_expression
    except ValueError:
        return None


def seen_branch(branch, reading):
    """Move to the next state together with what the indicator will show there."""
    if reading is None:
        return None
    move, shown = branch.map, reading.map
    told = _told(reading) if move.symbolic else None
    if told is None:
        return StochasticMap.from_functions(
            move.state_size, move.size, move.value, move.noise,
            weight=lambda t, x, v: (
                move.weight(t, x, v) * reading.probability(t, move.value(t, x, v))
            ),
        )  # fmt: skip
    if told.has(shown.time):
        raise ValueError(
            "split: an indicator whose probability depends on state and time cannot split the "
            "forecast; use split=False"
        )
    there = dict(zip(shown.state, move.expressions, strict=True))
    weight = move.weight_expression * told.subs(there, simultaneous=True)
    return StochasticMap(move.state, move.expressions, move.noise, weight, time=move.time)
