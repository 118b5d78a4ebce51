"""Axes, the place of a value between their nodes, and multilinear tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.checks import as_count, as_real, brief


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

    def __post_init__(self) -> None:
        count = as_count("count", self.count, 2)
        low, high = (float(as_real(name, getattr(self, name), ())) for name in ("low", "high"))
        if not low < high:
            raise ValueError(f"low, high: wanted numbers in order, got {low:g} and {high:g}")
        vars(self).update(low=low, high=high, count=count)

    @classmethod
    def of(cls, name: str, given: object) -> Axis:
        """Axis from itself or from (low, high, count); `name` is the argument's, for messages."""
        if isinstance(given, cls):
            return given
        try:
            low, high, count = given
        except (TypeError, ValueError):
            raise TypeError(
                f"{name}: wanted an Axis or (low, high, count), got {brief(given)}"
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
    def _top(self) -> float:
        return math.nextafter(self.count - 1, 0)

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
        position = (np.maximum(values, self.low) - self.low) * (1.0 / self.step)
        # just below the last node: its cell is the last one, and its share one but for rounding
        position = np.minimum(position, self._top)
        index = position.astype(np.intp)
        return index, position - index

    def __str__(self) -> str:
        return f"{self.count} nodes from {self.low:g} to {self.high:g}"


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes of a quadrature rule, anyhow spaced.

    A rule that is even in another variable u has the nodes x(u) and the weights h x'(u).

    Parameters
    ----------
    nodes : array_like, shape (S,)
        Increasing.
    weights : array_like, shape (S,), optional
        Positive; those of the trapezoid rule by default.

    Attributes
    ----------
    count : int
        Number of nodes.
    low, high : float
        First and last node.

    Raises
    ------
    TypeError, ValueError
        Nodes that do not increase, weights that are not positive, other shapes.
    """

    nodes: Any
    weights: Any = None
    count: int = field(init=False)
    low: float = field(init=False)
    high: float = field(init=False)

    def __post_init__(self) -> None:
        nodes = as_real("nodes", self.nodes)
        if nodes.ndim != 1 or len(nodes) < 2 or not (np.diff(nodes) > 0).all():
            raise ValueError("nodes: wanted two or more increasing numbers, got others")
        gaps = np.diff(nodes, prepend=nodes[0], append=nodes[-1])
        weights = 0.5 * (gaps[1:] + gaps[:-1])
        if self.weights is not None:
            weights = as_real("weights", self.weights, nodes.shape)
        if not (weights > 0).all():
            raise ValueError(f"weights: wanted positive numbers, got {weights.min():g}")
        vars(self).update(nodes=nodes, weights=weights, count=len(nodes))
        vars(self).update(low=float(nodes[0]), high=float(nodes[-1]))

    def place(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `Axis.place`."""
        position = np.interp(values, self.nodes, np.arange(float(self.count)))
        index = np.minimum(position, self.count - 2).astype(np.intp)
        return index, position - index

    def __str__(self) -> str:
        return f"{self.count} nodes from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Labels:
    """Whole numbers from 0 as an axis of a table: nothing lies between them.

    Attributes
    ----------
    count : int
    """

    count: int

    @property
    def nodes(self) -> np.ndarray:
        """The numbers, shape (count,)."""
        return np.arange(float(self.count))

    @property
    def weights(self) -> np.ndarray:
        """Weights of a sum over them, shape (count,)."""
        return np.ones(self.count)

    def place(self, values: np.ndarray) -> tuple[np.ndarray, None]:
        """The numbers themselves; there is no node above."""
        return np.asarray(values).astype(np.intp), None

    def __str__(self) -> str:
        return f"{self.count} labels"


class Located(NamedTuple):
    """Where points lie in a table.

    Attributes
    ----------
    index : ndarray of int, shape (*batch)
        Number of the lowest corner of the cell around each point, in the flat table.
    strides : tuple of int
        From a node to the next one, for each axis that is no `Labels`.
    shares : tuple of ndarray
        Shares of the upper nodes on these axes.
    """

    index: np.ndarray
    strides: tuple[int, ...]
    shares: tuple[np.ndarray, ...]

    def linear(self, flat: np.ndarray) -> np.ndarray:
        """Multilinear interpolation in a flat table, shape (*batch)."""
        values = [flat.take(self.index + o) if o else flat.take(self.index) for o in self.offsets]
        for share in reversed(self.shares):
            # the last axis is the fastest: its two nodes are neighbours in the list
            values = [a + share * (b - a) for a, b in zip(values[::2], values[1::2], strict=True)]
        return values[0]

    def rows(self, table: np.ndarray) -> np.ndarray:
        """`linear` in each of p tables, shape (p, count of each axis...): (p, *batch)."""
        values = [self.linear(row.reshape(-1)) for row in table]
        return values[0][None] if len(values) == 1 else np.stack(values)

    def nearest(self, flat: np.ndarray) -> np.ndarray:
        """Entry at the nearest node, the lower one of two equally near ones, shape (*batch)."""
        index = self.index
        for stride, share in zip(self.strides, self.shares, strict=True):
            index = index + stride * (share > 0.5)
        return flat.take(index)

    @property
    def offsets(self) -> list[int]:
        """From the lowest corner to each corner of the cell."""
        offsets = [0]
        for stride in self.strides:
            offsets = [offset + up for offset in offsets for up in (0, stride)]
        return offsets


def locate(axes: Sequence[Axis | Labels], points: Sequence[np.ndarray]) -> Located:
    """Place of points in a table over the axes; beyond the ends of an axis, at the end.

    Parameters
    ----------
    axes : sequence of Axis or Labels
    points : sequence of ndarray, one per axis, shapes that broadcast to (*batch)
    """
    index, strides, shares, stride = np.intp(0), [], [], 1
    for axis, point in zip(reversed(axes), reversed(points), strict=True):
        part, share = axis.place(point)
        index = index + (part * stride if stride > 1 else part)
        if share is not None:
            strides.append(stride)
            shares.append(share)
        stride *= axis.count
    return Located(index, tuple(reversed(strides)), tuple(reversed(shares)))


def mesh(axes: Sequence[Axis | Labels]) -> np.ndarray:
    """Points of a product of axes, (size, points), the last axis the fastest; one for none."""
    count = math.prod(axis.count for axis in axes)
    grid = np.meshgrid(*(axis.nodes for axis in axes), indexing="ij")
    return np.array(grid, dtype=float).reshape(len(axes), count)


AxisLike = Axis | tuple[float, float, int]
AxesLike = AxisLike | Sequence[AxisLike]
NodesLike = Nodes | AxisLike
Grid = NodesLike | Sequence[NodesLike]
"""Nodes of a component, or what makes evenly spaced ones; and those of several components."""


def as_axes(name: str, given: Grid, size: int) -> tuple[Axis, ...]:
    """Tuple of axes from one or several of them, each an Axis or (low, high, count).

    Raises
    ------
    TypeError, ValueError
        Something that is no axis, or another number of them.
    """
    axes = as_grids(name, given, size)
    for axis in axes:
        if not isinstance(axis, Axis):
            raise TypeError(f"{name}: wanted even axes, got Nodes")
    return axes


def as_grids(name: str, given: Grid, size: int) -> tuple[Any, ...]:
    """As `as_axes`, where nodes need not be evenly spaced."""
    if isinstance(given, Axis | Nodes) or np.ndim(given) == 0 or all(map(np.isscalar, given)):
        given = [given]
    axes = tuple(part if isinstance(part, Nodes) else Axis.of(name, part) for part in given)
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

    Raises
    ------
    TypeError, ValueError
        No numbers, or other shapes.
    """
    axes = tuple(axes)
    table = as_real("table", table, (-1, *(axis.count for axis in axes)), infinite=True)
    given = [as_real(f"points[{k}]", point) for k, point in enumerate(points)]
    if len(given) != len(axes):
        raise ValueError(f"points: wanted one for each of {len(axes)} axes, got {len(given)}")
    return locate(axes, given).rows(table)
