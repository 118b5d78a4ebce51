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
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import as_count
from seedslib.base.checks import as_covariance, as_shape
from seedslib.base.semidefinite import square_root
from seedslib.delay.coefficients import (
    Coefficient,
    as_delays,
    as_noise,
    coefficient,
    path_blocks,
    require_finite,
    start_law,
)


class Step(NamedTuple):
    """What leads from instant k-1 to k and to the measurement of instant k.

    dynamics: one (n, n) array for each delay, in increasing order of delay; noise_input (n, q);
    noise_cov (q, q); state_noise = G Q Gᵀ (n, n); sensor (m, n); sensor_cov (m, m).
    """

    dynamics: tuple[np.ndarray, ...]
    noise_input: np.ndarray
    noise_cov: np.ndarray
    state_noise: np.ndarray
    sensor: np.ndarray
    sensor_cov: np.ndarray


class Augmented(NamedTuple):
    """The same step for the stacked state ``(x_k, x_{k-1}, ..., x_{k-N})`` of size D = (N+1)n.

    transition (D, D), noise (D, D), sensor (m, D), sensor_cov (m, m).
    """

    transition: np.ndarray
    noise: np.ndarray
    sensor: np.ndarray
    sensor_cov: np.ndarray


class DelayPaths(NamedTuple):
    """Simulated paths.

    times (K+1,) are the instants 0..K; states (K+1, n, *batch); measurements (K+1, m, *batch),
    NaN at k = 0, where nothing is measured; history (N, n, *batch) holds x_{-1}, ..., x_{-N}.
    """

    times: np.ndarray
    states: np.ndarray
    measurements: np.ndarray
    history: np.ndarray


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
    n, m : int
        Dimensions of the state and of the measurement.
    """

    dynamics: Mapping[int, Coefficient]
    sensor: Coefficient
    noise_cov: Coefficient
    sensor_cov: Coefficient
    cov0: ArrayLike
    history_cov: ArrayLike | None = None
    mean0: ArrayLike | None = None
    noise_input: Coefficient | None = None

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
        values |= {"n": n, "m": m, "_table": table}
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self.step(1)

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
        ends = [
            len(c.value) - (name.startswith("sensor"))
            for name, c in self._table.items()
            if c.varies and not callable(c.value)
        ]
        return min(ends, default=None)

    def start_blocks(self) -> np.ndarray | None:
        """Covariances (N+1, n, n) of x_0, x_{-1}, ..., x_{-N}; None if these are correlated."""
        if self.history_cov is not None:
            return np.concatenate([self.cov0[None], self.history_cov])
        n, blocks = self.n, self.max_delay + 1
        joint = self.cov0.reshape(blocks, n, blocks, n).swapaxes(1, 2)
        return None if joint[~np.eye(blocks, dtype=bool)].any() else joint[np.diag_indices(blocks)]

    def start_cov(self) -> np.ndarray:
        """Covariance ((N+1)n, (N+1)n) of the stack ``(x_0, x_{-1}, ..., x_{-N})``."""
        if self.history_cov is None:
            return self.cov0.copy()
        n, blocks = self.n, self.max_delay + 1
        joint = np.zeros((blocks, n, blocks, n))
        joint[np.arange(blocks), :, np.arange(blocks)] = self.start_blocks()
        return joint.reshape(blocks * n, blocks * n)

    def step(self, k: int) -> Step:
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
        c, n = self.step(k), self.n
        size = (self.max_delay + 1) * n
        transition = np.eye(size, k=-n)
        transition[:n] = 0.0
        for d, block in zip(self.delays, c.dynamics, strict=True):
            transition[:n, d * n : (d + 1) * n] = block
        noise = np.zeros((size, size))
        noise[:n, :n] = c.state_noise
        sensor = np.zeros((self.m, size))
        sensor[:, :n] = c.sensor
        return Augmented(transition, noise, sensor, c.sensor_cov)

    def simulate(self, steps: int, paths: int | None, seed: object) -> DelayPaths:
        """Independent Gaussian paths.

        Parameters
        ----------
        steps : int
            Last instant K >= 1.
        paths : int or None
            Number of paths; None for one path without a batch axis.
        seed : int, SeedSequence or Generator
            One child stream is spawned per block of 8192 paths.

        Returns
        -------
        DelayPaths

        Raises
        ------
        TypeError, ValueError
            `steps` or `paths` is not a positive integer, `steps` is beyond the horizon, the
            seed is none, or a path of an unstable plant overflows.
        """
        count = as_count("steps", steps)
        width = 1 if paths is None else as_count("paths", paths)
        reach, n = self.max_delay + 1, self.n
        chain = np.empty((reach + count, n, width))  # x_{-N}, ..., x_K
        measured = np.full((count + 1, self.m, width), np.nan)
        blocks = self.start_blocks()
        root = square_root(self.start_cov()[None] if blocks is None else blocks)
        table = [self._drawing(k) for k in range(1, count + 1)]
        for rng, block in path_blocks(seed, width):
            size = block.stop - block.start
            start = root @ rng.standard_normal((*root.shape[:2], size))
            start = start.reshape(reach, n, size) + self.mean0.reshape(reach, n, 1)
            chain[:reach, :, block] = start[::-1]
            for k, (c, noise, error) in enumerate(table, start=1):
                now = reach - 1 + k
                with np.errstate(over="ignore", invalid="ignore"):
                    state = noise @ rng.standard_normal((noise.shape[1], size))
                    for d, matrix in zip(self.delays, c.dynamics, strict=True):
                        state += matrix @ chain[now - 1 - d, :, block]
                    seen = c.sensor @ state + error @ rng.standard_normal((self.m, size))
                require_finite("paths", k, state, seen)
                chain[now, :, block], measured[k, :, block] = state, seen
        parts = (chain[reach - 1 :], measured, chain[: reach - 1][::-1])
        if paths is None:
            parts = tuple(part[..., 0] for part in parts)
        return DelayPaths(np.arange(count + 1), *parts)

    def _drawing(self, k: int) -> tuple[Step, np.ndarray, np.ndarray]:
        c = self.step(k)
        noise = c.noise_input @ square_root(c.noise_cov)
        return c, noise, np.linalg.cholesky(c.sensor_cov)

    @cached_property
    def _only(self) -> Step:
        return self._read(1)

    def _read(self, k: int) -> Step:
        k = as_count("k", k)
        if self.horizon is not None and k > self.horizon:
            raise ValueError(
                f"k: wanted at most {self.horizon}, the reach of the coefficient arrays, got {k}"
            )
        dynamics = tuple(self._table[f"dynamics[{d}]"].at(k - 1) for d in self.delays)
        g, q = (self._table[name].at(k - 1) for name in ("noise_input", "noise_cov"))
        c, r = (self._table[name].at(k) for name in ("sensor", "sensor_cov"))
        if c.shape[0] != self.m:
            raise ValueError(f"sensor at k = {k}: wanted {self.m} rows, got shape {c.shape}")
        if g.shape[1] != q.shape[0]:
            raise ValueError(f"noise_cov at k = {k - 1}: wanted size {g.shape[1]}, got {q.shape}")
        with np.errstate(over="ignore", invalid="ignore"):
            state_noise = g @ q @ g.T
        require_finite("noise_input and noise_cov", k, state_noise)
        return Step(dynamics, g, q, state_noise, c, r)
