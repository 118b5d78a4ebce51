"""Systems that are linear on every cell of a partition of their leading components."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Array
from seedslib.base.checks import as_covariance, as_real
from seedslib.base.conditioning import gaussian_logpdf
from seedslib.base.values import Parametrized
from seedslib.models import DiscreteSystem, Noise, StochasticMap
from seedslib.models.kinds import as_steps
from seedslib.models.simulation import Simulation
from seedslib.piecewise.cells import Intervals, Polygons


class Coefficients(NamedTuple):
    """Offset, matrix and noise of a map ``offset + matrix x + noise w`` in every cell.

    The last axis is that of the records, of length 1 unless the coefficients follow the estimates.
    """

    offset: np.ndarray  # (m, n, 1 or N)
    matrix: np.ndarray  # (m, k, n, 1 or N)
    noise: np.ndarray  # (m, p, n, 1 or N)


@dataclass(frozen=True, eq=False)
class Tangents:
    """Tangents of a nonlinear map at the support points of the cells, equations (22) and (23).

    ``a = f(p) - f'(p) p``, ``A = f'(p)``. Made by `PiecewiseLinearSystem.from_functions`.

    Attributes
    ----------
    map : StochasticMap
    support : ndarray, shape (k, n)
    cells : Intervals
    adaptive : bool
        Whether the current estimate replaces the support point of the cell that holds it.
    """

    map: StochasticMap
    support: np.ndarray
    cells: Intervals
    adaptive: bool

    def __post_init__(self) -> None:
        import sympy as sp

        from seedslib.models.codegen import compile_array

        value = sp.Matrix(self.map.expressions.tolist())
        symbols = list(self.map.noise.symbols) or [sp.Dummy()]
        gain, mean = value.jacobian(symbols), value.subs(dict.fromkeys(symbols, 0))
        if gain.free_symbols & set(symbols):
            raise ValueError(f"noise: wanted one that enters linearly, got {list(value)}")
        given = self.map.time, self.map.state, self.map.parameters
        parts = list(mean), mean.jacobian(self.map.state), gain
        vars(self).update(functions=[compile_array(given, part) for part in parts])

    def __call__(self, t: float, estimate: np.ndarray | None) -> tuple[np.ndarray, ...]:
        points, lead = self.support, self.cells.size
        if estimate is not None:
            sound = np.flatnonzero(np.isfinite(estimate).all(axis=0))
            points = np.repeat(points[:, :, None], estimate.shape[1], axis=2)
            points[lead:, :, sound] = estimate[lead:, None, sound]
            points[:, self.cells.locate(estimate[:lead, sound]), sound] = estimate[:, sound]
        p = tuple(parameter.value for parameter in self.map.parameters)
        value, slope, noise = (function(t, points, p) for function in vars(self)["functions"])
        return value - np.einsum("ij...,j...->i...", slope, points), slope, noise


@dataclass(frozen=True, eq=False)
class PiecewiseLinearSystem(Parametrized):
    """State and sensor that are affine on every cell Q_i of a partition.

    In cell i: ``x(t+1) = a_i(t) + A_i(t) x(t) + G_i(t) w(t)`` where x(t) lies in Q_i, and
    ``y(t) = b_i(t) + B_i(t) x(t) + H_i(t) v(t)`` where x(t) does; w and v are independent
    standard normal. Coefficients of the dynamics are those of the time they leave. The cells
    restrict the leading one or two components only.
    Kolessa, equation (21).

    Parameters
    ----------
    regions : array_like or Polygons
        Edges from ``-inf`` to ``inf``, (n + 1,), of half-open cells ``lower <= x < upper``; for
        two restricted components the cells that `line_cells` makes.
    dynamics : (a, A) or callable
        Arrays (k, n) and (k, k, n), cell last; arrays without a cell axis hold for every cell. A
        callable takes the time t that is left and returns the pair.
    sensor : (b, B) or callable
        Arrays (m, n) and (m, k, n).
    sensor_noise : array_like or callable
        H, (m, q) or (m, q, n).
    mean0 : array_like, shape (k,)
    cov0 : array_like, shape (k, k)
        Prior at the first time, where nothing is measured.
    noise : array_like or callable, optional
        G, (k, p) or (k, p, n); none by default.
    """

    regions: Any
    dynamics: tuple[ArrayLike, ArrayLike] | Callable[..., Any]
    sensor: tuple[ArrayLike, ArrayLike] | Callable[..., Any]
    sensor_noise: ArrayLike | Callable[..., Any] | None
    mean0: Array
    cov0: Array
    noise: ArrayLike | Callable[..., Any] | None = None
    state_size: int = field(init=False)
    adaptive: bool = field(init=False)  # whether the coefficients follow the estimate
    indicators = 0

    def __post_init__(self) -> None:
        known = isinstance(self.regions, Intervals | Polygons)
        cells = self.regions if known else Intervals(self.regions)
        mean0 = as_real("mean0", self.mean0, (None,))
        if mean0.size < cells.size:
            raise ValueError(f"mean0: wanted {cells.size} components or more, got {mean0.size}")
        cov0 = as_covariance("cov0", self.cov0, mean0.size)
        adaptive = isinstance(self.dynamics, Tangents) and self.dynamics.adaptive
        sizes = {"state_size": mean0.size, "adaptive": adaptive}
        vars(self).update(regions=cells, mean0=mean0, cov0=cov0, **sizes)

    @classmethod
    def from_functions(
        cls, *, state, dynamics, sensor, noise, breakpoints, initial, support="centroid", time=None
    ) -> PiecewiseLinearSystem:
        """Tangents of nonlinear SymPy functions on every interval, equations (21) to (23).

        Parameters
        ----------
        state : sequence of Symbol
            The k state symbols; the first one is restricted by the cells.
        dynamics, sensor : sequence of expressions
            The next state and the measurement, in the state, the noise symbols and `time`.
        noise : sequence of Symbol
            Standard normal; each enters the dynamics or the sensor, linearly.
        breakpoints : array_like
            Increasing finite edges (n + 1,) of n cells, of which the first and the last are
            extended to infinity.
        initial : (mean0, cov0)
            Prior at the first time.
        support : {"centroid", "estimate"} or array_like
            Where the tangents are taken: the middle of the cell as given, so that an extended
            cell keeps the middle of the bounded one, and the prior mean in the components that
            are not restricted; "estimate" puts the current estimate in place of the support
            point of the cell that holds it (predicted estimate for the sensor), and its
            unrestricted components in every cell; or points (n,) of the first component.
        time : Symbol, optional
            Symbol of the time: in the dynamics the one they leave.
        """
        from seedslib.base.symbols import named_model
        from seedslib.models.codegen import known_expressions

        edges = as_real("breakpoints", breakpoints, (None,))
        cells = Intervals(np.concatenate([[-np.inf], edges[1:-1], [np.inf]]))
        rule = support if isinstance(support, str) else "points"
        middle, adaptive = rule in ("centroid", "estimate"), rule == "estimate"
        points = as_real("support", 0.5 * (edges[:-1] + edges[1:]) if middle else support, (None,))
        if not np.array_equal(cells.locate(points[None]), np.arange(len(cells))):
            raise ValueError("support: wanted one point in each cell, in the order of the cells")
        state, time, _ = named_model(state, time, None, noise=tuple(noise))
        mean0 = as_real("initial[0]", initial[0], (len(state),))
        points = np.vstack([points, np.repeat(mean0[1:, None], len(cells), axis=1)])
        allowed = {*state, *noise, time}
        f = known_expressions("dynamics", dynamics, (len(state),), {}, allowed)
        h = known_expressions("sensor", sensor, (None,), {}, allowed)
        own = [[s for s in noise if any(e.has(s) for e in part)] for part in (f, h)]
        if set(own[0]) & set(own[1]):
            raise ValueError("noise: wanted independent noises in the dynamics and in the sensor")
        pairs = zip((f, h), own, strict=True)
        maps = (StochasticMap(state, list(e), Noise(s), time=time) for e, s in pairs)
        parts = (Tangents(map_, points, cells, adaptive) for map_ in maps)
        return cls(cells, *parts, None, mean0, initial[1])

    def dynamics_at(self, t: float, estimate: np.ndarray | None = None) -> Coefficients:
        """Coefficients of the transition that leaves time t; they may follow `estimate` (k, N)."""
        noise = np.zeros((self.state_size, 0)) if self.noise is None else self.noise
        return self._coefficients("dynamics", self.dynamics, noise, t, estimate)

    def sensor_at(self, t: float, estimate: np.ndarray | None = None) -> Coefficients:
        """Coefficients of the measurement at time t; `estimate` (k, N) is the predicted one."""
        return self._coefficients("sensor", self.sensor, self.sensor_noise, t, estimate)

    def _coefficients(self, name, value, noise, t, estimate) -> Coefficients:
        """Arrays with a cell axis and an axis of records, from arrays that may lack both."""
        known = isinstance(value, Tangents)
        parts = value(t, estimate) if known else (*_at(value, t), _at(noise, t))
        rows, n = self.state_size if name == "dynamics" else len(parts[0]), len(self.regions)
        full = []
        for part, columns in zip(parts, ((), (self.state_size,), (-1,)), strict=True):
            part, depth = as_real(name, part), 1 + len(columns)
            part = part.reshape(part.shape + (1,) * (depth + 2 - part.ndim))
            part = as_real(name, part, (rows, *columns, n if part.shape[depth] > 1 else 1, -1))
            full.append(np.broadcast_to(part, (*part.shape[:depth], n, part.shape[-1])))
        return Coefficients(*full)

    def simulate(self, times: Any, paths: int, seed: Any, *, workers: int = 1) -> Simulation:
        """Simulate independent paths and their measurements.

        Parameters
        ----------
        times : int or array_like
            Number of steps K, for the times 0, 1, ..., K, or the grid (K+1,) itself.
        paths : int
            Number of paths N.
        seed : int, SeedSequence or Generator
        workers : int
            Threads over blocks of paths; the numbers do not depend on it.

        Returns
        -------
        Simulation
            states (K+1, k, N), measurements (K+1, m, N) with NaN at the first time: the first
            measurement follows the first transition.
        """
        times = as_steps(times)
        measured = np.arange(1, times.size)
        return self.discrete().simulate(times, paths, seed, measured=measured, workers=workers)

    def discrete(self) -> DiscreteSystem:
        """The system as a pair of maps, for simulation and for other filters.

        Of a system that was made from functions these functions, not their tangents.
        """
        if isinstance(self.dynamics, Tangents):
            return DiscreteSystem(self.dynamics.map, self.sensor.map, self.mean0, self.cov0)
        maps = (self._map(self.dynamics_at), self._map(self.sensor_at))
        return DiscreteSystem(*maps, self.mean0, self.cov0)

    def _map(self, coefficients: Callable[[float], Coefficients]) -> StochasticMap:
        rows, width = coefficients(1.0).noise.shape[:2]

        def of_cell(t: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            cell = self.regions.locate(x[: self.regions.size])
            offset, matrix, noise = (part[..., cell, 0] for part in coefficients(t))
            return offset + np.einsum("ij...,j...->i...", matrix, x), noise

        def value(t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
            mean, noise = of_cell(t, x)
            return mean + np.einsum("ij...,j...->i...", noise, v)

        def log_density(t: float, y: np.ndarray, x: np.ndarray) -> np.ndarray:
            mean, noise = of_cell(t, x)
            return gaussian_logpdf(y, mean, np.einsum("ip...,jp...->ij...", noise, noise))

        noise = Noise(width)
        return StochasticMap.from_functions(
            self.state_size, rows, value, noise, log_density=log_density
        )


def _at(value: Any, t: float) -> Any:
    return value(t) if callable(value) else value
