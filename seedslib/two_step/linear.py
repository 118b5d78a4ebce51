"""Linear diffusion with a linear sensor: the system of the Kalman-Bucy filter.

The state obeys ``dx = F x dt + G dv`` and is seen through ``dy = H x dt + dw``, where v and w are
independent Wiener processes of intensities Q and R (Choi, Song, Shin 2019, equation (1.1)).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import in_blocks
from seedslib.base.checks import (
    as_count,
    as_covariance,
    as_real,
    as_shape,
    as_times,
    require_one_size,
)
from seedslib.base.clock import when
from seedslib.base.semidefinite import square_root
from seedslib.models.propagation import distinct_steps, integrated, stepped

Coefficient = ArrayLike | Callable[[float], ArrayLike]
COEFFICIENTS = ("drift", "noise_intensity", "sensor", "sensor_intensity", "noise_input")


class PlantMatrices(NamedTuple):
    """Coefficients at one time: F (n,n), G Q Gᵀ (n,n), H (m,n), R (m,m)."""

    drift: np.ndarray
    diffusion: np.ndarray
    sensor: np.ndarray
    sensor_intensity: np.ndarray


class DiffusionPaths(NamedTuple):
    """Simulated paths: times (K+1,), states (K+1,n,N), measurement increments (K,m,N)."""

    times: np.ndarray
    states: np.ndarray
    increments: np.ndarray


@dataclass(frozen=True, eq=False)
class LinearDiffusion:
    """Linear system ``dx = F x dt + G dv``, ``dy = H x dt + dw`` with a Gaussian start.

    Every coefficient is a constant array or a function of time that returns one. Scalars are
    taken as 1×1 matrices.

    Parameters
    ----------
    drift : array_like or callable
        F, shape (n, n), 1/time.
    noise_intensity : array_like or callable
        Q, intensity of the process noise v, shape (r, r), positive semidefinite.
    sensor : array_like or callable
        H, shape (m, n).
    sensor_intensity : array_like or callable
        R, intensity of the sensor noise w, shape (m, m), positive definite.
    mean0, cov0 : array_like
        Mean (n,) and covariance (n, n) of the state at time 0; the covariance may be singular.
    noise_input : array_like or callable, optional
        G, shape (n, r); the identity by default.

    Raises
    ------
    TypeError
        A coefficient is complex, an object array, or ragged.
    ValueError
        A wrong shape, an entry that is not finite, a covariance or intensity that is not
        symmetric or not semidefinite, or R that is not positive definite. Functions of time are
        checked at time 0 on entry and at each time when they are used.
    """

    drift: Coefficient
    noise_intensity: Coefficient
    sensor: Coefficient
    sensor_intensity: Coefficient
    mean0: ArrayLike
    cov0: ArrayLike
    noise_input: Coefficient | None = None
    indicators = 0

    def __post_init__(self) -> None:
        mean0 = as_real("mean0", np.atleast_1d(as_real("mean0", self.mean0)), ndim=1)
        if mean0.size == 0:
            raise ValueError("mean0: wanted at least one state component, got none")
        cov0 = np.atleast_2d(as_real("cov0", self.cov0))
        require_one_size("mean0, cov0", mean0, cov0)
        cov0 = as_covariance("cov0", cov0, mean0.size)
        vars(self).update(mean0=_frozen(mean0), cov0=_frozen(cov0))
        for name in COEFFICIENTS:
            value = getattr(self, name)
            if value is not None and not callable(value):
                vars(self)[name] = _frozen(np.atleast_2d(as_real(name, value)))
        vars(self)["_constant"] = self._read(0.0) if self.constant else None
        self.matrices(0.0)

    @property
    def state_size(self) -> int:
        """Dimension n of the state."""
        return self.mean0.size

    @property
    def measurement_size(self) -> int:
        """Dimension m of the measurement."""
        return self.matrices(0.0).sensor.shape[0]

    @property
    def constant(self) -> bool:
        """Whether no coefficient depends on time."""
        return not any(callable(getattr(self, name)) for name in COEFFICIENTS)

    def matrices(self, t: float) -> PlantMatrices:
        """Coefficients at time t, checked.

        Raises
        ------
        TypeError, ValueError
            As for the class, when a function of time returns something illegal.
        """
        return self._read(float(t)) if self._constant is None else self._constant

    def transition(self, start: float, stop: float) -> tuple[np.ndarray, np.ndarray]:
        """Exact step of the state: x(stop) = A x(start) + noise of covariance Qd.

        Constant coefficients: Van Loan's matrix exponential on a short step, then doubling, so
        that a long step of a stable system neither overflows nor cancels. Otherwise the
        differential equations are integrated (DOP853).

        Returns
        -------
        A, Qd : ndarray
            Shapes (n, n) and (n, n).

        Raises
        ------
        ValueError
            Not 0 <= start <= stop.
        """
        if not 0.0 <= start <= stop < np.inf:
            raise ValueError(
                f"start, stop: wanted 0 <= start <= stop, got {when(start)}, {when(stop)}"
            )
        if self.constant:
            return stepped(*self.matrices(start)[:2], stop - start)
        return integrated(lambda t: self.matrices(t)[:2], start, stop)

    def simulate(self, times: ArrayLike, paths: int, seed: object) -> DiffusionPaths:
        """Independent paths of the state and the increments of the measurement.

        States and increments have their exact joint law on the grid (no discretisation error):
        the state is augmented with the integral of H x over each step.

        Parameters
        ----------
        times : array_like
            Grid, shape (K+1,), starting anywhere at or after 0.
        paths : int
            Number of paths N.
        seed : int, SeedSequence or Generator
            One child stream is spawned per block of 8192 paths.

        Returns
        -------
        DiffusionPaths
            times (K+1,), states (K+1, n, N), increments (K, m, N) of y over each step.

        Raises
        ------
        TypeError, ValueError
            An illegal grid or seed, or `paths` not a positive integer.
        """
        times = as_times("times", times)
        paths = as_count("paths", paths)
        steps = self._joint_steps(times)
        first, spread = self.transition(0.0, times[0])
        start = square_root(first @ self.cov0 @ first.T + spread)
        centre = first @ self.mean0
        states = np.empty((times.size, self.state_size, paths))
        increments = np.empty((times.size - 1, self.measurement_size, paths))

        def draw(first_path: int, last_path: int, stream: np.random.SeedSequence) -> None:
            rng, width = np.random.default_rng(stream), last_path - first_path
            block = slice(first_path, last_path)
            state = centre[:, None] + start @ rng.standard_normal((start.shape[1], width))
            states[0, :, block] = state
            for k, (move, noise) in enumerate(steps):
                joint = move @ state + noise @ rng.standard_normal((noise.shape[1], width))
                state = joint[: self.state_size]
                states[k + 1, :, block] = state
                increments[k, :, block] = joint[self.state_size :]

        in_blocks(draw, paths, seed)
        return DiffusionPaths(times, states, increments)

    def _joint_steps(self, times: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each step (transition, noise factor) of the state and the increment together."""
        if self.constant:
            lengths, index = distinct_steps(times)
            known = [self._drawn(*stepped(*self._joint(times[0]), step)) for step in lengths]
            return [known[j] for j in index]
        pairs = pairwise(times)
        return [self._drawn(*integrated(self._joint, start, stop)) for start, stop in pairs]

    def _joint(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Drift and diffusion of the state and the measurement y taken as one diffusion."""
        known, n = self.matrices(t), self.state_size
        size = n + known.sensor.shape[0]
        drift, diffusion = np.zeros((2, size, size))
        drift[:n, :n], drift[n:, :n] = known.drift, known.sensor
        diffusion[:n, :n], diffusion[n:, n:] = known.diffusion, known.sensor_intensity
        return drift, diffusion

    def _drawn(self, move: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.ascontiguousarray(move[:, : self.state_size]), square_root(spread)

    def _read(self, t: float) -> PlantMatrices:
        n = self.state_size
        drift = as_shape("drift", _at(self.drift, t), (n, n))
        sensor = as_shape("sensor", _at(self.sensor, t), (-1, n))
        if len(sensor) == 0:
            raise ValueError("sensor: wanted at least one row (zeros if it sees nothing), got none")
        intensity = as_covariance("noise_intensity", _at(self.noise_intensity, t))
        noise = as_covariance(
            "sensor_intensity", _at(self.sensor_intensity, t), sensor.shape[0], definite=True
        )
        if self.noise_input is None:
            diffusion = as_covariance("noise_intensity", intensity, n)
        else:
            gain = as_shape("noise_input", _at(self.noise_input, t), (n, intensity.shape[0]))
            diffusion = gain @ intensity @ gain.T
        return PlantMatrices(drift, diffusion, sensor, noise)


def needed(drift: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Components that the motion of the wanted ones depends on, themselves included, (n,) bool."""
    found = wanted
    while True:
        more = found | (drift[found] != 0.0).any(axis=0)
        if (more == found).all():
            return found
        found = more


def _at(value: Coefficient, t: float) -> np.ndarray:
    return np.atleast_2d(value(t)) if callable(value) else value


def _frozen(array: np.ndarray) -> np.ndarray:
    array = np.array(array)
    array.flags.writeable = False
    return array
