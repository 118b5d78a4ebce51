"""A nonlinear system in discrete time: the next state is a map of the state and of noise."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from seedslib.base.checks import as_covariance, as_shape
from seedslib.models.maps import StochasticMap
from seedslib.models.noise import Noise
from seedslib.models.simulation import Simulation, simulate


@dataclass(frozen=True, eq=False)
class DiscreteSystem:
    """X_k = f(t_k, X_{k-1}, W_k), Y_k = h(t_k, X_k, V_k).

    Parameters
    ----------
    dynamics : StochasticMap
        Evaluated at the time it leads to; one application per step of the time grid.
    sensor : StochasticMap
    mean0, cov0 : array_like, shapes (n,) and (n, n)
        Moments of the initial law, Gaussian unless `initial` is given.
    initial : callable, optional
        ``initial(rng, count) -> (n, count)``.

    Raises
    ------
    TypeError, ValueError
        Maps of different states, a covariance that is not semidefinite.
    """

    dynamics: StochasticMap
    sensor: StochasticMap
    mean0: np.ndarray
    cov0: np.ndarray
    initial: object = None
    state_size: int = field(init=False)
    law: Noise = field(init=False, repr=False)

    def __post_init__(self):
        n = self.dynamics.size
        if self.dynamics.state_size != n or self.sensor.state_size != n:
            raise ValueError(
                f"dynamics, sensor: wanted maps of a state of {n} components, got "
                f"{self.dynamics.state_size} and {self.sensor.state_size}"
            )
        mean0 = as_shape("mean0", self.mean0, (n,))
        cov0 = as_covariance("cov0", self.cov0, n)
        law = Noise(n, mean0, cov0, self.initial)
        for name, value in zip(
            ("state_size", "mean0", "cov0", "law"), (n, mean0, cov0, law), strict=True
        ):
            object.__setattr__(self, name, value)

    def initial_sample(self, rng, count) -> np.ndarray:
        """Draws of the initial state, shape (n, count)."""
        return self.law.draw(rng, count)

    def advance(self, x, start, stop, rng) -> np.ndarray:
        """States of shape (n, *batch) one step later, at time `stop`."""
        return self.dynamics.sample(stop, x, rng)

    def simulate(self, times, paths, seed, *, measured=None, workers=1) -> Simulation:
        """Simulate paths and measurements; see `seedslib.models.simulation.simulate`."""
        return simulate(self, times, paths, seed, measured=measured, workers=workers)
