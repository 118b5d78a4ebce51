"""Mode and state of a scalar switching system as a chain on a grid."""

from __future__ import annotations

import numpy as np

from seedslib.base.objects import Shown
from seedslib.base.parameters import current
from seedslib.base.tables import Axis, AxisLike
from seedslib.models.branches import parameters_in
from seedslib.models.chains.discrete import DiscreteChain
from seedslib.models.chains.feller import (
    FellerChain,
    cell_masses,
    normal_masses,
    sensor_reach,
    want_scalar,
    warn_at_ends,
)
from seedslib.models.kinds import in_steps, switches
from seedslib.models.switching import SwitchingSystem


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
        self._moving = parameters_in(system.branches)
        self._known: dict = {}

    def start(self) -> np.ndarray:
        """Initial probabilities, shape (S,)."""
        laws = ((p, mean[0], np.sqrt(cov[0, 0])) for p, mean, cov in self.system.initial)
        return np.concatenate([p * normal_masses(self.axis, mean, dev) for p, mean, dev in laws])

    def transition(self, start: float, stop: float) -> np.ndarray:
        """Transition matrix P, p(next) = P p(now), from the time `start`; columns sum to one."""
        key = None if self._steady else float(start), *current(self._moving)
        if key not in self._known:
            count = self.axis.count
            found = np.zeros((self.modes, count, self.modes, count))
            for i in range(self.modes):
                found[:, :, i] = self._leaving(float(start), i)
            self._known[key] = found.reshape(self.modes * count, -1)
        return self._known[key]

    def _leaving(self, t: float, i: int) -> np.ndarray:
        """Probabilities of the next mode and node (L, S') for each node (S) of mode i."""
        x, row = self.axis.nodes[None], self.system.branches[i]
        mean, deviation = sensor_reach(self.system.dynamics[i], t, x)
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
        logs = np.full((self.modes, *shape[1:]), -np.inf)
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


def chain_of(system: object, axis: AxisLike) -> DiscreteChain | FellerChain | SwitchingChain:
    """The chain of a scalar system of any kind."""
    want_scalar(system)
    if switches(system):
        return SwitchingChain(system, axis)
    return DiscreteChain(system, axis) if in_steps(system) else FellerChain(system, axis)
