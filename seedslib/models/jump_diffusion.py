"""Jump-diffusion observed at discrete times: dX = a dt + B dW + jumps, Y_k = c(X_k, V_k)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import BLOCK, Source, drawn, parts
from seedslib.base.checks import as_covariance, as_positive, as_real
from seedslib.base.clock import step_count, when
from seedslib.base.objects import Pickled
from seedslib.base.values import Parametrized, Values, in_order, of_paths, require_no_step
from seedslib.models.maps import StochasticMap, picked, warn_of_angles
from seedslib.models.noise import Noise, named_noise
from seedslib.models.simulation import Simulation, simulate

Rate = Callable[..., np.ndarray]


class JumpDiffusion(Parametrized, Pickled):
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
        Moments of the initial law, Gaussian unless `initial` is given.
    intensity : SymPy expression
        Jumps per unit of time (default 0).
    jump : sequence of SymPy expressions, optional
        The jump s as a function of the state before it and of the marks.
    marks : Noise, optional
        The marks z of a jump.
    parameters : mapping, optional
        Values of the other symbols.
    initial : callable, optional
        ``initial(rng, count) -> (n, count)``: sampler of an initial law that is not Gaussian.
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
    law : Noise
        The initial law.
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
        from seedslib.base.parameters import parameters_of
        from seedslib.base.symbols import named_model
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
        self._functions: Functions | None = None
        self._set_parameters(parameters_of(rates))
        self._set_law(n, self.diffusion_expressions.shape[1], mean0, cov0, initial, step)

    @classmethod
    def from_functions(
        cls,
        drift: Rate,
        diffusion: Rate,
        sensor: StochasticMap,
        mean0: ArrayLike,
        cov0: ArrayLike,
        *,
        intensity: Rate | None = None,
        jump: StochasticMap | None = None,
        initial: Any = None,
        step: float = 0.01,
        wiener_size: int | None = None,
        parameters: Sequence[Any] = (),
    ) -> JumpDiffusion:
        """Make a system of array functions.

        It takes the sigma-point and quadrature approximations, and the Euler scheme.

        Parameters
        ----------
        drift : callable
            ``drift(t, x) -> (n, *batch)``.
        diffusion : callable
            ``diffusion(t, x) -> (n, number of Wiener processes, *batch)``.
        sensor : StochasticMap
        intensity : callable, optional
            ``intensity(t, x) -> (*batch)``.
        jump : StochasticMap, optional
            The jump; its conditional moments or Gaussian marks are needed by filters.
        wiener_size : int, optional
            Number of Wiener processes, from one call of `diffusion` by default.
        parameters : sequence of Parameter, optional
            As `StochasticMap.from_functions`.

        Other parameters are those of the class.
        """
        self = object.__new__(cls)
        self.state = self.time = self.drift_expressions = self.diffusion_expressions = None
        self.intensity_expression = None
        if (jump is None) != (intensity is None):
            raise ValueError("jump, intensity: wanted both or neither, got one")
        self.sensor, self.jump = sensor, jump
        self._functions = Functions(drift, diffusion, intensity, tuple(parameters))
        self._set_parameters(parameters)
        mean0 = as_real("mean0", mean0, (sensor.state_size,))
        n, probe, p = len(mean0), np.tile(mean0[:, None], 3), self.nominal_values()
        as_real("drift", self.drift(0.0, probe, p), (n, 3))
        size = as_real("diffusion", self.diffusion(0.0, probe, p), (n, -1, 3)).shape[1]
        as_real("intensity", self.intensity(0.0, probe, p), (3,))
        self._set_law(n, size if wiener_size is None else wiener_size, mean0, cov0, initial, step)
        return self

    def _set_parameters(self, rates: Any) -> None:
        maps = [map for map in (self.sensor, self.jump) if map is not None]
        self.parameters = in_order([*rates, *(p for map in maps for p in map.mentions)])
        require_no_step("system", self.parameters)
        self.numbers: Mapping[Any, Any] = {}
        self.sensor = self.sensor.taking(self.parameters)
        self.jump = self.jump and self.jump.taking(self.parameters)

    def _set_law(self, n, wiener_size, mean0, cov0, initial, step):
        self.mean0: np.ndarray = as_real("mean0", mean0, (n,))
        self.cov0: np.ndarray = as_covariance("cov0", cov0, n)
        self.law: Noise = Noise(n, self.mean0, self.cov0, initial)
        if self.sensor.state_size != n or (self.jump and self.jump.size != n):
            raise ValueError(f"sensor, jump: wanted maps of a state of {n} components")
        self.state_size, self.wiener_size, self.measurement_size = n, wiener_size, self.sensor.size
        self.step: float = as_positive("step", step)

    @property
    def symbolic(self) -> bool:
        """Whether the system was given as SymPy expressions."""
        return self.drift_expressions is not None

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
        if self._functions is not None:
            *rates, own = self._functions
            places = tuple(map(self.parameters.index, own))
            return tuple(partial(picked, rate or _never, places) for rate in rates)
        from seedslib.models.codegen import compile_array

        given = self.time, self.state, self.parameters
        parts = self.drift_expressions, self.diffusion_expressions, self.intensity_expression
        return tuple(compile_array(given, part) for part in parts)

    @cached_property
    def jumps(self) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """Intensity and jump on lists of components; see `compiled_jumps`."""
        return compiled_jumps(self)

    @cached_property
    def moment_expressions(self) -> tuple[np.ndarray, np.ndarray]:
        """SymPy b = a + mu s̄ of shape (n,) and Sigma = B Bᵀ + mu S₂ of shape (n, n).

        Raises
        ------
        NoClosedForm
            The mean of the jump over its marks has no closed form.
        """
        return closed_rates(self)

    @cached_property
    def drift_map(self) -> StochasticMap:
        """Mean velocity b(t, x) as a map without noise; array functions without a closed form."""
        return rate_map(self, 0, ..., self.state_size)

    @cached_property
    def spread_map(self) -> StochasticMap:
        """Sigma(t, x) on and below the diagonal as a map without noise."""
        lower = np.tril_indices(self.state_size)
        return rate_map(self, 1, lower, len(lower[0]))

    def increment(self, scheme: str = "euler") -> Callable[..., Any]:
        """One step of the diffusion as ``f(t, h, sqrt(h), x, z, p) -> list of n components``.

        Parameters
        ----------
        scheme : {"euler", "heun"}
            Itô increment a h + B sqrt(h) z, or the Stratonovich increment with the drift
            a - (1/2) sum_j (dB_j/dx) B_j, which a Heun step needs to converge to the Itô
            solution.

        Raises
        ------
        ValueError
            An unknown scheme, or Heun for array functions, whose derivatives are unknown.
        """
        if scheme not in SCHEMES:
            raise ValueError(f"scheme: wanted one of {', '.join(SCHEMES)}, got {scheme!r}")
        if not self.symbolic:
            if scheme == "heun":
                raise ValueError("scheme: heun wants a symbolic system, got array functions")
            return partial(numeric_increment, self)
        return self._heun if scheme == "heun" else self._euler

    @cached_property
    def _euler(self) -> Callable[..., Any]:
        return compiled_increment(self, "euler")

    @cached_property
    def _heun(self) -> Callable[..., Any]:
        return compiled_increment(self, "heun")

    def initial_sample(self, rng: Source, count: int) -> np.ndarray:
        """Draws of the initial state, shape (n, count)."""
        return self.law.draw(rng, count)

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
        """Move states of shape (n, *batch) from one time to a later one; see `advance`.

        Parameters
        ----------
        p : tuple, optional
            Numbers of the parameters; the system's own by default.
        step : float, optional
            Largest integration step; the system's own by default.
        scheme : {"euler", "heun"}
        """
        step = self.step if step is None else step
        p = self.values() if p is None else p
        return advance(self, x, start, stop, rng, p, step, scheme)

    def simulate(self, times: ArrayLike, paths: Count, seed: Seed, **options: Any) -> Simulation:
        """Simulate paths and measurements; see `seedslib.models.simulation.simulate`.

        Options are those of that function, and `step` and `scheme` of `advance`.
        """
        return simulate(self, times, paths, seed, **options)


class Functions(NamedTuple):
    """The array functions that a system was given, and the parameters that each takes last."""

    drift: Rate
    diffusion: Rate
    intensity: Rate | None
    parameters: tuple[Any, ...]


def _never(t: float, x: np.ndarray) -> np.ndarray:
    """Intensity of no jumps."""
    return np.zeros(np.shape(x)[1:])


def closed_rates(system: JumpDiffusion) -> tuple[np.ndarray, np.ndarray]:
    """SymPy b of shape (n,) and Sigma of shape (n, n) of a symbolic `JumpDiffusion`.

    Raises
    ------
    NoClosedForm
        The mean of the jump over its marks has no closed form.
    """
    import sympy

    velocity = system.drift_expressions
    spread = system.diffusion_expressions @ system.diffusion_expressions.T
    if system.jump is not None:
        mean, cov, _ = system.jump.conditional_expressions
        velocity = velocity + system.intensity_expression * mean
        spread = spread + system.intensity_expression * (cov + np.outer(mean, mean))
    expand = np.vectorize(sympy.expand, otypes=[object])
    return expand(velocity), expand(spread)


def numeric_rates(
    system: JumpDiffusion, t: float, x: np.ndarray, p: Values
) -> tuple[np.ndarray, np.ndarray]:
    """The same as arrays (n, *batch) and (n, n, *batch), the jump averaged over its marks."""
    x = np.asarray(x)
    velocity, diffusion = system.drift(t, x, p), system.diffusion(t, x, p)
    spread = np.einsum("ik...,jk...->ij...", diffusion, diffusion)
    if system.jump is not None:
        rate = system.intensity(t, x, p)
        mean, cov = system.jump.conditional_moments(t, x, p)
        velocity = velocity + rate * mean
        spread = spread + rate * (cov + mean[:, None] * mean[None, :])
    return velocity, spread


def rate_map(system: JumpDiffusion, part: int, chosen: object, size: int) -> StochasticMap:
    """Map without noise of b (`part` 0) or Sigma (1): its `chosen` entries, `size` in number.

    The closed form where there is one, array functions otherwise.
    """
    if system.symbolic:
        from seedslib.gaussian.algebra import NoClosedForm

        try:
            value = system.moment_expressions[part][chosen]
            made = StochasticMap(system.state, value, time=system.time)
            return made.taking(system.parameters)
        except NoClosedForm:
            pass
    return StochasticMap.from_functions(
        system.state_size,
        size,
        lambda t, x, v, *p: numeric_rates(system, t, x, p)[part][chosen],
        parameters=system.parameters,
    )


SCHEMES = ("euler", "heun")
CHUNK = 16
"""Normal numbers drawn at a time for each path: a block of them stays in the cache."""

LARGEST_LOSS = 0.05
"""Share of jumps that come second in a step and are left out above which the step is too coarse."""


def advance(
    system: JumpDiffusion,
    x: np.ndarray,
    start: float,
    stop: float,
    rng: Source,
    p: Values,
    step: float,
    scheme: str,
) -> np.ndarray:
    """Move states from one time to a later one.

    A jump comes in a step with probability 1 - exp(-mu(t, X) h) and is drawn at the state before
    the step. This is done by one unit exponential clock per path that runs out with the
    intensity: the same law, without a uniform number at every step. The clock needs no memory
    across calls.

    Parameters
    ----------
    system : JumpDiffusion
    x : ndarray, shape (n, *batch)
    start, stop : float
    rng : numpy.random.Generator
        Only its children are used, in a layout where the first paths of many have the numbers
        of few.
    p : tuple
        Numbers of the parameters, or arrays (*batch).
    step : float
        Largest step; the interval is divided evenly.
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
    step = as_positive("step", step, infinite=True)
    increment = system.increment(scheme)
    steps = step_count(start, stop, step)
    h = (stop - start) / steps
    root = math.sqrt(h)
    shape = np.shape(x)
    x = np.array(x, dtype=float).reshape(shape[0], -1)
    state, count = list(x), x.shape[1]
    p = of_paths(p, shape[1:])
    clock = _JumpClock(system, rng, count, p) if system.jump is not None else None
    with np.errstate(over="ignore", invalid="ignore"):
        for k, normal in enumerate(_normals(rng, steps, system.wiener_size, count)):
            t = start + k * h
            move = increment(t, h, root, state, normal, p)
            if scheme == "heun":
                guess = [c + d for c, d in zip(state, move, strict=True)]
                again = increment(t + h, h, root, guess, normal, p)
                move = [0.5 * (a + b) for a, b in zip(move, again, strict=True)]
            moved = [c + d for c, d in zip(state, move, strict=True)]
            if clock is not None:
                clock.jump(t, h, state, moved)
            state = moved
    if clock is not None and clock.second > LARGEST_LOSS:
        warnings.warn(
            f"step: about {clock.second:.2g} of the jumps would come second in a step and are left "
            f"out; take a step below {h:g}",
            stacklevel=2,
        )
    return np.stack(state).reshape(shape)


def compiled_increment(system: JumpDiffusion, scheme: str) -> Callable[..., Any]:
    """Code of one step of a symbolic system; see `JumpDiffusion.increment`."""
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


def numeric_increment(
    system: JumpDiffusion,
    t: float,
    h: float,
    root: float,
    x: list[np.ndarray],
    z: np.ndarray,
    p: Values,
) -> list[np.ndarray]:
    """Euler increment of a system of array functions; see `JumpDiffusion.increment`."""
    state = np.stack(x)
    noise = np.einsum("ij...,j...->i...", system.diffusion(t, state, p), root * z)
    return list(system.drift(t, state, p) * h + noise)


def compiled_jumps(system: JumpDiffusion) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Intensity ``(t, x, p) -> component`` and jump ``(t, x, z, p) -> list`` on components.

    The intensity comes as a plain number where it is constant.
    """
    if not system.symbolic:
        return (
            lambda t, x, p: system.intensity(t, np.stack(x), p),
            lambda t, x, z, p: list(system.jump.value(t, np.stack(x), np.stack(z), p)),
        )
    from seedslib.models.codegen import compile_components

    given, p = (system.time, system.state), system.parameters
    rate = compile_components((*given, p), [system.intensity_expression])
    marks, jump = system.jump.noise.symbols, system.jump.expressions.tolist()
    kick = compile_components((*given, marks, p), jump)
    return lambda t, x, p: rate(t, x, p)[0], kick


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
        for generator, here in parts(child, count):
            # path by path, so that a path has the same numbers however many follow it
            columns = chunk[:, here]
            rows = by_path[: columns.size].reshape(columns.shape[::-1])
            generator.standard_normal(out=rows)
            columns[...] = rows.T
        yield from chunk.reshape(-1, size, count)


def _bad_intensity(value: float, t: float) -> ValueError:
    return ValueError(
        f"intensity: wanted finite nonnegative numbers, got {value:g} at time {when(t)}"
    )


class _JumpClock:
    """Unit exponential clocks of the paths of one block over one interval."""

    def __init__(self, system: JumpDiffusion, rng: Source, count: int, p: Values):
        self.p = p
        self.count, self.noise = count, system.jump.noise
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

    def jump(self, t: float, h: float, before: list, after: list) -> None:
        """Run the clocks for one step and add the jumps to the states after it, in place."""
        hazard = self.rate(t, before, self.p) * h
        least = hazard.min() if isinstance(hazard, np.ndarray) else hazard
        if not least >= 0:
            raise _bad_intensity(least / h, t)
        left = self.left
        left -= hazard
        due = (left <= 0).nonzero()[0]
        if due.size == 0:
            return
        met = hazard[due] if isinstance(hazard, np.ndarray) else np.full(1, hazard)
        if met.max() == np.inf:
            raise _bad_intensity(np.inf, t)
        self.hazards.append(met)
        number = self.jumped[due]
        while number.max() + 1 >= self.ready:
            self._extend()
        marks = self.marks[number, :, due]
        p = of_paths(self.p, (self.count,), due)
        kicks = self.kick(t, [c[due] for c in before], list(marks.T), p)
        for component, kick in zip(after, kicks, strict=True):
            if isinstance(kick, np.ndarray) or kick != 0:
                component[due] += kick
        number += 1
        left[due] = self.clocks[number, due]
        self.jumped[due] = number
