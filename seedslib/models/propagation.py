"""Exact propagation of the mean and covariance of a linear diffusion over a step of time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from seedslib.base.checks import as_covariance, as_positive, as_real
from seedslib.base.clock import lengths_alike, when

RTOL = 1e-11
ATOL = 1e-14

Pair = tuple[np.ndarray, np.ndarray]


def van_loan(drift: np.ndarray, diffusion: np.ndarray, step: float) -> Pair:
    """Transition matrix and noise covariance of a step, constant coefficients.

    The matrix exponential of Van Loan (1978) is taken on a step so short that ``|F| h <= 1``;
    doubling ``A <- A A``, ``Q <- A Q Aᵀ + Q`` then reaches the wanted step as a sum of
    nonnegative terms. One long exponential of a stable system would overflow and cancel.

    Parameters
    ----------
    drift, diffusion : ndarray
        F and G Q Gᵀ, both (n, n).
    step : float
        Length of the step, nonnegative.

    Returns
    -------
    A, Qd : ndarray
        Both (n, n).

    Raises
    ------
    TypeError, ValueError
        No numbers, other shapes, no covariance, no such step; the moments overflow.
    """
    diffusion = as_covariance("diffusion", diffusion)
    drift = as_real("drift", drift, diffusion.shape)
    return stepped(drift, diffusion, as_positive("step", step, zero=True))


def stepped(drift: np.ndarray, diffusion: np.ndarray, step: float) -> Pair:
    """`van_loan` of arrays that were checked when their system was made."""
    n = len(drift)
    doublings = halvings(np.linalg.norm(drift, 1) * step)
    short = step / 2**doublings
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n] = -drift
    block[:n, n:] = diffusion
    block[n:, n:] = drift.T
    power = expm(short * block)
    move = power[n:, n:].T
    spread = move @ power[:n, n:]
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(doublings):
            spread = move @ spread @ move.T + spread
            move = move @ move
    return bounded(step, move, 0.5 * (spread + spread.T))


def bounded(step: float, *values: np.ndarray) -> tuple[np.ndarray, ...]:
    """The values, all finite.

    Raises
    ------
    ValueError
        An unstable system has left the range of floating-point numbers.
    """
    if not all(np.isfinite(value).all() for value in values):
        raise ValueError(f"times: the moments overflow over a time of {step:g}: unstable system")
    return values


def halvings(size: float) -> int:
    """How often a step of scaled length `size` is halved until its length is at most one."""
    return max(0, int(np.ceil(np.log2(size)))) if size > 0 else 0


def integrated(coefficients: Callable[[float], Pair], start: float, stop: float) -> Pair:
    """Transition matrix and noise covariance of a step, coefficients that depend on time.

    Integrates ``A' = F A`` and ``Q' = F Q + Q Fᵀ + G Q Gᵀ`` with DOP853.

    Parameters
    ----------
    coefficients : callable
        Time to (F, G Q Gᵀ).
    start, stop : float
        The step, ``start <= stop``.

    Returns
    -------
    A, Qd : ndarray

    Raises
    ------
    ValueError
        The integration failed, for instance because the solution grows without bound.
    """
    n = coefficients(start)[0].shape[0]
    start_pair = np.stack([np.eye(n), np.zeros((n, n))])
    if stop == start:
        return start_pair[0], start_pair[1]

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        drift, diffusion = coefficients(t)
        move, spread = y.reshape(2, n, n)
        return np.stack([drift @ move, drift @ spread + spread @ drift.T + diffusion]).ravel()

    y0 = start_pair.ravel()
    # An absolute tolerance far below the size of the data keeps components that start at zero
    # accurate relative to what they become.
    size = max(1.0, np.abs(slope(start, y0)).max() * (stop - start))
    with np.errstate(over="ignore", invalid="ignore"):
        result = solve_ivp(slope, (start, stop), y0, "DOP853", rtol=RTOL, atol=ATOL * size)
    if not result.success:
        raise ValueError(
            f"times: the equations of the moments could not be integrated from {when(start)} to "
            f"{when(stop)}: {result.message}"
        )
    move, spread = result.y[:, -1].reshape(2, n, n)
    return move, 0.5 * (spread + spread.T)


def distinct_steps(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of steps that differ by more than rounding, and the index of each step's length.

    The steps of a uniform grid differ in the last digits; lengths equal to 1e-12 relative are
    taken as one, so that a uniform grid needs one matrix exponential.

    Returns
    -------
    lengths : ndarray
        Shape (J,).
    index : ndarray
        Shape (K,), ``lengths[index]`` are the steps.
    """
    steps = np.diff(times)
    _, first, index = np.unique(lengths_alike(steps), return_index=True, return_inverse=True)
    return steps[first], index
