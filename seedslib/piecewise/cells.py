"""Partitions of the leading one or two components: intervals of a line, convex cells of a plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from seedslib.base.checks import as_bound, as_real, as_shape
from seedslib.piecewise.clipping import HalfPlanes, area, box, clip_all, half_planes

_CONVEX = 1e-12  # relative depth of a dent that counts as rounding
_TILING = 1e-9  # relative area that may be missing or covered twice


@dataclass(frozen=True, eq=False)
class Intervals:
    """Partition of a line into the half-open cells ``edges[i] <= x < edges[i + 1]``.

    Parameters
    ----------
    edges : array_like, shape (n + 1,)
        Strictly increasing, from ``-inf`` to ``inf``.

    Raises
    ------
    TypeError, ValueError
        Edges that are not real numbers, not increasing, or do not cover the line.
    """

    edges: np.ndarray

    size = 1  # number of restricted components

    def __post_init__(self) -> None:
        edges = as_bound("regions", self.edges)
        if edges.ndim != 1 or edges.size < 2:
            raise ValueError(f"regions: wanted at least two edges in a row, got {edges.shape}")
        wrong = np.flatnonzero(np.diff(edges) <= 0.0)
        if wrong.size:
            i = int(wrong[0])
            raise ValueError(
                f"regions: wanted strictly increasing edges, got {edges[i]:g} then "
                f"{edges[i + 1]:g} at index {i}"
            )
        if edges[0] != -np.inf or edges[-1] != np.inf:
            raise ValueError(
                "regions: wanted cells that cover the line from -inf to inf, got edges from "
                f"{edges[0]:g} to {edges[-1]:g}"
            )
        edges.flags.writeable = False
        object.__setattr__(self, "edges", edges)

    @classmethod
    def from_pairs(cls, pairs: Sequence[tuple[float, float]]) -> Intervals:
        """Partition from (lower, upper) pairs, in order.

        Raises
        ------
        ValueError
            Pairs that are out of order, overlap, or leave a gap.
        """
        pairs = np.asarray(pairs, dtype=float)
        if pairs.ndim != 2 or pairs.shape[1] != 2 or not len(pairs):
            raise ValueError(f"regions: wanted pairs (lower, upper), got shape {pairs.shape}")
        for i in range(len(pairs) - 1):
            right, left = pairs[i, 1], pairs[i + 1, 0]
            if right != left:
                what = "out of order" if pairs[i + 1, 1] <= pairs[i, 0] else "overlapping"
                what = "a gap between" if right < left else what
                raise ValueError(
                    f"regions: wanted adjoining cells, got {what} cells {i} and {i + 1}: "
                    f"({pairs[i, 0]:g}, {right:g}) and ({left:g}, {pairs[i + 1, 1]:g})"
                )
        return cls(np.concatenate([pairs[:1, 0], pairs[:, 1]]))

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.edges.size - 1

    @property
    def lower(self) -> np.ndarray:
        """Lower ends, shape (n,)."""
        return self.edges[:-1]

    @property
    def upper(self) -> np.ndarray:
        """Upper ends, shape (n,)."""
        return self.edges[1:]

    def locate(self, points: np.ndarray) -> np.ndarray:
        """Index of the cell of each point; `points` of shape (1, *batch), result (*batch)."""
        return np.searchsorted(self.edges[1:-1], points[0], side="right")


@dataclass(frozen=True, eq=False)
class Polygons:
    """Partition of a plane into convex cells.

    Parameters
    ----------
    cells : sequence
        Each cell is `HalfPlanes` or, where it is bounded, the table of its vertices, shape
        (V, 2), in either orientation.

    Raises
    ------
    TypeError, ValueError
        Cells that are not real numbers, not convex, empty, overlapping, or do not cover the plane.
    """

    cells: tuple[HalfPlanes, ...]
    radius: float = field(init=False)

    size = 2

    def __post_init__(self) -> None:
        if not len(self.cells):
            raise ValueError("regions: wanted at least one cell, got none")
        cells = tuple(_as_half_planes(f"regions[{i}]", cell) for i, cell in enumerate(self.cells))
        vars(self).update(cells=cells, radius=_extent(cells))
        self._check_tiling()

    @property
    def count(self) -> int:
        """Number of cells."""
        return len(self.cells)

    def locate(self, points: np.ndarray) -> np.ndarray:
        """Index of the cell of each point, the first one on a common edge.

        Parameters
        ----------
        points : ndarray, shape (2, *batch)

        Returns
        -------
        ndarray of int, shape (*batch)
        """
        beyond = (np.tensordot(c.normals.T, points, 1).T - c.offsets for c in self.cells)
        slack = np.stack([each.max(-1, initial=-np.inf) for each in beyond])
        # on a common edge the cell of the smallest index
        return np.argmin(np.maximum(slack, 0.0), axis=0).T

    def _check_tiling(self) -> None:
        square = box(np.zeros(2), np.full(2, self.radius))
        whole, pieces = area(square), [clip_all(square, cell) for cell in self.cells]
        for i, piece in enumerate(pieces):
            if area(piece) <= _TILING * whole * 1e-6:
                raise ValueError(f"regions: wanted cells of positive area, cell {i} is empty")
        for i, piece in enumerate(pieces):
            for j in range(i):
                common = area(clip_all(piece, self.cells[j]))
                if common > _TILING * min(area(piece), area(pieces[j])):
                    raise ValueError(
                        f"regions: wanted cells without overlap, cells {j} and {i} share an area"
                    )
        covered = sum(area(piece) for piece in pieces) / whole
        if covered < 1.0 - _TILING:
            raise ValueError(
                f"regions: wanted cells that cover the plane, got {1.0 - covered:.3g} of a large "
                "square uncovered"
            )


def as_cells(regions: object) -> Intervals | Polygons:
    """Partition from what a user passes: edges, (lower, upper) pairs, or a list of plane cells.

    Raises
    ------
    TypeError, ValueError
        As `Intervals` and `Polygons`.
    """
    if isinstance(regions, Intervals | Polygons):
        return regions
    try:
        array = np.asarray(regions, dtype=float)
    except (TypeError, ValueError):
        array = None  # cells with different numbers of vertices, or HalfPlanes
    if array is not None and array.ndim == 1:
        return Intervals(array)
    if array is not None and array.ndim == 2:
        return Intervals.from_pairs(array)
    if not isinstance(regions, Sequence | np.ndarray):
        raise TypeError(
            "regions: wanted edges, pairs (lower, upper), or a list of plane cells, got "
            f"{type(regions).__name__}"
        )
    return Polygons(tuple(regions))


def line_cells(normals: object, offsets: object) -> Polygons:
    """Cells into which the lines ``normals[:, j] . x = offsets[j]`` cut the plane.

    Parameters
    ----------
    normals : array_like, shape (2, p)
    offsets : array_like, shape (p,)

    Returns
    -------
    Polygons
        Cells ordered by their sides: below the first line before above it, and so on.
    """
    normals = as_shape("normals", normals, (2, -1))
    offsets = as_shape("offsets", offsets, (normals.shape[1],))
    found = [HalfPlanes(np.empty((2, 0)), np.empty(0))]
    square = box(np.zeros(2), np.full(2, _extent([HalfPlanes(normals, offsets)])))
    for normal, offset in zip(normals.T, offsets, strict=True):
        signed = [(n, c, sign) for n, c in found for sign in (1.0, -1.0)]
        sides = (HalfPlanes(np.c_[n, s * normal], np.append(c, s * offset)) for n, c, s in signed)
        found = [side for side in sides if area(clip_all(square, side)) > 1e-12 * area(square)]
    return Polygons(tuple(found))


def _as_half_planes(name: str, cell: object) -> HalfPlanes:
    if not isinstance(cell, HalfPlanes):
        vertices = as_shape(name, cell, (-1, 2)).T
        if vertices.shape[1] < 3 or area(vertices) == 0.0:
            raise ValueError(f"{name}: wanted at least three vertices that span an area")
        vertices = vertices if area(vertices) > 0.0 else vertices[:, ::-1]
        cell = half_planes(vertices)
        scale = np.abs(cell.normals).max() * np.abs(vertices).max()
        if (cell.normals.T @ vertices - cell.offsets[:, None]).max() > _CONVEX * scale:
            raise ValueError(f"{name}: wanted a convex cell; split it into convex ones")
    normals = as_real(f"{name}.normals", cell.normals, ndim=2)
    if normals.shape[0] != 2:
        raise ValueError(f"{name}.normals: wanted shape (2, any), got {normals.shape}")
    offsets = as_shape(f"{name}.offsets", cell.offsets, (normals.shape[1],))
    length = np.hypot(*normals)
    if (length == 0.0).any():
        raise ValueError(f"{name}.normals: wanted nonzero normals, got a zero column")
    return HalfPlanes(normals / length, offsets / length)


def _extent(cells: Sequence[HalfPlanes]) -> float:
    """Half-width of a square that holds every crossing of boundary lines, with room to spare."""
    normals = np.concatenate([cell.normals for cell in cells], axis=1)
    offsets = np.concatenate([cell.offsets for cell in cells])
    if not offsets.size:
        return 1.0
    reach = np.abs(offsets / np.hypot(*normals)).max()
    determinant = normals[0][:, None] * normals[1] - normals[1][:, None] * normals[0]
    i, j = np.nonzero(np.triu(np.abs(determinant) > 1e-9, 1))
    if i.size:
        d = determinant[i, j]
        x = (offsets[i] * normals[1, j] - offsets[j] * normals[1, i]) / d
        y = (normals[0, i] * offsets[j] - normals[0, j] * offsets[i]) / d
        reach = max(reach, np.abs(x).max(), np.abs(y).max())
    return 4.0 * reach + 1.0
