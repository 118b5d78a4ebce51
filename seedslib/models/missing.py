"""What a log-density given as an array function says where measurements are missing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


def told(log_density: Callable[..., Any], t: float, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The given log-density; zero where the whole measurement is missing (NaN), log 1.

    Parameters
    ----------
    log_density : callable
        ``log_density(t, y, x) -> (*batch)``.
    t : float
    y, x : ndarray, shapes (m, *batch) and (n, *batch)

    Raises
    ------
    ValueError
        A part of a measurement is missing, and the function gives no number at any state.
    """
    y, gaps = np.asarray(y, dtype=float), np.isnan(y)
    if not gaps.any():
        return log_density(t, y, x)
    with np.errstate(invalid="ignore"):
        found = np.where(gaps.all(axis=0), 0.0, log_density(t, y, x))
    partly = np.broadcast_to(gaps.any(axis=0) & ~gaps.all(axis=0), found.shape)
    if partly.any() and np.isnan(found[partly]).all():
        raise ValueError(
            "log_density: wanted numbers where a part of the measurement is missing (NaN), got "
            "NaN; it must integrate over that part, or the measurement be missing as a whole"
        )
    return found
