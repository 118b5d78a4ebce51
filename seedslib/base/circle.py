"""Components that lie on a circle: angles, phases, times of day."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from seedslib.base.checks import as_positive, brief, is_whole

Periods = tuple[tuple[int, float], ...]
"""Components that are circular, and their periods."""


def as_periods(name: str, value: Mapping[int, float] | None, size: int) -> Periods:
    """Circular components of a vector of this size; None means none.

    Raises
    ------
    TypeError, ValueError
        No mapping; a component that does not exist, a period that is not positive.
    """
    table = {} if value is None else value
    if not isinstance(table, Mapping):
        raise TypeError(
            f"{name}: wanted a mapping of components to their periods, such as {{0: 2 * pi}}, got "
            f"{brief(value)}"
        )
    for k in table:
        if not is_whole(k) or not 0 <= k < size:
            raise ValueError(f"{name}: wanted components from 0 to {size - 1}, got {k!r}")
    return tuple(sorted((int(k), as_positive(f"{name}[{k}]", v)) for k, v in table.items()))


def around(value: Any, centre: Any, period: float) -> Any:
    """The same value on a circle, within half a turn of another; recorded numbers too."""
    return value - period * np.floor((value - centre) / period + 0.5)


def nearest(y: Any, expected: Any, periods: Periods) -> Any:
    """Of all values that mean the same on the circle those nearest to what was expected.

    Parameters
    ----------
    y : array_like, shape (m, *batch)
        NaN stays NaN.
    expected : array_like, shape (m, *batch)
        With more axes where one measurement is compared with several expectations.
    periods : tuple
        From `as_periods`.
    """
    if not periods:
        return y
    y, expected = np.asarray(y, dtype=float), np.asarray(expected)
    y = np.broadcast_to(y, np.broadcast_shapes(y.shape, expected.shape)).copy()
    for k, period in periods:
        y[k] = around(y[k], expected[k], period)
    return y


def wrapped(y: np.ndarray, periods: Periods) -> np.ndarray:
    """Circular components between minus and plus half a period, as sensors report them."""
    for k, period in periods:
        y[k] = around(y[k], 0.0, period)
    return y
