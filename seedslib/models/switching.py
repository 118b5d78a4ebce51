"""Switching system: a mode chooses dynamics, sensor and indicator, and the state moves the mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import Source, drawn, normal
from seedslib.base.checks import (
    as_count,
    as_covariance,
    as_real,
    as_whole,
    brief,
    require_shape,
)
from seedslib.base.clock import when
from seedslib.base.linalg import cholesky
from seedslib.base.objects import Pickled
from seedslib.base.values import Parametrized, Values, in_order, of_paths, require_no_step
from seedslib.models.kinds import as_grid
from seedslib.models.maps import Noise, StochasticMap, lower_times, named_noise, warn_of_angles
from seedslib.models.simulation import Simulation, simulate

if TYPE_CHECKING:
    import sympy

    from seedslib.base.symbols import Parameter

CLOSE = 1e-9
"""Probabilities may miss their sum or their range by this much."""


class Branch(Pickled):
    """One branch of a switching map: y = value(t, x, v), taken with probability w(t, x, v).

    Parameters
    ----------
    map : StochasticMap
        Of formulas, with its weight.

    Attributes
    ----------
    map, whole : StochasticMap
        With the weight, and without.
    """

    def __init__(self, map: StochasticMap) -> None:
        self.map: StochasticMap = map
        self.whole: StochasticMap = map.with_weight(1) if map.weighted else map

    @cached_property
    def switch_only(self) -> Branch:
        """The switch alone, the state left where it is; of a probability without noise."""
        map = self.map
        made = StochasticMap(map.state, map.state, None, map.weight_expression, time=map.time)
        return Branch(made.taking(map.parameters))

    @cached_property
    def constant(self) -> bool:
        """Whether the probability depends on neither state nor noise."""
        map = self.map
        return not map.weight_expression.free_symbols & {*map.state, *map.noise.symbols}

    @cached_property
    def depends_on_noise(self) -> bool:
        """Whether the probability mentions the noise of the map: dependent noises."""
        return bool(self.map.weight_expression.free_symbols & set(self.map.noise.symbols))

    @cached_property
    def has_log_density(self) -> bool:
        """Whether `log_density` exists."""
        if not self.whole.has_log_density:
            return False
        return not self.depends_on_noise or self.map.solved_noise is not None

    @cached_property
    def probability_expression(self) -> sympy.Expr:
        """SymPy probability of the branch given the state.

        Raises
        ------
        NoClosedForm
            The mean over the noise has no closed form.
        """
        if not self.depends_on_noise:
            return self.map.weight_expression
        return self.map.noise.expectation(self.map.weight_expression)

    @cached_property
    def _probability(self):
        from seedslib.models.codegen import compile_array

        given = self.map.time, self.map.state, self.map.parameters
        return compile_array(given, self.probability_expression)

    def probability(self, t: float, x: np.ndarray, p: Values = ()) -> np.ndarray:
        """Probability of the branch given the state, shape (*batch).

        Where it depends on the noise: the closed form if there is one, otherwise nine
        Gauss-Hermite nodes per component of Gaussian noise.

        Raises
        ------
        ValueError
            No closed form, and noise that is not Gaussian.
        """
        x = np.asarray(x)
        if not self.depends_on_noise:
            none = np.zeros((self.map.noise.size, *(1,) * (x.ndim - 1)))
            return np.broadcast_to(self.map.weight(t, x, none, p), x.shape[1:])
        try:
            return np.broadcast_to(self._probability(t, x, p), x.shape[1:])
        except ValueError:
            if not self.map.noise.gaussian:
                raise
        states, v, weights = self.map.noise.nodes(x)
        shares = np.broadcast_to(self.map.weight(t, states, v, p), v.shape[1:])
        return np.einsum("s...,s->...", shares, weights)

    def log_density(self, t: float, y: np.ndarray, x: np.ndarray, p: Values = ()) -> np.ndarray:
        """Logarithm of the joint density of y and the branch given x, shape (*batch).

        A measurement that is missing as a whole (NaN) leaves the probability of the branch.

        Raises
        ------
        ValueError
            There is no closed form: the noise enters nonlinearly, is not Gaussian, or is not
            determined by the measurement although the probability depends on it.
        """
        plain = self.whole.log_density(t, y, x, p)
        y = np.asarray(y, dtype=float)
        x = np.asarray(x, dtype=float)
        with np.errstate(divide="ignore"):
            if not self.depends_on_noise:
                return plain + np.log(self.probability(t, x, p))
            if not self.has_log_density:
                raise ValueError(
                    "log_density: wanted noise that the value determines where the probability "
                    "of a branch depends on it"
                )
            missing = np.isnan(y).any(axis=0)
            v = self.map.solved_noise(t, x, np.where(missing, 0.0, y), p)[:-1]
            joint = plain + np.log(self.map.weight(t, x, v, p))
            if missing.any():
                joint = np.where(missing, plain + np.log(self.probability(t, x, p)), joint)
            return joint


Table = tuple[tuple[Branch | None, ...], ...]


def branch_table(
    name: str,
    maps: Sequence[Sequence[StochasticMap]],
    x: np.ndarray,
    p: Values,
    new: bool = False,
) -> Table:
    """Branches without those of probability zero; all probabilities are looked at first.

    Parameters
    ----------
    name : str
        Of the probabilities, for messages.
    maps : sequence of sequence of StochasticMap, shape (L, L) or (L, M)
        With their weights.
    x : ndarray, shape (n, N)
        States where the probabilities are looked at, with noises.
    p : tuple
        Numbers of the parameters there.
    new : bool
        Whether the new mode drives the step, so that no probability may depend on the noise.

    Raises
    ------
    ValueError
        No probabilities, or some that depend on the noise where they must not.
    """
    branches = []
    v = maps[0][0].noise.draw(np.random.default_rng(1), x.shape[1])
    for i, row in enumerate(maps):
        row = [Branch(map) for map in row]
        if new and any(branch.depends_on_noise for branch in row):
            raise ValueError(
                f"{name} of mode {i}: wanted probabilities without the noise, which comes "
                "after the switch where the new mode drives the step"
            )
        weight = [np.broadcast_to(b.map.weight(0.0, x, v, p), x.shape[1:]) for b in row]
        want_probabilities(f"{name} of mode {i}", np.stack(weight))
        branches.append(tuple(None if b.map.weight_expression.is_zero else b for b in row))
    return tuple(branches)


def want_probabilities(name: str, weights: ArrayLike) -> None:
    """Probabilities along the first axis, or ValueError."""
    weights = np.asarray(weights, dtype=float)
    if not (np.isfinite(weights).all() and (weights >= -CLOSE).all()):
        raise ValueError(f"{name}: wanted probabilities of at least 0, got {np.min(weights):.6g}")
    total = weights.sum(axis=0)
    worst = np.ravel(total)[np.argmax(np.abs(total - 1.0))]
    if abs(worst - 1.0) > CLOSE:
        raise ValueError(f"{name}: wanted probabilities that sum to 1, got {worst:.10g}")


def _as_maps(name: str, maps: Sequence[StochasticMap]) -> tuple[StochasticMap, ...]:
    """Maps of all modes, which have one state, one size and one noise."""
    for map in maps:
        if not isinstance(map, StochasticMap):
            raise TypeError(f"{name}: wanted a StochasticMap of each mode, got {map!r}")
        if not map.symbolic:
            raise TypeError(f"{name}: wanted maps of formulas, got array functions")
        sizes, first = (map.state_size, map.size), maps[0]
        if sizes != (first.state_size, first.size) or not map.noise.alike(first.noise):
            raise ValueError(f"{name}: wanted maps of one state, one size and one noise")
    return tuple(maps)


class InitialMode(NamedTuple):
    """Start in one mode: its probability, mean and covariance of the Gaussian state in it."""

    probability: float
    mean: np.ndarray
    cov: np.ndarray


class SwitchingSystem(Parametrized, Pickled):
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

    The elapsed time `seedslib.base.ELAPSED` may stand in dynamics and in probabilities: then steps
    may be of any length, as with ``1 - exp(-rate * ELAPSED)`` for a switch of constant rate.

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
        Of each mode at the start, and of the Gaussian state in it.
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
        initial distribution, where they depend on the state, and again wherever paths, particles
        and nodes of a grid go; a filter of Gaussian distributions warns of their means); those of
        a switch that depend on the noise where the new mode drives the step.
    """

    state: tuple[sympy.Symbol, ...]
    time: sympy.Symbol
    modes: int
    state_size: int
    measurement_size: int
    noise: Noise
    sensor_noise: Noise
    drives: str
    dynamics: tuple[StochasticMap, ...]
    sensors: tuple[StochasticMap, ...]

    def __init__(
        self,
        state: Sequence[Any],
        dynamics: Any,
        noise: Noise,
        switching: Any,
        sensor: Any,
        sensor_noise: Noise,
        initial: Sequence[tuple[float, ArrayLike, ArrayLike]],
        *,
        indicator: Any = None,
        parameters: Mapping[sympy.Symbol, Any] | None = None,
        time: sympy.Symbol | None = None,
        drives: str = "old",
        period: Mapping[int, float] | None = None,
    ) -> None:
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

        moves = expressions("dynamics", dynamics, (None, len(self.state)), noise)
        modes = len(moves)
        switching = expressions("switching", switching, (modes, modes), noise)
        measured = expressions("sensor", sensor, (modes, None), sensor_noise)
        if indicator is not None:
            indicator = expressions("indicator", indicator, (modes, None), sensor_noise)
        made = partial(StochasticMap, self.state, time=self.time)
        moves = [made(row, noise) for row in moves]
        sensors = [made(row, sensor_noise, period=period) for row in measured]
        self._complete(moves, switching, sensors, initial, indicator, drives)
        warn_of_angles(self.sensors[0])

    @classmethod
    def from_maps(
        cls,
        dynamics: Sequence[StochasticMap],
        switching: Any,
        sensors: Sequence[StochasticMap],
        initial: Sequence[tuple[float, ArrayLike, ArrayLike]],
        *,
        indicator: Any = None,
        drives: str = "old",
    ) -> SwitchingSystem:
        """Make a system of maps of formulas.

        Parameters
        ----------
        dynamics, sensors : sequence of StochasticMap, length L
            The move and the measurement of each mode.
        switching : nested sequence, shape (L, L)
            Probabilities of the switches from mode i to mode l: numbers or SymPy expressions.
        initial : as in the class
        indicator : nested sequence, shape (L, M), optional
            Probabilities of the values of the indicator, likewise.
        drives : {"old", "new"}

        Raises
        ------
        TypeError, ValueError
            As the class; maps of several sizes or noises.
        """
        dynamics, sensors = _as_maps("dynamics", dynamics), _as_maps("sensors", sensors)
        self = object.__new__(cls)
        self.state, self.time = dynamics[0].state, dynamics[0].time
        self._complete(dynamics, switching, sensors, initial, indicator, drives)
        return self

    def _complete(
        self,
        dynamics: Sequence[StochasticMap],
        switching: Any,
        sensors: Sequence[StochasticMap],
        initial: Sequence[tuple[float, ArrayLike, ArrayLike]],
        indicator: Any,
        drives: str,
    ) -> None:
        if drives not in ("old", "new"):
            raise ValueError(f"drives: wanted 'old' or 'new', got {drives!r}")
        n, modes = dynamics[0].state_size, len(dynamics)
        self.drives, self.modes, self.state_size = drives, modes, n
        self.measurement_size = sensors[0].size
        if len(sensors) != modes or not dynamics[0].size == n == sensors[0].state_size:
            raise ValueError(f"sensors: wanted {modes} maps of the state, of {n} components")
        self.noise, self.sensor_noise = dynamics[0].noise, sensors[0].noise
        switching = np.array(switching, dtype=object)
        require_shape("switching", switching, (modes, modes))
        shares = np.array([[1]] * modes if indicator is None else indicator, dtype=object)
        require_shape("indicator", shares, (modes, None))
        self.indicators: int = 0 if indicator is None else shares.shape[1]
        self.initial: tuple[InitialMode, ...] = self._initial_modes(initial)
        probability, means, covs = map(np.array, zip(*self.initial, strict=True))
        self.mean0: np.ndarray = probability @ means
        deviations = means - self.mean0
        self.cov0: np.ndarray = np.einsum("l,li,lj->ij", probability, deviations, deviations)
        self.cov0 += np.einsum("l,lij->ij", probability, covs)
        new = drives == "new"
        moves = [
            [dynamics[l if new else i].with_weight(switching[i, l]) for l in range(modes)]
            for i in range(modes)
        ]
        readings = [
            [sensor.with_weight(share) for share in row]
            for sensor, row in zip(sensors, shares, strict=True)
        ]
        tables = moves, readings, [dynamics], [sensors]
        mentions = [[p for row in table for m in row for p in m.mentions] for table in tables]
        require_no_step("sensor", mentions[1])
        self.parameters = in_order(p for part in mentions for p in part)
        self.numbers: Mapping[Parameter, ArrayLike] = {}
        moves, readings, (self.dynamics,), (self.sensors,) = (
            [tuple(m.taking(self.parameters) for m in row) for row in table] for table in tables
        )
        x, p = self._probe(), self.nominal_values()
        self.branches: Any = branch_table("switching", moves, x, p, new)
        self.readings: Any = branch_table("indicator", readings, x, p)

    def _initial_modes(self, initial: Sequence) -> tuple[InitialMode, ...]:
        initial = list(initial)
        if len(initial) != self.modes:
            raise ValueError(f"initial: wanted {self.modes} modes, got {len(initial)}")
        n, modes = self.state_size, []
        for i, part in enumerate(initial):
            try:
                probability, mean, cov = part
            except (TypeError, ValueError):
                raise TypeError(
                    f"initial: wanted (probability, mean, cov) for mode {i}, got {brief(part)}"
                ) from None
            probability = float(as_real(f"initial[{i}] probability", probability, ()))
            mean = as_real(f"initial[{i}] mean", mean, (n,))
            modes.append(InitialMode(probability, mean, as_covariance(f"initial[{i}] cov", cov, n)))
        want_probabilities("initial", np.array([part.probability for part in modes]))
        return tuple(modes)

    def _probe(self) -> np.ndarray:
        """States about the initial distribution, (n, 64)."""
        draws = np.random.default_rng(0).standard_normal((self.state_size, 64))
        deviation = np.sqrt(np.diagonal(self.cov0)) + 1e-3
        return self.mean0[:, None] + 2.0 * deviation[:, None] * draws

    @property
    def initial_probabilities(self) -> np.ndarray:
        """Probabilities of the modes at the start, (L,)."""
        return np.array([part.probability for part in self.initial])

    @cached_property
    def indicator_ignores_state(self) -> bool:
        """Whether the indicator does not depend on the state (corollaries 3 and 4)."""
        return all(b is None or b.constant for row in self.readings for b in row)

    @property
    def hybrid(self) -> Hybrid:
        """The system as one whose state has the mode as last row, and the measurement J."""
        return Hybrid(self)

    def simulate(
        self,
        times: ArrayLike,
        paths: Count,
        seed: Seed,
        *,
        modes: ArrayLike | None = None,
        **options: Any,
    ) -> Simulation:
        """Simulate paths, modes, measurements and indicators.

        See `seedslib.models.simulation.simulate`; `modes` (K+1, paths) and, where there is one,
        `indicators` (K+1, paths) are whole numbers from 0, -1 for an indicator not measured.

        Parameters
        ----------
        times, paths, seed, **options
            As there.
        modes : array_like of int, shape (K+1,) or (K+1, paths), optional
            Modes that are imposed on the paths, as in the truth of a benchmark:
            nothing is switched, and the probabilities of switches are not looked at. The noises
            are those of the same seed without it.

        Raises
        ------
        TypeError, ValueError
            As there; modes of a system whose switching depends on the noise, which would have
            another distribution.
        """
        if modes is not None:
            if any(b is not None and b.depends_on_noise for row in self.branches for b in row):
                raise ValueError("modes: wanted none, for the switching depends on the noise")
            steps, paths = len(as_grid("times", times, self)), as_count("paths", paths)
            modes = np.asarray(modes)
            modes = np.repeat(modes[:, None], paths, axis=1) if modes.ndim == 1 else modes
            modes = as_whole("modes", modes, (steps, paths))
            if not ((modes >= 0) & (modes < self.modes)).all():
                raise ValueError(f"modes: wanted numbers from 0 to {self.modes - 1}, got others")
        data, m = (
            simulate(self.hybrid, times, paths, seed, modes=modes, **options),
            self.sensors[0].size,
        )
        modes, indicators = data.states[:, -1].astype(int), None
        if self.indicators:
            values = data.measurements[:, m]
            indicators = np.where(np.isnan(values), -1.0, values).astype(int)
        return Simulation(
            data.times, data.states[:, :-1], data.measurements[:, :m], modes, indicators
        )


class Hybrid(Parametrized):
    """Mixed state (n + 1, *batch) with the mode as last row, as a number.

    Parameters
    ----------
    system : SwitchingSystem

    Attributes
    ----------
    state_size : int
        n + 1.
    measurement_size : int
        m, or m + 1 where there is an indicator.
    sensor : HybridSensor
    mean0 : ndarray, shape (n + 1,)
        A harmless mixed state.
    parameters, numbers
        Those of the system.
    """

    def __init__(self, system: SwitchingSystem) -> None:
        self.system: SwitchingSystem = system
        self.parameters, self.numbers = system.parameters, system.numbers
        self.state_size: int = system.state_size + 1
        self.sensor: HybridSensor = HybridSensor(system)
        self.indicators: int = system.indicators
        self.measurement_size: int = self.sensor.size
        # of the numbers the user gave, so no rounding decides; it stands in for diverged paths only
        likely = system.initial[int(np.argmax(system.initial_probabilities))]
        self.mean0: np.ndarray = np.append(
            likely.mean, float(np.argmax(system.initial_probabilities))
        )
        self.initial_dists: list[tuple[np.ndarray, np.ndarray]] = [
            (part.mean, cholesky(part.cov)) for part in system.initial
        ]

    def initial_sample(
        self, rng: Source, count: int, modes: np.ndarray | None = None
    ) -> np.ndarray:
        """Draws of mode and state, shape (n + 1, count); in given modes, (count,), if any."""
        bounds = np.cumsum(self.system.initial_probabilities)
        moving, choosing = rng.spawn(2)
        mode = _chosen(bounds[:-1, None], drawn(choosing, count, Generator.random))
        mode = mode if modes is None else modes
        noise = normal(moving, self.system.state_size, count)
        x = np.empty((self.state_size, count))
        for i, (mean, root) in enumerate(self.initial_dists):
            mask = mode == i
            x[:-1, mask] = mean[:, None] + lower_times(root, noise[:, mask])
        x[-1] = mode
        return x

    def advance(
        self,
        x: np.ndarray,
        start: float,
        stop: float,
        rng: Source,
        p: Values | None = None,
        modes: np.ndarray | None = None,
    ) -> np.ndarray:
        """Mixed states (n + 1, *batch) one step later; the noises are those of the old time.

        The numbers `p` are the system's own by default. The new modes are drawn, unless they are
        given, (*batch).
        """
        p = self.values(dt=stop - start) if p is None else p
        flat, old_drives = x.reshape(len(x), -1), self.system.drives == "old"
        moving, choosing = rng.spawn(2)
        v = self.system.noise.draw(moving, flat.shape[1])
        choice = drawn(choosing, flat.shape[1], Generator.random)
        moved = np.empty_like(flat)
        for i, row in enumerate(self.system.branches):
            mask = flat[-1] == i
            old, noise, own = flat[:-1, mask], v[:, mask], of_paths(p, x.shape[1:], mask)
            if old_drives:
                moved[:-1, mask] = self.system.dynamics[i].value(start, old, noise, own)
            if modes is None:
                moved[-1, mask] = _branch("switching", row, start, old, noise, own, choice[mask])
        if modes is not None:
            moved[-1] = modes.ravel()
        if not old_drives:
            for l, map in enumerate(self.system.dynamics):
                mask = moved[-1] == l
                own = of_paths(p, x.shape[1:], mask)
                moved[:-1, mask] = map.value(start, flat[:-1, mask], v[:, mask], own)
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

    def sample(self, t: float, x: np.ndarray, rng: Source, p: Values = ()) -> np.ndarray:
        """One draw for each mixed state, shape (m or m + 1, *batch)."""
        system, flat = self.system, x.reshape(len(x), -1)
        sensing, choosing = rng.spawn(2)
        w = system.sensor_noise.draw(sensing, flat.shape[1])
        y = np.empty((self.size, flat.shape[1]))
        choice = drawn(choosing, flat.shape[1], Generator.random) if system.indicators else None
        for i, row in enumerate(system.readings):
            mask = flat[-1] == i
            state, noise = flat[:-1, mask], w[:, mask]
            own = of_paths(p, x.shape[1:], mask)
            y[: system.measurement_size, mask] = system.sensors[i].value(t, state, noise, own)
            if system.indicators:
                y[-1, mask] = _branch("indicator", row, t, state, noise, own, choice[mask])
        return y.reshape(self.size, *x.shape[1:])

    def log_density(self, t: float, y: np.ndarray, x: np.ndarray, p: Values = ()) -> np.ndarray:
        """Logarithm of the density of a measurement with its indicator, shape (*batch).

        NaN is a missing component; an indicator that is NaN is missing too.
        """
        system = self.system
        batch = np.broadcast_shapes(y.shape[1:], x.shape[1:])
        y, x = np.broadcast_to(y, (len(y), *batch)), np.broadcast_to(x, (len(x), *batch))
        density = np.full(batch, -np.inf)
        for i, row in enumerate(system.readings):
            mode = x[-1] == i
            readings = [(row[0], mode)]
            if system.indicators:
                readings = [(branch, mode & (y[-1] == j)) for j, branch in enumerate(row)]
                readings.append((system.sensors[i], mode & np.isnan(y[-1])))
            for reading, mask in readings:
                if reading is not None and mask.any():
                    own = of_paths(p, batch, mask)
                    values = y[: system.measurement_size, mask]
                    density[mask] = reading.log_density(t, values, x[:-1, mask], own)
        return density


def _branch(
    name: str,
    row: tuple,
    t: float,
    x: np.ndarray,
    noise: np.ndarray,
    p: Values,
    choice: np.ndarray,
) -> np.ndarray:
    """Number of the branch that each uniform number chooses."""
    weights = np.zeros((len(row), x.shape[1]))
    for weight, branch in zip(weights, row, strict=True):
        if branch is not None:
            weight[:] = branch.map.weight(t, x, noise, p)
    bounds = np.cumsum(weights, axis=0)
    # comparisons that are false for a path that has diverged
    if (weights < -CLOSE).any() or (np.abs(bounds[-1] - 1.0) > CLOSE).any():
        worst = weights.flat[np.nanargmax(np.abs(weights - 0.5))]
        raise ValueError(
            f"{name}: wanted probabilities from 0 to 1 that sum to 1, got {worst:g} at time "
            f"{when(t)}"
        )
    return _chosen(bounds[:-1], choice)


def _chosen(bounds: np.ndarray, choice: np.ndarray) -> np.ndarray:
    """How many of the bounds lie at or below each number."""
    return (bounds <= choice).sum(axis=0)
