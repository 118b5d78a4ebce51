"""Kalman-Bucy filter on a grid of measured increments: what is computed before the data."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from seedslib.models.propagation import balanced, distinct_steps
from seedslib.two_step.linear import LinearDiffusion, PlantMatrices
from seedslib.two_step.riccati import RiccatiStep, hamiltonian, information_rate, riccati_step

LONGEST_STEP = 1.0


class LinearMoments(NamedTuple):
    """Second-order description of state and estimate on a grid.

    Attributes
    ----------
    mean : ndarray
        μ = E x = E x̂, shape (K, n).
    cov : ndarray
        C, covariance of the state without measurements, shape (K, n, n).
    error_cov : ndarray
        P, covariance of the estimation error, shape (K, n, n). The estimate has covariance C - P
        and is independent of the error.
    """

    mean: np.ndarray
    cov: np.ndarray
    error_cov: np.ndarray


class KalmanBucyDesign(NamedTuple):
    """Precomputed filter on a grid of K+1 times.

    Attributes
    ----------
    times : ndarray
        Shape (K+1,).
    start : ndarray
        Estimate at the first time, shape (n,).
    transition, gain : ndarray
        Shapes (K, n, n) and (K, n, m).
    cov : ndarray
        Error covariances, shape (K+1, n, n).
    """

    times: np.ndarray
    start: np.ndarray
    transition: np.ndarray
    gain: np.ndarray
    cov: np.ndarray


def make_design(
    system: LinearDiffusion, times: np.ndarray, seen: ArrayLike | None
) -> KalmanBucyDesign:
    """Design of the filter of a system; see `KalmanBucyFilter.design`.

    Parameters
    ----------
    system : LinearDiffusion
    times : ndarray
        Checked grid, shape (K+1,).
    seen : array_like of bool or None
        Shape (K, m).

    Raises
    ------
    ValueError
        `seen` of a wrong shape, or a step longer than the time constant of the filter.
    """
    n, m, count = system.state_size, system.measurement_size, times.size - 1
    seen = np.ones((count, m), bool) if seen is None else np.asarray(seen, bool)
    if seen.shape != (count, m):
        raise ValueError(f"seen: wanted shape ({count}, {m}), got {seen.shape}")
    move, noise = system.transition(0.0, times[0])
    transition, gain = np.empty((count, n, n)), np.empty((count, n, m))
    cov = np.empty((times.size, n, n))
    cov[0] = move @ system.cov0 @ move.T + noise
    for k, step in enumerate(estimate_steps(system, times, seen)):
        transition[k], gain[k], cov[k + 1] = step.at(cov[k])
    return KalmanBucyDesign(times, move @ system.mean0, transition, gain, cov)


def estimate_steps(
    system: LinearDiffusion, times: np.ndarray, seen: np.ndarray
) -> Iterator[EstimateStep]:
    """Steps of the estimate on a grid, with the components (K, m) that are measured over each.

    Raises
    ------
    ValueError
        A step longer than the time constant of the filter.
    """
    lengths, index = distinct_steps(times)
    known: dict = {}
    for k, j in enumerate(index):
        # Constant coefficients: one exponential for each step length and set of sensors.
        key = (j, seen[k].tobytes()) if system.constant else k
        if key not in known:
            middle = 0.5 * (times[k] + times[k + 1])
            known[key] = EstimateStep.of(system.matrices(middle), lengths[j], seen[k])
        yield known[key]


class EstimateStep(NamedTuple):
    """Step of the estimate for a constant rate of measurement: what does not depend on P.

    Attributes
    ----------
    riccati : RiccatiStep
    integral : ndarray
        Lower half of the integral of exp(sM) over the step, divided by its length, (n, 2n).
    forcing : ndarray
        Its upper left quarter, (n, n).
    weights : ndarray
        R⁻¹H on the measured components, (m, n).
    """

    riccati: RiccatiStep
    integral: np.ndarray
    forcing: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, known: PlantMatrices, step: float, seen: np.ndarray) -> EstimateStep:
        """Step of length `step`, coefficients `known`, with the components `seen` measured.

        Raises
        ------
        ValueError
            The step is longer than the time constant of the filter.
        """
        n = known.drift.shape[0]
        information = information_rate(known, seen)
        unit, *scaled = balanced(known.drift, information, known.diffusion)
        matrix = hamiltonian(*scaled)
        rate = np.abs(np.linalg.eigvals(matrix).real).max()
        if seen.any() and rate * step > LONGEST_STEP:
            raise ValueError(
                f"times: wanted steps shorter than the filter's time constant {1 / rate:.3g}, "
                f"got {step:.3g}"
            )
        # The integral of exp(sM) over the step stands in the corner of a larger exponential.
        large = np.zeros((4 * n, 4 * n))
        large[: 2 * n, : 2 * n] = step * matrix
        large[: 2 * n, 2 * n :] = np.eye(2 * n)
        weights = np.zeros((known.sensor.shape[0], n))
        noise = known.sensor_intensity[np.ix_(seen, seen)]
        weights[seen] = np.linalg.solve(noise, known.sensor[seen])
        summed = expm(large)[: 2 * n, 2 * n :]
        return cls(
            riccati_step(known.drift, information, known.diffusion, step),
            summed[n:] * np.outer(unit, np.concatenate([unit, 1 / unit])),
            summed[:n, :n] * np.outer(1 / unit, unit),
            weights,
        )

    def at(self, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Closed-loop transition, gain on the increment, and the new covariance."""
        n = cov.shape[0]
        loop = self.riccati.closed_loop(cov)
        # Ψ(h, s) P(s) = Ψ(h, 0) Y(s)ᵀ with Y(s) linear in exp(sM): its integral is exact.
        summed = self.integral[:, :n] + self.integral[:, n:] @ cov
        gain = loop @ summed.T @ self.weights.T
        return loop, gain, self.riccati.apply(cov)
