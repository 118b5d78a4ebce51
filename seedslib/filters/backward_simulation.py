"""Backward simulation: trajectories drawn from the particles of a filter, last time first."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.blocks import child
from seedslib.base.semidefinite import factor
from seedslib.filters.backward import Smoother
from seedslib.filters.estimates import Estimates
from seedslib.filters.particle import ParticleState
from seedslib.filters.weights import most_probable, relative
from seedslib.models.kinds import in_steps, switches
from seedslib.models.linear import LinearMap

BACKWARDS = 1 << 31
"""First number of the streams backwards: no filter makes so many draws forwards."""

ENTRIES = 1 << 20
"""Densities that are worked on together."""


class Drawn(NamedTuple):
    """Trajectories (n, trajectories, *batch) at one time, and how often the last state had drawn.

    Those of a switching system have the mode as last row.
    """

    x: np.ndarray
    end: int


class BackwardSimulation(Smoother):
    """Trajectories of the particle filter, drawn backwards (Godsill, Doucet and West 2004).

    A trajectory starts at a particle of the last time. Each step back it takes a particle of the
    time before, with a probability proportional to the density of the move from there to where
    it is. The particles are those after resampling, whose weights are equal. The price of a step
    is that of particles times trajectories densities.

    Parameters
    ----------
    filter : ParticleFilter
    trajectories : int

    Raises
    ------
    ValueError
        A system whose moves have no log-density.
    """

    def __init__(self, filter: Any, trajectories: int) -> None:
        super().__init__(filter)
        self.trajectories: int = trajectories
        system = filter.system
        if not in_steps(system):
            raise ValueError(
                "filter: wanted particles of a system that moves with a log-density, got a "
                f"{type(system).__name__}, which has none between measurements; smooth with "
                "assumed_density or extended_kalman, or give a DiscreteSystem of its steps"
            )
        maps = [system.dynamics]
        if switches(system):
            maps = [b for row in system.branches for b in row if b is not None]
        if not all(map.has_log_density for map in maps):
            raise ValueError(
                "filter: wanted particles of a system that moves with a log-density (noise that is "
                "Gaussian and enters linearly, or a given log_density), got one without; smooth "
                "with unscented_kalman or KnownModeFilter"
            )
        wholes = [map.whole for map in maps] if switches(system) else maps
        # a log-density that was given is believed
        given = [not map.symbolic and not isinstance(map, LinearMap) for map in wholes]
        self._covs = [m.conditional.cov for m, g in zip(wholes, given, strict=True) if not g]

    def last(self, state: ParticleState) -> Drawn:
        """See `Smoother.last`.

        Raises
        ------
        ValueError
            Noise that leaves a direction of the state alone: then there is no density.
        """
        x, count = state.particles, len(state.mean)
        for cov in self._covs:
            spread = np.asarray(cov(state.time, x[:count].reshape(count, -1)[:, 0]))
            if not (np.einsum("ii...->i...", factor(spread)) > 0).all():
                raise ValueError(
                    "filter: wanted particles of a system whose noise moves every direction of "
                    "the state, got one that moves some without noise; smooth with "
                    "extended_kalman or unscented_kalman"
                )
        chance = self._uniform(state, state.draws, x.shape[2:])
        return Drawn(_taken(x, (chance * x.shape[1]).astype(int)), state.draws)

    def back(
        self, state: ParticleState, part: Drawn, link: Any, indicator: MaybeArray = None
    ) -> Drawn:
        """See `Smoother.back`."""
        x, later = state.particles, part.x
        chance = self._uniform(state, part.end, x.shape[2:])
        chosen = np.empty(chance.shape, dtype=int)
        width = max(1, ENTRIES // x[0].size)
        for a in range(0, self.trajectories, width):
            some = slice(a, a + width)
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                log = self._moved(state.time, later[:, None, some], x[:, :, None])
            weight, _, lost = relative(np.where(np.isfinite(log), log, -np.inf), 0)
            edges = np.cumsum(np.where(lost, 1.0, weight), axis=0)
            chosen[some] = (edges[:-1] <= chance[some] * edges[-1]).sum(axis=0)
        return Drawn(_taken(x, chosen), part.end)

    def lost(self, state: ParticleState) -> np.ndarray:
        """Where no particle has explained a measurement."""
        return state.diverged

    def report(self, part: Drawn) -> Estimates:
        """Moments over the trajectories, and how many are in each mode."""
        x = part.x
        mean, cov, prob = self.filter.estimate(x, np.full(x.shape[1:], 1.0 / x.shape[1]))
        return Estimates(mean, cov, prob, modes=None if prob is None else most_probable(prob))

    def _uniform(self, state, end, batch):
        """Numbers that choose, (trajectories, *batch): of the steps back to a state from an end."""
        stream = child(state.seed, BACKWARDS, end, state.draws)
        return np.random.default_rng(stream).random((self.trajectories, *batch))

    def _moved(self, t, later, x):
        """Logarithm of the density of a move from x to a later state, (particles, chosen...)."""
        system = self.filter.system
        if not switches(system):
            return system.dynamics.log_density(t, later, x)
        batch = np.broadcast_shapes(later.shape[1:], x.shape[1:])
        later, x = (np.broadcast_to(part, (len(part), *batch)) for part in (later, x))
        found = np.full(batch, -np.inf)
        for i, row in enumerate(system.branches):
            for l, branch in enumerate(row):
                here = (x[-1] == i) & (later[-1] == l)
                if branch is not None and here.any():
                    found[here] = branch.log_density(t, later[:-1, here], x[:-1, here])
        return found


def _taken(x: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Particles (n, chosen, *batch) by their numbers."""
    return np.take_along_axis(x, chosen[None], axis=1)
