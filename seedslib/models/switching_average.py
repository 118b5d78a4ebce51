"""The same system with switching that no longer depends on the state."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from seedslib.models.kinds import as_system
from seedslib.models.maps import StochasticMap
from seedslib.models.switching import SwitchingSystem


def averaged_switching(
    system: SwitchingSystem, times: ArrayLike, paths: int, seed: object
) -> SwitchingSystem:
    """System whose switching probabilities are the stationary averages of those of another.

    A filter made for it shows what it is worth to know how switching depends on the state
    (section 8.4 of the switching paper's benchmarks). A_il becomes the mean of A_il(X_k) over
    paths in mode i and over the later half of the times.

    Parameters
    ----------
    system : SwitchingSystem
        Symbolic.
    times : array_like, shape (K+1,)
        Long enough for the law to be stationary by half of them.
    paths : int
    seed : int, SeedSequence or Generator

    Returns
    -------
    SwitchingSystem
        With everything else as it was.

    Raises
    ------
    TypeError, ValueError
        A system of array functions; a mode that no path was in; arguments as in `simulate`.
    """
    as_system("system", system, "SwitchingSystem")
    if not system.symbolic:
        raise ValueError("system: wanted a symbolic system, got one of array functions")
    data = system.simulate(times, paths, seed)
    later = range(len(data.times) // 2, len(data.times))
    moves = []
    for i, row in enumerate(system.branches):
        total = np.zeros(len(row))
        for k in later:
            x = data.states[k][:, data.modes[k] == i]
            for l, branch in enumerate(row):
                if branch is not None:
                    total[l] += branch.probability(data.times[k], x).sum()
        if not total.sum() > 0:
            raise ValueError(f"paths: wanted some in mode {i}, got none")
        share, maps = total / total.sum(), system.dynamics
        driven = maps if system.drives == "new" else [maps[i]] * len(maps)
        moves.append([_branch(map, w) for map, w in zip(driven, share, strict=True)])
    readings = [
        [_branch(map, 0) if b is None else b.map for b in row]
        for map, row in zip(system.sensors, system.readings, strict=True)
    ]
    return SwitchingSystem.from_maps(
        moves, readings, system.initial, indicator=system.indicators > 0, drives=system.drives
    )


def _branch(map: StochasticMap, weight: float) -> StochasticMap:
    """A map that applies with a constant probability; 0 stays the integer that means never."""
    weight = float(weight) or 0
    return StochasticMap(map.state, map.expressions, map.noise, weight, time=map.time)
