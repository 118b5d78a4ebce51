"""Switching system: a mode chooses dynamics, sensor and indicator, and the state moves the mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.checks import as_covariance, as_real, as_shape
from seedslib.base.objects import Shown
from seedslib.base.values import Inputs, looked_at
from seedslib.models.branches import branch_table, map_rows, want_probabilities
from seedslib.models.hybrid import Hybrid, simulate_hybrid
from seedslib.models.maps import StochasticMap
from seedslib.models.noise import Noise, named_noise
from seedslib.models.simulation import Simulation


class InitialMode(NamedTuple):
    """Initial law of one mode: its probability, and the Gaussian law of the state in it."""

    probability: float
    mean: np.ndarray
    cov: np.ndarray


class SwitchingSystem(Shown):
    """Discrete-time system of several modes, with switching that may depend on the state.

    In mode i the state moves as X_{k+1} = a_i(t_k, X_k, V_k), the next mode is l with probability
    A_il(t_k, X_k, V_k), and the sensor shows Y_k = b_i(t_k, X_k, W_k) and, if there is one, an
    indicator of value j with probability B_ij(t_k, X_k, W_k). Equations (1.1) to (1.4) of the
    switching paper: the step from k to k + 1 uses the *old* mode and the old time. A probability
    that mentions the noise describes dependent noises V' and V (W' and W). Modes and values of
    the indicator are numbered from 0.

    In the textbooks (Blom and Bar-Shalom, the interacting multiple model filter) the mode switches
    first and the *new* one drives the step: with ``drives="new"`` the next mode is l with
    probability A_il(t_k, X_k), and then X_{k+1} = a_l(t_k, X_k, V_k). Each step is a switch during
    which the state stands still, and a move of each mode without a switch; the noise comes after
    the switch, so the probabilities cannot depend on it.

    Parameters
    ----------
    state : sequence of SymPy symbols, length n
    dynamics : nested sequence of SymPy expressions, shape (L, n)
        a_i, of the state, the noise and the time.
    noise : Noise
        V.
    switching : nested sequence of SymPy expressions, shape (L, L)
        A_il; each row sums to one.
    sensor : nested sequence of SymPy expressions, shape (L, m)
        b_i, of the state, the sensor noise and the time.
    sensor_noise : Noise
        W.
    initial : sequence of (probability, mean, cov), length L
        Law of the mode at the start, and Gaussian law of the state in each.
    indicator : nested sequence of SymPy expressions, shape (L, M), optional
        B_ij; each row sums to one. None where there is no indicator.
    parameters : mapping, optional
        Values of the other symbols.
    time : SymPy symbol, optional
        Name of the time, ``t`` by default.
    drives : {"old", "new"}
        The mode that drives a step.
    period : mapping of int to float, optional
        Components of the measurement that lie on a circle, and their periods.

    Attributes
    ----------
    modes, indicators : int
        L and M; 0 for M where there is no indicator.
    state_size, measurement_size : int
    dynamics, sensors : tuple of StochasticMap, length L
        The maps without their probabilities.
    branches : tuple of tuple of Branch, shape (L, L)
        Move to the next state together with a switch to mode l; None where it never happens.
    readings : tuple of tuple of Branch, shape (L, M)
        Measurement together with value j of the indicator; None where it never happens.
    mean0, cov0 : ndarray, shapes (n,) and (n, n)
        Moments of the initial state over all modes.

    Raises
    ------
    TypeError, ValueError
        Shapes that do not fit, unknown symbols, covariances that are not semidefinite,
        probabilities outside of [0, 1] or that do not sum to one (looked at on points about the
        initial law, where they depend on the state); those of a switch that depend on the noise
        where the new mode drives the step.
    """

    _shown = "state_size", "measurement_size"

    _shown = "state_size", "measurement_size", "modes"
    state: Any
    time: Any
    modes: int
    state_size: int
    measurement_size: int
    noise: Noise
    sensor_noise: Noise

    def __init__(
        self, state: Any, dynamics: Any, noise: Any, switching: Any, sensor: Any, sensor_noise: Any,
        initial: Any, *, indicator: Any = None, parameters: Mapping[Any, Any] | None = None,
        time: Any = None, drives: str = "old", period: Mapping[int, float] | None = None,
    ) -> None:  # fmt: skip
        from seedslib.base.symbols import named_model
        from seedslib.models.codegen import known_expressions

        noise = named_noise("noise", noise)
        sensor_noise = named_noise("sensor_noise", sensor_noise)
        # dynamics and sensor are two maps: a symbol may name the noise of each
        for name, source in (("noise", noise), ("sensor_noise", sensor_noise)):
            self.state, self.time, values = named_model(
                state, time, parameters, **{name: source.symbols}
            )

        def expressions(name, value, shape, source):
            allowed = {self.time, *self.state, *source.symbols}
            return known_expressions(name, value, shape, values, allowed)

        n = len(self.state)
        moves = expressions("dynamics", dynamics, (None, n), noise)
        modes = len(moves)
        leave = expressions("switching", switching, (modes, modes), noise)
        shows = expressions("sensor", sensor, (modes, None), sensor_noise)
        told = [[1]] * modes if indicator is None else indicator
        tells = expressions("indicator", told, (modes, None), sensor_noise)

        def table(values, weights, source, period=None):
            made = partial(StochasticMap, self.state, time=self.time, period=period)
            return [
                [made(row, source, w) for w in weight]
                for row, weight in zip(values, weights, strict=True)
            ]

        moves, readings = (
            table(moves, leave.T if drives == "new" else leave, noise),
            table(shows, tells, sensor_noise, period),
        )
        if drives == "new":  # those of one value are a column: the moves to a mode
            moves = list(zip(*moves, strict=True))
        self._set_up(moves, readings, initial, indicator is not None, drives)

    @classmethod
    def from_maps(
        cls, moves: Any, readings: Any, initial: Any, *, indicator: bool = False,
        drives: str = "old",
    ) -> SwitchingSystem:  # fmt: skip
        """Make a system of maps with probabilities, such as those of array functions.

        Parameters
        ----------
        moves : nested sequence of StochasticMap, shape (L, L)
            Maps with the weights of the switches from mode i to mode l; those of a row have the
            same value, or those of a column where the new mode drives the step.
        readings : nested sequence of StochasticMap, shape (L, M)
            Measurement of mode i, each with the weight of value j of the indicator.
        initial : as in the class
        indicator : bool
            Whether the indicator is seen.
        drives : {"old", "new"}

        Raises
        ------
        TypeError, ValueError
            As the class; no rows of maps, maps of a mode with several values, or maps with several
            noises.
        """
        moves, readings = map_rows("moves", moves), map_rows("readings", readings)
        if not isinstance(indicator, bool | np.bool_):
            raise TypeError(f"indicator: wanted True where it is seen or False, got {indicator!r}")
        self = object.__new__(cls)
        self.state = moves[0][0].state
        self.time = moves[0][0].time
        self._set_up(moves, readings, initial, bool(indicator), drives)
        return self

    def _set_up(
        self, moves: Sequence, readings: Sequence, initial: Sequence, indicator: bool, drives: str
    ) -> None:  # fmt: skip
        if drives not in ("old", "new"):
            raise ValueError(f"drives: wanted 'old' or 'new', got {drives!r}")
        self.drives: str = drives
        if drives == "new":
            self._shown = (*self._shown, "drives")
        self.modes, values = len(moves), len(readings[0])
        self.indicators: int = values if indicator else 0
        if len(readings) != self.modes or any(len(row) != values for row in readings):
            raise ValueError(f"sensor: wanted one row for each of {self.modes} modes")
        if any(len(row) != self.modes for row in moves):
            raise ValueError(f"switching: wanted {self.modes} next modes in each row")
        if not indicator and values != 1:
            raise ValueError("indicator: wanted one column of readings where it is not seen")
        self.noise, self.sensor_noise = moves[0][0].noise, readings[0][0].noise
        self.state_size, self.measurement_size = moves[0][0].state_size, readings[0][0].size
        for name, table in (("dynamics", moves), ("sensor", readings)):
            for each in (m for row in table for m in row):
                if each.state_size != self.state_size:
                    raise ValueError(f"{name}: wanted maps of {self.state_size} components")
        self.initial: tuple[InitialMode, ...] = self._initial_modes(initial)
        probability, means, covs = map(np.array, zip(*self.initial, strict=True))
        self.mean0: np.ndarray = probability @ means
        apart = means - self.mean0
        self.cov0: np.ndarray = np.einsum("l,li,lj->ij", probability, apart, apart)
        self.cov0 += np.einsum("l,lij->ij", probability, covs)
        maps = [m for table in (moves, readings) for row in table for m in row]
        self.mentions: frozenset[Any] = frozenset().union(*(m.mentions for m in maps))
        new, sensed = drives == "new", self.sensor_noise
        with looked_at(self.mentions):
            self.branches: Any = branch_table("switching", moves, *self._probe(self.noise), new)
            self.readings: Any = branch_table("indicator", readings, *self._probe(sensed))
        moved = moves[0] if new else [row[0] for row in moves]
        self.dynamics: tuple[StochasticMap, ...] = tuple(map.whole() for map in moved)
        self.sensors: tuple[StochasticMap, ...] = tuple(row[0].whole() for row in readings)

    def _initial_modes(self, initial: Sequence) -> tuple[InitialMode, ...]:
        initial = list(initial)
        if len(initial) != self.modes:
            raise ValueError(f"initial: wanted {self.modes} modes, got {len(initial)}")
        n, found = self.state_size, []
        for i, part in enumerate(initial):
            try:
                probability, mean, cov = part
            except (TypeError, ValueError):
                raise TypeError(
                    f"initial: wanted (probability, mean, cov) for mode {i}, got {part!r}"
                ) from None
            probability = float(as_real(f"initial[{i}] probability", probability, ndim=0))
            mean = as_shape(f"initial[{i}] mean", mean, (n,))
            found.append(InitialMode(probability, mean, as_covariance(f"initial[{i}] cov", cov, n)))
        want_probabilities("initial", np.array([part.probability for part in found]))
        return tuple(found)

    def _probe(self, noise: Noise) -> tuple[Noise, np.ndarray, np.ndarray]:
        """The noise, and states and noises about the initial law, (n, 64), (noise size, 64)."""
        rng = np.random.default_rng(0)
        spread = np.sqrt(np.diagonal(self.cov0)) + 1e-3
        x = self.mean0[:, None] + 2.0 * spread[:, None] * rng.standard_normal((self.state_size, 64))
        return noise, x, noise.draw(rng, 64)

    @property
    def symbolic(self) -> bool:
        """Whether the system was given as SymPy expressions."""
        return self.state is not None

    @property
    def initial_probabilities(self) -> np.ndarray:
        """Probabilities of the modes at the start, (L,)."""
        return np.array([part.probability for part in self.initial])

    @cached_property
    def indicator_is_blind(self) -> bool:
        """Whether the indicator does not depend on the state (corollaries 3 and 4)."""
        return all(b is None or b.constant for row in self.readings for b in row)

    @cached_property
    def hybrid(self) -> Hybrid:
        """The system as one whose state has the mode as last row, and the measurement J."""
        return Hybrid(self)

    def simulate(
        self, times: ArrayLike, paths: Count, seed: Seed, *, measured: ArrayLike | None = None,
        availability: ArrayLike | None = None, inputs: Inputs | None = None,
        modes: ArrayLike | None = None, workers: int = 1,
    ) -> Simulation:  # fmt: skip
        """Simulate paths, modes, measurements and indicators.

        See `seedslib.models.simulation.simulate`; `modes` (K+1, paths) and, where there is one,
        `indicators` (K+1, paths) are whole numbers from 0, -1 for an indicator not measured.

        Parameters
        ----------
        times, paths, seed, measured, availability, inputs, workers
            As there.
        modes : array_like of int, shape (K+1,) or (K+1, paths), optional
            A course of the modes that is imposed on the paths, as in the truth of a benchmark:
            nothing is switched, and the probabilities of switches are not looked at. The noises
            are those of the same seed without it.

        Raises
        ------
        TypeError, ValueError
            As there; modes of a system whose switching depends on the noise, which would have
            another law.
        """
        return simulate_hybrid(
            self,
            times,
            paths,
            seed,
            measured=measured,
            availability=availability,
            inputs=inputs,
            modes=modes,
            workers=workers,
        )
