"""What a designed filter refuses and warns of: states in the wrong order, times not its own.

And what nobody may change in it.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from seedslib.base.checks import outside
from seedslib.base.clock import Clock, when


def want_forecast(state: Any) -> None:
    """Refuse to correct a state that holds no forecast.

    Raises
    ------
    ValueError
        The state before any measurement, or after a correction.
    """
    if state.index < 0 or state.corrected:
        raise ValueError("state: wanted a forecast, got a state without; call predict first")


def want_corrected(state: Any) -> None:
    """Refuse to forecast from a state that holds a forecast.

    Raises
    ------
    ValueError
        A state after `predict`, or the one before any measurement.
    """
    if not state.corrected:
        raise ValueError("state: wanted a state after a correction, got a forecast")


def moment(clock: Clock, k: int, cycle: int) -> float:
    """Time of measurement k.

    Raises
    ------
    ValueError
        There is no such measurement.
    """
    if k >= len(clock.times) and not cycle:
        raise ValueError(f"t: wanted at most the last measurement time {when(clock.times[-1])}")
    return clock.moment(k, cycle)


def want_next(clock: Clock, k: int, t: float, cycle: int) -> None:
    """Refuse a time that is not the one of measurement k.

    Raises
    ------
    ValueError
        Another time, or no such measurement.
    """
    wanted = moment(clock, k, cycle)
    if not clock.same(t, wanted):
        raise ValueError(f"t: wanted the next measurement time {when(wanted)}, got {when(t)}")


def positions(times: np.ndarray, y: np.ndarray, clock: Clock, horizon: float) -> np.ndarray:
    """Number of the measurement time at each time of a grid, -1 between them.

    Parameters
    ----------
    times : ndarray, shape (J+1,)
    y : ndarray, shape (J+1, m, *batch)
        Must be NaN between the measurement times.
    clock : Clock
        Measurement times of the filter.
    horizon : float

    Raises
    ------
    ValueError
        A grid that starts elsewhere, goes too far, or leaves out a measurement time; a
        measurement at another time.
    """
    wanted = np.array(clock.times)
    wanted = wanted[wanted <= times[-1] + clock.tolerance]
    if not clock.same(times[0], clock.times[0]):
        raise ValueError(f"times: wanted to begin at {when(clock.times[0])}, got {when(times[0])}")
    if times[-1] > horizon + clock.tolerance:
        raise ValueError(
            f"times: wanted at most {when(horizon)}, where the design ends, got {when(times[-1])}; "
            "seedslib.design.stationary makes it go on"
        )
    place = clock.rows(times)[: len(wanted)]
    missed = place < 0
    if missed.any():
        raise ValueError(
            f"times: wanted all measurement times of the design, {when(wanted[missed][0])} is not "
            "among them"
        )
    index = np.full(len(times), -1)
    index[place] = np.arange(len(wanted))
    for j in np.flatnonzero(index < 0):
        if not np.isnan(y[j]).all():
            raise ValueError(
                f"measurements: wanted NaN at {when(times[j])}, which is no measurement time of "
                "the design"
            )
    return index


def warn_of_mended(raised: int) -> None:
    """Tell the caller of a run or a design of covariances that had to be mended, if any."""
    if raised:
        warnings.warn(
            f"covariances: eigenvalues of {raised} were raised to 1e-12 of their scale",
            stacklevel=outside(),
        )


def freeze(part: object) -> None:
    """Make an array, or the arrays in a tuple, read-only: a designed filter does not change."""
    if isinstance(part, np.ndarray):
        part.flags.writeable = False
    elif isinstance(part, tuple):
        for piece in part:
            freeze(piece)
