"""Linear discrete system whose next state depends on states of several past instants.

The state obeys ``x_k = sum_d A_d x_{k-1-d} + G w_{k-1}`` for any set of delays d and is measured
as ``y_k = C x_k + v_k``, k = 1, 2, ... (Babenko, Lebedev, *Kalman filter for linear discrete
systems with delay*, equations (1)-(3), where the delays are 0 and N).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_count, as_covariance, as_real, is_whole
from seedslib.base.linalg import cholesky
from seedslib.models.linear import LinearSystem
from seedslib.models.simulation import Simulation


@dataclass(frozen=True, eq=False)
class DelaySystem:
    """Linear system with state delays, a linear sensor and a Gaussian history.

    A number stands for a 1×1 matrix; one of the last three for that times the identity (or times
    ones, of the mean).

    Parameters
    ----------
    dynamics : mapping of int to array_like
        For each delay d >= 0 the matrix A_d, shape (n, n), that multiplies x_{k-1-d}. The
        largest delay is N, also where its matrix is zero.
    sensor : array_like
        C, shape (m, n).
    noise_cov : array_like
        Q, shape (q, q), positive semidefinite; may be singular or zero.
    sensor_cov : array_like
        R, shape (m, m), positive definite.
    cov0 : array_like
        Covariance of x_0, shape (n, n). May be singular.
    history_cov : array_like, optional
        Covariances of x_{-1}, ..., x_{-N}, shape (N, n, n), or one for all, shape (n, n): the
        history has mean zero and is independent from instant to instant (2). Zero by default.
    mean0 : array_like, optional
        Mean of x_0, shape (n,). Zero by default.
    noise_input : array_like, optional
        G, shape (n, q); the identity by default.

    Raises
    ------
    TypeError, ValueError
        No or a negative delay, a wrong shape, a covariance that is none, a singular R.
    """

    dynamics: Mapping[int, Any]
    sensor: Any
    noise_cov: Any
    sensor_cov: Any
    cov0: Any
    history_cov: Any = 0.0
    mean0: Any = 0.0
    noise_input: Any = 1.0

    def __post_init__(self) -> None:
        delays = sorted(self.dynamics) if isinstance(self.dynamics, Mapping) else []
        if not delays or not all(is_whole(d) and d >= 0 for d in delays):
            raise ValueError(f"dynamics: wanted matrices by delays >= 0, got {self.dynamics}")
        noise_cov, sensor_cov, cov0 = (
            as_covariance(name, _filled(name, getattr(self, name)), definite=name == "sensor_cov")
            for name in ("noise_cov", "sensor_cov", "cov0")
        )
        n, reach = len(cov0), max(delays)
        drive = _filled("noise_input", self.noise_input, np.eye(n))
        history = _filled("history_cov", self.history_cov, np.eye(n))
        history = np.tile(history, (reach, 1, 1)) if history.ndim == 2 else history
        for block in history:
            as_covariance("history_cov", block)
        blocks = {d: _filled("dynamics", self.dynamics[d]) for d in delays}
        vars(self).update(
            dynamics={d: as_real("dynamics", block, (n, n)) for d, block in blocks.items()},
            sensor=as_real("sensor", _filled("sensor", self.sensor), (len(sensor_cov), n)),
            noise_cov=noise_cov,
            sensor_cov=sensor_cov,
            cov0=cov0,
            history_cov=as_real("history_cov", history, (reach, n, n)),
            mean0=as_real("mean0", _filled("mean0", self.mean0, np.ones(n)), (n,)),
            noise_input=as_real("noise_input", drive, (n, len(noise_cov))),
        )

    @property
    def state_size(self) -> int:
        """Dimension n of the state."""
        return len(self.cov0)

    @property
    def measurement_size(self) -> int:
        """Dimension m of the measurement."""
        return len(self.sensor)

    @property
    def max_delay(self) -> int:
        """The largest delay N."""
        return max(self.dynamics)

    @property
    def state_noise(self) -> np.ndarray:
        """Covariance G Q Gᵀ of what drives the state, (n, n)."""
        return self.noise_input @ self.noise_cov @ self.noise_input.T

    def start_blocks(self) -> np.ndarray:
        """Covariances (N+1, n, n) of x_0, x_{-1}, ..., x_{-N}."""
        return np.concatenate([self.cov0[None], self.history_cov])

    def stacked(self) -> LinearSystem:
        """The same system for the stack (x_k, ..., x_{k-N}) of size D = (N+1)n, newest first.

        Its Kalman filter is the optimal filter of the system with delays; block s of the estimate
        is that of the smoother with fixed lag s. A record begins with NaN at k = 0, where nothing
        is measured.
        """
        n, size = self.state_size, (self.max_delay + 1) * self.state_size
        transition = np.eye(size, k=-n)
        noise, cov, mean = np.zeros((size, size)), np.zeros((size, size)), np.zeros(size)
        for d, matrix in self.dynamics.items():
            transition[:n, d * n : (d + 1) * n] = matrix
        noise[:n, :n], mean[:n] = self.state_noise, self.mean0
        for j, block in enumerate(self.start_blocks()):
            cov[j * n : (j + 1) * n, j * n : (j + 1) * n] = block
        sensor = np.hstack([self.sensor, np.zeros((self.measurement_size, size - n))])
        return LinearSystem(transition, noise, sensor, self.sensor_cov, mean, cov)

    def simulate(self, steps: int, paths: int, seed: object, *, workers: int = 1) -> Simulation:
        """Independent Gaussian paths up to instant K = `steps`.

        Parameters
        ----------
        steps, paths : int
        seed : int, SeedSequence or Generator
            One child stream is spawned per block of 8192 paths.
        workers : int
            Threads over blocks of paths.

        Returns
        -------
        Simulation
            times 0, ..., K; states (K+1, n, paths); measurements (K+1, m, paths), NaN at k = 0,
            where nothing is measured.

        Raises
        ------
        TypeError, ValueError
            An illegal argument.
        """
        steps, paths = as_count("steps", steps), as_count("paths", paths)
        n, m, reach = self.state_size, self.measurement_size, self.max_delay + 1
        states = np.empty((reach + steps, n, paths))  # x_{-N}, ..., x_K
        measurements = np.full((steps + 1, m, paths), np.nan)
        start = np.stack([cholesky(block) for block in self.start_blocks()])
        drive = self.noise_input @ cholesky(self.noise_cov)
        sensor_root = np.linalg.cholesky(self.sensor_cov)

        def draw(first: int, last: int, stream: np.random.SeedSequence) -> None:
            rng, block, size = np.random.default_rng(stream), slice(first, last), last - first
            states[:reach, :, block] = (start @ rng.standard_normal((reach, n, size)))[::-1]
            states[reach - 1, :, block] += self.mean0[:, None]
            for k in range(1, steps + 1):
                state = drive @ rng.standard_normal((drive.shape[1], size))
                for d, matrix in self.dynamics.items():
                    state += matrix @ states[reach + k - 2 - d, :, block]
                states[reach + k - 1, :, block] = state
                noise = sensor_root @ rng.standard_normal((m, size))
                measurements[k, :, block] = self.sensor @ state + noise

        in_blocks(draw, paths, seed, workers=workers)
        return Simulation(np.arange(steps + 1.0), states[reach - 1 :], measurements)


def _filled(name: str, value: ArrayLike, unit: ArrayLike = ((1.0,),)) -> np.ndarray:
    """An array; a number is that times `unit`."""
    value = as_real(name, value)
    return value * np.array(unit) if value.ndim == 0 else value
