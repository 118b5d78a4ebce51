"""When a sensor is there, from the command line: probabilities, and times for each component."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.base.clock import Clock, when
from seedslib.commands.words import as_time_grid


def as_availability(text: str) -> float | np.ndarray:
    """Probabilities that components arrive, from ``0.9`` or, one for each, ``0.9,1``.

    Raises
    ------
    ValueError
        Something that is no list of numbers from 0 to 1.
    """
    try:
        found = np.array([float(part) for part in text.split(",")])
    except ValueError:
        found = np.array([np.nan])
    if not ((found >= 0) & (found <= 1)).all():
        raise ValueError(
            "availability: wanted a probability such as 0.9, or one for each component as in "
            f"0.9,1; got {text!r}"
        )
    return float(found[0]) if len(found) == 1 else found


def as_schedule(texts: list[str], times: Any, system: Any) -> np.ndarray:
    """Mask (K+1, m) of what is read, from times for all components or ``y2=0:10:5`` for some.

    Parameters
    ----------
    texts : list of str
        Times as `as_time_grid` takes them, alone or after the name of a component and ``=``:
        y1, y2, ... or `indicator`. A component without is read at all times.
    times : array_like, shape (K+1,)
        Measurement times of the design.
    system : object

    Raises
    ------
    ValueError
        No such component, one of them twice, a time that is no measurement time.
    """
    names = [f"y{i}" for i in range(1, system.measurement_size + 1)]
    names += ["indicator"] * (system.indicators > 0)
    mask, given = np.ones((len(times), len(names)), dtype=bool), set()
    for text in texts:
        name, named, grid = text.rpartition("=")
        chosen = [name] if named else names
        if not set(chosen) <= set(names) or given & set(chosen):
            raise ValueError(
                f"measured: wanted times for all, or once for some of {', '.join(names)}, as in "
                f"{names[0]}=0:10:2; got {' '.join(texts)!r}"
            )
        given |= set(chosen)
        try:
            wanted = as_time_grid(grid)
        except ValueError as error:
            raise ValueError(f"measured: {error}") from None
        rows = Clock(wanted).rows(times)
        if (rows < 0).any():
            raise ValueError(
                f"measured: wanted measurement times of the design, got {when(wanted[rows < 0][0])}"
            )
        for i in (names.index(each) for each in chosen):
            mask[:, i] = False
            mask[rows, i] = True
    return mask
