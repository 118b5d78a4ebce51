"""Systems that are linear on every cell of a partition of their leading components."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Array
from seedslib.base.checks import as_covariance, as_real, as_shape, require_one_size
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.kinds import as_steps
from seedslib.models.simulation import Schedule, Simulation
from seedslib.piecewise.cells import as_cells
from seedslib.piecewise.coefficients import Coefficients, affine_map, as_coefficients
from seedslib.piecewise.functions import Tangents, tangents


@dataclass(frozen=True, eq=False)
class PiecewiseLinearSystem:
    """State and sensor that are affine on every cell Q_i of a partition.

    In cell i: ``x(t+1) = a_i(t) + A_i(t) x(t) + G_i(t) w(t)`` where x(t) lies in Q_i, and
    ``y(t) = b_i(t) + B_i(t) x(t) + H_i(t) v(t)`` where x(t) does; w and v are independent
    standard normal. Coefficients of the dynamics are those of the time they leave. The cells
    restrict the leading one or two components only.
    Kolessa, equation (21).

    Parameters
    ----------
    regions : array_like or sequence
        Edges from ``-inf`` to ``inf``, (n + 1,), or pairs (lower, upper); cells are half-open,
        ``lower <= x < upper``. For two restricted components a list of convex cells, each the
        table (V, 2) of its vertices or, where unbounded, `HalfPlanes`.
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
    functions : Tangents, optional
        The nonlinear functions behind the coefficients; set by `from_functions`.

    Raises
    ------
    TypeError, ValueError
        Cells that overlap, are out of order or do not cover the space, shapes that do not fit,
        entries that are not finite, an indefinite `cov0`.
    """

    regions: Any
    dynamics: tuple[ArrayLike, ArrayLike] | Callable[..., Any]
    sensor: tuple[ArrayLike, ArrayLike] | Callable[..., Any]
    sensor_noise: ArrayLike | Callable[..., Any] | None
    mean0: Array
    cov0: Array
    noise: ArrayLike | Callable[..., Any] | None = None
    functions: Tangents | None = None
    indicators = 0

    def __post_init__(self) -> None:
        mean0 = as_real("mean0", self.mean0, ndim=1)
        cells = as_cells(self.regions)
        if mean0.size < cells.size:
            raise ValueError(
                f"mean0: wanted at least {cells.size} components for these regions, "
                f"got {mean0.size}"
            )
        cov0 = as_real("cov0", self.cov0)
        require_one_size("mean0, cov0", mean0, cov0)
        cov0 = as_covariance("cov0", cov0, mean0.size)
        vars(self).update(regions=cells, mean0=mean0, cov0=cov0)
        if self.functions is None:
            if not callable(self.dynamics) and not callable(self.noise):
                self.dynamics_at(0.0)
            if not callable(self.sensor) and not callable(self.sensor_noise):
                self.sensor_at(0.0)

    @classmethod
    def from_functions(
        cls, *, state: Sequence[Any], dynamics: Sequence[Any], sensor: Sequence[Any],
        breakpoints: object, initial: tuple[Any, ...], noise: object = None,
        support: object = "centroid", time: object = None,
        parameters: Mapping[Any, Any] | None = None,
    ) -> PiecewiseLinearSystem:  # fmt: skip
        """Tangents of nonlinear SymPy functions on every cell, equations (21) to (23).

        Parameters
        ----------
        state : sequence of Symbol
            The k state symbols; the leading one or two are restricted by the cells.
        dynamics, sensor : sequence of expressions
            The next state and the measurement, in the state, the noise symbols and `time`.
        breakpoints : array_like or sequence
            Increasing finite edges (n + 1,) of n cells, of which the first and the last are
            extended to infinity; or plane cells as in the constructor.
        initial : (mean0, cov0)
            Prior at the first time.
        noise : Noise or Symbol or sequence of Symbol, optional
            Noise symbols, standard normal unless a `Noise` says otherwise. They enter linearly,
            each of them the dynamics or the sensor.
        support : {"centroid", "estimate"} or array_like
            Where the tangents are taken: the middle of the cell as given, so that an extended
            cell keeps the middle of the bounded one, and the prior mean in the components that
            are not restricted; "estimate" puts the current estimate in place of the support
            point of the cell that holds it (predicted estimate for the sensor), and its
            unrestricted components in every cell; or points (k1, n) or (k, n).
        time : Symbol, optional
            Symbol of the time: in the dynamics the one they leave.
        parameters : mapping, optional
            Values of further symbols.

        Raises
        ------
        TypeError, ValueError
            Unknown symbols, noise that does not enter linearly or enters both functions, edges
            that do not increase, support points outside their cells.
        """
        mean0 = as_real("initial[0]", initial[0], ndim=1)
        model = tangents(
            state=state, dynamics=dynamics, sensor=sensor, noise=noise, breakpoints=breakpoints,
            support=support, time=time, mean0=as_shape("initial[0]", mean0, (len(tuple(state)),)),
            parameters=parameters,
        )  # fmt: skip
        return cls(
            model.cells, model.dynamics, model.sensor, None, mean0, initial[1], functions=model
        )

    @property
    def state_size(self) -> int:
        """Number of state components."""
        return self.mean0.size

    @property
    def measurement_size(self) -> int:
        """Number of measured components; of a sensor that is a function of time those at t = 1."""
        return self.sensor_at(1.0).offset.shape[0]

    def dynamics_at(self, t: float, estimate: np.ndarray | None = None) -> Coefficients:
        """Coefficients of the transition that leaves time t.

        Parameters
        ----------
        t : float
        estimate : ndarray, shape (k, N), optional
            Estimates at time t; used with ``support="estimate"`` only.
        """
        if self.functions is not None:
            parts = self.functions.dynamics(t, estimate)
        else:
            noise = _at(self.noise, t)
            noise = np.zeros((self.state_size, 0)) if noise is None else noise
            parts = (*_at(self.dynamics, t), noise)
        count, n = self.regions.count, self.state_size
        return as_coefficients("dynamics", parts, count, n, n)

    def sensor_at(self, t: float, estimate: np.ndarray | None = None) -> Coefficients:
        """Coefficients of the measurement at time t; `estimate` (k, N) is the predicted one."""
        if self.functions is not None:
            parts = self.functions.sensor(t, estimate)
        else:
            parts = (*_at(self.sensor, t), _at(self.sensor_noise, t))
        return as_coefficients("sensor", parts, self.regions.count, self.state_size, None)

    def simulate(
        self, times: object, paths: int, seed: object, *, measured: object = None,
        availability: Any = None, start: object = None, linear: bool = False, workers: int = 1,
    ) -> Simulation:  # fmt: skip
        """Simulate independent paths and their measurements.

        Parameters
        ----------
        times : int or array_like
            Number of steps K, for the times 0, 1, ..., K, or the grid (K+1,) itself.
        paths : int
            Number of paths N.
        seed : int, SeedSequence or Generator
        measured : array_like, optional
            Mask or indices of the times with a measurement, or mask (K+1, m): all but the first
            by default, and at the first nothing is ever measured.
        availability : float or array_like, shape (m,), optional
            Probability that a component arrives; see `seedslib.models.simulation.simulate`.
        start : array_like, shape (k,), optional
            Initial state of every path; drawn from the prior by default.
        linear : bool
            Simulate the piecewise-linear model also where it approximates nonlinear functions,
            which are simulated by default.
        workers : int
            Threads over blocks of paths; the numbers do not depend on it.

        Returns
        -------
        Simulation
            states (K+1, k, N), measurements (K+1, m, N) with NaN at the first time: the first
            measurement follows the first transition.

        Raises
        ------
        TypeError, ValueError
            An illegal grid, `paths` not a positive integer, `start` of a wrong shape.
        """
        times = as_steps(times)
        source = self.discrete(linear=linear, times=(times[0], times[-1]))
        if start is not None:
            start = as_shape("start", start, (self.state_size,))
            same = start[:, None]
            source = replace(source, initial=lambda rng, count: np.repeat(same, count, axis=1))
        mask = Schedule.of(measured, None, times.size, source.measurement_size).mask
        mask = mask & (np.arange(times.size) > 0)[:, None]
        return source.simulate(
            times, paths, seed, measured=mask, availability=availability, workers=workers
        )

    def discrete(
        self, *, linear: bool = False, times: Sequence[Any] = (0.0, 1.0)
    ) -> DiscreteSystem:
        """The system as a pair of maps, for simulation and for other filters.

        Parameters
        ----------
        linear : bool
            The piecewise-linear maps also where they approximate nonlinear functions; by
            default the functions themselves.
        times : (float, float)
            A time at which there are dynamics, and one at which there is a sensor: the shapes of
            their coefficients are looked up there.
        """
        if self.functions is not None and not linear:
            maps = self.functions.transition, self.functions.sensor_map
        else:
            maps = (
                affine_map(self.regions, self.state_size, coefficients, float(t))
                for coefficients, t in zip((self.dynamics_at, self.sensor_at), times, strict=True)
            )
        return DiscreteSystem(*maps, self.mean0, self.cov0)


def _at(value: object, t: float) -> object:
    return value(t) if callable(value) else value
