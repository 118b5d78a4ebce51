"""The filter of the paper exactly as printed, equations (5)-(29): a museum piece.

It is not optimal, and the matrix it computes as the covariance of its error is not that
covariance. Nothing is repaired here. For estimation use `DelayKalmanFilter`; for the true error
covariance of these gains use `seedslib.delay.error_covariance`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from seedslib.base.blocks import as_count
from seedslib.base.checks import as_real
from seedslib.delay.analysis import apply_gains
from seedslib.delay.coefficients import require_finite
from seedslib.delay.structure import StructureGains
from seedslib.delay.system import DelaySystem


class PrintedGains(NamedTuple):
    """Result of the printed recursion.

    gains: K_k and L_{k,j} of (20) and (21), for structure (6); claimed (K+1, n, n): the matrix
    P_k of (22); expanded (K+1, n, n): the same quadratic form written out, (12).
    """

    gains: StructureGains
    claimed: np.ndarray
    expanded: np.ndarray


class PrintedEstimates(NamedTuple):
    """mean (K+1, n, *batch) and the matrix `claimed` (K+1, n, n) that the paper calls P_k."""

    mean: np.ndarray
    claimed: np.ndarray


@dataclass(frozen=True, eq=False)
class PrintedDelayFilter:
    """Literal filter (5)-(29) for ``x_k = A x_{k-1} + Ā x_{k-1-N} + G w_{k-1}``.

    Where the paper is silent: a measurement of an instant k <= 0 does not exist and its term is
    absent; lags that the start values (25), (28) do not give are zero (they never enter).

    Parameters
    ----------
    system : DelaySystem
        With no delay but 0 and N, and a history that is independent from instant to instant with
        mean zero, as (2) supposes.

    Raises
    ------
    TypeError, ValueError
        Not a `DelaySystem`, other delays, or another history.
    """

    system: DelaySystem

    def __post_init__(self) -> None:
        system = self.system
        if not isinstance(system, DelaySystem):
            raise TypeError(f"system: wanted a DelaySystem, got {type(system).__name__}")
        reach, n = system.max_delay, system.n
        if not set(system.delays) <= {0, reach}:
            raise ValueError(f"system: wanted the delays 0 and {reach} only, got {system.delays}")
        if system.start_blocks() is None or system.mean0[n:].any():
            raise ValueError("system: wanted an independent history of mean zero, see (2)")

    def gains(self, steps: int) -> PrintedGains:
        """Gains and the claimed matrix up to instant K = `steps`.

        Raises
        ------
        TypeError, ValueError
            `steps` is not a positive integer or beyond the horizon; the printed recursion meets
            an indefinite innovation matrix.
        """
        steps = as_count("steps", steps)
        system = self.system
        reach, n, m = system.max_delay, system.n, system.m
        lags = _start_lags(system)
        gain, past = np.zeros((steps + 1, n, m)), np.zeros((steps + 1, reach, n, m))
        claimed, expanded = np.empty((2, steps + 1, n, n))
        claimed[0] = expanded[0] = lags[0, 0]
        table = [None]
        for k in range(1, steps + 1):
            table.append(_coefficients(system, k))
            with np.errstate(over="ignore", invalid="ignore"):
                now = _instant(table, k, reach, lags)
            require_finite("the printed matrices", k, now.gain, now.claimed, now.lags)
            gain[k], past[k, : len(now.past)] = now.gain, now.past
            claimed[k], expanded[k] = now.claimed, now.expanded
            lags = now.lags
        return PrintedGains(StructureGains(gain, past), claimed, expanded)

    def run(self, measurements: ArrayLike) -> PrintedEstimates:
        """Estimates by (5) and (6).

        Parameters
        ----------
        measurements : array_like, shape (K+1, m, *batch)
            Entry 0 is NaN; nothing else may be missing.

        Raises
        ------
        TypeError, ValueError
            As `gains` and `apply_gains`.
        """
        y = as_real("measurements", measurements, nan=True)
        if y.ndim < 2 or len(y) < 2:
            raise ValueError(
                f"measurements: wanted shape (K+1, {self.system.m}, *batch) with K >= 1, "
                f"got {y.shape}"
            )
        printed = self.gains(len(y) - 1)
        return PrintedEstimates(apply_gains(self.system, printed.gains, y), printed.claimed)


class _Matrices(NamedTuple):
    """A, Ā, G Q Gᵀ at k-1; C, R at k."""

    near: np.ndarray
    far: np.ndarray
    noise: np.ndarray
    sensor: np.ndarray
    sensor_cov: np.ndarray


class _Instant(NamedTuple):
    gain: np.ndarray
    past: np.ndarray
    claimed: np.ndarray
    expanded: np.ndarray
    lags: np.ndarray


def _coefficients(system: DelaySystem, k: int) -> _Matrices:
    """With N = 0 there is one matrix only, and it counts as A."""
    step, zero = system.step(k), np.zeros((system.n, system.n))
    given = dict(zip(system.delays, step.dynamics, strict=True))
    far = given.get(system.max_delay, zero) if system.max_delay else zero
    return _Matrices(given.get(0, zero), far, step.state_noise, step.sensor, step.sensor_cov)


def _start_lags(system: DelaySystem) -> np.ndarray:
    """(23), (25), (28): P_{0,j,i} = X_j δ_ij, an array (2N+1, 2N+1, n, n)."""
    reach, n = system.max_delay, system.n
    lags = np.zeros((2 * reach + 1, 2 * reach + 1, n, n))
    same = np.arange(reach + 1)
    lags[same, same] = system.start_blocks()
    return lags


def _instant(table: list, k: int, reach: int, lags: np.ndarray) -> _Instant:
    """(9)-(11), then (21), (20), (22), (24), (26), (27), (29)."""
    used = min(reach, k - 1)
    near, far, noise, sensor, sensor_cov = (
        np.stack(entry) for entry in zip(*(table[k - j] for j in range(used + 1)), strict=True)
    )
    # half[j] = A_{k-1-j} P_{j,·} + Ā_{k-1-j} P_{N+j,·}, the left factor of (9)-(11) and (24)
    top, bottom = lags[: used + 1], lags[reach : reach + used + 1]
    half = near[:, None] @ top + far[:, None] @ bottom
    right = half[:, : used + 1] @ near.swapaxes(1, 2)
    right = right + half[:, reach : reach + used + 1] @ far.swapaxes(1, 2)
    same = np.arange(used + 1)
    right[same, same] += noise  # (9), (10), (11): P'_{k,j,i} = right[j, i]

    inner = sensor @ right[same, same] @ sensor.swapaxes(1, 2) + sensor_cov
    cross = right[0] @ sensor.swapaxes(1, 2)  # P'_{k,j} C_{k-j}^T
    past = np.zeros_like(cross[1:])
    for j in range(1, used + 1):
        past[j - 1] = _over(cross[j], inner[j])  # (21)
    told = (cross[1:] @ past.swapaxes(1, 2)).sum(axis=0)
    left = right[0, 0] - told.T
    gain = _over(left @ sensor[0].T, inner[0])  # (20)
    keep = np.eye(len(gain)) - gain @ sensor[0]

    seen = past @ sensor[1:]  # L_{k,j} C_{k-j}
    doubled = seen[:, None] @ right[1:, 1:] @ seen.swapaxes(1, 2)
    apart = ~np.eye(used, dtype=bool)
    claimed = keep @ (right[0, 0] - told) + doubled[apart].sum(axis=0)  # (22)
    mixed = keep @ told
    expanded = keep @ right[0, 0] @ keep.T + gain @ sensor_cov[0] @ gain.T - mixed - mixed.T  # (12)
    expanded += (past @ sensor_cov[1:] @ past.swapaxes(1, 2)).sum(axis=0)
    expanded += doubled.sum(axis=(0, 1))

    moved = np.zeros_like(lags)
    moved[1:, 1:] = lags[:-1, :-1]  # (27)
    row = keep @ half[0] - (seen[:, None] @ half[1:]).sum(axis=0)
    moved[0, 1:] = row[:-1]  # (24)
    moved[1:, 0] = row[:-1].swapaxes(1, 2)
    moved[0, 0] = claimed  # (29)
    return _Instant(gain, past, claimed, expanded, moved)


def _over(cross: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """``cross · inner⁻¹`` by Cholesky, the factors S of (13), (14)."""
    try:
        root = cho_factor(inner, lower=True, check_finite=False)
        return cho_solve(root, cross.T, check_finite=False).T
    except np.linalg.LinAlgError:
        raise ValueError(
            "the printed recursion met an innovation matrix that is not positive definite"
        ) from None
