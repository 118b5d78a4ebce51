"""Mode and state of a scalar switching system as a chain on a grid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from seedslib.base.objects import Shown
from seedslib.base.tables import Axis, AxisLike
from seedslib.base.values import present
from seedslib.models.branches import Branch
from seedslib.models.chains.discrete import DiscreteChain
from seedslib.models.chains.feller import (
    FellerChain,
    cell_masses,
    normal_masses,
    sensor_reach,
    want_scalar,
    warn_at_ends,
)
from seedslib.models.kinds import elapsed, in_steps, switches
from seedslib.models.maps import StochasticMap
from seedslib.models.switching import SwitchingSystem

KEPT = 64
"""Transitions that are kept, of times or of values of inputs."""


class SwitchingChain(Shown):
    """Scalar switching system as a chain that is seen through a likelihood.

    The states of the chain are the nodes of the state in mode 0, then those in mode 1, and so on.
    (1.3) and (1.4) of the switching paper on the nodes.

    Parameters
    ----------
    system : SwitchingSystem
        With one state component, and moves and readings that have densities in closed form.
    axis : Axis
        Nodes of the state. Their range should hold all but a millionth of the probability: columns
        of the transition are normalised, so what would leave it is spread over its nodes.

    Attributes
    ----------
    values : ndarray, shape (1, S)
        State at each node, the nodes repeated for each mode.
    modes, indicators : int
        L, and M or 0 without an indicator.

    Raises
    ------
    ValueError
        More than one state component, or no density.
    """

    loses: bool = False
    _shown = ("axis",)

    def __init__(self, system: SwitchingSystem, axis: AxisLike) -> None:
        want_scalar(system)
        for name, table in (("dynamics", system.branches), ("sensor", system.readings)):
            if not all(b is None or b.has_log_density for row in table for b in row):
                raise ValueError(
                    f"{name}: wanted values affine in Gaussian noise or with a log_density, got "
                    "one whose density has no closed form"
                )
        self.system: SwitchingSystem = system
        self.axis: Axis = Axis.of("axis", axis)
        self.modes: int = system.modes
        self.indicators: int = system.indicators
        self.values: np.ndarray = np.tile(self.axis.nodes, self.modes)[None]
        self._known: dict = {}

    def start(self) -> np.ndarray:
        """Initial probabilities, shape (S,)."""
        laws = ((p, mean[0], np.sqrt(cov[0, 0])) for p, mean, cov in self.system.initial)
        return np.concatenate([p * normal_masses(self.axis, mean, dev) for p, mean, dev in laws])

    def transition(self, start: float, stop: float) -> np.ndarray:
        """Transition matrix P, p(next) = P p(now), from the time `start`; columns sum to one."""
        with elapsed(self.system, start, stop):
            return self._transition(start)

    def _transition(self, start: float) -> np.ndarray:
        key = None if self._steady else float(start), *present(self.system.mentions)
        if key not in self._known:
            if len(self._known) >= KEPT:
                self._known.clear()
            count = self.axis.count
            found = np.zeros((self.modes, count, self.modes, count))
            maps, table = self.system.dynamics, self.system.branches
            if self.system.drives == "new":  # the switch at each node, and the move of the new mode
                x = self.axis.nodes[None]
                moves = [self._leaving(float(start), map, [Branch(map)])[0] for map in maps]
                for i, l in np.ndindex(self.modes, self.modes):
                    if (branch := table[i][l]) is not None:
                        found[l, :, i] = moves[l] * branch.probability(float(start), x)
            else:
                for i, (map, row) in enumerate(zip(maps, table, strict=True)):
                    found[:, :, i] = self._leaving(float(start), map, row)
            self._known[key] = found.reshape(self.modes * count, -1)
        return self._known[key]

    def _leaving(self, t: float, map: StochasticMap, row: Sequence[Branch | None]) -> np.ndarray:
        """Probabilities (branches, S', S) of the branches of a map and the next node."""
        x = self.axis.nodes[None]
        mean, deviation = sensor_reach(map, t, x)
        if (deviation < self.axis.step).any():
            if any(b is not None and b.depends_on_noise for b in row):
                raise ValueError(
                    f"x: wanted a step below the deviation {deviation.min():g} of the noise, "
                    "which the switching depends on"
                )
            masses = cell_masses(self.axis, mean[0], deviation[0])
            shares = [0.0 if b is None else b.probability(t, x) for b in row]
            return np.stack([share * masses for share in shares])
        shape = (1, self.axis.count, self.axis.count)
        there = np.broadcast_to(x[:, :, None], shape)
        here = np.broadcast_to(x[:, None, :], shape)
        logs = np.full((len(row), *shape[1:]), -np.inf)
        for log, branch in zip(logs, row, strict=True):
            if branch is not None:
                log[:] = branch.log_density(t, there, here)
        # a state that moves far beyond the ends goes to the node that is the least far away
        masses = np.exp(logs - logs.max(axis=(0, 1)))
        return masses / masses.sum(axis=(0, 1))

    @property
    def _steady(self) -> bool:
        """Whether the moves are the same at all times, as far as expressions tell."""
        maps = [b.map for row in self.system.branches for b in row if b is not None]
        if not all(map.symbolic for map in maps):
            return False
        parts = [e for map in maps for e in (map.weight_expression, *map.expressions)]
        return not any(e.has(self.system.time) for e in parts)

    def log_likelihood(self, t: float, shown: np.ndarray) -> np.ndarray:
        """Logarithm of the density of measurements (m, Y) at each state: (Y, S).

        Where there is an indicator, its values are the first row, (1 + m, Y); -1 is a missing one.
        """
        system, count = self.system, self.axis.count
        told = shown[0] if self.indicators else np.zeros(shown.shape[1])
        y = shown[1:] if self.indicators else shown
        found = np.full((shown.shape[1], self.modes, count), -np.inf)
        for j in np.unique(told):
            here = np.flatnonzero(told == j)
            part, x = y[:, here, None], self.axis.nodes[None, None]
            for i in range(self.modes):
                reading = system.sensors[i] if j < 0 else system.readings[i][int(j)]
                if reading is not None:
                    found[here, i] = reading.log_density(t, part, x)
        return found.reshape(len(found), -1)

    def told(self, t: float) -> np.ndarray:
        """Probability of each value of the indicator at each state, and one for none: (M+1, S).

        What is known without a measurement; (1, S) where there is no indicator.
        """
        x = self.axis.nodes[None]
        found = np.ones((self.indicators + 1, self.modes, self.axis.count))
        for j in range(self.indicators):
            for i, row in enumerate(self.system.readings):
                found[j, i] = 0.0 if row[j] is None else row[j].probability(t, x)
        return found.reshape(len(found), -1)

    def reach(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation of the measurement at each state, both (m, S)."""
        x = self.axis.nodes[None]
        parts = [sensor_reach(sensor, t, x) for sensor in self.system.sensors]
        return tuple(np.concatenate(part, axis=1) for part in zip(*parts, strict=True))

    def look_at_ends(self, mass: np.ndarray) -> None:
        """Warn where the probability reaches the ends of the grid; mass of shape (S,)."""
        warn_at_ends(mass.reshape(self.modes, -1).sum(axis=0))


def chain_of(system: object, axis: Any) -> DiscreteChain | FellerChain | SwitchingChain:
    """The chain of a scalar system of any kind; only that of a `DiscreteSystem` takes `Nodes`."""
    want_scalar(system)
    if switches(system):
        return SwitchingChain(system, axis)
    return DiscreteChain(system, axis) if in_steps(system) else FellerChain(system, axis)
