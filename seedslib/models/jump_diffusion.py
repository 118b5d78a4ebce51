"""Jump-diffusion observed at discrete times: dX = a dt + B dW + jumps, Y_k = c(X_k, V_k)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.bundles import Source
from seedslib.base.checks import as_covariance, as_positive, as_shape
from seedslib.base.objects import Shown, Travelling
from seedslib.base.values import Inputs, looked_at, with_values
from seedslib.models import stepping
from seedslib.models.maps import StochasticMap
from seedslib.models.noise import Noise, named_noise
from seedslib.models.rates import closed_rates, rate_map
from seedslib.models.simulation import Simulation, simulate

Rate = Callable[[float, np.ndarray], np.ndarray]


class JumpDiffusion(Travelling, Shown):
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

    Raises
    ------
    TypeError, ValueError
        Shapes that do not fit, unknown symbols, one symbol with two meanings, covariances that
        are not semidefinite.
    """

    _shown = "state_size", "measurement_size"

    indicators: int = 0
    state: Any
    time: Any
    state_size: int
    wiener_size: int
    measurement_size: int

    def __init__(
        self, state: Any, drift: Any, diffusion: Any, sensor: Any, noise: Any, mean0: ArrayLike,
        cov0: ArrayLike, *, intensity: Any = 0, jump: Any = None, marks: Any = None,
        parameters: Any = None, initial: Any = None, step: float = 0.01, time: Any = None,
        period: Mapping[int, float] | None = None,
    ) -> None:  # fmt: skip
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
        rates = *self.drift_expressions, *self.diffusion_expressions.flat, self.intensity_expression
        self._parameters = parameters_of(rates)
        self._set_law(n, self.diffusion_expressions.shape[1], mean0, cov0, initial, step)

    @classmethod
    def from_functions(
        cls, drift: Rate, diffusion: Rate, sensor: StochasticMap, mean0: ArrayLike, cov0: ArrayLike,
        *, intensity: Rate | None = None, jump: StochasticMap | None = None, initial: Any = None,
        step: float = 0.01, wiener_size: int | None = None, parameters: Sequence[Any] = (),
    ) -> JumpDiffusion:  # fmt: skip
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
            Number of Wiener processes, found by one call of `diffusion` by default.
        parameters : sequence of Parameter, optional
            As `StochasticMap.from_functions`.

        Other parameters are those of the class.
        """
        self = object.__new__(cls)
        self.state = self.time = self.drift_expressions = self.diffusion_expressions = None
        self.intensity_expression = None
        if (jump is None) != (intensity is None):
            raise ValueError("jump, intensity: wanted both or neither, got one")
        self.sensor, self.jump, self._parameters = sensor, jump, tuple(parameters)
        drift, diffusion, intensity = with_values(parameters, drift, diffusion, intensity)
        mean0 = as_shape("mean0", mean0, (sensor.state_size,))
        n, probe = len(mean0), np.tile(mean0[:, None], 3)
        with looked_at(parameters):
            as_shape("drift", drift(0.0, probe), (n, 3))
            found = as_shape("diffusion", diffusion(0.0, probe), (n, -1, 3)).shape[1]
            if intensity is not None:
                as_shape("intensity", intensity(0.0, probe), (3,))
        vars(self).update(drift=drift, diffusion=diffusion, intensity=intensity or _never)
        self._set_law(n, found if wiener_size is None else wiener_size, mean0, cov0, initial, step)
        return self

    def _set_law(self, n, wiener_size, mean0, cov0, initial, step):
        self.mean0: np.ndarray = as_shape("mean0", mean0, (n,))
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

    @cached_property
    def mentions(self) -> frozenset[Any]:
        """Parameters and inputs in its formulas."""
        maps = [map.mentions for map in (self.sensor, self.jump) if map is not None]
        return frozenset(self._parameters).union(*maps)

    def _compiled(self, expression: object) -> Rate:
        from seedslib.models.codegen import compile_array

        return compile_array((self.time, self.state), expression)

    @cached_property
    def drift(self) -> Rate:
        """a(t, x), shape (n, *batch)."""
        return self._compiled(self.drift_expressions)

    @cached_property
    def diffusion(self) -> Rate:
        """B(t, x), shape (n, number of Wiener processes, *batch)."""
        return self._compiled(self.diffusion_expressions)

    @cached_property
    def intensity(self) -> Rate:
        """mu(t, x), shape (*batch); zero without jumps."""
        return self._compiled(self.intensity_expression)

    @cached_property
    def jumps(self) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """Intensity and jump on lists of components; see `stepping.compiled_jumps`."""
        return stepping.compiled_jumps(self)

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
        """One step of the diffusion as ``f(t, h, sqrt(h), x, z) -> list of n components``.

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
        if scheme not in stepping.SCHEMES:
            raise ValueError(f"scheme: wanted one of {', '.join(stepping.SCHEMES)}, got {scheme!r}")
        if not self.symbolic:
            if scheme == "heun":
                raise ValueError("scheme: heun wants a symbolic system, got array functions")
            return partial(stepping.numeric_increment, self)
        made = self.__dict__.setdefault("_increments", {})
        if scheme not in made:
            made[scheme] = stepping.compiled_increment(self, scheme)
        return made[scheme]

    def initial_sample(self, rng: Source, count: int) -> np.ndarray:
        """Draws of the initial state, shape (n, count)."""
        return self.law.draw(rng, count)

    def advance(
        self, x: np.ndarray, start: float, stop: float, rng: Source, *, step: float | None = None,
        scheme: str = "euler",
    ) -> np.ndarray:  # fmt: skip
        """Move states of shape (n, *batch) from one time to a later one; see `stepping.advance`.

        Parameters
        ----------
        step : float, optional
            Largest integration step; the system's own by default.
        scheme : {"euler", "heun"}
        """
        step = self.step if step is None else step
        return stepping.advance(self, x, start, stop, rng, step, scheme)

    def simulate(
        self, times: ArrayLike, paths: Count, seed: Seed, *, step: float | None = None,
        scheme: str = "euler", measured: ArrayLike | None = None,
        availability: ArrayLike | None = None, inputs: Inputs | None = None, workers: int = 1,
    ) -> Simulation:  # fmt: skip
        """Simulate paths and measurements; see `seedslib.models.simulation.simulate`.

        `step` is the largest integration step and `scheme` as in `advance`.
        """
        return simulate(
            self, times, paths, seed, measured=measured, availability=availability, inputs=inputs,
            workers=workers, step=step, scheme=scheme,
        )  # fmt: skip


def _never(t: float, x: np.ndarray) -> np.ndarray:
    """Intensity of no jumps."""
    return np.zeros(np.shape(x)[1:])
