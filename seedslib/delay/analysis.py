"""Estimators with a prescribed structure, and the exact covariance of their errors.

Structure (6) of the paper: from the prediction ``x̂'_k = sum_d A_d x̂_{k-1-d}`` and the innovations
``ν_k = y_k - C x̂'_k`` the estimate ``x̂_k = x̂'_k + K_k ν_k + sum_j L_{k,j} ν_{k-j}``.
Structure (R1) takes each innovation against the prediction that the older ones have corrected:
``x̄_k = x̂'_k + sum_j L_{k,j} e_{k-j}``, ``e_k = y_k - C x̄_k``, ``x̂_k = x̄_k + K_k e_k``.

For any gains the errors and innovations of the last instants, stacked, obey a linear recursion
driven by the white noises of the new instant alone, so their covariance is computed exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import as_count
from seedslib.base.checks import as_real, as_shape
from seedslib.delay.coefficients import require_finite
from seedslib.delay.structure import Moments, StructureErrors, StructureGains, propagate, regression
from seedslib.delay.system import DelaySystem


def error_covariance(system: DelaySystem, gains: StructureGains) -> np.ndarray:
    """Exact covariance (K+1, n, n) of the errors ``x_k - x̂_k`` that given gains leave.

    Parameters
    ----------
    system : DelaySystem
    gains : StructureGains
        Any gains, optimal or not.

    Raises
    ------
    TypeError, ValueError
        Shapes that do not fit, or entries that are not finite.
    """
    gains = _checked(system, gains)

    def given(moments: Moments) -> tuple[np.ndarray, np.ndarray]:
        return gains.gain[moments.k], gains.past[moments.k]

    return propagate(system, len(gains.gain) - 1, given, gains.corrected).cov


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
    within the structure. With `corrected`, all innovations kept and nothing dropped it is the
    optimal filter.

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
    reach = _as_system(system).max_delay
    past = reach if past is None else past
    if isinstance(past, bool) or not isinstance(past, int | np.integer):
        raise TypeError(f"past: wanted an integer, got {past!r}")
    if not 0 <= past <= reach:
        raise ValueError(f"past: wanted 0 to {reach}, got {past}")
    if keep not in ("newest", "oldest"):
        raise ValueError(f"keep: wanted 'newest' or 'oldest', got {keep!r}")
    if criterion not in ("newest", "sum") or (corrected and criterion == "sum"):
        raise ValueError(
            f"criterion: wanted 'newest', or 'sum' in structure (6), got {criterion!r}"
        )
    used = np.zeros(reach, dtype=bool)
    used[(slice(past) if keep == "newest" else slice(reach - past, None))] = True

    def regress(moments: Moments) -> tuple[np.ndarray, np.ndarray]:
        c, n, m = moments.step, system.n, system.m
        lags = np.flatnonzero(used[: moments.past.shape[0] // m])
        at = (lags[:, None] * m + np.arange(m)).ravel()
        cross, spread = moments.cross[:, at], moments.past[np.ix_(at, at)]
        past_gains = np.zeros((reach, n, m))
        if corrected:
            known = regression(cross, spread)
            left = moments.predicted - known @ cross.T
            gain = regression(left @ c.sensor.T, c.sensor @ left @ c.sensor.T + c.sensor_cov)
        else:
            own = moments.predicted @ c.sensor.T
            joint = np.empty((m + len(at), m + len(at)))
            joint[:m, :m] = c.sensor @ own + c.sensor_cov
            joint[:m, m:] = c.sensor @ cross
            joint[m:, :m] = joint[:m, m:].T
            joint[m:, m:] = spread
            if criterion == "sum":
                own = own + moments.older_predicted @ c.sensor.T
                cross = cross + moments.older_cross[:, at]
            both = regression(np.hstack([own, cross]), joint)
            gain, known = both[:, :m], both[:, m:]
        past_gains[lags] = known.reshape(n, -1, m).swapaxes(0, 1)
        return gain, past_gains

    return propagate(system, as_count("steps", steps), regress, corrected)


def separate_gains(system: DelaySystem, steps: int) -> StructureErrors:
    """Gains of the paper's (20) and (21) in structure (6), with exact covariances put in.

    Each L_{k,j} regresses on one innovation alone and K_k accounts for them one by one; since
    the innovations of structure (6) are correlated this is no minimum.

    Raises
    ------
    TypeError, ValueError
        An illegal argument.
    """

    def separate(moments: Moments) -> tuple[np.ndarray, np.ndarray]:
        c, m = moments.step, system.m
        past = np.zeros((system.max_delay, system.n, m))
        left = moments.predicted
        for j in range(moments.past.shape[0] // m):
            at = slice(j * m, (j + 1) * m)
            past[j] = regression(moments.cross[:, at], moments.past[at, at])
            left = left - past[j] @ moments.cross[:, at].T
        inner = c.sensor @ moments.predicted @ c.sensor.T + c.sensor_cov
        return regression(left @ c.sensor.T, inner), past

    return propagate(_as_system(system), as_count("steps", steps), separate, False)


def apply_gains(system: DelaySystem, gains: StructureGains, measurements: ArrayLike) -> np.ndarray:
    """Estimates of an estimator with given gains.

    Parameters
    ----------
    system : DelaySystem
    gains : StructureGains
    measurements : array_like, shape (K+1, m, *batch)
        Entry 0 is NaN; nothing else may be missing.

    Returns
    -------
    ndarray, shape (K+1, n, *batch)

    Raises
    ------
    TypeError, ValueError
        Shapes that do not fit, or entries that are not finite.
    """
    gains = _checked(system, gains)
    y = as_real("measurements", measurements, nan=True)
    wanted = gains.gain.shape[0], system.m
    if y.shape[:2] != wanted:
        raise ValueError(f"measurements: wanted shape {(*wanted, '*batch')}, got {y.shape}")
    if y.size == 0:
        raise ValueError(f"measurements: wanted at least one path, got shape {y.shape}")
    if not np.isnan(y[0]).all() or np.isnan(y[1:]).any():
        raise ValueError("measurements: wanted NaN at k = 0, and nowhere else")
    flat = y.reshape(*wanted, -1)
    reach, n = system.max_delay, system.n
    start = system.mean0.reshape(reach + 1, n, 1)[::-1]
    chain = np.empty((reach + len(y), n, flat.shape[2]))  # estimates of x_{-N}, ..., x_K
    chain[: reach + 1] = start
    innovations = np.zeros_like(flat)
    for k in range(1, len(y)):
        c, now = system.step(k), reach + k
        with np.errstate(over="ignore", invalid="ignore"):
            mean = sum(
                a @ chain[now - 1 - d] for d, a in zip(system.delays, c.dynamics, strict=True)
            )
            plain = mean
            for j in range(1, min(reach, k - 1) + 1):
                mean = mean + gains.past[k, j - 1] @ innovations[k - j]
            innovations[k] = flat[k] - c.sensor @ (mean if gains.corrected else plain)
            chain[now] = mean + gains.gain[k] @ innovations[k]
        require_finite("estimates", k, chain[now], innovations[k])
    return chain[reach:].reshape(len(y), n, *y.shape[2:])


def _as_system(value: object) -> DelaySystem:
    if not isinstance(value, DelaySystem):
        raise TypeError(f"system: wanted a DelaySystem, got {type(value).__name__}")
    return value


def _checked(system: DelaySystem, gains: StructureGains) -> StructureGains:
    _as_system(system)
    if not isinstance(gains, StructureGains):
        raise TypeError(f"gains: wanted StructureGains, got {type(gains).__name__}")
    gain = as_shape("gains.gain", gains.gain, (-1, system.n, system.m))
    past = as_shape("gains.past", gains.past, (len(gain), system.max_delay, system.n, system.m))
    if len(gain) < 2:
        raise ValueError(f"gains.gain: wanted K >= 1, got shape {gain.shape}")
    return StructureGains(gain, past, bool(gains.corrected))
