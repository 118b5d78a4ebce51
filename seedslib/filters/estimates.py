"""What a filter returns: one type for every filter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib._validate import as_real


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
    """

    mean: np.ndarray
    cov: np.ndarray | None = None
    mode_prob: np.ndarray | None = None
    loglik: np.ndarray | None = None
    diverged: np.ndarray | None = None


def as_record(measurements: object, count: int, size: int) -> np.ndarray:
    """Measurements of shape (count, size, *batch); NaN is a missing component.

    A float64 array is passed on without a copy.

    Raises
    ------
    TypeError, ValueError
        Not real numbers, a wrong shape, or an infinite entry.
    """
    record = np.asarray(measurements)
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
