"""Systems of two state components as chains on a grid of the plane, for theorems 1 and 2."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from seedslib.base.clock import lengths_alike, step_count
from seedslib.base.objects import Shown
from seedslib.base.tables import Axis, AxisLike, as_axes, mesh
from seedslib.base.values import present
from seedslib.models.chains.feller import log_densities
from seedslib.models.jump_diffusion import JumpDiffusion
from seedslib.models.switching import SwitchingSystem

POINTS = 6
"""Nodes that a narrow law is shared between: its moments up to the fifth are kept."""

NARROW = 0.8
"""Deviation, in steps of the grid, below which a law has no density to speak of on the nodes."""

SHIFT = 1e-5
"""Relative shift of a state for the derivative of its drift."""


class PlaneChain(Shown):
    """Diffusion in the plane, seen through a likelihood, whose law moves on a grid.

    The Kolmogorov equation between measurements by splitting: half a substep of the second
    component with the first held, a substep of the first with the second held, and again half a
    substep of the second. Each is the transition law of a scalar diffusion, Gaussian with the
    exact moments of its linear part, so a component that moves linearly when the other is held
    moves without error. Narrow laws are shared between six nodes with their moments up to the
    fifth kept, hence there is no artificial diffusion, and densities may be slightly negative
    where they are small.

    Parameters
    ----------
    system : JumpDiffusion
        Of two components, without jumps, driven by noises that are not correlated with each
        other, and with a sensor that has a density. Its functions do not depend on time.
    axes : two of Axis or (low, high, count)
    substep : float
        Largest substep.

    Attributes
    ----------
    values : ndarray, shape (2, S)
    modes : int
        1.

    Raises
    ------
    ValueError
        A system of another kind.
    """

    modes: int = 1
    _shown = ("axes",)

    def __init__(
        self, system: JumpDiffusion, axes: Sequence[AxisLike], substep: float = 0.1
    ) -> None:
        if system.state_size != 2 or system.jump is not None:
            raise ValueError("system: wanted two state components and no jumps")
        if not system.sensor.has_log_density:
            raise ValueError("system: wanted a sensor with a density")
        self.system: JumpDiffusion = system
        self.axes: tuple[Axis, ...] = as_axes("axes", axes, 2)
        self.values: np.ndarray = mesh(self.axes)
        self.substep: float = float(substep)
        spread = self._spread()
        if np.abs(spread[0, 1]).max() > 0:
            raise ValueError("system: wanted components driven by noises of their own")
        self._known: dict = {}

    def _spread(self) -> np.ndarray:
        """B Bᵀ at the nodes, (2, 2, S)."""
        root = self.system.diffusion(0.0, self.values)
        root = np.broadcast_to(root, (2, self.system.wiener_size, self.values.shape[1]))
        return np.einsum("iwN,jwN->ijN", root, root)

    def start(self) -> np.ndarray:
        """Initial probabilities, shape (S,)."""
        return normal_nodes(self.values, self.system.mean0, self.system.cov0)

    def move(self, law: np.ndarray, start: float, stop: float) -> np.ndarray:
        """Laws (S, C) of the state at a later time, each a column."""
        steps = step_count(start, stop, self.substep)
        first, half = self._kernels(float(lengths_alike((stop - start) / steps)))
        whole = half @ half
        grid = law.reshape(*(axis.count for axis in self.axes), -1)
        for k in range(steps):
            grid = (whole if k else half) @ grid
            grid = (first @ grid.swapaxes(0, 1)).swapaxes(0, 1)
        return np.maximum((half @ grid).reshape(law.shape), 0.0)

    def back(self, values: np.ndarray, start: float, stop: float) -> np.ndarray:
        """Means of functions (p, S) of the later state, given the state at `start`: (p, S)."""
        steps = step_count(start, stop, self.substep)
        first, half = self._kernels(float(lengths_alike((stop - start) / steps)))
        first, half = first.swapaxes(1, 2), half.swapaxes(1, 2)
        grid = values.T.reshape(*(axis.count for axis in self.axes), -1)
        for _ in range(steps):  # the moves of a substep, in the same order, turned over
            grid = (first @ (half @ grid).swapaxes(0, 1)).swapaxes(0, 1)
            grid = half @ grid
        return grid.reshape(values.shape[1], -1).T

    def _kernels(self, length: float) -> tuple[np.ndarray, np.ndarray]:
        """Matrices of the first component (n2, n1, n1) and of half the second (n1, n2, n2)."""
        if length not in self._known:
            square = self._spread()
            found = []
            for i, time in enumerate((length, 0.5 * length)):
                mean, deviation = self._alone(i, time, square[i, i])
                # the other component numbers the matrices
                pair = (mean.T, deviation.T) if i == 0 else (mean, deviation)
                axis = self.axes[i]
                found.append(np.stack([shared(axis, *row) for row in zip(*pair, strict=True)]))
            self._known[length] = found[0], found[1]
        return self._known[length]

    def _alone(self, i: int, time: float, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation (n1, n2) of component i after a time, the other one held."""
        x, aside = self.values, np.zeros((2, 1))
        aside[i] = SHIFT
        speed, up, down = (
            np.broadcast_to(self.system.drift(0.0, at)[i], x.shape[1:])
            for at in (x, x + aside, x - aside)
        )
        slope = (up - down) / (2.0 * SHIFT)
        mean = x[i] + speed * _grown(slope, time)
        deviation = np.sqrt(square * _grown(2.0 * slope, time))
        shape = tuple(axis.count for axis in self.axes)
        return mean.reshape(shape), deviation.reshape(shape)

    def log_likelihood(self, t: float, y: np.ndarray) -> np.ndarray:
        """Logarithm of the density of measurements (m, Y) at each node: (Y, S)."""
        return log_densities(self.system.sensor, t, y, self.values)


class PlaneModes(Shown):
    """Switching system of two state components as a chain on a grid of the plane.

    The states of the chain are the nodes in mode 0, then those in mode 1, and so on.

    Parameters
    ----------
    system : SwitchingSystem
        Of two components, without an indicator, whose moves and readings have densities.
    axes : two of Axis or (low, high, count)
        With steps below the deviations of the noise, which must move both components.

    Attributes
    ----------
    values : ndarray, shape (2, S)
    modes : int

    Raises
    ------
    ValueError
        A system of another kind.
    """

    _shown = ("axes",)

    def __init__(self, system: SwitchingSystem, axes: Sequence[AxisLike]) -> None:
        if system.state_size != 2 or system.indicators:
            raise ValueError("system: wanted two state components and no indicator")
        self.system: SwitchingSystem = system
        self.axes: tuple[Axis, ...] = as_axes("axes", axes, 2)
        self.nodes: np.ndarray = mesh(self.axes)
        self.modes: int = system.modes
        self.values: np.ndarray = np.tile(self.nodes, self.modes)
        self._known: dict = {}

    def start(self) -> np.ndarray:
        """Initial probabilities, shape (S,)."""
        parts = self.system.initial
        return np.concatenate([p * normal_nodes(self.nodes, m, cov) for p, m, cov in parts])

    def move(self, law: np.ndarray, start: float, stop: float) -> np.ndarray:
        """Laws (S, C) after one step, each a column; the functions are those of its start."""
        key = start, *present(self.system.mentions)
        if key not in self._known:
            self._known = {key: [self._leaving(float(start), i) for i in range(self.modes)]}
        count = self.nodes.shape[1]
        parts = zip(self._known[key], law.reshape(self.modes, count, -1), strict=True)
        return sum(kernel @ part for kernel, part in parts).reshape(law.shape)

    def _leaving(self, t: float, i: int) -> np.ndarray:
        """Probabilities (L, S', S) of the next mode and node for each node in mode i."""
        count = self.nodes.shape[1]
        there = np.broadcast_to(self.nodes[:, :, None], (2, count, count))
        here = np.broadcast_to(self.nodes[:, None, :], (2, count, count))
        found = np.zeros((self.modes, count, count))
        for mass, branch in zip(found, self.system.branches[i], strict=True):
            if branch is not None:
                mass[:] = np.exp(branch.log_density(t, there, here))
        return found / found.sum(axis=(0, 1))

    def log_likelihood(self, t: float, y: np.ndarray) -> np.ndarray:
        """Logarithm of the density of measurements (m, Y) at each state: (Y, S)."""
        each = [log_densities(sensor, t, y, self.nodes) for sensor in self.system.sensors]
        return np.concatenate(each, axis=1)


def normal_nodes(values: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Probabilities of the nodes (2, S) for a normal law whose deviations exceed the steps."""
    apart = values - np.asarray(mean)[:, None]
    mass = np.exp(-0.5 * np.einsum("iN,iN->N", apart, np.linalg.solve(cov, apart)))
    return mass / mass.sum()


def shared(axis: Axis, mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Masses (nodes, N) of normal laws: the density where it is wide, else kept moments.

    What a law has beyond the ends of the axis stays in them.
    """
    nodes, size = axis.nodes, axis.count
    mean = np.clip(mean, axis.low, axis.high)
    found = np.zeros((size, len(mean)))
    wide = deviation >= NARROW * axis.step
    found[:, wide] = np.exp(-0.5 * ((nodes[:, None] - mean[wide]) / deviation[wide]) ** 2)
    found[:, wide] /= found[:, wide].sum(axis=0)
    mean, deviation = mean[~wide], deviation[~wide]
    first = np.floor((mean - axis.low) / axis.step).astype(int) - POINTS // 2 + 1
    first = np.clip(first, 0, size - POINTS)
    # three Gauss-Hermite points integrate a polynomial of the fifth degree
    place, weights = np.array([-np.sqrt(3.0), 0.0, np.sqrt(3.0)]), np.array([1.0, 4.0, 1.0]) / 6.0
    at = (mean + deviation * place[:, None] - axis.low) / axis.step - first
    columns = np.flatnonzero(~wide)
    for a in range(POINTS):
        others = [b for b in range(POINTS) if b != a]
        share = np.prod([(at - b) / (a - b) for b in others], axis=0)
        found[first + a, columns] = weights @ share
    return found


def _grown(rate: np.ndarray, time: float) -> np.ndarray:
    """Integral of exp(rate s) over a time."""
    product = rate * time
    safe = np.where(np.abs(product) > 1e-9, product, 1.0)
    return time * np.where(np.abs(product) > 1e-9, np.expm1(product) / safe, 1.0)
