"""Sensors that a filter of means and covariances cannot use: uncorrelated with the state."""

from __future__ import annotations

import warnings
from itertools import product
from typing import Any

import numpy as np

from seedslib.models.kinds import AnySystem

TIMES = (0.0, 0.7, 1.0, 10.0, 1e3)
"""Where it is looked; a sensor may be switched off for a while."""

PLACES = (0.0, 0.37, -0.61, 1.53, -2.29)
"""Means in deviations from that of the initial law, each component in an order of its own."""

DIFFUSE = 1.0, 1e70, 1e140, 1e-70, 1e-140
"""Deviations of components without a law; the first is that of those that are known."""

NOTHING = 1e-14
"""A correlation below this is rounding."""


def warn_blind(sensor: Any, system: AnySystem) -> None:
    """Warn of components of a measurement that no state is correlated with, wherever it is.

    Parameters
    ----------
    sensor : callable
        ``sensor(t, mean, cov) -> Moments``.
    system : object
        With `mean0` and `cov0`, which say where to look.

    Warns
    -----
    UserWarning
    """
    known, blind = np.sqrt(np.diagonal(system.cov0)), np.array(True)
    # nobody knows in which units a diffuse component is large
    units = DIFFUSE if getattr(system, "diffuse", ()) else DIFFUSE[:1]
    with np.errstate(all="ignore"):
        for unit, t, turn in product(units, TIMES, range(len(PLACES))):
            spread = np.where(known > 0, known, unit)
            cov = np.diag(spread**2)
            place = np.array([PLACES[(turn + k) % len(PLACES)] for k in range(len(spread))])
            try:
                _, cross, square = sensor(t, system.mean0 + spread * place, cov)
            except LookupError:
                return  # matrices from a table, which need not have these times
            size = np.outer(spread, np.sqrt(np.abs(np.diagonal(square))))
            # what is not a number is no evidence
            blind = blind & ((np.abs(cross) <= NOTHING * size) & np.isfinite(size)).all(axis=0)
            if not blind.any():
                return
    for j in np.flatnonzero(blind):
        warnings.warn(
            f"sensor: y{j + 1} is uncorrelated with the state wherever that is, so it moves no "
            "estimate of this filter; a function of it may be correlated, as log y**2 is for "
            "y = exp(x) v",
            stacklevel=4,
        )
