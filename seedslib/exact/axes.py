"""Evenly spaced axes, the place of a value between their nodes, and multilinear tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Axis:
    """Evenly spaced nodes.

    Parameters
    ----------
    low, high : float
        First and last node.
    count : int
        Number of nodes, at least 2.

    Raises
    ------
    TypeError, ValueError
        A count that is no whole number or too small, ends that are not finite or not in order.
    """

    low: float
    high: float
    count: int

    def __post_init__(self):
        if isinstance(self.count, bool) or not isinstance(self.count, int | np.integer):
            raise TypeError(f"count: wanted a whole number, got {self.count!r}")
        if self.count < 2:
            raise ValueError(f"count: wanted at least 2, got {self.count}")
        try:
            low, high = float(self.low), float(self.high)
        except (TypeError, ValueError):
            raise TypeError(
                f"low, high: wanted numbers, got {self.low!r} and {self.high!r}"
            ) from None
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"low, high: wanted finite numbers in order, got {low:g}, {high:g}")
        for name, value in (("low", low), ("high", high), ("count", int(self.count))):
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, name: str, given) -> Axis:
        """Axis from itself or from (low, high, count); `name` is the argument's, for messages."""
        if isinstance(given, cls):
            return given
        try:
            low, high, count = given
        except (TypeError, ValueError):
            raise TypeError(
                f"{name}: wanted an Axis or (low, high, count), got {given!r}"
            ) from None
        try:
            return cls(low, high, count)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{name}: {error}") from None

    @cached_property
    def nodes(self) -> np.ndarray:
        """The nodes, shape (count,)."""
        return np.linspace(self.low, self.high, self.count)

    @property
    def step(self) -> float:
        """Distance between nodes."""
        return (self.high - self.low) / (self.count - 1)

    @cached_property
    def weights(self) -> np.ndarray:
        """Weights of the trapezoid rule, shape (count,)."""
        weights = np.full(self.count, self.step)
        weights[[0, -1]] *= 0.5
        return weights

    def place(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Number of the node below each value and the share of the node above it.

        A value outside is taken to the nearest end: shares outside of [0, 1] would be negative
        masses.
        """
        position = (np.clip(values, self.low, self.high) - self.low) * (1.0 / self.step)
        index = np.minimum(position.astype(np.intp), self.count - 2)
        return index, np.minimum(position - index, 1.0)

    def __str__(self) -> str:
        return f"{self.count} nodes from {self.low:g} to {self.high:g}"


def as_axes(name: str, given, size: int) -> tuple[Axis, ...]:
    """Tuple of axes from one or several of them, each an Axis or (low, high, count).

    Raises
    ------
    TypeError, ValueError
        Something that is no axis, or another number of them.
    """
    if isinstance(given, Axis) or all(np.isscalar(part) for part in given):
        given = [given]
    axes = tuple(Axis.of(name, axis) for axis in given)
    if len(axes) != size:
        raise ValueError(f"{name}: wanted {size} axes, got {len(axes)}")
    return axes


def interpolate(
    table: np.ndarray, axes: Sequence[Axis], points: Sequence[np.ndarray]
) -> np.ndarray:
    """Multilinear interpolation in a table, constant beyond its ends.

    Parameters
    ----------
    table : ndarray, shape (p, count of each axis...)
    axes : sequence of Axis
    points : sequence of ndarray, one per axis, shapes that broadcast to (*batch)

    Returns
    -------
    ndarray, shape (p, *batch)
    """
    flat = table.reshape(len(table), -1)
    # numbers and weights of the corners of the cell around each point, doubled axis by axis
    corners = [(0, None)]
    for axis, point in zip(axes, points, strict=True):
        index, share = axis.place(np.asarray(point, dtype=float))
        below = 1.0 - share
        corners = [
            (number * axis.count + (index + up), part if weight is None else weight * part)
            for number, weight in corners
            for up, part in ((0, below), (1, share))
        ]
    number, weight = corners[0]
    result = flat[:, number] * (1.0 if weight is None else weight)
    for number, weight in corners[1:]:
        result += flat[:, number] * weight
    return result
