"""A system in discrete time as a chain on nodes: what leaves them is dropped, never put back."""

from __future__ import annotations

import numpy as np

from seedslib.base.nodes import Grid, Nodes, as_grids
from seedslib.base.objects import Shown
from seedslib.base.tables import Axis, locate, mesh
from seedslib.base.values import present
from seedslib.models.chains.feller import log_densities, sensor_reach, warn_at_ends
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.kinds import elapsed

SINGULAR = 1e-12
"""Determinant of a noise's correlations below which it does not move all components."""


class DiscreteChain(Shown):
    """Discrete system of one or two state components as a chain seen through a likelihood.

    Means over the state are quadrature on the nodes, p'(x') = sum of w p(x' | x) p(x). On evenly
    spaced nodes the trapezoid rule converges faster than any power of the step for smooth
    densities; a step of half of the noise's deviation leaves rounding. No column is normalised:
    what leaves the nodes is lost, and likelihoods say so.

    Parameters
    ----------
    system : DiscreteSystem
        Of one or two components, each moved by noise of its own, whose next state and measurement
        have densities.
    axes : Axis, (low, high, count) or Nodes, or two of them
        Nodes of the state.

    Attributes
    ----------
    values : ndarray, shape (n, S)
        State at each node, the last component fastest.
    weights : ndarray, shape (S,)
    modes, indicators : int
        1 and 0: there are neither.
    loses : bool
        True: columns of the transition need not sum to one.

    Raises
    ------
    ValueError
        More components, no density, an initial law that is not Gaussian.
    """

    modes: int = 1
    indicators: int = 0
    loses: bool = True

    _shown = ("axes",)

    def __init__(self, system: DiscreteSystem, axes: Grid) -> None:
        n = system.state_size
        if n > 2:
            raise ValueError(
                f"system: wanted one or two state components, got {n}; see ParticleFilter"
            )
        for name, map in (("dynamics", system.dynamics), ("sensor", system.sensor)):
            if not map.has_log_density:
                raise ValueError(
                    f"{name}: wanted values affine in noise with a density or with a log_density, "
                    "got one whose density has no closed form"
                )
        if not system.law.gaussian:
            raise ValueError("system: wanted a Gaussian initial law, got one that is only sampled")
        self.system: DiscreteSystem = system
        self.axes: tuple[Axis | Nodes, ...] = as_grids("x", axes, n)
        self.values: np.ndarray = mesh(self.axes)
        self.weights: np.ndarray = np.ones(1)
        for axis in self.axes:
            self.weights = np.outer(self.weights, axis.weights).ravel()
        map = system.dynamics
        self._steady = map.symbolic and not any(e.has(map.time) for e in map.expressions)
        self._known: tuple = (None, None)

    def start(self) -> np.ndarray:
        """Initial masses, shape (S,).

        A state that is known is exact at a node and otherwise shared between those about it.

        Raises
        ------
        ValueError
            A law that is neither known nor has a density.
        """
        mean, cov = self.system.mean0, self.system.cov0
        if not cov.any():
            place = locate(self.axes, list(mean))
            return np.array([place.linear(row) for row in np.eye(len(self.weights))])
        _want_spread("cov0", cov[:, :, None])
        apart = self.values - mean[:, None]
        square = np.einsum("iS,iS->S", apart, np.linalg.solve(cov, apart))
        root = np.sqrt(np.linalg.det(2.0 * np.pi * cov))
        return self.weights * np.exp(-0.5 * square) / root

    def transition(self, start: float, stop: float) -> np.ndarray:
        """Masses P (S, S) at `stop` of those at `start`, p(next) = P p(now).

        Formulas are evaluated at the present values of the parameters that they mention.

        Raises
        ------
        ValueError
            A component without noise; a parameter that has a value for each path.
        """
        map = self.system.dynamics
        with elapsed(self.system, start, stop):
            key = None if self._steady else float(start), *present(map.mentions)
            if not map.symbolic:
                return self._leaving(float(start))
            if self._known[0] != key:
                self._known = key, self._leaving(float(start))
            return self._known[1]

    def _leaving(self, t: float) -> np.ndarray:
        x, map = self.values, self.system.dynamics
        if map.gaussian_density:
            if len(x) == 1 and not map.period:
                return self._gaussian(*(part[0] for part in sensor_reach(map, t, x)))
            _want_spread("dynamics", map.conditional_moments(t, x)[1])
        shape = (len(x), x.shape[1], x.shape[1])
        there, here = (np.broadcast_to(part, shape) for part in (x[:, :, None], x[:, None, :]))
        return self.weights[:, None] * np.exp(map.log_density(t, there, here))

    def _gaussian(self, mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
        _want_spread("dynamics", deviation[None, None])
        found = self.values.T - mean
        found /= deviation
        found *= found
        found *= -0.5
        np.exp(found, out=found)
        found *= self.weights[:, None]
        found /= np.sqrt(2.0 * np.pi) * deviation
        return found

    def move(self, law: np.ndarray, start: float, stop: float) -> np.ndarray:
        """Masses (S, C) after one step, each a column."""
        return self.transition(start, stop) @ law

    def log_likelihood(self, t: float, y: np.ndarray) -> np.ndarray:
        """Logarithm of the density of measurements (m, Y) at each node: (Y, S)."""
        present(self.system.sensor.mentions)  # one number each
        return log_densities(self.system.sensor, t, y, self.values)

    def reach(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation of the measurement at each node, both (m, S)."""
        return sensor_reach(self.system.sensor, t, self.values)

    def look_at_ends(self, mass: np.ndarray) -> None:
        """Warn where the probability reaches the ends of the grid; mass of shape (S,)."""
        warn_at_ends(mass)


def _want_spread(name: str, cov: np.ndarray) -> None:
    """Refuse covariances (n, n, S), or deviations (1, 1, S), that leave a component unmoved."""
    spread = np.einsum("iiS->iS", cov)
    unit = np.sqrt(np.where(spread > 0, spread, 1.0))
    det = np.linalg.det(np.moveaxis(cov / unit[:, None] / unit[None, :], -1, 0))
    if not ((spread > 0).all() and (det > SINGULAR).all()):
        raise ValueError(
            f"{name}: wanted noise of its own in every state component for a grid, got none in "
            "some direction"
        )
