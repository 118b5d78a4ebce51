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

from seedslib.base.checks import as_count, as_shape
from seedslib.delay.coefficients import require_finite
from seedslib.delay.means import as_records
from seedslib.delay.structure import (
    PriorMoments,
    StructureErrors,
    StructureGains,
    regression,
    structured_errors,
)
from seedslib.delay.system import DelaySystem
from seedslib.models.kinds import as_system


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

    def given(moments: PriorMoments) -> tuple[np.ndarray, np.ndarray]:
        return gains.gain[moments.k], gains.past[moments.k]

    return structured_errors(system, len(gains.gain) - 1, given, gains.corrected).cov


def greedy_gains(
    system: DelaySystem, steps: int, *, past: int | None = None, keep: str = "newest",
    corrected: bool = False, criterion: str = "newest",
) -> StructureErrors:  # fmt: skip
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
    reach = as_system("system", system, "DelaySystem").max_delay
    past = reach if past is None else as_count("past", past, 0, reach)
    if keep not in ("newest", "oldest"):
        raise ValueError(f"keep: wanted 'newest' or 'oldest', got {keep!r}")
    if criterion not in ("newest", "sum") or (corrected and criterion == "sum"):
        raise ValueError(
            f"criterion: wanted 'newest', or 'sum' in structure (6), got {criterion!r}"
        )
    used = np.zeros(reach, dtype=bool)
    used[(slice(past) if keep == "newest" else slice(reach - past, None))] = True

    def regress(moments: PriorMoments) -> tuple[np.ndarray, np.ndarray]:
        c, n, m = moments.step, system.state_size, system.measurement_size
        lags = np.flatnonzero(used[: moments.past.shape[0] // m])
        at = (lags[:, None] * m + np.arange(m)).ravel()
        cross, spread = moments.cross[:, at], moments.past[np.ix_(at, at)]
        past_gains = np.zeros((reach, n, m))
        if corrected:
            known = regression(cross, spread)
            left = moments.predicted - known @ cross.T
            gain = regression(left @ c.sensor.T, c.sensor @ left @ c.sensor.T + c.sensor_cov)
        else:
            own, shared = moments.predicted @ c.sensor.T, c.sensor @ cross
            joint = np.vstack(
                [np.hstack([c.sensor @ own + c.sensor_cov, shared]), np.hstack([shared.T, spread])]
            )
            if criterion == "sum":
                own = own + moments.older_predicted @ c.sensor.T
                cross = cross + moments.older_cross[:, at]
            both = regression(np.hstack([own, cross]), joint)
            gain, known = both[:, :m], both[:, m:]
        past_gains[lags] = known.reshape(n, -1, m).swapaxes(0, 1)
        return gain, past_gains

    return structured_errors(system, as_count("steps", steps), regress, corrected)


def separate_gains(system: DelaySystem, steps: int) -> StructureErrors:
    """Gains of the paper's (20) and (21) in structure (6), with exact covariances put in.

    Each L_{k,j} regresses on one innovation alone and K_k accounts for them one by one; since
    the innovations of structure (6) are correlated this is no minimum.

    Raises
    ------
    TypeError, ValueError
        An illegal argument.
    """

    def separate(moments: PriorMoments) -> tuple[np.ndarray, np.ndarray]:
        c, m = moments.step, system.measurement_size
        past = np.zeros((system.max_delay, system.state_size, m))
        left = moments.predicted
        for j in range(moments.past.shape[0] // m):
            at = slice(j * m, (j + 1) * m)
            past[j] = regression(moments.cross[:, at], moments.past[at, at])
            left = left - past[j] @ moments.cross[:, at].T
        inner = c.sensor @ moments.predicted @ c.sensor.T + c.sensor_cov
        return regression(left @ c.sensor.T, inner), past

    system = as_system("system", system, "DelaySystem")
    return structured_errors(system, as_count("steps", steps), separate, False)


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
    y, batch = as_records(measurements, system.measurement_size, len(gains.gain))
    if np.isnan(y[1:]).any():
        raise ValueError("measurements: wanted NaN at k = 0, and nowhere else")
    reach, n = system.max_delay, system.state_size
    chain = np.empty((reach + len(y), n, y.shape[2]))  # estimates of x_{-N}, ..., x_K
    chain[: reach + 1] = system.mean0.reshape(reach + 1, n, 1)[::-1]
    innovations = np.zeros_like(y)
    for k in range(1, len(y)):
        c, now = system.step(k), reach + k
        with np.errstate(over="ignore", invalid="ignore"):
            mean = plain = sum(a @ chain[now - 1 - d] for d, a in c.dynamics.items())
            for j in range(1, min(reach, k - 1) + 1):
                mean = mean + gains.past[k, j - 1] @ innovations[k - j]
            innovations[k] = y[k] - c.sensor @ (mean if gains.corrected else plain)
            chain[now] = mean + gains.gain[k] @ innovations[k]
        require_finite("estimates", k, chain[now], innovations[k])
    return chain[reach:].reshape(len(y), n, *batch)


def _checked(system: DelaySystem, gains: StructureGains) -> StructureGains:
    as_system("system", system, "DelaySystem")
    if not isinstance(gains, StructureGains):
        raise TypeError(f"gains: wanted StructureGains, got {type(gains).__name__}")
    sizes = system.state_size, system.measurement_size
    gain = as_shape("gains.gain", gains.gain, (-1, *sizes))
    past = as_shape("gains.past", gains.past, (len(gain), system.max_delay, *sizes))
    if len(gain) < 2:
        raise ValueError(f"gains.gain: wanted K >= 1, got shape {gain.shape}")
    return StructureGains(gain, past, bool(gains.corrected))
