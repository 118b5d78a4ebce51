"""Exact covariance recursion of estimators with innovations of the past."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from seedslib.base.semidefinite import symmetrized
from seedslib.delay.coefficients import InstantStep, divided, require_finite
from seedslib.delay.system import DelaySystem


class StructureGains(NamedTuple):
    """Gains of an estimator with innovations of the past.

    gain (K+1, n, m): K_k; past (K+1, N, n, m): entry [k, j-1] is L_{k,j}, zero where there is no
    measurement k-j; corrected: whether the structure is (R1) rather than (6).
    """

    gain: np.ndarray
    past: np.ndarray
    corrected: bool = False


class StructureErrors(NamedTuple):
    """Gains, and the exact error covariance cov (K+1, n, n) of the estimates they give."""

    gains: StructureGains
    cov: np.ndarray


class PriorMoments(NamedTuple):
    """Covariances at instant k before its gains are chosen; J = min(N, k-1).

    predicted (n, n): of x̃'_k; cross (n, J m): of x̃'_k with the past innovations k-1, ..., k-J;
    past (J m, J m): of the latter; older_predicted (n, n), older_cross (n, J m): of the sum
    x̃_{k-1} + ... + x̃_{k-N} with x̃'_k and with the past innovations.
    """

    k: int
    step: InstantStep
    predicted: np.ndarray
    cross: np.ndarray
    past: np.ndarray
    older_predicted: np.ndarray
    older_cross: np.ndarray


Choice = Callable[[PriorMoments], tuple[np.ndarray, np.ndarray]]


def structured_errors(
    system: DelaySystem, steps: int, choose: Choice, corrected: bool
) -> StructureErrors:
    """Covariance of ``(x̃_k, ..., x̃_{k-N}, ν_k, ..., ν_{k-N+1})``, gains chosen on the way."""
    reach, n, m = system.max_delay, system.state_size, system.measurement_size
    errors = (reach + 1) * n
    size = errors + reach * m
    joint = np.zeros((size, size))
    joint[:errors, :errors] = system.start_cov()
    table = StructureGains(
        np.zeros((steps + 1, n, m)), np.zeros((steps + 1, reach, n, m)), corrected
    )
    cov = np.empty((steps + 1, n, n))
    cov[0] = system.cov0[:n, :n]
    for k in range(1, steps + 1):
        c, known = system.step(k), errors + min(reach, k - 1) * m
        ahead = c.block_row(size)  # x̃'_k = ahead · z + G w
        older = np.zeros((n, size))
        older[:, : reach * n] = np.tile(np.eye(n), reach)
        with np.errstate(over="ignore", invalid="ignore"):
            cross = ahead @ joint
            predicted = symmetrized(cross @ ahead.T + c.state_noise)
            older_predicted = older @ joint @ ahead.T
        require_finite("covariances", k, predicted, cross, older_predicted)
        past = slice(errors, known)
        gain, past = table.gain[k], table.past[k] = choose(
            PriorMoments(
                k, c, predicted, cross[:, past], joint[past, past], older_predicted,
                older @ joint[:, past],
            )
        )  # fmt: skip
        known_part = np.zeros((n, size))
        known_part[:, errors:] = past.swapaxes(0, 1).reshape(n, reach * m)
        target = ahead - known_part if corrected else ahead
        keep = np.eye(n) - gain @ c.sensor
        row = keep @ target if corrected else keep @ ahead - known_part  # x̃_k on z
        with np.errstate(over="ignore", invalid="ignore"):
            joint = _advance(joint, row, c.sensor @ target, keep, gain, c, errors)
        require_finite("covariances", k, joint)
        cov[k] = joint[:n, :n]
    return StructureErrors(table, cov)


def _advance(
    joint: np.ndarray, row: np.ndarray, seen: np.ndarray, keep: np.ndarray, gain: np.ndarray,
    c: InstantStep, errors: int,
) -> np.ndarray:  # fmt: skip
    """Covariance of the stack one instant on: new rows on top of each part, the rest shifted.

    x̃_k = row z + keep G w - gain v and the innovation is seen z + C G w + v.
    """
    n, m, size = len(row), len(seen), len(joint)
    moved = np.empty_like(joint)
    new = slice(n, errors)
    moved[new, new] = joint[: errors - n, : errors - n]
    noise, mixed = c.sensor_cov, row @ joint
    corner = mixed @ row.T + keep @ c.state_noise @ keep.T + gain @ noise @ gain.T
    moved[:n, :n] = symmetrized(corner)
    _both(moved, slice(n), new, mixed[:, : errors - n])
    if size == errors:
        return moved
    first, rest, kept = slice(errors, errors + m), slice(errors + m, size), slice(errors, size - m)
    moved[rest, rest] = joint[kept, kept]
    _both(moved, new, rest, joint[: errors - n, kept])
    _both(moved, slice(n), rest, mixed[:, kept])
    other = seen @ joint
    moved[first, first] = symmetrized(
        other @ seen.T + c.sensor @ c.state_noise @ c.sensor.T + noise
    )
    _both(moved, first, new, other[:, : errors - n])
    _both(moved, first, rest, other[:, kept])
    shared = mixed @ seen.T + keep @ c.state_noise @ c.sensor.T - gain @ noise
    _both(moved, slice(n), first, shared)
    return moved


def _both(matrix: np.ndarray, rows: slice, columns: slice, block: np.ndarray) -> None:
    """Write a block and its transpose."""
    matrix[rows, columns] = block
    matrix[columns, rows] = block.T


def regression(cross: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """``cross · cov⁻¹`` for a positive definite matrix, which may be of size zero."""
    if not cov.size:
        return np.zeros_like(cross)
    return divided(
        cross, symmetrized(cov),
        "system: wanted innovations with a covariance that is positive definite to rounding; "
        "these are not, the plant is too ill-conditioned for this analysis",
    )  # fmt: skip
