"""Linear diffusion with a linear sensor, the Kalman-Bucy filter, its moments and steady state.

The state obeys ``dx = F x dt + G dv`` and is measured as ``dy = H x dt + dw``, where v and w are
independent Wiener processes of intensities Q and R (Choi, Song, Shin 2019, equation (1.1)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, expm, solve_continuous_are, solve_continuous_lyapunov

from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_count, as_covariance, as_real, as_times
from seedslib.base.linalg import cholesky, symmetrized
from seedslib.filters.base import Estimates
from seedslib.models.linear import balanced, bounded, distinct_steps, halvings, stepped


class LinearMoments(NamedTuple):
    """Second-order description of state and estimate at K times.

    Attributes
    ----------
    mean : ndarray, shape (K, n)
        μ = E x = E x̂.
    cov : ndarray, shape (K, n, n)
        C, covariance of the state without measurements.
    error_cov : ndarray, shape (K, n, n)
        P, covariance of the estimation error. The estimate has covariance C - P and is
        independent of the error.
    """

    mean: np.ndarray
    cov: np.ndarray
    error_cov: np.ndarray


class DiffusionPaths(NamedTuple):
    """Simulated paths: times (K+1,), states (K+1, n, N), measurement increments (K, m, N)."""

    times: np.ndarray
    states: np.ndarray
    increments: np.ndarray


class KalmanBucyGains(NamedTuple):
    """What a filter needs before any data: ``x̂_{k+1} = transition_k x̂_k + gain_k Δy_k``.

    Attributes
    ----------
    mean0 : ndarray, shape (n,)
        Estimate at the first time, before any measurement.
    transition : ndarray, shape (K, n, n)
    gain : ndarray, shape (K, n, m)
        Zero for a component that is not measured.
    cov : ndarray, shape (K+1, n, n)
        Error covariance P.
    """

    mean0: np.ndarray
    transition: np.ndarray
    gain: np.ndarray
    cov: np.ndarray


@dataclass(frozen=True, eq=False)
class LinearDiffusion:
    """Linear system ``dx = F x dt + G dv``, ``dy = H x dt + dw`` with a Gaussian start.

    A number stands for a 1×1 matrix.

    Parameters
    ----------
    drift : array_like
        F, shape (n, n), 1/time.
    noise_intensity : array_like
        Q, intensity of the process noise v, shape (r, r), positive semidefinite.
    sensor : array_like
        H, shape (m, n).
    sensor_intensity : array_like
        R, intensity of the sensor noise w, shape (m, m), positive definite.
    mean0, cov0 : array_like
        Mean (n,) and covariance (n, n) of the state at time 0; the covariance may be singular.
    noise_input : array_like, optional
        G, shape (n, r); the identity by default.

    Raises
    ------
    TypeError, ValueError
        A wrong shape, a covariance or intensity that is none, a singular R.
    """

    drift: Any
    noise_intensity: Any
    sensor: Any
    sensor_intensity: Any
    mean0: Any
    cov0: Any
    noise_input: Any = None

    def __post_init__(self) -> None:
        fields = "drift", "noise_intensity", "sensor", "sensor_intensity", "cov0"
        drift, noise, sensor, sensor_noise, cov0 = (
            np.atleast_2d(as_real(name, getattr(self, name))) for name in fields
        )
        n, sensor = len(cov0), as_real("sensor", sensor, (-1, len(cov0)))
        drive = np.eye(n) if self.noise_input is None else self.noise_input
        drive = as_real("noise_input", np.atleast_2d(as_real("noise_input", drive)), (n, -1))
        vars(self).update(
            drift=as_real("drift", drift, (n, n)),
            noise_intensity=as_covariance("noise_intensity", noise, drive.shape[1]),
            sensor=sensor,
            sensor_intensity=as_covariance(
                "sensor_intensity", sensor_noise, len(sensor), definite=True
            ),
            mean0=as_real("mean0", np.atleast_1d(as_real("mean0", self.mean0)), (n,)),
            cov0=as_covariance("cov0", cov0),
            noise_input=drive,
        )

    @property
    def state_size(self) -> int:
        """Dimension n of the state."""
        return len(self.cov0)

    @property
    def diffusion(self) -> np.ndarray:
        """Intensity G Q Gᵀ of what drives the state, (n, n)."""
        return self.noise_input @ self.noise_intensity @ self.noise_input.T

    @property
    def information(self) -> np.ndarray:
        """Information rate Hᵀ R⁻¹ H of the measurement, (n, n)."""
        return symmetrized(self.sensor.T @ np.linalg.solve(self.sensor_intensity, self.sensor))

    def simulate(self, times: ArrayLike, paths: int, seed: object) -> DiffusionPaths:
        """Independent paths of the state and the increments of the measurement, exact on the grid.

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
        """
        times, paths, n = as_times("times", times), as_count("paths", paths), self.state_size
        mean, cov = self._start(times[0])
        lengths, index = distinct_steps(times)
        joint_drift, joint_diffusion = np.zeros((2, n + len(self.sensor), n + len(self.sensor)))
        joint_drift[:n, :n], joint_drift[n:, :n] = self.drift, self.sensor
        joint_diffusion[:n, :n], joint_diffusion[n:, n:] = self.diffusion, self.sensor_intensity
        steps = [stepped(joint_drift, joint_diffusion, h) for h in lengths]
        moves = [np.ascontiguousarray(move[:, :n]) for move, _ in steps]
        start, roots = cholesky(cov), [cholesky(noise) for _, noise in steps]
        states = np.empty((len(times), n, paths))
        increments = np.empty((len(times) - 1, len(self.sensor), paths))

        def draw(first: int, last: int, stream: np.random.SeedSequence) -> None:
            rng, block = np.random.default_rng(stream), slice(first, last)
            state = mean[:, None] + start @ rng.standard_normal((n, last - first))
            states[0, :, block] = state
            for k, j in enumerate(index):
                noise = roots[j] @ rng.standard_normal((len(roots[j]), last - first))
                joint = moves[j] @ state + noise
                state = states[k + 1, :, block] = joint[:n]
                increments[k, :, block] = joint[n:]

        in_blocks(draw, paths, seed)
        return DiffusionPaths(times, states, increments)

    def moments(self, times: ArrayLike) -> LinearMoments:
        """Mean, prior covariance and error covariance on a grid, exact ((2.1), (3.10)).

        Parameters
        ----------
        times : array_like
            Increasing nonnegative times, shape (K,). Measurements start at time 0.

        Raises
        ------
        TypeError, ValueError
            An illegal grid; moments of an unstable system that overflow.
        """
        times = as_times("times", times)
        grid = times if times[0] == 0 else np.append(0.0, times)
        lengths, index = distinct_steps(grid)
        free = [stepped(self.drift, self.diffusion, h) for h in lengths]
        filtered = [
            _RiccatiStep.of(self.drift, self.information, self.diffusion, h) for h in lengths
        ]
        mean, cov, error_cov = [self.mean0], [self.cov0], [self.cov0]
        for j in index:
            move, noise = free[j]
            mean.append(move @ mean[-1])
            cov.append(move @ cov[-1] @ move.T + noise)
            error_cov.append(filtered[j].at(error_cov[-1])[2])
        parts = (np.array(part)[len(grid) - len(times) :] for part in (mean, cov, error_cov))
        return LinearMoments(*bounded(grid[-1], *parts))

    def steady_error_cov(self) -> np.ndarray:
        """Steady error covariance P (n, n): the stabilising solution of the Riccati equation.

        Raises
        ------
        ValueError
            There is none: the sensor does not see an unstable mode, or no noise reaches one that
            is not damped.
        """
        unit, drift, information, diffusion = balanced(self.drift, self.information, self.diffusion)
        whitened = np.linalg.solve(np.linalg.cholesky(self.sensor_intensity), self.sensor) * unit
        try:
            cov = solve_continuous_are(
                drift.T, whitened.T, diffusion, np.eye(len(whitened)), balanced=False
            )
        except LinAlgError:
            cov = np.zeros_like(drift)
        rates = np.linalg.eigvals(drift - cov @ information).real
        if rates.max() >= -UNDAMPED * np.abs(rates).max():
            raise ValueError(
                "system: wanted every mode that is not damped observed by the sensor and driven by "
                "noise, for a steady error covariance"
            )
        return symmetrized(cov) * unit[:, None] * unit

    def steady_moments(self) -> LinearMoments:
        """Steady mean (zero), prior covariance and error covariance, arrays (1, ...).

        Raises
        ------
        ValueError
            A drift that is not Hurwitz: the state has no steady distribution.
        """
        rates = np.linalg.eigvals(self.drift).real
        if rates.max() >= 0:
            raise ValueError(
                "drift: wanted eigenvalues with negative real parts (Hurwitz) for a steady "
                f"covariance of the state, got a real part of {rates.max():.4g}"
            )
        unit, drift, _, diffusion = balanced(self.drift, self.information, self.diffusion)
        cov = symmetrized(solve_continuous_lyapunov(drift, -diffusion)) * unit[:, None] * unit
        error_cov = self.steady_error_cov()
        return LinearMoments(np.zeros((1, len(cov))), cov[None], error_cov[None])

    def _start(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of the state at a time, without measurements."""
        move, noise = stepped(self.drift, self.diffusion, t)
        return move @ self.mean0, move @ self.cov0 @ move.T + noise


def kalman_bucy_gains(
    system: LinearDiffusion, times: ArrayLike, observed: ArrayLike | None = None
) -> KalmanBucyGains:
    """Gains and covariances of `kalman_bucy` on a grid; they do not depend on the data.

    Parameters
    ----------
    system : LinearDiffusion
    times : array_like
        Grid, shape (K+1,). The measurement begins at its first time.
    observed : array_like of bool, optional
        Which components are measured over each step, shape (K, m); all by default.

    Raises
    ------
    TypeError, ValueError
        An illegal grid; a step longer than the time constant of the filter, over which the
        increment does not carry what the covariance promises.
    """
    times, n, m = as_times("times", times), system.state_size, len(system.sensor)
    shape = len(times) - 1, m
    observed = as_real("observed", np.ones(shape) if observed is None else observed, shape) != 0
    mean, cov = system._start(times[0])
    lengths, index = distinct_steps(times)

    @cache
    def step(length: float, components: tuple[bool, ...]) -> tuple[_RiccatiStep, np.ndarray]:
        rows = np.array(components)
        sensor, weights = system.sensor[rows], np.zeros((m, n))
        weights[rows] = np.linalg.solve(system.sensor_intensity[np.ix_(rows, rows)], sensor)
        information = symmetrized(sensor.T @ weights[rows])
        made = _RiccatiStep.of(system.drift, information, system.diffusion, length)
        if rows.any() and made.rate * length > LONGEST_STEP:
            raise ValueError(
                "times: wanted steps shorter than the filter's time constant "
                f"{1 / made.rate:.3g}, got {length:.3g}"
            )
        return made, weights.T

    transitions, gains, covs = [], [], [cov]
    for j, components in zip(index, observed, strict=True):
        riccati, weights = step(lengths[j], tuple(components))
        transition, gain, cov = riccati.at(cov)
        transitions.append(transition)
        gains.append(gain @ weights)
        covs.append(cov)
    tables = np.reshape(transitions, (-1, n, n)), np.reshape(gains, (-1, n, m)), np.array(covs)
    return KalmanBucyGains(mean, *tables)


def kalman_bucy(system: LinearDiffusion, times: ArrayLike, increments: ArrayLike) -> Estimates:
    """Kalman-Bucy filter along measured paths (Choi, Song, Shin 2019, equation (2.1)).

    Over a step of length h the measured increment Δy is taken as the constant rate Δy/h; for that
    rate the estimate is exact. The error of the discretisation is of first order in h along a path.

    Parameters
    ----------
    system : LinearDiffusion
    times : array_like
        Grid, shape (K+1,). The measurement begins at its first time.
    increments : array_like
        Increments of the measurement over the steps, shape (K, m, ...), batch axes last. NaN
        marks a component that was not measured over a step, in all paths of the batch alike.

    Returns
    -------
    Estimates
        mean (K+1, n, ...), and cov (K+1, n, n): the error covariance of these measurements.

    Raises
    ------
    TypeError, ValueError
        Illegal arrays; gaps that differ between paths; a step longer than the time constant of
        the filter.
    """
    times, increments = as_times("times", times), as_real("increments", increments, nan=True)
    batch = increments.shape[2:]
    wanted = len(times) - 1, len(system.sensor), *batch
    increments = as_real("increments", increments, wanted, nan=True)
    flat = increments.reshape(*wanted[:2], math.prod(batch))
    missing = np.isnan(flat)
    if (missing.any(axis=2) & ~missing.all(axis=2)).any():
        raise ValueError(
            "increments: wanted gaps (NaN) common to all paths of a batch, got gaps of some; "
            "run those paths by themselves"
        )
    gains = kalman_bucy_gains(system, times, ~missing.any(axis=2))
    mean = np.empty((len(times), system.state_size, flat.shape[2]))
    mean[0] = gains.mean0[:, None]
    for k, increment in enumerate(np.nan_to_num(flat)):
        mean[k + 1] = gains.transition[k] @ mean[k] + gains.gain[k] @ increment
    return Estimates(mean.reshape(*mean.shape[:2], *batch), gains.cov)


LONGEST_STEP = 1.0
"""Longest step of a filter, in its time constants."""

UNDAMPED = 1e-7
"""Part of the largest rate of the steady filter under which a mode counts as undamped: rounding
moves a double eigenvalue by the square root of the smallest difference of numbers, 1.5e-8."""


class _RiccatiStep(NamedTuple):
    """Exact step of estimate and covariance while the measured rate is constant.

    With the costate p of the Hamiltonian matrix the step is linear in both directions of time,

        x' = move x + noise p' + forward u,   p = moveᵀ p' - information x + backward u,

    where u = HᵀR⁻¹Δy. Two steps compose into a third, and noise and information stay positive
    semidefinite, so a long step is reached by doubling: no ill-conditioned exponential, no loss
    of symmetry. All matrices are (n, n); rate is the largest of the filter.
    """

    move: np.ndarray
    noise: np.ndarray
    information: np.ndarray
    forward: np.ndarray
    backward: np.ndarray
    rate: float

    @classmethod
    def of(
        cls, drift: np.ndarray, information: np.ndarray, diffusion: np.ndarray, step: float
    ) -> _RiccatiStep:
        """The step of a system, from the exponential over a part of it and doublings."""
        unit, drift, information, diffusion = balanced(drift, information, diffusion)
        matrix, n = np.block([[-drift.T, information], [diffusion, drift]]), len(drift)
        rate = np.abs(np.linalg.eigvals(matrix).real).max()
        doublings = halvings(np.linalg.norm(matrix, 1) * step)
        # the integral of the exponential stands in the corner of a larger one
        large = np.zeros((3 * n, 3 * n))
        large[: 2 * n, : 2 * n], large[:n, 2 * n :] = matrix * (step / 2**doublings), np.eye(n)
        power = expm(large)
        first = np.linalg.inv(power[:n, :n])
        move, information = first.T, symmetrized(first @ power[:n, n : 2 * n])
        noise = symmetrized(power[n : 2 * n, :n] @ first)
        summed = power[: 2 * n, 2 * n :] / 2**doublings  # the response to p' = -u
        backward, forward = first @ summed[:n], noise @ summed[:n] - summed[n:]
        for _ in range(doublings):
            parts = np.hstack([move.T, information @ move, backward - information @ forward])
            ahead, inward, back = np.hsplit(
                np.linalg.solve(np.eye(n) + information @ noise, parts), 3
            )
            forward = forward + ahead.T @ (forward + noise @ backward)
            backward = backward + move.T @ back
            information = symmetrized(information + move.T @ inward)
            noise = symmetrized(noise + ahead.T @ noise @ move.T)
            move = ahead.T @ move
        column = unit[:, None]
        return cls(
            move * (column / unit),
            noise * column * unit,
            information / column / unit,
            forward * column * unit,
            backward / column * unit,
            rate,
        )

    def at(self, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Transition of the estimate, its gain on u, and the next error covariance."""
        loop = np.linalg.solve(np.eye(len(cov)) + self.information @ cov, self.move.T).T
        gain = loop @ cov @ self.backward + self.forward
        return loop, gain, symmetrized(loop @ cov @ self.move.T + self.noise)
