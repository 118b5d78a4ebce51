"""Exact propagation of the mean and covariance of a linear diffusion over a step of time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm, matrix_balance

from seedslib.base.checks import as_covariance, as_positive, as_real, require_shape
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
    drift, diffusion = as_real("drift", drift, ndim=2), as_real("diffusion", diffusion)
    n = drift.shape[0]
    require_shape("drift", drift, (n, n))
    as_covariance("diffusion", diffusion, n)
    return stepped(drift, diffusion, as_positive("step", step, zero=True))


def stepped(drift: np.ndarray, diffusion: np.ndarray, step: float) -> Pair:
    """`van_loan` of arrays that were checked when their system was made."""
    n = len(drift)
    unit, drift, _, diffusion = balanced(drift, np.zeros((n, n)), diffusion)
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
        column = unit[:, None]
        move, spread = move * (column / unit), 0.5 * (spread + spread.T) * column * unit
    return bounded(step, move, spread)


class Discretised:
    """Exact discretisation of dX = (F X + G u) dt + dW, with u constant within a step.

    Called with the length of a step it gives the transition matrix, the covariance of the noise
    and the matrix of the inputs, the integral of exp(F s) G; those of the last length are kept.

    Parameters
    ----------
    drift, diffusion : ndarray, shape (n, n)
        F, and the covariance of W per unit of time.
    push : ndarray, shape (n, p)
        G.
    """

    def __init__(self, drift: np.ndarray, diffusion: np.ndarray, push: np.ndarray) -> None:
        n, p = push.shape
        self.size: int = n
        self._drift, self._diffusion = np.zeros((2, n + p, n + p))  # of (X, u)
        self._drift[:n] = np.hstack([drift, push])
        self._diffusion[:n, :n] = diffusion
        self._last: Any = None, None

    def __call__(self, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The three matrices for a step of this length."""
        known, n = self._last, self.size
        if known[0] != step:
            move, spread = stepped(self._drift, self._diffusion, step)
            known = step, (move[:n, :n], spread[:n, :n], move[:n, n:])
            self._last = known
        return known[1]


class SteppedMatrix:
    """One of the matrices of `Discretised`, for the time that has elapsed in a step.

    Parameters
    ----------
    steps : Discretised
    part : int
        0 for the transition, 1 for the noise, 2 for the inputs.
    """

    def __init__(self, steps: Discretised, part: int) -> None:
        self.steps: Discretised = steps
        self.part: int = part

    def __call__(self, t: float, dt: float) -> np.ndarray:
        """The matrix."""
        return self.steps(dt)[self.part]


def balanced(
    drift: np.ndarray, information: np.ndarray, diffusion: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Units of the state in which the Hamiltonian matrix is small, and the three matrices in them.

    Noise and information are given in units of the state squared and of its inverse: in badly
    chosen units a step would be halved until the drift is lost to rounding. The units are powers
    of two, so that changing to them and back is exact.

    Parameters
    ----------
    drift, information, diffusion : ndarray
        F, HᵀR⁻¹H and GQGᵀ, all (n, n).

    Returns
    -------
    unit : ndarray
        d, shape (n,); x is measured in units of d.
    drift, information, diffusion : ndarray
        ``D⁻¹FD``, ``D HᵀR⁻¹H D`` and ``D⁻¹GQGᵀD⁻¹``.
    """
    n = drift.shape[0]
    rate = np.abs(drift).max() or 1.0
    gain, noise = np.abs(information).max(), np.abs(diffusion).max()
    if gain > 0 and noise > 0:
        square = np.sqrt(noise) / np.sqrt(gain)
    else:
        square = noise / rate if noise > 0 else rate / gain if gain > 0 else 1.0
    common = np.ldexp(1.0, np.frexp(np.sqrt(square))[1])
    upper, lower = information * common * common, diffusion / common / common
    matrix = np.block([[-drift.T, upper], [lower, drift]])
    with np.errstate(invalid="ignore"):  # of the permutation, which is not asked for
        scale = np.log2(matrix_balance(np.abs(matrix), permute=False, separate=True)[1][0])
    unit = common * 2.0 ** np.round(0.5 * (scale[n:] - scale[:n]))
    column = unit[:, None]
    return unit, drift * (unit / column), information * column * unit, diffusion / column / unit


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

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        drift, diffusion = coefficients(t)
        move, spread = y.reshape(2, n, n)
        return np.stack([drift @ move, drift @ spread + spread @ drift.T + diffusion]).ravel()

    if stop == start:
        return start_pair[0], start_pair[1]
    move, spread = solve(slope, start, stop, start_pair.ravel())[:, -1].reshape(2, n, n)
    return move, 0.5 * (spread + spread.T)


def solve(
    slope: Callable[..., Any],
    start: float,
    stop: float,
    y0: np.ndarray,
    times: np.ndarray | None = None,
) -> np.ndarray:
    """Solution of a differential equation at `times` (at `stop` by default), shape (y, K).

    Raises
    ------
    ValueError
        The integration failed.
    """
    # An absolute tolerance far below the size of the data keeps components that start at zero
    # accurate relative to what they become.
    size = max(np.abs(y0).max(initial=0.0), np.abs(slope(start, y0)).max() * (stop - start))
    with np.errstate(over="ignore", invalid="ignore"):
        atol = ATOL * (size or 1.0)
        result = solve_ivp(slope, (start, stop), y0, "DOP853", times, rtol=RTOL, atol=atol)
    if not result.success:
        raise ValueError(
            f"times: the equations of the moments could not be integrated from {when(start)} to "
            f"{when(stop)}: {result.message}"
        )
    return result.y


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
