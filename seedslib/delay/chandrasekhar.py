"""Fast (Chandrasekhar) recursion of the delay filter for coefficients that do not vary.

The change of the predicted covariance from step to step has low rank, ``Y M Yᵀ`` with at most
3n + m columns. Only Y and the gain are carried: no D × D matrix is ever formed.

Covariances are sums of such changes, so rounding is absolute: it is watched against the smallest
eigenvalue of the innovation covariance S, and a covariance much smaller than S keeps fewer digits
than in the other recursions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, cho_solve

from seedslib.base.semidefinite import INDEFINITE, symmetrized
from seedslib.delay.coefficients import require_finite
from seedslib.delay.gains import StepGains, innovation_factor
from seedslib.delay.system import DelaySystem

RANK = 1e-14
"""Eigenvalues of the first change below this fraction of the largest are dropped."""

SETTLED = 1e-20
"""The change is zero once it is below this fraction of the predicted covariance."""

CANCELLED = 1e-9
"""Largest rounding error, relative to S, that the subtractions so far may have left."""


class LowRankChange(NamedTuple):
    """Recursion after instant k.

    change (N+1, n, w) and middle (w, w) give ``Π_{k+1} - Π_k``; gain (N+1, n, m) and
    innovation_cov (m, m) are those of instant k; predicted (n, n) is block 0 of Π_k; terms
    is the sum of the sizes of all terms of S so far, the scale of its rounding error.
    """

    k: int
    change: np.ndarray
    middle: np.ndarray
    gain: np.ndarray
    innovation_cov: np.ndarray
    predicted: np.ndarray
    terms: float

    def copy(self) -> LowRankChange:
        """The state itself: a step never overwrites it."""
        return self


class BreakdownError(ValueError):
    """The recursion has lost its digits; the structured recursion has to be used."""


def refusal(system: DelaySystem) -> str | None:
    """Why the recursion does not apply to a system, or None."""
    if not system.constant:
        return "coefficients that vary with k"
    spread = system.start_blocks()
    if spread is None or (spread[1:] != spread[1:2]).any():
        return "a history that is not independent with one covariance"
    return None


def start(system: DelaySystem) -> LowRankChange:
    """Change ``F P_0 Fᵀ + W - P_0`` of the first prediction, as ``V Λ Vᵀ``, at k = 0.

    With P_0 = diag(P, X, ..., X) it is non-zero in block row and column 0 and in block (1, 1)
    only, so that an orthonormal basis of 3n columns carries it.

    Raises
    ------
    ValueError
        The recursion does not apply to the system.
    """
    if (reason := refusal(system)) is not None:
        raise ValueError(f"method 'chandrasekhar': not for {reason}")
    c, n, blocks = system.step(1), system.state_size, system.max_delay + 1
    spread = system.start_blocks()  # P, X, ..., X
    corner, column = c.state_noise - spread[0], np.zeros((blocks, n, n))
    with np.errstate(over="ignore", invalid="ignore"):
        for d, a in c.dynamics.items():
            corner = corner + a @ spread[d] @ a.T
            if d + 1 < blocks:
                column[d + 1] = (a @ spread[d]).T
    require_finite("covariances", 1, corner, column)
    parts = np.zeros((blocks, n, 3 * n))
    parts[0, :, :n] = np.eye(n)
    parts[..., n : 2 * n] = column
    middle = np.zeros((3 * n, 3 * n))
    middle[:n, :n] = corner
    middle[:n, n : 2 * n] = middle[n : 2 * n, :n] = np.eye(n)
    if blocks > 1:
        parts[1, :, 2 * n :] = np.eye(n)
        middle[2 * n :, 2 * n :] = spread[0] - spread[1]
    # the bases are free: the recursion goes on with change @ middle @ changeᵀ, which is not
    basis, mixed = np.linalg.qr(parts.reshape(blocks * n, 3 * n))
    inner = mixed @ middle @ mixed.T
    values, vectors = np.linalg.eigh(symmetrized(inner))
    kept = np.abs(values) > RANK * np.abs(values).max(initial=0.0)
    change = (basis @ vectors[:, kept]).reshape(blocks, n, -1)
    m = system.measurement_size
    gain, inner = np.zeros((blocks, n, m)), np.eye(m)
    return LowRankChange(0, change, np.diag(values[kept]), gain, inner, spread[0], 0.0)


def advance(
    system: DelaySystem, state: LowRankChange, missing: np.ndarray | None = None
) -> tuple[LowRankChange, StepGains]:
    """One step of gain, innovation covariance and change.

    With ``Π_{k} = Π_{k-1} + Y M Yᵀ``, H the sensor and B_k = Π_k Hᵀ the gain times S_k:
    ``S_k = S_{k-1} + (H Y) M (H Y)ᵀ``, ``B_k = B_{k-1} + Y M (H Y)ᵀ``, and the next change is
    ``Y <- F (Y - K_{k-1} H Y)``, ``M <- M - M (H Y)ᵀ S_k⁻¹ (H Y) M``.

    Raises
    ------
    BreakdownError
        A missing value, S is not finite or not positive definite, the filtered covariance is
        indefinite, or too many digits have cancelled.
    """
    if missing is not None and missing.any():
        raise BreakdownError(f"a value is missing at step {state.k + 1}")
    c, k = system.step(1), state.k + 1
    change, middle = state.change, state.middle
    with np.errstate(over="ignore", invalid="ignore"):
        seen = c.sensor @ change[0]
        predicted = symmetrized(state.predicted + change[0] @ middle @ change[0].T)
        told = change @ (middle @ seen.T)
        if k == 1:  # there is no gain before: B_0 and S_0 are those of the start law
            cross = _start_cross(system) + told
            inner = symmetrized(c.sensor @ predicted @ c.sensor.T + c.sensor_cov)
        else:
            cross = state.gain @ state.innovation_cov + told
            inner = symmetrized(state.innovation_cov + seen @ middle @ seen.T)
        terms = state.terms + (_size(seen, middle) + np.abs(inner).max() if k == 1 else 0.0)
        pivot = _pivot(inner, terms, k)
        flat = cross.reshape(-1, system.measurement_size)
        gain = cho_solve(pivot, flat.T, check_finite=False).T.reshape(cross.shape)
        # Joseph's form forgives the gain's rounding
        keep = np.eye(system.state_size) - gain[0] @ c.sensor
        filtered = symmetrized(keep @ predicted @ keep.T + gain[0] @ c.sensor_cov @ gain[0].T)
        _require(np.isfinite(filtered).all(), "the recursion overflowed", k)
        smallest = np.linalg.eigvalsh(filtered)[0]
        definite = not smallest < -INDEFINITE * np.abs(predicted).max()
        _require(definite, "the covariance became indefinite", k)
        if k == 1:
            # the first measurement takes K S Kᵀ off: m more columns, once and for all
            change = np.concatenate([_moved(system, change), _moved(system, gain)], axis=2)
            before = middle = block_diag(middle, -inner)
        else:
            change = _moved(system, change) - _moved(system, state.gain) @ seen
            before, less = middle, cho_solve(pivot, seen @ middle, check_finite=False)
            middle = symmetrized(middle - middle @ seen.T @ less)
        # the rounding error of the new middle is relative to the one before
        terms += _size(c.sensor @ change[0], before)
        # steady: without columns the recursion costs nothing from here on
        if _size(change, middle) <= SETTLED * np.abs(predicted).max():
            change, middle = change[..., :0], middle[:0, :0]
    state = LowRankChange(k, change, middle, gain, inner, predicted, terms)
    return state, StepGains(gain, inner, predicted, filtered)


def _size(columns: np.ndarray, middle: np.ndarray) -> float:
    """Bound of the terms of ``columns middle columnsᵀ``."""
    return np.abs(columns).max(initial=0.0) ** 2 * np.abs(middle).max(initial=0.0)


def _start_cross(system: DelaySystem) -> np.ndarray:
    cross = np.zeros((system.max_delay + 1, system.state_size, system.measurement_size))
    cross[0] = system.cov0[: system.state_size, : system.state_size] @ system.step(1).sensor.T
    return cross


def _moved(system: DelaySystem, stack: np.ndarray) -> np.ndarray:
    """F times a stack of columns (N+1, n, w): a shift below one new block."""
    moved = np.empty_like(stack)
    moved[1:] = stack[:-1]
    moved[0] = sum(a @ stack[d] for d, a in system.step(1).dynamics.items())
    return moved


def _pivot(inner: np.ndarray, terms: float, k: int) -> tuple[np.ndarray, bool]:
    """Cholesky factor of S, as long as S is large beside the rounding of its terms."""
    _require(np.isfinite(inner).all(), "the recursion overflowed", k)
    large = np.linalg.eigvalsh(inner)[0] > np.finfo(float).eps / CANCELLED * terms
    _require(large, "the innovation covariance has lost its digits", k)
    return innovation_factor(inner, k)


def _require(sound: bool, what: str, k: int) -> None:
    if not sound:
        raise BreakdownError(f"{what} at step {k}")
