"""From nonlinear state and sensor functions to a tangent on every cell."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from seedslib.base.checks import as_real, as_shape
from seedslib.base.objects import Remade
from seedslib.base.semidefinite import factor
from seedslib.models.maps import StochasticMap
from seedslib.models.noise import Noise
from seedslib.piecewise.cells import Intervals, Polygons, as_cells
from seedslib.piecewise.clipping import HalfPlanes, box, centroid, clip_all

Numeric = Callable[[float, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Tangents(Remade):
    """Nonlinear functions f and h, and where they are linearised.

    Made by `PiecewiseLinearSystem.from_functions`. The coefficients of cell i are those of the
    tangents at its support point, equations (22) and (23) of the paper:
    ``a = f(p) - f'(p) p``, ``A = f'(p)``, and the same for the sensor.

    Attributes
    ----------
    transition, sensor_map : StochasticMap
        Next state and measurement, with their noises.
    support : ndarray, shape (k, n)
        Support points of the cells.
    cells : Intervals or Polygons
    adaptive : bool
        Whether the current estimate replaces the support point of the cell that holds it.
    slopes : tuple of two triples of callables
        For the dynamics and for the sensor: mean, Jacobian in the state, and coefficients of
        independent standard normal noise, as functions of t and x (k, *batch).

    Raises
    ------
    ValueError
        Noise that does not enter linearly.
    """

    transition: StochasticMap
    sensor_map: StochasticMap
    support: np.ndarray
    cells: Intervals | Polygons
    adaptive: bool
    slopes: tuple[tuple[Numeric, Numeric, Numeric], ...] = field(init=False)

    def __post_init__(self) -> None:
        slopes = _slopes("dynamics", self.transition), _slopes("sensor", self.sensor_map)
        object.__setattr__(self, "slopes", slopes)

    def points(self, estimate: np.ndarray | None) -> np.ndarray:
        """Support points, (k, n) or, with estimates (k, N) of an adaptive system, (k, n, N)."""
        if not self.adaptive or estimate is None:
            return self.support
        lead = self.cells.size
        points = np.repeat(self.support[:, :, None], estimate.shape[1], axis=2)
        sound = np.flatnonzero(np.isfinite(estimate).all(axis=0))
        points[lead:, :, sound] = estimate[lead:, None, sound]
        points[:, self.cells.locate(estimate[:lead, sound]), sound] = estimate[:, sound]
        return points

    def dynamics(self, t: float, estimate: np.ndarray | None = None) -> tuple[Any, ...]:
        """Offset, matrix and noise of every cell, as arrays (k, n), (k, k, n), (k, p, n)."""
        return _tangent(*self.slopes[0], t, self.points(estimate))

    def sensor(self, t: float, estimate: np.ndarray | None = None) -> tuple[Any, ...]:
        """Offset, matrix and noise of every cell, as arrays (m, n), (m, k, n), (m, q, n)."""
        return _tangent(*self.slopes[1], t, self.points(estimate))


def _tangent(
    mean: Numeric, jacobian: Numeric, noise: Numeric, t: float, points: np.ndarray
) -> tuple:
    slope = jacobian(t, points)
    return mean(t, points) - np.einsum("ij...,j...->i...", slope, points), slope, noise(t, points)


def tangents(
    *, state: Sequence[Any], dynamics: Sequence[Any], sensor: Sequence[Any], noise: object,
    breakpoints: object, support: object, time: object, mean0: np.ndarray,
    parameters: Mapping[Any, Any] | None,
) -> Tangents:  # fmt: skip
    """Compile the model of `PiecewiseLinearSystem.from_functions`; see there."""
    from seedslib.base.symbols import named_model
    from seedslib.models.codegen import known_expressions

    noise = _as_noise(noise)
    state, time, values = named_model(state, time, parameters, noise=noise.symbols)
    allowed = {*state, *noise.symbols, time}
    f = known_expressions("dynamics", dynamics, (len(state),), values, allowed)
    h = known_expressions("sensor", sensor, (None,), values, allowed)
    if not len(h):
        raise ValueError("sensor: wanted at least one expression, got none")
    used = [set().union(*(e.free_symbols for e in part)) for part in (f, h)]
    moving, seen = ([s in part for s in noise.symbols] for part in used)
    if noise.cov[np.ix_(moving, seen)].any():
        raise ValueError("noise: wanted independent noises in the dynamics and in the sensor")
    transition = StochasticMap(state, list(f), _part(noise, moving), time=time)
    sensor_map = StochasticMap(state, list(h), _part(noise, seen), time=time)
    cells, middle = _cells(breakpoints)
    adaptive = isinstance(support, str) and support == "estimate"
    points = _points(support, cells, middle, mean0)
    return Tangents(transition, sensor_map, points, cells, adaptive)


def _as_noise(noise: object) -> Noise:
    """A Gaussian `Noise` with named components from what the user passed."""
    if noise is None or isinstance(noise, Noise):
        noise = noise or Noise()
    else:
        noise = Noise(tuple(noise) if isinstance(noise, Sequence) else (noise,))
    if noise.symbols is None or not noise.gaussian:
        raise ValueError("noise: wanted Gaussian noise with named components")
    return noise


def _part(noise: Noise, used: list[bool]) -> Noise:
    symbols = [symbol for symbol, is_used in zip(noise.symbols, used, strict=True) if is_used]
    return Noise(symbols, mean=noise.mean[used], cov=noise.cov[np.ix_(used, used)])


def _slopes(name: str, map_: StochasticMap) -> tuple[Numeric, Numeric, Numeric]:
    """Mean, Jacobian and noise coefficients of a map that is affine in its noise."""
    import sympy as sp

    from seedslib.models.codegen import compile_array

    value, noise = sp.Matrix(map_.expressions.tolist()), map_.noise
    symbols = list(noise.symbols)
    gain = value.jacobian(symbols) if symbols else sp.zeros(len(value), 0)
    if gain.free_symbols & set(symbols):
        raise ValueError(f"{name}: wanted noise that enters linearly, got {list(value)}")
    mean = value.subs(dict(zip(symbols, noise.mean.tolist(), strict=True)))
    spread = gain * sp.Matrix(len(symbols), len(symbols), factor(noise.cov).ravel().tolist())
    arguments = (map_.time, map_.state)
    compiled = (compile_array(arguments, e) for e in (list(mean), mean.jacobian(map_.state)))
    if not symbols:
        return (*compiled, lambda t, x: np.zeros((len(value), 0, *x.shape[1:])))
    return (*compiled, compile_array(arguments, spread))


def _cells(breakpoints: object) -> tuple[Intervals | Polygons, np.ndarray]:
    """Cells that cover the space, and the middles (k1, n) of those given; infinite without one."""
    whole = isinstance(breakpoints, Intervals | Polygons)
    if not whole and not isinstance(breakpoints[0], HalfPlanes) and np.ndim(breakpoints[0]) == 0:
        edges = as_real("breakpoints", breakpoints, ndim=1)
        if edges.size < 2 or (np.diff(edges) <= 0.0).any():
            raise ValueError("breakpoints: wanted at least two strictly increasing edges")
        cells = Intervals(np.concatenate([[-np.inf], edges[1:-1], [np.inf]]))
        return cells, 0.5 * (edges[:-1] + edges[1:])[None]
    cells = as_cells(breakpoints)
    if isinstance(cells, Intervals):
        bounded = np.isfinite(cells.lower) & np.isfinite(cells.upper)
        ends = np.where(bounded, cells.lower, 0.0), np.where(bounded, cells.upper, 0.0)
        return cells, np.where(bounded, 0.5 * (ends[0] + ends[1]), np.inf)[None]
    square, reach = box(np.zeros(2), np.full(2, cells.radius)), cells.radius * (1.0 - 1e-9)
    pieces = [clip_all(square, cell) for cell in cells.cells]
    middle = [
        np.full(2, np.inf) if np.abs(piece).max() >= reach else centroid(piece) for piece in pieces
    ]
    return cells, np.stack(middle, axis=1)


def _points(
    support: object, cells: Intervals | Polygons, middle: np.ndarray, mean0: np.ndarray
) -> np.ndarray:
    """Support points of the cells, shape (k, n)."""
    if isinstance(support, str):
        if support not in ("centroid", "estimate"):
            raise ValueError(f'support: wanted "centroid", "estimate" or points, got "{support}"')
        if not np.isfinite(middle).all():
            raise ValueError("support: an unbounded cell has no centroid; pass support points")
        points = middle
    else:
        points = as_real("support", support)
        points = points[None] if points.ndim == 1 else points
        rows = mean0.size if len(points) == mean0.size else cells.size
        points = as_shape("support", points, (rows, cells.count))
        if (cells.locate(points[: cells.size]) != np.arange(cells.count)).any():
            raise ValueError("support: wanted one point in each cell, in the order of the cells")
    rest = np.repeat(mean0[len(points) :, None], cells.count, axis=1)
    return np.concatenate([points, rest])
