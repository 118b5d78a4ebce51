"""Gains for systems with delay: optimal, repaired, printed, greedy; and the errors any gains leave.

Structure (6) of the paper: from the prediction ``x̂'_k = sum_d A_d x̂_{k-1-d}`` and the innovations
``ν_k = y_k - C x̂'_k`` the estimate ``x̂_k = x̂'_k + K_k ν_k + sum_j L_{k,j} ν_{k-j}``.
Structure (R1) takes each innovation against the prediction that the older ones have corrected:
``x̄_k = x̂'_k + sum_j L_{k,j} e_{k-j}``, ``e_k = y_k - C x̄_k``, ``x̂_k = x̄_k + K_k e_k``.

For any gains the errors and innovations are linear functions of the start and of the noises.
Their coefficients on independent variables of variance one are carried along, so that every
covariance is a product of coefficients and every best gain a regression.

The optimal gains come from the covariance of the stacked state (x_k, ..., x_{k-N}) in a ring:
instant k occupies block ``k mod (N+1)``, so that the shift of the stack costs nothing and one step
overwrites the oldest block only. The correction is a symmetric rank-2m update of the lower
triangle in place. Nothing of size D × D, D = (N+1)n, is ever multiplied.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.blas import dsyr2k

from seedslib.base.checks import as_count, as_real
from seedslib.base.linalg import cholesky, symmetrized
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


class OptimalGains(NamedTuple):
    """Gains and covariances of the optimal filter for k = 0..K; they do not depend on the data.

    Attributes
    ----------
    gain : ndarray, shape (K+1, N+1, n, m)
        Entry [k, s] is K_k^{[s]}, the gain of the measurement of instant k for x_{k-s}: the
        filter's for s = 0, the smoother's of lag s otherwise.
    innovation_cov : ndarray, shape (K+1, m, m)
    cov : ndarray, shape (K+1, n, n)
        Error covariance of the estimate of x_k.
    """

    gain: np.ndarray
    innovation_cov: np.ndarray
    cov: np.ndarray


class PrintedGains(NamedTuple):
    """Result of the printed recursion.

    gains: K_k and L_{k,j} of (20) and (21), for structure (6); claimed (K+1, n, n): the matrix
    P_k of (22).
    """

    gains: StructureGains
    claimed: np.ndarray


def optimal_gains(system: DelaySystem, steps: int) -> OptimalGains:
    """Gains of the Kalman filter of ``system.stacked()`` up to instant K = `steps`.

    A step costs n²N²m operations, where that of the stacked filter costs n³N³.

    Raises
    ------
    TypeError, ValueError
        `steps` is no positive integer; the covariances of an unstable system overflow.
    """
    steps = as_count("steps", steps)
    n, m, blocks = system.state_size, system.measurement_size, system.max_delay + 1
    shapes = (blocks, n, m), (m, m), (n, n)
    tables = OptimalGains(*(np.zeros((steps + 1, *shape)) for shape in shapes))
    tables.innovation_cov[0], tables.cov[0] = np.eye(m), system.cov0
    ring = np.zeros((blocks * n, blocks * n), order="F")
    for j, block in enumerate(system.start_blocks()):
        at = (-j % blocks) * n
        ring[at : at + n, at : at + n] = block
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(1, steps + 1):
            ring, *entries = _advance(system, k, ring)
            for table, entry in zip(tables, entries, strict=True):
                table[k] = entry
    if not all(np.isfinite(table).all() for table in tables):
        raise ValueError("steps: the covariances overflow: unstable system")
    return tables


def repaired_gains(system: DelaySystem, steps: int) -> StructureGains:
    """Gains of the optimal filter in the innovations form (R1), for `apply_gains`.

    By (R2) ``L_{k,j} = sum_{d>=j} A_d K_{k-j}^{[d+1-j]}``.

    Raises
    ------
    TypeError, ValueError
        As `optimal_gains`.
    """
    gain = optimal_gains(system, steps).gain
    past = np.zeros((len(gain), system.max_delay, *gain.shape[2:]))
    for d, matrix in system.dynamics.items():
        for j in range(1, d + 1):
            past[j + 1 :, j - 1] += matrix @ gain[1:-j, d + 1 - j]
    return StructureGains(gain[:, 0], past, corrected=True)


def printed_gains(system: DelaySystem, steps: int) -> PrintedGains:
    """Gains exactly as printed, (9)-(29), and the matrix that they claim as error covariance.

    The filter is not optimal, and the matrix is not the covariance of its error: that is
    `error_covariance` of the gains. Where the paper is silent: a measurement of an instant k <= 0
    does not exist and its term is absent; lags that the start values (25), (28) do not give are
    zero (they never enter).

    Parameters
    ----------
    system : DelaySystem
        With no delay but 0 and N.
    steps : int
        Last instant K.

    Raises
    ------
    TypeError, ValueError
        Other delays; the printed recursion meets an indefinite innovation matrix.
    """
    steps, reach, n = as_count("steps", steps), system.max_delay, system.state_size
    if not set(system.dynamics) <= {0, reach}:
        raise ValueError(f"system: wanted the delays 0 and {reach}, got {[*system.dynamics]}")
    # with N = 0 there is one matrix only, and it counts as A
    near, far = (system.dynamics.get(d, np.zeros((n, n))) for d in (0, reach or -1))
    sensor, m = system.sensor, system.measurement_size
    gain, past = np.zeros((steps + 1, n, m)), np.zeros((steps + 1, reach, n, m))
    claimed = np.tile(system.cov0, (steps + 1, 1, 1))
    lags = np.zeros((2 * reach + 1, 2 * reach + 1, n, n))  # P_{k,j,i}
    lags[np.arange(reach + 1), np.arange(reach + 1)] = system.start_blocks()  # (23), (25), (28)
    for k in range(1, steps + 1):
        used = min(reach, k - 1)
        same = np.arange(used + 1)
        # half[j] = A P_{j,·} + Ā P_{N+j,·}, the left factor of (9)-(11) and (24)
        half = near @ lags[: used + 1] + far @ lags[reach : reach + used + 1]
        right = half[:, : used + 1] @ near.T + half[:, reach : reach + used + 1] @ far.T
        right[same, same] += system.state_noise  # (9), (10), (11): P'_{k,j,i} = right[j, i]
        innovation_covs = sensor @ right[same, same] @ sensor.T + system.sensor_cov
        # the factors S of (13), (14): without them there is no filter
        np.linalg.cholesky(innovation_covs)
        cross = right[0] @ sensor.T
        past[k, :used] = np.linalg.solve(innovation_covs[1:], cross[1:].mT).mT  # (21)
        removed = (cross[1:] @ past[k, :used].mT).sum(axis=0)
        gain[k] = np.linalg.solve(innovation_covs[0], sensor @ (right[0, 0].T - removed)).T  # (20)
        reduction = np.eye(n) - gain[k] @ sensor
        older = past[k, :used] @ sensor  # L_{k,j} C
        doubled = older[:, None] @ right[1:, 1:] @ older.mT
        claimed[k] = reduction @ (right[0, 0] - removed)  # (22)
        claimed[k] += doubled[~np.eye(used, dtype=bool)].sum(axis=0)
        first = reduction @ half[0] - (older[:, None] @ half[1:]).sum(axis=0)
        lags[1:, 1:] = lags[:-1, :-1].copy()  # (27)
        lags[0, 1:], lags[1:, 0] = first[:-1], first[:-1].mT  # (24)
        lags[0, 0] = claimed[k]  # (29)
    return PrintedGains(StructureGains(gain, past), claimed)


def error_covariance(system: DelaySystem, gains: StructureGains) -> np.ndarray:
    """Exact covariance (K+1, n, n) of the errors ``x_k - x̂_k`` that given gains leave.

    Raises
    ------
    ValueError
        Shapes that do not fit.
    """
    gains = _checked(system, gains)

    def given(k, past, *_):
        return gains.gain[k], gains.past[k, : len(past)]

    return _errors(system, len(gains.gain) - 1, given, gains.corrected).cov


def greedy_gains(
    system: DelaySystem,
    steps: int,
    *,
    past: int | None = None,
    keep: str = "newest",
    corrected: bool = False,
    criterion: str = "newest",
) -> StructureErrors:
    """Gains that minimise the error covariance of each instant, given those before.

    All kept innovations enter one regression of the prediction error: the best one-step choice
    within the structure. With `corrected` and all innovations kept it is the optimal filter.

    Parameters
    ----------
    system : DelaySystem
    steps : int
        Last instant K.
    past : int, optional
        Number of past innovations that are used, 0 to N; all N by default.
    keep : {"newest", "oldest"}
        Which of the N past innovations these are: j = 1, 2, ... or j = N, N-1, ...
    corrected : bool
        Structure (R1) instead of (6).
    criterion : {"newest", "sum"}
        Minimise the error of x_k, (7), or ``E |x̃_k + x̃_{k-1} + ... + x̃_{k-N}|²``, which is
        what (4) says if its double sum is taken at its word; the latter in structure (6) only.

    Raises
    ------
    TypeError, ValueError
        An illegal argument.
    """
    reach, m = system.max_delay, system.measurement_size
    past = reach if past is None else as_count("past", past, 0, reach)
    if keep not in ("newest", "oldest"):
        raise ValueError(f"keep: wanted 'newest' or 'oldest', got {keep!r}")
    if criterion not in ("newest", "sum") or (corrected and criterion == "sum"):
        raise ValueError(f"criterion: wanted 'newest', or 'sum' of (6), got {criterion!r}")
    used = range(past) if keep == "newest" else range(reach - past, reach)

    def regress(k, past, predicted, innovation, older):
        selected = [j for j in used if j < len(past)]
        rows, target = np.vstack(past[selected]) if selected else innovation[:0], predicted
        if criterion == "sum":
            target = predicted + older
        if corrected:
            past_gain = _regression(target, rows)
            gain = _regression(target, innovation - system.sensor @ past_gain @ rows)
        else:
            joint = _regression(target, np.vstack([innovation, rows]))
            gain, past_gain = np.split(joint, [m], axis=1)
        past_gains = np.zeros((len(past), *gain.shape))
        past_gains[selected] = past_gain.reshape(len(gain), -1, m).swapaxes(0, 1)
        return gain, past_gains

    return _errors(system, as_count("steps", steps), regress, corrected)


def separate_gains(system: DelaySystem, steps: int) -> StructureErrors:
    """Gains of the paper's (20) and (21) in structure (6), with exact covariances put in.

    Each L_{k,j} regresses on one innovation alone and K_k accounts for them one by one; since
    the innovations of structure (6) are correlated this is no minimum.
    """

    def separate(k, past, predicted, innovation, older):
        past_gains = np.zeros((len(past), *system.sensor.T.shape))
        remaining = predicted @ predicted.T
        for j, one in enumerate(past):
            past_gains[j] = _regression(predicted, one)
            remaining = remaining - past_gains[j] @ one @ predicted.T
        innovation_cov = innovation @ innovation.T
        return np.linalg.solve(innovation_cov, system.sensor @ remaining.T).T, past_gains

    return _errors(system, as_count("steps", steps), separate, False)


def apply_gains(system: DelaySystem, gains: StructureGains, measurements: ArrayLike) -> np.ndarray:
    """Estimates of an estimator with given gains.

    Parameters
    ----------
    system : DelaySystem
    gains : StructureGains
    measurements : array_like, shape (K+1, m, *batch)
        Nothing is measured at k = 0, and nothing may be missing after it.

    Returns
    -------
    ndarray, shape (K+1, n, *batch)

    Raises
    ------
    ValueError
        Shapes that do not fit.
    """
    gains, y = _checked(system, gains), np.asarray(measurements, dtype=float)
    flat = y.reshape(*y.shape[:2], -1)
    as_real("measurements", flat[1:], (len(gains.gain) - 1, system.measurement_size, -1))
    reach, n = system.max_delay, system.state_size
    estimates = np.zeros((reach + len(y), n, flat.shape[2]))  # of x_{-N}, ..., x_K
    estimates[reach] = system.mean0[:, None]
    innovations = np.zeros_like(flat)
    for k in range(1, len(y)):
        plain = sum(a @ estimates[reach + k - 1 - d] for d, a in system.dynamics.items())
        mean = plain
        for j in range(1, min(reach, k - 1) + 1):
            mean = mean + gains.past[k, j - 1] @ innovations[k - j]
        innovations[k] = flat[k] - system.sensor @ (mean if gains.corrected else plain)
        estimates[reach + k] = mean + gains.gain[k] @ innovations[k]
    return estimates[reach:].reshape(len(y), n, *y.shape[2:])


def _advance(system: DelaySystem, k: int, cov: np.ndarray) -> tuple[np.ndarray, ...]:
    """Predict and correct the ring, valid on and below the diagonal; then gain, S_k and P_k.

    The correction is Joseph's form ``(I-KH) Π (I-KH)ᵀ + K R Kᵀ``, which stays right for a gain
    that is not: with ``T = Π - K H Π`` it is ``T - V Kᵀ``, ``V = T Hᵀ - K R``. V is zero but for
    rounding; it is computed from block column 0 of T, because ``B - K S`` (the same on paper,
    ``B = Π Hᵀ``) has lost the digits that matter when S is nearly singular. The blocks of the
    newest instant, where the measurement bites, are written with ``I - K^{[0]} C`` multiplied
    out.
    """
    sensor, sensor_cov, n = system.sensor, system.sensor_cov, system.state_size
    blocks = system.max_delay + 1
    start = (k % blocks) * n
    new = slice(start, start + n)

    # the new block row A Π, and its corner A Π Aᵀ + G Q Gᵀ, from the blocks the delays reach
    moves = [(a, ((k - 1 - d) % blocks) * n) for d, a in system.dynamics.items()]
    row = sum(a @ _rows(cov, at, n) for a, at in moves)
    corner = sum((row[:, at : at + n] @ a.T for a, at in moves), start=system.state_noise)
    row[:, new] = predicted = symmetrized(corner)

    cross_cov = row.T @ sensor.T
    innovation_cov = symmetrized(sensor @ cross_cov[new] + sensor_cov)
    # rows without a gap between them, as the update of the triangle wants them
    gains = np.ascontiguousarray(np.linalg.solve(innovation_cov, cross_cov.T).T)
    gain = gains[new]
    reduction = np.eye(n) - gain @ sensor
    column = row.T - gains @ (sensor @ predicted)  # block column 0 of T = Π - K (C Π_0)
    column[new] = reduction @ predicted
    rest = column @ sensor.T - gains @ sensor_cov  # V
    # also over the blocks of the oldest instant, which those of the newest replace then
    cov = dsyr2k(-1.0, gains, 0.5 * (cross_cov + rest), beta=1.0, c=cov, lower=1, overwrite_c=1)

    border = reduction @ row - rest[new] @ gains.T
    filtered = symmetrized(reduction @ predicted @ reduction.T + gain @ sensor_cov @ gain.T)
    border[:, new] = filtered
    cov[new, :start], cov[start:, new] = border[:, :start], border[:, start:].T

    lags = (k - np.arange(blocks)) % blocks
    return cov, gains.reshape(blocks, n, -1)[lags], innovation_cov, filtered


def _rows(cov: np.ndarray, at: int, n: int) -> np.ndarray:
    """Full block row (n, D) of a symmetric matrix of which the lower triangle is valid."""
    row = np.hstack([cov[at : at + n, :at], cov[at:, at : at + n].T])
    corner = row[:, at : at + n]
    corner[...] = np.where(np.tri(n, dtype=bool), corner.T, corner)
    return row


def _errors(
    system: DelaySystem, steps: int, choose: Callable[..., tuple], corrected: bool
) -> StructureErrors:
    """Errors and innovations instant by instant, with gains chosen on the way.

    ``choose(k, past, predicted, innovation, older)`` is given, as coefficients on the independent
    variables, the innovations (J, m, size) of the instants k-1, ..., k-J, the error (n, size) of
    x̂'_k, ν_k (m, size), and the sum (n, size) of the errors of the estimates of x_{k-1}, ...,
    x_{k-N}; it returns K_k (n, m) and the L_{k,j}, (J, n, m).
    """
    reach, n, m = system.max_delay, system.state_size, system.measurement_size
    drive = system.noise_input @ cholesky(system.noise_cov)
    sensor_root, q = np.linalg.cholesky(system.sensor_cov), drive.shape[1]
    size = (reach + 1) * n + steps * (q + m)
    errors = list(np.zeros((reach + 1, n, size)))  # newest first, as the past innovations
    past = np.zeros((0, m, size))
    for j, block in enumerate(system.start_blocks()):
        errors[j][:, j * n : (j + 1) * n] = cholesky(block)
    gains, past_gains = np.zeros((steps + 1, n, m)), np.zeros((steps + 1, reach, n, m))
    cov = np.tile(system.cov0, (steps + 1, 1, 1))
    for k in range(1, steps + 1):
        at = (reach + 1) * n + (k - 1) * (q + m)
        predicted = sum(a @ errors[d] for d, a in system.dynamics.items())
        predicted[:, at : at + q] += drive
        innovation = system.sensor @ predicted
        innovation[:, at + q : at + q + m] += sensor_root
        older = sum(errors[:reach], np.zeros((n, size)))
        gains[k], chosen = choose(k, past, predicted, innovation, older)
        past_gains[k, : len(past)] = chosen
        error = predicted - np.einsum("jnm,jms->ns", chosen, past)
        if corrected:
            innovation = innovation - system.sensor @ (predicted - error)
        error = error - gains[k] @ innovation
        errors = [error, *errors[:-1]]
        past = np.concatenate([innovation[None], past])[:reach]
        cov[k] = error @ error.T
    return StructureErrors(StructureGains(gains, past_gains, corrected), cov)


def _regression(target: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Gain of the best linear estimate of a target from other variables, all as coefficients."""
    return np.linalg.solve(rows @ rows.T, rows @ target.T).T


def _checked(system: DelaySystem, gains: StructureGains) -> StructureGains:
    sizes = system.state_size, system.measurement_size
    gain = as_real("gains.gain", gains.gain, (-1, *sizes))
    past = as_real("gains.past", gains.past, (len(gain), system.max_delay, *sizes))
    return StructureGains(gain, past, gains.corrected)
