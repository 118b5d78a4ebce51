"""Kalman-Bucy smoother: the state at a time from what was measured after it as well.

What is measured after t tells of x(t) an information Λ(t), which obeys the Riccati equation of
the filter with the time reversed and the parts exchanged,

    -dΛ/dt = FᵀΛ + ΛF - Λ GQGᵀ Λ + HᵀR⁻¹H,

from zero where the measurement ends. The covariance is then P (I + ΛP)⁻¹ with P that of the
filter, and the estimate x̂ + P λ with the adjoint λ of Bryson and Frazier (1963),

    -dλ/dt = Fᵀλ + HᵀR⁻¹ (dy/dt - H (x̂ + P λ)).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from seedslib.base.checks import as_count
from seedslib.base.semidefinite import symmetrized
from seedslib.models.propagation import distinct_steps, solve
from seedslib.two_step.kalman_bucy_design import KalmanBucyDesign, estimate_steps
from seedslib.two_step.linear import LinearDiffusion
from seedslib.two_step.riccati import RiccatiStep, information_rate, riccati_step


def smoothed_errors(
    system: LinearDiffusion, times: np.ndarray, cov: np.ndarray, lag: int | None
) -> np.ndarray:
    """Error covariances (K, n, n) of the smoother from those of the filter; exact.

    Parameters
    ----------
    system : LinearDiffusion
    times : ndarray, shape (K,)
    cov : ndarray, shape (K, n, n)
    lag : int or None
        Measured until so many times later.
    """
    full = np.ones(system.measurement_size, bool)
    if not system.constant:
        steps = [_backwards(system, full, *pair) for pair in pairwise(times)]
    else:
        known, (lengths, index) = system.matrices(0.0), distinct_steps(times)
        information = information_rate(known, full)
        made = [riccati_step(known.drift, information, known.diffusion, h) for h in lengths]
        steps = [_reversed(made[j]).apply for j in index]
    return _corrected(steps, cov, lag)


def smoothed_means(
    system: LinearDiffusion, design: KalmanBucyDesign, mean: np.ndarray, increments: np.ndarray,
    seen: np.ndarray, lag: int | None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Smoothed means (K+1, n, paths) and covariances (K+1, n, n) along measured paths.

    Parameters
    ----------
    system : LinearDiffusion
    design : KalmanBucyDesign
    mean : ndarray, shape (K+1, n, paths)
        Of the filter.
    increments : ndarray, shape (K, m, paths)
        Zero where nothing was measured.
    seen : ndarray of bool, shape (K, m)
    lag : int or None
    """
    steps = list(estimate_steps(system, design.times, seen))
    told = []
    for k, step in enumerate(steps):
        back, info = design.transition[k].T, step.riccati.information
        known = np.linalg.solve(np.eye(len(info)) + info @ design.cov[k], info)
        told.append(back @ step.forcing @ step.weights.T @ increments[k] - known @ mean[k])
    backs = [_affine(move.T, part) for move, part in zip(design.transition, told, strict=True)]
    adjoint = _windows(backs, np.zeros_like(mean[0]), lag)
    cov = _corrected([_reversed(step.riccati).apply for step in steps], design.cov, lag)
    return mean + design.cov @ adjoint, cov


def _reversed(step: RiccatiStep) -> RiccatiStep:
    """The same step of what later measurements tell: information and noise change places."""
    return RiccatiStep(step.transition.T, step.noise, step.information)


def _affine(move, told):
    """One step back of the adjoint."""
    return lambda later: move @ later + told


def _backwards(system, seen, start, stop):
    """The same step where the coefficients depend on time: the equation, integrated."""
    n = system.state_size

    def slope(s: float, y: np.ndarray) -> np.ndarray:
        known, later = system.matrices(stop - s), y.reshape(n, n)
        moved = known.drift.T @ later
        gained = information_rate(known, seen) - later @ known.diffusion @ later
        return (moved + moved.T + gained).ravel()

    def step(later: np.ndarray) -> np.ndarray:
        return symmetrized(solve(slope, 0.0, stop - start, later.ravel())[:, -1].reshape(n, n))

    return step


def _corrected(steps, cov, lag):
    """Covariances of the filter (K, n, n) with the information of what follows."""
    told = _windows(steps, np.zeros_like(cov[0]), lag)
    found = np.linalg.solve(np.eye(cov.shape[-1]) + cov @ told, cov)
    return 0.5 * (found + found.mT)


def _windows(steps: list[Callable[..., np.ndarray]], end: np.ndarray, lag: int | None):
    """What K steps back make of an end value at each of K+1 times, at most `lag` steps away."""
    if lag is None:
        found = [end]
        for step in steps[::-1]:
            found.append(step(found[-1]))
        return np.stack(found[::-1])
    lag, found = as_count("lag", lag), []
    for k in range(len(steps) + 1):
        value = end
        for step in steps[k : k + lag][::-1]:
            value = step(value)
        found.append(value)
    return np.stack(found)
