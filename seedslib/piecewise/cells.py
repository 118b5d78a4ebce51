"""Partitions of the leading components, and the regions of branches that are cut along them.

A partition is made of the intervals of a line or of the convex polygons into which lines cut a
plane. Both answer the same questions about regions, one for each branch and the branch last: the
region before anything was measured (`whole`), its `image` under an affine map, its pieces in the
cells (`split`), and the `moments` of a Gaussian distribution inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_real
from seedslib.gaussian import RegionMoments, interval, pad_regions, polygon

ROUNDING = 16.0 * np.finfo(float).eps  # relative distance that only rounding can have made
SLIVER = 1e-15  # area of a piece, relative to the region, that only rounding can have made
REACH = 40.0  # standard deviations of the prior (a mass of 1e-349) where plane regions end

Pieces = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Intervals:
    """The half-open cells ``edges[i] <= x < edges[i + 1]`` of a line; regions are (2, B).

    Parameters
    ----------
    edges : array_like, shape (n + 1,)
        Strictly increasing, from ``-inf`` to ``inf``.
    """

    edges: np.ndarray

    size = 1  # number of restricted components

    def __post_init__(self) -> None:
        edges = as_real("regions", self.edges, infinite=True)
        whole = edges.ndim == 1 and edges.size > 1 and (edges[[0, -1]] == [-np.inf, np.inf]).all()
        if not whole or not (np.diff(edges) > 0.0).all():
            raise ValueError(f"regions: wanted edges increasing from -inf to inf, got {edges}")
        object.__setattr__(self, "edges", edges)

    def __len__(self) -> int:
        return self.edges.size - 1

    def locate(self, points: np.ndarray) -> np.ndarray:
        """Index (*batch) of the cell of each point (1, *batch)."""
        return np.searchsorted(self.edges[1:-1], points[0], side="right")

    def whole(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """The line as one region; the prior `mean` and `cov` are not used."""
        return np.array([[-np.inf], [np.inf]])

    def image(self, regions: np.ndarray, slope: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """Regions mapped by ``s -> shift + slope s``; slope (1, 1, B), not zero; shift (1, B)."""
        return np.sort(shift + slope[0] * regions, axis=0)

    def split(self, regions: np.ndarray, slope: np.ndarray, shift: np.ndarray) -> Pieces:
        """Cut every region along the cells of ``shift + slope s``; the slope may be zero.

        Returns
        -------
        parent, cell : ndarray of int, shape (C,)
            The branch that each piece comes from, and the cell that it lies in.
        pieces : regions
        """
        slope, shift, (lower, upper) = slope[0, 0, :, None], shift[0, :, None], regions[..., None]
        edges = np.stack([self.edges[:-1], self.edges[1:]])[:, None]
        size = np.where(np.isfinite(edges), np.abs(edges), 0.0) + np.abs(shift)
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (edges - shift) / slope
            rounding = ROUNDING * size / np.abs(slope)
            for bound in (lower, upper):  # an edge within rounding of an end does not cut
                ends = np.where(np.abs(ends - bound) < rounding, bound, ends)
        # a map without slope takes the whole region into the cell of its shift
        ends = np.where(np.isnan(ends), -np.inf, ends)
        low, high = np.maximum(ends.min(axis=0), lower), np.minimum(ends.max(axis=0), upper)
        parent, cell = np.nonzero(high > low)
        return parent, cell, np.stack([low[parent, cell], high[parent, cell]])

    def moments(self, regions, branch, mean, cov) -> RegionMoments:
        """Conditioned moments of pairs (branch, distribution); mean (1, F), cov (1, 1, F)."""
        return interval(mean[0], cov[0, 0], *regions[:, branch])


@dataclass(frozen=True, eq=False)
class Polygons:
    """Convex cells into which p lines cut a plane; regions are polygons, (V, 2, B).

    A cell is numbered by its sides, below a line 0 and above it 1, as by a binary number with
    the first line first; of the 2^p numbers some may belong to no cell. A point on a line is
    below it. Made by `line_cells`.
    """

    normals: np.ndarray  # (2, p)
    offsets: np.ndarray  # (p,)

    size = 2

    def __len__(self) -> int:
        return 2 ** len(self.offsets)

    def locate(self, points: np.ndarray) -> np.ndarray:
        """Index (*batch) of the cell of each point (2, *batch)."""
        above = np.einsum("ij,i...->...j", self.normals, points) > self.offsets
        return above @ (2 ** np.arange(len(self.offsets))[::-1])

    def whole(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """A rectangle that holds the prior, so that all regions are bounded."""
        deviation = np.sqrt(cov.diagonal()[:2])
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return (mean[:2] + REACH * np.where(deviation > 0, deviation, 1.0) * corners)[..., None]

    def image(self, regions: np.ndarray, slope: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """Regions mapped by ``s -> shift + slope s``; slope (2, 2, B) regular, shift (2, B)."""
        moved = shift + np.einsum("ijb,vjb->vib", slope, regions)
        mirrored = np.linalg.det(np.moveaxis(slope, 2, 0)) < 0.0
        return np.where(mirrored, moved[::-1], moved)  # counter-clockwise

    def split(self, regions: np.ndarray, slope: np.ndarray, shift: np.ndarray) -> Pieces:
        """Cut every region along the cells of ``shift + slope s``; see `Intervals.split`."""
        parent, cell, pieces = [], [], []
        for b, vertices in enumerate(np.moveaxis(regions, 2, 0)):
            parts = [(0, vertices)]
            for normal, offset in zip(self.normals.T, self.offsets, strict=True):
                size = np.abs(normal) @ np.abs(shift[:, b]) + abs(offset)
                line = slope[:, :, b].T @ normal, offset - normal @ shift[:, b], size
                halves = [(sides, _cut(part, *line)) for sides, part in parts]
                parts = [(2 * sides + i, pair[i]) for sides, pair in halves for i in (0, 1)]
            parts = [(i, part) for i, part in parts if _area(part) > SLIVER * _area(vertices)]
            parent += [b] * len(parts)
            cell += [i for i, _ in parts]
            pieces += [part for _, part in parts]
        return np.array(parent, int), np.array(cell, int), pad_regions(pieces)

    def moments(self, regions, branch, mean, cov) -> RegionMoments:
        """Conditioned moments of pairs (branch, distribution); mean (2, F), cov (2, 2, F)."""
        return polygon(mean, cov, regions[:, :, branch])


def line_cells(normals: ArrayLike, offsets: ArrayLike) -> Polygons:
    """Cells into which lines cut the plane, ``normals[:, j] @ x = offsets[j]``.

    Parameters
    ----------
    normals : array_like, shape (2, p)
    offsets : array_like, shape (p,)
    """
    normals = as_real("normals", normals, (2, -1))
    if not normals.any(axis=0).all():
        raise ValueError("normals: wanted nonzero normals, got a zero column")
    return Polygons(normals, as_real("offsets", offsets, normals.shape[1:]))


def _area(vertices: np.ndarray) -> float:
    """Area of a polygon (V, 2), positive counter-clockwise."""
    x, y = (vertices[1:] - vertices[:1]).T
    return 0.5 * float(x[:-1] @ y[1:] - x[1:] @ y[:-1])


def _cut(vertices, normal, offset: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Parts of a convex polygon where ``normal . x <= offset``, and on the other side.

    A vertex within rounding of the line, whose offset is the difference of numbers of this size,
    counts as lying on it, so that a polygon cut along one of its own edges leaves no sliver.
    """
    value = vertices @ normal - offset
    value[np.abs(value) <= ROUNDING * (np.abs(vertices) @ np.abs(normal) + size)] = 0.0
    if (value <= 0.0).all():
        return vertices, vertices[:1]
    after = np.roll(value, -1)
    crosses = value * after < 0.0
    share = (value / np.where(crosses, value - after, 1.0))[:, None]
    crossings = vertices + share * (np.roll(vertices, -1, axis=0) - vertices)
    points = np.stack([vertices, crossings], axis=1).reshape(-1, 2)
    below, above = (np.stack([side, crosses], axis=1).ravel() for side in (value <= 0, value >= 0))
    return points[below], points[above]
