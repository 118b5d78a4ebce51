"""Linear discrete system whose next state depends on states of several past instants.

The state obeys ``x_k = sum_d A_d[k-1] x_{k-1-d} + G[k-1] w_{k-1}`` for any set of delays d and is
seen through ``y_k = C[k] x_k + v_k``, k = 1, 2, ... (Babenko, Lebedev, *Kalman filter for linear
discrete systems with delay*, equations (1)-(3), where the delays are 0 and N).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_count, as_covariance, as_shape
from seedslib.base.objects import by_fields
from seedslib.base.semidefinite import square_root
from seedslib.delay.coefficients import (
    Augmented,
    Coefficient,
    InstantStep,
    as_delays,
    as_instants,
    as_noise,
    coefficient,
    require_finite,
    start_law,
)
from seedslib.models.simulation import Schedule, Simulation


@dataclass(frozen=True, eq=False)
class DelaySystem:
    """Linear system with state delays, a linear sensor and a Gaussian history.

    A coefficient is an array, an array with one entry per instant on a leading axis, or a
    function of the instant k that returns an array; a number stands for a 1×1 matrix. Entry (or
    value) k - 1 of the dynamics and of the noise drives x_k; entry k of the sensor gives y_k, so
    that entry 0 of a sensor array is never used.

    Parameters
    ----------
    dynamics : mapping of int to array_like or callable
        For each delay d >= 0 the matrix A_d, shape (n, n), that multiplies x_{k-1-d}. The
        largest delay is N, also where its matrix is zero.
    sensor : array_like or callable
        C, shape (m, n).
    noise_cov : array_like or callable
        Q, shape (q, q), positive semidefinite; may be singular or zero.
    sensor_cov : array_like or callable
        R, shape (m, m), positive definite.
    cov0 : array_like
        Covariance of x_0, shape (n, n), or of ``(x_0, x_{-1}, ..., x_{-N})``, shape
        ((N+1)n, (N+1)n). May be singular.
    history_cov : array_like, optional
        Covariances of x_{-1}, ..., x_{-N}, shape (N, n, n), or one for all, shape (n, n): the
        history is then independent from instant to instant (2). Only beside a `cov0` of shape
        (n, n); zero by default.
    mean0 : array_like, optional
        Mean of x_0, shape (n,) (the history then has mean zero), or of the whole stack, shape
        ((N+1)n,). Zero by default.
    noise_input : array_like or callable, optional
        G, shape (n, q); the identity by default.

    Raises
    ------
    TypeError
        A coefficient is complex, an object array, or ragged; a delay is not an integer.
    ValueError
        No or a negative delay, a wrong shape, an entry that is not finite, a covariance that is
        not symmetric or not semidefinite, R that is not positive definite. Functions of k are
        checked at their first instant on entry and at every instant when they are used.

    Attributes
    ----------
    state_size, measurement_size : int
        Dimensions n of the state and m of the measurement.
    """

    dynamics: Mapping[int, Coefficient]
    sensor: Coefficient
    noise_cov: Coefficient
    sensor_cov: Coefficient
    cov0: ArrayLike
    history_cov: ArrayLike | None = None
    mean0: ArrayLike | None = None
    noise_input: Coefficient | None = None
    indicators = 0

    def __post_init__(self) -> None:
        delays = as_delays(self.dynamics)
        first = coefficient(f"dynamics[{delays[0]}]", self.dynamics[delays[0]], as_shape, (-1, -1))
        n = first.at(0).shape[1]
        if n == 0:
            raise ValueError("dynamics: wanted at least one state component, got none")
        table = {
            f"dynamics[{d}]": coefficient(f"dynamics[{d}]", self.dynamics[d], as_shape, (n, n))
            for d in delays
        }
        table["noise_cov"] = coefficient("noise_cov", self.noise_cov, as_covariance)
        q = table["noise_cov"].at(0).shape[0]
        gain = np.eye(n) if self.noise_input is None else self.noise_input
        table["noise_input"] = coefficient("noise_input", gain, as_shape, (n, q))
        table["sensor"] = coefficient("sensor", self.sensor, as_shape, (-1, n))
        m = table["sensor"].at(1).shape[0]
        if m == 0:
            raise ValueError("sensor: wanted at least one measurement component, got none")
        table["sensor_cov"] = coefficient("sensor_cov", self.sensor_cov, as_noise, m)
        law = start_law(self.mean0, self.cov0, self.history_cov, n, delays[-1])
        values = {name: checked.value for name, checked in table.items()}
        values["dynamics"] = MappingProxyType({d: values.pop(f"dynamics[{d}]") for d in delays})
        values |= {"mean0": law.mean, "cov0": law.cov, "history_cov": law.past}
        vars(self).update(values, state_size=n, measurement_size=m, _table=table)
        self.step(1)

    def __reduce__(self) -> tuple[Any, ...]:
        past = self.history_cov if np.size(self.history_cov) else None
        return by_fields(self, dynamics=dict(self.dynamics), history_cov=past)

    @cached_property
    def delays(self) -> tuple[int, ...]:
        """The delays, increasing."""
        return tuple(self.dynamics)

    @property
    def max_delay(self) -> int:
        """The largest delay N."""
        return self.delays[-1]

    @cached_property
    def constant(self) -> bool:
        """Whether no coefficient depends on k."""
        return not any(c.varies for c in self._table.values())

    @cached_property
    def horizon(self) -> int | None:
        """Largest K to which all coefficient arrays reach; None without such arrays."""
        arrays = (c for c in self._table.values() if c.varies and not callable(c.value))
        return min((len(c.value) - c.name.startswith("sensor") for c in arrays), default=None)

    def start_blocks(self) -> np.ndarray | None:
        """Covariances (N+1, n, n) of x_0, x_{-1}, ..., x_{-N}; None if these are correlated."""
        if self.history_cov is not None:
            return np.concatenate([self.cov0[None], self.history_cov])
        n, blocks = self.state_size, self.max_delay + 1
        joint = self.cov0.reshape(blocks, n, blocks, n).swapaxes(1, 2)
        return None if joint[~np.eye(blocks, dtype=bool)].any() else joint[np.diag_indices(blocks)]

    def start_cov(self) -> np.ndarray:
        """Covariance ((N+1)n, (N+1)n) of the stack ``(x_0, x_{-1}, ..., x_{-N})``."""
        if self.history_cov is None:
            return self.cov0.copy()
        n, blocks = self.state_size, self.max_delay + 1
        joint = np.zeros((blocks, n, blocks, n))
        joint[np.arange(blocks), :, np.arange(blocks)] = self.start_blocks()
        return joint.reshape(blocks * n, blocks * n)

    def step(self, k: int) -> InstantStep:
        """Coefficients of the step from instant k-1 to k, checked, k >= 1.

        Raises
        ------
        TypeError, ValueError
            k < 1 or beyond the horizon, or a function of k returned something illegal.
        """
        return self._only if self.constant else self._read(k)

    def augmented(self, k: int = 1) -> Augmented:
        """Matrices of step k for the stacked state, newest block first.

        Raises
        ------
        TypeError, ValueError
            As `step`.
        """
        return self.step(k).stacked(self.max_delay + 1)

    def simulate(
        self, times: ArrayLike, paths: int | None, seed: object, *,
        measured: ArrayLike | None = None, availability: ArrayLike | None = None,
        workers: int = 1,
    ) -> Simulation:  # fmt: skip
        """Independent Gaussian paths.

        Parameters
        ----------
        times : int or array_like
            Last instant K >= 1, or the instants 0, 1, ..., K, shape (K+1,).
        paths : int or None
            Number of paths; None for one path without a batch axis.
        seed : int, SeedSequence or Generator
            One child stream is spawned per block of 8192 paths.
        measured : array_like, optional
            Mask or indices of the instants with a measurement (default all), or mask (K+1, m);
            NaN at the others.
        availability : float or array_like, shape (m,), optional
            Probability that a component arrives; see `seedslib.models.simulation.simulate`.
        workers : int
            Threads over blocks of paths.

        Returns
        -------
        Simulation
            states (K+1, n, *batch); measurements (K+1, m, *batch), NaN at k = 0, where nothing
            is measured; history (N, n, *batch) holds x_{-1}, ..., x_{-N}.

        Raises
        ------
        TypeError, ValueError
            Other times, or times beyond the horizon; `paths` is not a positive integer, the
            seed is none, or a path of an unstable plant overflows.
        """
        times = as_instants(times)
        schedule = Schedule.of(measured, availability, len(times), self.measurement_size)
        reach, n, m = self.max_delay + 1, self.state_size, self.measurement_size
        width = 1 if paths is None else as_count("paths", paths)
        chain = np.empty((reach + len(times) - 1, n, width))  # x_{-N}, ..., x_K
        shown = np.full((len(times), m, width), np.nan)
        blocks = self.start_blocks()
        root = square_root(self.start_cov()[None] if blocks is None else blocks)
        steps = [self.step(k) for k in range(1, len(times))]
        drives = [c.noise_input @ square_root(c.noise_cov) for c in steps]
        errors = [np.linalg.cholesky(c.sensor_cov) for c in steps]

        def draw(first: int, last: int, stream: np.random.SeedSequence) -> None:
            rng, block, size = np.random.default_rng(stream), slice(first, last), last - first
            start = root @ rng.standard_normal((*root.shape[:2], size))
            start = start.reshape(reach, n, size) + self.mean0.reshape(reach, n, 1)
            chain[:reach, :, block] = start[::-1]
            for k, c in enumerate(steps, start=1):
                now, noise, error = reach - 1 + k, drives[k - 1], errors[k - 1]
                with np.errstate(over="ignore", invalid="ignore"):
                    state = noise @ rng.standard_normal((noise.shape[1], size))
                    for d, matrix in c.dynamics.items():
                        state += matrix @ chain[now - 1 - d, :, block]
                    seen = c.sensor @ state + error @ rng.standard_normal((m, size))
                require_finite("paths", k, state, seen)
                chain[now, :, block] = state
                shown[k, :, block] = seen
                schedule.leave_out(k, shown[k, :, block], stream)

        in_blocks(draw, width, seed, workers=workers)
        parts = (chain[reach - 1 :], shown, chain[: reach - 1][::-1])
        if paths is None:
            parts = tuple(part[..., 0] for part in parts)
        return Simulation(times, *parts[:2], history=parts[2])

    @cached_property
    def _only(self) -> InstantStep:
        return self._read(1)

    def _read(self, k: int) -> InstantStep:
        k = as_count("k", k)
        if self.horizon is not None and k > self.horizon:
            raise ValueError(
                f"k: wanted at most {self.horizon}, the reach of the coefficient arrays, got {k}"
            )
        dynamics = {d: self._table[f"dynamics[{d}]"].at(k - 1) for d in self.delays}
        g, q = (self._table[name].at(k - 1) for name in ("noise_input", "noise_cov"))
        c, r = (self._table[name].at(k) for name in ("sensor", "sensor_cov"))
        if c.shape[0] != self.measurement_size:
            raise ValueError(
                f"sensor at k = {k}: wanted {self.measurement_size} rows, got shape {c.shape}"
            )
        if g.shape[1] != q.shape[0]:
            raise ValueError(f"noise_cov at k = {k - 1}: wanted size {g.shape[1]}, got {q.shape}")
        with np.errstate(over="ignore", invalid="ignore"):
            state_noise = g @ q @ g.T
        require_finite("noise_input and noise_cov", k, state_noise)
        return InstantStep(dynamics, g, q, state_noise, c, r)
