"""Nodes that are not evenly spaced, with the weights of their quadrature rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from seedslib.base.checks import as_real, as_shape
from seedslib.base.tables import Axis, AxisLike, as_axes


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

    Raises
    ------
    TypeError, ValueError
        Nodes that do not increase, weights that are not positive, other shapes.
    """

    nodes: Any
    weights: Any = None

    def __post_init__(self) -> None:
        nodes = as_real("nodes", self.nodes)
        if nodes.ndim != 1 or len(nodes) < 2 or not (np.diff(nodes) > 0).all():
            raise ValueError("nodes: wanted two or more increasing numbers, got others")
        gaps = np.diff(nodes, prepend=nodes[0], append=nodes[-1])
        weights = 0.5 * (gaps[1:] + gaps[:-1])
        if self.weights is not None:
            weights = as_shape("weights", as_real("weights", self.weights), nodes.shape)
        if not (weights > 0).all():
            raise ValueError(f"weights: wanted positive numbers, got {weights.min():g}")
        vars(self).update(nodes=nodes, weights=weights)

    @property
    def count(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def low(self) -> float:
        """First node."""
        return float(self.nodes[0])

    @property
    def high(self) -> float:
        """Last node."""
        return float(self.nodes[-1])

    def place(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `Axis.place`."""
        position = np.interp(values, self.nodes, np.arange(float(self.count)))
        index = np.minimum(position, self.count - 2).astype(np.intp)
        return index, position - index

    def __str__(self) -> str:
        return f"{self.count} nodes from {self.low:g} to {self.high:g}"


NodesLike = Nodes | AxisLike
Grid = NodesLike | Sequence[NodesLike]
"""Nodes of a state, evenly spaced or not; and of several components."""


def as_grids(name: str, given: object, size: int) -> tuple[Axis | Nodes, ...]:
    """Tuple of nodes for each component from one or several of them; errors as `as_axes`."""
    parts = [given] if isinstance(given, Nodes) or np.isscalar(given) else given
    if isinstance(parts, Axis) or not any(isinstance(part, Nodes) for part in parts):
        return as_axes(name, parts, size)
    if len(parts) != size:
        raise ValueError(f"{name}: wanted {size} axes, got {len(parts)}")
    return tuple(p if isinstance(p, Nodes) else Axis.of(name, p) for p in parts)
