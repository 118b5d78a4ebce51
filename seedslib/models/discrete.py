"""A nonlinear system in discrete time: the next state is a map of the state and of noise."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Array, Count, Seed
from seedslib.base.blocks import Source
from seedslib.base.checks import brief
from seedslib.base.objects import Pickled
from seedslib.base.values import Values, in_order, require_no_step
from seedslib.models.first_state import Started
from seedslib.models.maps import Noise, StochasticMap, warn_of_angles
from seedslib.models.simulation import Simulation, simulate


@dataclass(frozen=True, eq=False, repr=False)
class DiscreteSystem(Started, Pickled):
    """X_{k+1} = f(t_k, X_k, W_k), Y_k = h(t_k, X_k, V_k).

    The dynamics are evaluated at the time they leave, as those of a `SwitchingSystem`, and the
    sensor at the time of the measurement. Dynamics that mention `seedslib.base.ELAPSED` see how
    long their step is, and move the state over steps of any length.

    Parameters
    ----------
    dynamics : StochasticMap
        f, evaluated at the time it leaves; one application per step of the time grid.
    sensor : StochasticMap
    mean0, cov0 : array_like, shapes (n,) and (n, n)
        Moments of the initial distribution, Gaussian unless `initial` is given; numbers will do
        for one component. Entries may be SymPy expressions in parameters, as the variance
        ``q / (1 - phi**2)`` of a stationary process.
    initial : callable, optional
        ``initial(rng, count) -> (n, count)``.

    Raises
    ------
    TypeError, ValueError
        Maps of different states, a state of one map that is a noise of the other, a sensor that
        mentions the elapsed time, a covariance that is not semidefinite.
    """

    dynamics: StochasticMap
    sensor: StochasticMap
    mean0: Array
    cov0: Array
    initial: object = None
    state_size: int = field(init=False)
    prior: Noise = field(init=False, repr=False)
    indicators = 0

    def __post_init__(self) -> None:
        for name, map in (("dynamics", self.dynamics), ("sensor", self.sensor)):
            if not isinstance(map, StochasticMap):
                raise TypeError(f"{name}: wanted a StochasticMap, got {brief(map)}")
        n = self.dynamics.size
        if self.dynamics.state_size != n or self.sensor.state_size != n:
            raise ValueError(
                f"dynamics, sensor: wanted maps of a state of {n} components, got "
                f"{self.dynamics.state_size} and {self.sensor.state_size}"
            )
        self._require_names()
        first = self._start(self.mean0, self.cov0, self.initial, n)
        vars(self)["state_size"] = n
        require_no_step("sensor", self.sensor.mentions)
        warn_of_angles(self.sensor)
        parameters = in_order((*self.dynamics.mentions, *self.sensor.mentions, *first))
        dynamics, sensor = (map.taking(parameters) for map in (self.dynamics, self.sensor))
        vars(self).update(parameters=parameters, numbers={}, dynamics=dynamics, sensor=sensor)

    def _require_names(self) -> None:
        maps = [map for map in (self.dynamics, self.sensor) if map.symbolic]
        if maps:
            from seedslib.base.symbols import require_distinct

            parts = ([m.state for m in maps], [m.noise.symbols for m in maps])
            state, noise = (dict.fromkeys(s for part in group for s in part) for group in parts)
            require_distinct(state=state, noise=noise)

    @property
    def measurement_size(self) -> int:
        """Number of measured components."""
        return self.sensor.size

    def advance(
        self, x: np.ndarray, start: float, stop: float, rng: Source, p: Values | None = None
    ) -> np.ndarray:
        """States of shape (n, *batch) one step later; the dynamics are those of time `start`.

        The numbers `p` of the parameters are the system's own by default.
        """
        p = self.values(dt=stop - start) if p is None else p
        return self.dynamics.sample(start, x, rng, p)

    def simulate(self, times: ArrayLike, paths: Count, seed: Seed, **options: Any) -> Simulation:
        """Simulate paths and measurements; see `seedslib.models.simulation.simulate`."""
        return simulate(self, times, paths, seed, **options)
