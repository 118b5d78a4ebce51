"""A switching system seen as one with a mixed state: the mode is its last row.

Simulation, designs and particle filters move paths of any system that can be sampled; in this
form a switching system is one. Noises and choices of branches have streams of their own, so that
path i of a small run is path i of a large one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.bundles import Source, drawn, normal
from seedslib.base.checks import as_count, as_whole
from seedslib.base.semidefinite import factor
from seedslib.base.values import on_paths
from seedslib.models.kinds import as_grid, elapsed
from seedslib.models.noise import lower_times
from seedslib.models.simulation import Simulation, simulate

if TYPE_CHECKING:
    from seedslib.models.switching import SwitchingSystem


class Hybrid:
    """Mixed state (n + 1, *batch) with the mode as last row, as a number.

    Parameters
    ----------
    system : SwitchingSystem

    Attributes
    ----------
    state_size : int
        n + 1.
    measurement_size : int
        m, or m + 1 where an indicator is shown.
    sensor : HybridSensor
    mean0 : ndarray, shape (n + 1,)
        A harmless mixed state.
    """

    def __init__(self, system: SwitchingSystem) -> None:
        self.system: SwitchingSystem = system
        self.state_size: int = system.state_size + 1
        self.sensor: HybridSensor = HybridSensor(system)
        self.indicators: int = system.indicators
        self.measurement_size: int = self.sensor.size
        # of the numbers the user gave, so no rounding decides; it is a stand-in for lost paths only
        likely = system.initial[int(np.argmax(system.initial_probabilities))]
        self.mean0: np.ndarray = np.append(
            likely.mean, float(np.argmax(system.initial_probabilities))
        )
        self.initial_laws: list[Any] = [(part.mean, factor(part.cov)) for part in system.initial]

    def initial_sample(
        self, rng: Source, count: int, told: np.ndarray | None = None
    ) -> np.ndarray:  # fmt: skip
        """Draws of mode and state, shape (n + 1, count); in the modes `told`, (count,), if any."""
        bounds = np.cumsum(self.system.initial_probabilities)
        moving, choosing = rng.spawn(2)
        mode = _chosen(bounds[:-1, None], drawn(choosing, count, Generator.random))
        mode = mode if told is None else told
        noise = normal(moving, self.system.state_size, count)
        x = np.empty((self.state_size, count))
        for i, (mean, root) in enumerate(self.initial_laws):
            here = mode == i
            x[:-1, here] = mean[:, None] + lower_times(root, noise[:, here])
        x[-1] = mode
        return x

    def advance(
        self, x: np.ndarray, start: float, stop: float, rng: Source, told: np.ndarray | None = None
    ) -> np.ndarray:  # fmt: skip
        """Mixed states (n + 1, *batch) one step later; the noises are those of the old time.

        The new modes are drawn, unless they are `told`, (*batch).
        """
        flat, old_drives = x.reshape(len(x), -1), self.system.drives == "old"
        moving, choosing = rng.spawn(2)
        v = self.system.noise.draw(moving, flat.shape[1])
        choice = drawn(choosing, flat.shape[1], Generator.random)
        moved = np.empty_like(flat)
        for i, row in enumerate(self.system.branches):
            here = flat[-1] == i
            old, noise = flat[:-1, here], v[:, here]
            with elapsed(self, start, stop), on_paths(x.shape[1:], here):
                if old_drives:
                    moved[:-1, here] = self.system.dynamics[i].value(start, old, noise)
                if told is None:
                    moved[-1, here] = _branch(row, start, old, noise, choice[here])
        if told is not None:
            moved[-1] = told.ravel()
        if not old_drives:
            for l, map in enumerate(self.system.dynamics):
                here = moved[-1] == l
                with elapsed(self, start, stop), on_paths(x.shape[1:], here):
                    moved[:-1, here] = map.value(start, flat[:-1, here], v[:, here])
        return moved.reshape(x.shape)


class HybridSensor:
    """Measurement (m, *batch) of a mixed state, with the indicator as last row if there is one."""

    def __init__(self, system: SwitchingSystem) -> None:
        self.system: SwitchingSystem = system
        self.size: int = system.measurement_size + (system.indicators > 0)

    @property
    def has_log_density(self) -> bool:
        """Whether all readings have a density in closed form."""
        return all(b is None or b.has_log_density for row in self.system.readings for b in row)

    def sample(self, t: float, x: np.ndarray, rng: Source) -> np.ndarray:
        """One draw for each mixed state, shape (m or m + 1, *batch)."""
        system, flat = self.system, x.reshape(len(x), -1)
        sensing, choosing = rng.spawn(2)
        w = system.sensor_noise.draw(sensing, flat.shape[1])
        y = np.empty((self.size, flat.shape[1]))
        choice = drawn(choosing, flat.shape[1], Generator.random) if system.indicators else None
        for i, row in enumerate(system.readings):
            here = flat[-1] == i
            state, noise = flat[:-1, here], w[:, here]
            with on_paths(x.shape[1:], here):
                y[: system.measurement_size, here] = system.sensors[i].value(t, state, noise)
                if system.indicators:
                    y[-1, here] = _branch(row, t, state, noise, choice[here])
        return y.reshape(self.size, *x.shape[1:])

    def log_density(self, t: float, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Logarithm of the density of a measurement with its indicator, shape (*batch).

        NaN is a missing component; an indicator that is NaN is missing too.
        """
        system = self.system
        batch = np.broadcast_shapes(y.shape[1:], x.shape[1:])
        y, x = np.broadcast_to(y, (len(y), *batch)), np.broadcast_to(x, (len(x), *batch))
        found = np.full(batch, -np.inf)
        for i, row in enumerate(system.readings):
            here = x[-1] == i
            if not system.indicators:
                with on_paths(batch, here):
                    found[here] = row[0].log_density(t, y[:, here], x[:-1, here])
                continue
            unseen = here & np.isnan(y[-1])
            if unseen.any():
                with on_paths(batch, unseen):
                    shown, known = y[:-1, unseen], x[:-1, unseen]
                    found[unseen] = system.sensors[i].log_density(t, shown, known)
            for j, branch in enumerate(row):
                both = here & (y[-1] == j)
                if branch is not None and both.any():
                    with on_paths(batch, both):
                        found[both] = branch.log_density(t, y[:-1, both], x[:-1, both])
        return found


def simulate_hybrid(
    system: Any, times: ArrayLike, paths: Count, seed: Seed, *, modes: ArrayLike | None = None,
    **options: Any,
) -> Simulation:  # fmt: skip
    """Simulate a switching system, its modes and indicators apart from the numbers."""
    told = None
    if modes is not None:
        if any(b is not None and b.depends_on_noise for row in system.branches for b in row):
            raise ValueError("modes: wanted none, for the switching depends on the noise")
        steps = len(as_grid("times", times, system))
        paths = as_count("paths", paths)
        told = np.asarray(modes)
        if told.ndim == 1:
            told = np.repeat(told[:, None], paths, axis=1)
        told = as_whole("modes", told, (steps, paths))
        if not ((told >= 0) & (told < system.modes)).all():
            raise ValueError(f"modes: wanted numbers from 0 to {system.modes - 1}, got others")
    made = simulate(system.hybrid, times, paths, seed, told=told, **options)
    m, shown = system.measurement_size, made.measurements
    indicators, modes = None, made.states[:, -1].astype(int)
    if system.indicators:
        indicators = np.where(np.isnan(shown[:, m]), -1.0, shown[:, m]).astype(int)
    return Simulation(made.times, made.states[:, :-1], shown[:, :m], modes, indicators)


def _branch(
    row: tuple, t: float, x: np.ndarray, noise: np.ndarray, choice: np.ndarray
) -> np.ndarray:
    """Number of the branch that each uniform number chooses."""
    weights = np.zeros((len(row), x.shape[1]))
    for weight, branch in zip(weights, row, strict=True):
        if branch is not None:
            weight[:] = branch.map.weight(t, x, noise)
    return _chosen(np.cumsum(weights, axis=0)[:-1], choice)


def _chosen(bounds: np.ndarray, choice: np.ndarray) -> np.ndarray:
    """How many of the bounds lie at or below each number."""
    return (bounds <= choice).sum(axis=0)
