"""Jump-diffusion observed at discrete times: dX = a dt + B dW + jumps, Y_k = c(X_k, V_k)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import BLOCK, Source, drawn, parts
from seedslib.base.checks import as_positive, outside
from seedslib.base.clock import step_count, when
from seedslib.base.objects import Pickled
from seedslib.base.values import Values, in_order, of_paths, require_no_step
from seedslib.models.first_state import Started
from seedslib.models.maps import StochasticMap, named_noise, warn_of_angles
from seedslib.models.simulation import Simulation, simulate

Rate = Callable[..., np.ndarray]


class JumpDiffusion(Started, Pickled):
    """Itô equation with state-dependent jumps and a sensor that is read at discrete times.

    Between jumps dX = a(t, X) dt + B(t, X) dW. Jumps come with intensity mu(t, X) and add
    s(t, X, z) with marks z; the sensor shows c(t, X, V), where V may enter nonlinearly.
    Equations (1.1), (1.2) of the jump-diffusion paper.

    Parameters
    ----------
    state : sequence of SymPy symbols, length n
    drift : sequence of SymPy expressions, length n
    diffusion : nested sequence of SymPy expressions, shape (n, number of Wiener processes)
    sensor : sequence of SymPy expressions, length m
    noise : Noise
        The sensor noise V.
    mean0, cov0 : array_like, shapes (n,) and (n, n)
        Moments of the initial distribution, Gaussian unless `initial` is given.
    intensity : SymPy expression
        Jumps per unit of time (default 0).
    jump : sequence of SymPy expressions, optional
        The jump s as a function of the state before it and of the marks.
    marks : Noise, optional
        The marks z of a jump.
    parameters : mapping, optional
        Values of the other symbols.
    initial : callable, optional
        ``initial(rng, count) -> (n, count)``: sampler of an initial distribution that is not
        Gaussian.
    step : float
        Default step of simulation and of the filters' integration, in units of time.
    time : SymPy symbol, optional
        Name of the time, ``t`` by default.
    period : mapping of int to float, optional
        Components of the measurement that lie on a circle, and their periods.

    Attributes
    ----------
    sensor, jump : StochasticMap
        `jump` is None without jumps.
    drift_map : StochasticMap
        Without noise: the mean velocity b = a + mu s̄, s̄ the mean jump.
    spread_map : StochasticMap
        Without noise: Sigma = B Bᵀ + mu S₂ on and below the diagonal, row by row, with S₂ the
        second moment of the jump.
    prior : Noise
        The initial distribution.
    parameters : tuple of Parameter
        Parameters and inputs in all formulas, in the order of their numbers p.

    Raises
    ------
    TypeError, ValueError
        Shapes that do not fit, unknown symbols, one symbol with two meanings, covariances that
        are not semidefinite, the elapsed time.
    """

    indicators: int = 0
    state: Any
    time: Any
    state_size: int
    wiener_size: int
    measurement_size: int

    def __init__(
        self,
        state: Any,
        drift: Any,
        diffusion: Any,
        sensor: Any,
        noise: Any,
        mean0: ArrayLike,
        cov0: ArrayLike,
        *,
        intensity: Any = 0,
        jump: Any = None,
        marks: Any = None,
        parameters: Any = None,
        initial: Any = None,
        step: float = 0.01,
        time: Any = None,
        period: Mapping[int, float] | None = None,
    ) -> None:
        from seedslib.base.symbols import named_model, parameters_of
        from seedslib.models.codegen import known_expressions

        noise, marks = named_noise("noise", noise), named_noise("marks", marks)
        self.state, self.time, values = named_model(
            state, time, parameters, noise=noise.symbols, marks=marks.symbols
        )

        def expressions(name, value, shape, symbols=()):
            allowed = {self.time, *self.state, *symbols}
            return known_expressions(name, value, shape, values, allowed)

        def mapped(name, value, rows, source, period=None):
            value = expressions(name, value, (rows,), source.symbols)
            return StochasticMap(self.state, value, source, time=self.time, period=period)

        n = len(self.state)
        self.drift_expressions: Any = expressions("drift", drift, (n,))
        self.diffusion_expressions: Any = expressions("diffusion", diffusion, (n, None))
        self.intensity_expression: Any = expressions("intensity", intensity, ())[()]
        if (jump is None) != (self.intensity_expression == 0):
            raise ValueError("jump, intensity: wanted both or neither, got one")
        self.jump: StochasticMap | None = None if jump is None else mapped("jump", jump, n, marks)
        self.sensor: StochasticMap = mapped("sensor", sensor, None, noise, period)
        warn_of_angles(self.sensor)
        rates = *self.drift_expressions, *self.diffusion_expressions.flat, self.intensity_expression
        self.wiener_size = self.diffusion_expressions.shape[1]
        self.state_size, self.measurement_size = n, self.sensor.size
        maps = [map for map in (self.sensor, self.jump) if map is not None]
        named = [*parameters_of(rates), *self._start(mean0, cov0, initial, n)]
        self.parameters = in_order([*named, *(p for map in maps for p in map.mentions)])
        require_no_step("system", self.parameters)
        self.numbers: Mapping[Any, Any] = {}
        self.sensor = self.sensor.taking(self.parameters)
        self.jump = self.jump and self.jump.taking(self.parameters)
        self.step: float = as_positive("step", step)

    def drift(self, t: float, x: np.ndarray, p: Values | None = None) -> np.ndarray:
        """a(t, x), shape (n, *batch); numbers p are the system's own by default."""
        return self._rates[0](t, x, self.values() if p is None else p)

    def diffusion(self, t: float, x: np.ndarray, p: Values | None = None) -> np.ndarray:
        """B(t, x), shape (n, number of Wiener processes, *batch)."""
        return self._rates[1](t, x, self.values() if p is None else p)

    def intensity(self, t: float, x: np.ndarray, p: Values | None = None) -> np.ndarray:
        """mu(t, x), shape (*batch); zero without jumps."""
        return self._rates[2](t, x, self.values() if p is None else p)

    @cached_property
    def _rates(self) -> tuple[Rate, Rate, Rate]:
        """Drift, diffusion and intensity as functions (t, x, p)."""
        from seedslib.models.codegen import compile_array

        given = self.time, self.state, self.parameters
        parts = self.drift_expressions, self.diffusion_expressions, self.intensity_expression
        return tuple(compile_array(given, part) for part in parts)

    @cached_property
    def jumps(self) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """Intensity (t, x, p) and the components of the jump (t, x, z, p); they may be numbers."""
        from seedslib.models.codegen import compile_components

        given, p = (self.time, self.state), self.parameters
        rate = compile_components((*given, p), [self.intensity_expression])
        marks, jump = self.jump.noise.symbols, self.jump.expressions.tolist()
        kick = compile_components((*given, marks, p), jump)
        return lambda t, x, p: rate(t, x, p)[0], kick

    @cached_property
    def moment_expressions(self) -> tuple[np.ndarray, np.ndarray]:
        """SymPy b = a + mu s̄ of shape (n,) and Sigma = B Bᵀ + mu S₂ of shape (n, n).

        Raises
        ------
        NoClosedForm
            The mean of the jump over its marks has no closed form.
        """
        import sympy

        velocity, spread = self.drift_expressions, self.diffusion_expressions
        spread = spread @ spread.T
        if self.jump is not None:
            mean, cov, _ = self.jump.conditional_expressions
            velocity = velocity + self.intensity_expression * mean
            spread = spread + self.intensity_expression * (cov + np.outer(mean, mean))
        expand = np.vectorize(sympy.expand, otypes=[object])
        return expand(velocity), expand(spread)

    @cached_property
    def drift_map(self) -> StochasticMap:
        """Mean velocity b(t, x) as a map without noise."""
        return self._without_noise(self.moment_expressions[0])

    @cached_property
    def spread_map(self) -> StochasticMap:
        """Sigma(t, x) on and below the diagonal as a map without noise."""
        return self._without_noise(self.moment_expressions[1][np.tril_indices(self.state_size)])

    def _without_noise(self, value: np.ndarray) -> StochasticMap:
        return StochasticMap(self.state, value, time=self.time).taking(self.parameters)

    @cached_property
    def _euler(self) -> Callable[..., Any]:
        return compiled_increment(self, "euler")

    @cached_property
    def _heun(self) -> Callable[..., Any]:
        return compiled_increment(self, "heun")

    def _increment(self, scheme: str) -> Callable[..., Any]:
        """One step of the diffusion, ``f(t, h, sqrt(h), x, z, p)``: its n components.

        The Itô increment a h + B sqrt(h) z, or the Stratonovich increment with the drift
        a - (1/2) sum_j (dB_j/dx) B_j, which a Heun step needs to converge to the Itô solution.
        """
        if scheme not in SCHEMES:
            raise ValueError(f"scheme: wanted one of {', '.join(SCHEMES)}, got {scheme!r}")
        return self._heun if scheme == "heun" else self._euler

    def advance(
        self,
        x: np.ndarray,
        start: float,
        stop: float,
        rng: Source,
        p: Values | None = None,
        *,
        step: float | None = None,
        scheme: str = "euler",
    ) -> np.ndarray:
        """Move states from one time to a later one.

        A jump comes in a step with probability 1 - exp(-mu(t, X) h) and is drawn at the state
        before the step. This is done by one unit exponential clock per path that runs out with
        the intensity: the same distribution, without a uniform number at every step. The clock
        needs no memory across calls.

        Parameters
        ----------
        x : ndarray, shape (n, *batch)
        start, stop : float
        rng : numpy.random.Generator
            Only its children are used, in a layout where the first paths of many have the numbers
            of few.
        p : tuple, optional
            Numbers of the parameters, or arrays (*batch); the system's own by default.
        step : float, optional
            Largest step, the system's own by default; the interval is divided evenly.
        scheme : {"euler", "heun"}

        Returns
        -------
        ndarray, shape (n, *batch)
            Where a path leaves the range of floating-point numbers, what arithmetic makes of it.

        Raises
        ------
        ValueError
            An intensity that is negative or not a number, an unknown scheme, an empty interval.
        """
        if not stop > start:
            raise ValueError(f"stop: wanted a time after {when(start)}, got {when(stop)}")
        step = as_positive("step", self.step if step is None else step, infinite=True)
        increment, steps = self._increment(scheme), step_count(start, stop, step)
        h, shape = (stop - start) / steps, np.shape(x)
        root, state = math.sqrt(h), np.array(x, dtype=float).reshape(shape[0], -1)
        count, p = state.shape[1], of_paths(self.values() if p is None else p, shape[1:])
        clock = None if self.jump is None else _JumpClock(self, rng, count, p)
        later = np.empty_like(state)
        with np.errstate(over="ignore", invalid="ignore"):
            for k, normal in enumerate(_normals(rng, steps, self.wiener_size, count)):
                t = start + k * h
                move = increment(t, h, root, state, normal, p)
                if scheme == "heun":
                    guess = [a + b for a, b in zip(state, move, strict=True)]
                    again = increment(t + h, h, root, guess, normal, p)
                    move = [0.5 * (a + b) for a, b in zip(move, again, strict=True)]
                for row, component, change in zip(later, state, move, strict=True):
                    np.add(component, change, out=row)
                if clock is not None:
                    clock.jump(t, h, state, later)
                state, later = later, state
        if clock is not None and clock.second > LARGEST_LOSS:
            warnings.warn(
                f"step: about {clock.second:.2g} of the jumps would come second in a step and are "
                f"left out; take a step below {h:g}",
                stacklevel=outside(),
            )
        return state.reshape(shape)

    def simulate(self, times: ArrayLike, paths: Count, seed: Seed, **options: Any) -> Simulation:
        """Simulate paths and measurements; see `seedslib.models.simulation.simulate`.

        Options are those of that function, and `step` and `scheme` of `advance`.
        """
        return simulate(self, times, paths, seed, **options)


SCHEMES = ("euler", "heun")
CHUNK = 16
"""Normal numbers drawn at a time for each path: a block of them stays in the cache."""

LARGEST_LOSS = 0.05
"""Share of jumps that come second in a step and are left out above which the step is too coarse."""


def compiled_increment(system: JumpDiffusion, scheme: str) -> Callable[..., Any]:
    """Code of one step of a symbolic system, a list of n components."""
    import sympy

    from seedslib.models.codegen import compile_components

    drift, matrix = system.drift_expressions, system.diffusion_expressions
    rows, columns = range(matrix.shape[0]), range(matrix.shape[1])
    if scheme == "heun":
        # a - (1/2) sum_j (dB_j/dx) B_j
        pairs = [(j, k, x) for j in columns for k, x in enumerate(system.state)]
        drift = [
            drift[i] - sum(sympy.diff(matrix[i, j], x) * matrix[k, j] for j, k, x in pairs) / 2
            for i in rows
        ]
    h, root = sympy.Dummy("h"), sympy.Dummy("root")
    z = [sympy.Dummy(f"z{j}") for j in columns]
    moves = [drift[i] * h + root * sum(matrix[i, j] * z[j] for j in columns) for i in rows]
    return compile_components((system.time, h, root, system.state, z, system.parameters), moves)


def _normals(rng: Source, steps: int, size: int, count: int) -> Iterator[np.ndarray]:
    """Normal numbers step by step, each of shape (size, count)."""
    if size == 0:
        yield from (np.empty((0, count)) for _ in range(steps))
        return
    chunks = -(-steps // max(1, CHUNK // size))
    length = -(-steps // chunks)
    by_step = np.empty((length * size, count))
    by_path = np.empty(length * size * min(count, BLOCK))
    for first, child in zip(range(0, steps, length), rng.spawn(chunks), strict=False):
        chunk = by_step[: min(length, steps - first) * size]
        for generator, paths in parts(child, count):
            # path by path, so that a path has the same numbers however many follow it
            columns = chunk[:, paths]
            rows = by_path[: columns.size].reshape(columns.shape[::-1])
            generator.standard_normal(out=rows)
            columns[...] = rows.T
        yield from chunk.reshape(-1, size, count)


class _JumpClock:
    """Unit exponential clocks of the paths of one block over one interval."""

    def __init__(self, system: JumpDiffusion, rng: Source, count: int, p: Values):
        self.count, self.p, self.noise = count, p, system.jump.noise
        self.rate, self.kick = system.jumps
        self.rng = rng.spawn(1)[0]
        self.jumped = np.zeros(count, dtype=int)
        self.hazards = []
        self.marks = np.empty((4, self.noise.size, count))
        self.clocks = np.empty((4, count))
        self.ready = 0
        self._extend()
        self.left = self.clocks[0].copy()

    def _extend(self) -> None:
        """Draw the clocks and marks of every path's next jump, when the first path needs them."""
        if self.ready == len(self.clocks):
            self.clocks, self.marks = (np.concatenate([a, a]) for a in (self.clocks, self.marks))
        waiting, marking = self.rng.spawn(2)
        self.clocks[self.ready] = drawn(waiting, self.count, Generator.standard_exponential)
        self.marks[self.ready] = self.noise.draw(marking, self.count)
        self.ready += 1

    @property
    def second(self) -> float:
        """Share of the jumps that would have come second in a step.

        Jumps come in proportion to the hazard of a step, so the mean hazard at the jumps is
        E hazard² / E hazard; half of it is the share.
        """
        met = np.concatenate(self.hazards) if self.hazards else np.zeros(1)
        return 0.5 * float(met.mean())

    def jump(self, t: float, h: float, before: np.ndarray, after: np.ndarray) -> None:
        """Run the clocks for one step and add the jumps to the states after it, in place."""
        hazard = np.broadcast_to(self.rate(t, before, self.p) * h, self.count)
        self.left -= hazard
        due = (self.left <= 0).nonzero()[0]
        met = hazard[due]
        least, most = hazard.min(), met.max(initial=0.0)
        if not (least >= 0 and most < np.inf):
            bad = most if least >= 0 else least
            raise ValueError(
                f"intensity: wanted finite nonnegative numbers, got {bad / h:g} at time {when(t)}"
            )
        if due.size == 0:
            return
        self.hazards.append(met)
        number = self.jumped[due]
        while number.max() + 1 >= self.ready:
            self._extend()
        marks = self.marks[number, :, due].T
        p = of_paths(self.p, (self.count,), due)
        kicks = self.kick(t, before[:, due], marks, p)
        for component, kick in zip(after, kicks, strict=True):
            component[due] += kick
        self.left[due] = self.clocks[number + 1, due]
        self.jumped[due] = number + 1
