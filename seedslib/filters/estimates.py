"""What filters take and return: estimates, records of measurements, times of states."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_real, as_whole, unmasked
from seedslib.models.kinds import AnySystem, switches


class Estimates(NamedTuple):
    """Estimates on a grid of times; what a filter does not give is None.

    Attributes
    ----------
    mean : ndarray, shape (K+1, n, *batch)
        Estimated state after each measurement.
    cov : ndarray, shape (K+1, n, n) or (K+1, n, n, *batch), or None
        Covariance of the error that the filter itself claims.
    mode_prob : ndarray, shape (K+1, L, *batch), or None
        Posterior probabilities of the modes.
    loglik : ndarray, shape (K+1, *batch), or None
        Logarithm of the predictive density of each measurement; the sum over time is the
        log-likelihood of the record.
    diverged : ndarray of bool, shape (*batch), or None
        Which paths left the region that the filter was told to believe, or became NaN.
    modes : ndarray of int, shape (K+1, *batch), or None
        Decided modes of a switching system, numbered from 0.
    """

    mean: np.ndarray
    cov: MaybeArray = None
    mode_prob: MaybeArray = None
    loglik: MaybeArray = None
    diverged: MaybeArray = None
    modes: MaybeArray = None


def as_record(measurements: object, count: int, size: int) -> np.ndarray:
    """Measurements of shape (count, size, *batch); NaN, or a mask, is a missing component.

    A float64 array is passed on without a copy.

    Raises
    ------
    TypeError, ValueError
        Not real numbers, a wrong shape, or an infinite entry.
    """
    record = np.asarray(unmasked("measurements", measurements, missing=np.nan))
    if record.dtype != np.float64:
        record = as_real("measurements", measurements, nan=True)
    if record.ndim < 2 or record.shape[:2] != (count, size):
        raise ValueError(
            f"measurements: wanted shape ({count}, {size}, *batch), got {record.shape}"
        )
    with np.errstate(invalid="ignore", over="ignore"):
        suspect = not np.isfinite(record.sum())
    if suspect and np.isinf(record).any():
        where = tuple(int(i) for i in np.argwhere(np.isinf(record))[0])
        raise ValueError(
            f"measurements: wanted finite numbers or NaN, got {record[where]} at index {where}"
        )
    return record


def stays(state: object, t: float) -> bool:
    """Whether a forecast to time t leaves the state as it is: it has no time yet, or that one.

    Parameters
    ----------
    state : NamedTuple
        Of any filter, with a field `time`.
    t : float

    Raises
    ------
    ValueError
        A time before that of the state.
    """
    if state.time is None or t == state.time:
        return True
    if not t > state.time:
        raise ValueError(f"t: wanted a time from {state.time:g} on, got {t:g}")
    return False


def require_time(state: object) -> None:
    """Refuse to correct a state that was not given a time.

    Raises
    ------
    ValueError
        A state without a time: `predict` gives it one.
    """
    if state.time is None:
        raise ValueError("state: wanted a state with a time, got None; predict to it first")


def as_indicators(
    indicators: Any, system: AnySystem, shape: tuple[int, ...], name: str = "indicators"
) -> np.ndarray | None:
    """Indicators of a switching system, whole numbers in the shape; -1, or a mask, is missing.

    Raises
    ------
    TypeError, ValueError
        Indicators where the system has none or none where it has; no whole numbers, a wrong
        shape, a value out of range.
    """
    values = getattr(system, "indicators", 0)
    if indicators is None:
        if values:
            raise ValueError(f"{name}: wanted, the system has an indicator; got none")
        return None
    if not values:
        what = "indicator" if switches(system) else "modes"
        raise ValueError(f"{name}: wanted none, the system has no {what}")
    seen = as_whole(name, unmasked(name, indicators, missing=-1), shape)
    if seen.size and not (seen.min() >= -1 and seen.max() < values):
        worst = seen.max() if seen.max() >= values else seen.min()
        raise ValueError(f"{name}: wanted 0 to {values - 1}, or -1 for a missing one, got {worst}")
    return seen


def as_seen(
    state: object, system: object, y: object, indicator: object
) -> tuple[np.ndarray, np.ndarray | None]:
    """What a state with a time is corrected by: a measurement (m, *batch), and an indicator.

    Raises
    ------
    TypeError, ValueError
        As `require_time` and `as_indicators`.
    """
    require_time(state)
    y = np.asarray(unmasked("y", y, missing=np.nan), dtype=float)
    return y, as_indicators(indicator, system, y.shape[1:], "indicator")


def as_modes(name: str, value: object, shape: tuple[int, ...], count: int) -> np.ndarray:
    """Modes, whole numbers from 0 to count - 1 in the wanted shape.

    Raises
    ------
    TypeError, ValueError
        No whole numbers, another shape, or numbers out of range.
    """
    modes = as_whole(name, value, shape)
    bad = (modes < 0) | (modes >= count)
    if bad.any():
        raise ValueError(f"{name}: wanted numbers from 0 to {count - 1}, got {modes[bad][0]}")
    return modes
