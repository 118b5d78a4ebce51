"""Regions of branches: intervals or convex polygons that are mapped, split and weighed together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from seedslib.gaussian.intervals import interval
from seedslib.gaussian.polygons import pad_regions, polygon
from seedslib.gaussian.regions import RegionMoments
from seedslib.piecewise.cells import Intervals, Polygons
from seedslib.piecewise.clipping import area, box, clip, clip_all

PRIOR_REACH = 40.0  # standard deviations of the prior beyond which a plane region is cut off
SLIVER = 8.0 * np.finfo(float).eps  # relative width that only rounding can have made
AREA_SLIVER = 1e-15  # the same for areas, relative to the region that was split
_HALF_LOG_2PI = 0.5 * np.log(2.0 * np.pi)


@dataclass(frozen=True, eq=False)
class IntervalRegions:
    """Intervals ``lower[b] <= s < upper[b]``, one for each branch.

    Attributes
    ----------
    lower, upper : ndarray, shape (B,)
    """

    lower: np.ndarray
    upper: np.ndarray

    def take(self, index: np.ndarray) -> IntervalRegions:
        """The regions of some branches."""
        return IntervalRegions(self.lower[index], self.upper[index])

    def image(self, slope: np.ndarray, shift: np.ndarray) -> IntervalRegions:
        """Regions mapped by ``s -> shift + slope s``; slope (1, 1, B), not zero; shift (1, B)."""
        slope, shift = slope[0, 0], shift[0]
        ends = shift + slope * self.lower, shift + slope * self.upper
        return IntervalRegions(np.minimum(*ends), np.maximum(*ends))

    def split(
        self, cells: Intervals, slope: np.ndarray, shift: np.ndarray,
        target: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, IntervalRegions]:  # fmt: skip
        """Cut every region along the cells of ``shift + slope s``.

        Parameters
        ----------
        cells : Intervals
        slope, shift : ndarray, shapes (1, 1, B) and (1, B)
            Where a point s of branch b lies now; the slope may be zero.
        target : ndarray of int, shape (B,), optional
            The cell that is known to hold the whole region; negative where none is.

        Returns
        -------
        parent, cell : ndarray of int, shape (C,)
            The branch that each piece comes from and the cell that it lies in.
        pieces : IntervalRegions
        """
        slope, shift = slope[0, 0][:, None], shift[0][:, None]
        flat = slope == 0.0
        divisor = np.where(flat, 1.0, slope)
        ends = (cells.lower - shift) / divisor, (cells.upper - shift) / divisor
        low = np.maximum(np.minimum(*ends), self.lower[:, None])
        high = np.minimum(np.maximum(*ends), self.upper[:, None])
        inside = (cells.lower <= shift) & (shift < cells.upper)
        low = np.where(flat, self.lower[:, None], low)
        high = np.where(flat, np.where(inside, self.upper[:, None], low), high)
        if target is not None:
            known, here = target[:, None] >= 0, target[:, None] == np.arange(cells.count)
            low = np.where(known, self.lower[:, None], low)
            high = np.where(known, np.where(here, self.upper[:, None], low), high)
        finite = np.isfinite(low) & np.isfinite(high)
        scale = np.where(finite, np.maximum(np.abs(low), np.abs(high)), 0.0)
        parent, cell = np.nonzero(high > low + SLIVER * scale)
        return parent, cell, IntervalRegions(low[parent, cell], high[parent, cell])

    def log_mass_bound(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Cheap upper bound of the logarithm of the mass of each region.

        With d the distance of the mean from the region in standard deviations and w its width in
        the same unit: ``P <= exp(-d^2 / 2) min(1 or, for d > 0, 1/2, w / sqrt(2 pi))``.

        Parameters
        ----------
        mean : ndarray, shape (1, B, N)
        cov : ndarray, shape (1, 1, B, 1 or N)
        """
        mean, sigma = mean[0], np.sqrt(cov[0, 0])
        lower, upper = self.lower[:, None], self.upper[:, None]
        gap = np.maximum(np.maximum(lower - mean, mean - upper), 0.0)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            distance = np.where(gap > 0.0, gap / sigma, 0.0)
            narrow = np.log((upper - lower) / sigma) - _HALF_LOG_2PI
            wide = np.where(gap > 0.0, -np.log(2.0), 0.0)
            return np.minimum(wide, narrow) - 0.5 * distance * distance

    def moments(self, branch: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> RegionMoments:
        """Conditioned moments of pairs (branch, law); mean (1, F), cov (1, 1, F)."""
        return interval(mean[0], cov[0, 0], self.lower[branch], self.upper[branch])


@dataclass(frozen=True, eq=False)
class PolygonRegions:
    """Convex polygons, one for each branch.

    Attributes
    ----------
    vertices : tuple of ndarray, shape (2, N_b)
        Counter-clockwise.
    """

    vertices: tuple[np.ndarray, ...]

    def take(self, index: np.ndarray) -> PolygonRegions:
        """The regions of some branches."""
        return PolygonRegions(tuple(self.vertices[i] for i in index))

    def image(self, slope: np.ndarray, shift: np.ndarray) -> PolygonRegions:
        """Regions mapped by ``s -> shift + slope s``; slope (2, 2, B) regular, shift (2, B)."""
        mapped = []
        for b, vertices in enumerate(self.vertices):
            moved = shift[:, b, None] + slope[:, :, b] @ vertices
            mapped.append(moved if np.linalg.det(slope[:, :, b]) > 0.0 else moved[:, ::-1])
        return PolygonRegions(tuple(mapped))

    def split(
        self, cells: Polygons, slope: np.ndarray, shift: np.ndarray,
        target: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, PolygonRegions]:  # fmt: skip
        """Cut every region along the cells of ``shift + slope s``; `target` is not used."""
        parent, index, pieces = [], [], []
        for b, vertices in enumerate(self.vertices):
            whole = area(vertices)
            for i, cell in enumerate(cells.cells):
                normals = slope[:, :, b].T @ cell.normals
                offsets = cell.offsets - shift[:, b] @ cell.normals
                piece = vertices
                for normal, offset, outward in zip(normals.T, offsets, cell.normals.T, strict=True):
                    if normal.any():
                        piece = clip(piece, normal, offset)
                    elif not _on_this_side(offset, outward):
                        piece = piece[:, :0]
                if area(piece) > AREA_SLIVER * whole:
                    parent.append(b)
                    index.append(i)
                    pieces.append(piece)
        return np.array(parent, int), np.array(index, int), PolygonRegions(tuple(pieces))

    def log_mass_bound(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Cheap upper bound of the logarithm of the mass, shape (B, N).

        The distance d is that to the farthest violated edge line:
        ``P <= exp(-d^2 / 2) min(1 or, for d > 0, 1/2, area / (2 pi sqrt(det)))``.
        """
        bound = np.empty(mean.shape[1:])
        for b, vertices in enumerate(self.vertices):
            edge = np.roll(vertices, -1, axis=1) - vertices
            normal = np.array([edge[1], -edge[0]])
            gap = np.einsum("ie,in->en", normal, mean[:, b]) - np.sum(normal * vertices, 0)[:, None]
            spread = np.einsum("ie,ijn,je->en", normal, cov[:, :, b], normal)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                distance = np.where(gap > 0.0, gap / np.sqrt(spread), 0.0).max(axis=0)
                determinant = cov[0, 0, b] * cov[1, 1, b] - cov[0, 1, b] ** 2
                density = area(vertices) / np.sqrt(np.maximum(determinant, 0.0))
                narrow = np.log(density) - 2.0 * _HALF_LOG_2PI
            wide = np.where(distance > 0.0, -np.log(2.0), 0.0)
            bound[b] = np.minimum(wide, narrow) - 0.5 * distance * distance
        return bound

    def moments(self, branch: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> RegionMoments:
        """Conditioned moments of pairs (branch, law); mean (2, F), cov (2, 2, F)."""
        vertices = pad_regions([item.T for item in self.vertices])
        return polygon(mean, cov, vertices[:, :, branch])


def prior_regions(
    cells: Intervals | Polygons, mean: np.ndarray, cov: np.ndarray
) -> tuple[Any, ...]:
    """Region of every cell before anything was measured, and which cells have one.

    Plane cells are cut off 40 standard deviations from the prior mean, where the prior mass is
    1e-349: polygons are then bounded, and so are all their images.
    """
    if isinstance(cells, Intervals):
        return np.arange(cells.count), IntervalRegions(cells.lower, cells.upper)
    spread = np.sqrt(np.diag(cov)[:2])
    reach = PRIOR_REACH * np.where(spread > 0.0, spread, 1.0)
    whole = box(mean[:2], reach)
    pieces = [clip_all(whole, cell) for cell in cells.cells]
    kept = [i for i, piece in enumerate(pieces) if area(piece) > AREA_SLIVER * area(whole)]
    return np.array(kept), PolygonRegions(tuple(pieces[i] for i in kept))


def whole_images(cells: Intervals | Polygons, offset: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The cell into which a map takes all of cell i, or -1, shape (n,).

    Decided on the cells themselves: where a map contracts for a long time, branches become too
    narrow to say on which side of an edge they lie. Lines only; -1 throughout on a plane.

    Parameters
    ----------
    cells : Intervals or Polygons
    offset, slope : ndarray, shapes (k1, n) and (k1, k1, n)
        Restricted rows of the dynamics.
    """
    target = np.full(cells.count, -1)
    if isinstance(cells, Polygons):
        return target
    offset, slope = offset[0], slope[0, 0]
    with np.errstate(invalid="ignore"):
        ends = offset + slope * cells.lower, offset + slope * cells.upper
    low, high = (np.where(slope == 0.0, offset, end(*ends)) for end in (np.minimum, np.maximum))
    slack = SLIVER * np.where(np.isfinite(cells.edges), np.abs(cells.edges), 0.0)
    inside = (low[:, None] >= cells.lower - slack[:-1]) & (high[:, None] <= cells.upper + slack[1:])
    fits = inside.any(axis=1) & (slope != 0.0)
    # sets on a common edge go to the cell of the smallest index, with slack against rounding
    target[fits] = np.argmax(inside, axis=1)[fits]
    return target


def _on_this_side(offset: float, outward: np.ndarray) -> bool:
    """Whether a branch collapsed to a point on the inner side of an edge line belongs there.

    A point on the line itself belongs to the one side whose outward normal points down.
    """
    if offset != 0.0:
        return offset > 0.0
    return bool(outward[0] < 0.0 or (outward[0] == 0.0 and outward[1] < 0.0))
