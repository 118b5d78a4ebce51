"""Branches: Gaussian laws restricted to regions, moved, split and corrected together."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.correction import correct
from seedslib.base.semidefinite import factor
from seedslib.linearization.moments import Moments
from seedslib.piecewise.cells import Intervals, Polygons
from seedslib.piecewise.coefficients import Coefficients
from seedslib.piecewise.geometry import IntervalRegions, PolygonRegions, prior_regions, whole_images
from seedslib.piecewise.precision import gram, sharpened
from seedslib.piecewise.system import PiecewiseLinearSystem

_SHRINK = 0.1  # contraction up to which an interval is replaced by its image
_RESOLVED = 1e-5  # least width of an image relative to the numbers that describe it


class Branches(NamedTuple):
    """Posterior law ``sum_b U_b N(v; mean_b, cov_b) [s in region_b]`` for each data set.

    A branch keeps its region in coordinates s in which it has volume: ``v = (s, x2)`` with
    ``x1 = shift + slope s``. Usually s is x1 itself; where the dynamics contract or collapse
    x1, it is x1 at an earlier time.

    Attributes
    ----------
    cell : ndarray of int, shape (B,)
        Cell in which x1 lies now.
    regions : IntervalRegions or PolygonRegions
    slope, shift : ndarray, shapes (k1, k1, B) and (k1, B)
    mean : ndarray, shape (k, B, N)
    cov : ndarray, shape (k, k, B, 1 or N)
        Common to all data sets unless missing measurements, merging, or coefficients that
        follow the estimate make it differ.
    log_unit : ndarray, shape (B, N)
        ``ln U``; not a probability: the weight of a branch is U times the mass of its region.
        ``-inf`` marks a branch that was dropped for that data set.
    """

    cell: np.ndarray
    regions: Any
    slope: np.ndarray
    shift: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    log_unit: np.ndarray

    def take(self, index: np.ndarray) -> Branches:
        """Some of the branches."""
        return self.pieces(index, self.cell[index], self.regions.take(index))

    def pieces(
        self, parent: np.ndarray, cell: np.ndarray, regions: IntervalRegions | PolygonRegions
    ) -> Branches:
        """Branches with the laws of their parents on regions and in cells of their own."""
        return Branches(
            cell, regions, self.slope[:, :, parent], self.shift[:, parent], self.mean[:, parent],
            self.cov[:, :, parent], self.log_unit[parent],
        )  # fmt: skip


def prior_branches(system: PiecewiseLinearSystem, datasets: int) -> Branches:
    """One branch per cell, all with the law of the prior and U = 1."""
    cell, regions = prior_regions(system.regions, system.mean0, system.cov0)
    count, size, n = cell.size, system.regions.size, system.state_size
    return Branches(
        cell, regions, _identity(size, count), np.zeros((size, count)),
        np.broadcast_to(system.mean0[:, None, None], (n, count, datasets)),
        np.broadcast_to(system.cov0[:, :, None, None], (n, n, count, 1)),
        np.zeros((count, datasets)),
    )  # fmt: skip


def obstacle(c: Coefficients, size: int) -> str | None:
    """Why a transition keeps no branch Gaussian on a region, or None where it is exact.

    The restricted rows must have no noise, must not depend on the other components, and must be
    the same for every data set.
    """
    if c.noise[:size].any():
        return "noise enters the restricted components"
    if c.matrix[:size, size:].any():
        return "the restricted components depend on the others"
    rows = c.offset[:size], c.matrix[:size, :size]
    if any((part != part[..., :1]).any() for part in rows):
        return "the restricted rows of the dynamics differ between data sets"
    return None


def move(branches: Branches, cells: Intervals | Polygons, c: Coefficients) -> Branches:
    """Carry every branch through the dynamics of its cell and cut it along the cells.

    Exact where `obstacle` says None. The region follows x1 (its image becomes the region) as
    long as that costs no digits; otherwise it stays where it is and the cells are pulled back.
    """
    size, cell = cells.size, branches.cell
    a, A, G = c.offset[:, cell], c.matrix[:, :, cell], c.noise[:, :, cell]
    lead = A[:size, :size, :, 0]
    shift = a[:size, :, 0] + np.einsum("ijb,jb->ib", lead, branches.shift)
    slope = np.einsum("ijb,jkb->ikb", lead, branches.slope)
    follow = _follows(branches, slope, shift)
    identity = _identity(size, cell.size)
    turn, origin = np.where(follow, slope, identity), np.where(follow, shift, 0.0)

    depth = np.broadcast_shapes(a.shape[2:], A.shape[3:])[0]
    through = np.zeros((len(a), len(a), cell.size, depth))
    through[:size, :size] = turn[..., None]
    through[size:, :size] = np.einsum("ijbd,jkb->ikbd", A[size:, :size], branches.slope)
    through[size:, size:] = A[size:, size:]
    offset = np.zeros((len(a), cell.size, depth))
    offset[:size] = origin[..., None]
    offset[size:] = a[size:] + np.einsum("ijbd,jb->ibd", A[size:, :size], branches.shift)

    mean = offset + np.einsum("ij...,j...->i...", through, branches.mean)
    cov = _sandwich(through, branches.cov)
    if G[size:].any():
        cov = cov + np.einsum("ip...,jp...->ij...", G, G)
    regions = branches.regions.image(turn, origin)
    slope, shift = np.where(follow, identity, slope), np.where(follow, 0.0, shift)
    target = whole_images(cells, c.offset[:size, :, 0], c.matrix[:size, :size, :, 0])[cell]
    moved = branches._replace(slope=slope, shift=shift, mean=mean, cov=cov)
    return moved.pieces(*regions.split(cells, slope, shift, target))


def spread_out(
    cells: Intervals | Polygons, c: Coefficients, log_weight: np.ndarray, mean: np.ndarray,
    cov: np.ndarray,
) -> Branches:  # fmt: skip
    """Predict one Gaussian per cell and cut each of them along all cells.

    Parameters
    ----------
    cells : Intervals or Polygons
    c : Coefficients
        Dynamics of the step.
    log_weight : ndarray, shape (n, N)
    mean, cov : ndarray, shapes (k, n, N) and (k, k, n, N)
        Moments of the law in each cell; anything where the weight is zero.
    """
    kept = alive(log_weight)
    a, A, G = c.offset[:, kept], c.matrix[:, :, kept], c.noise[:, :, kept]
    mean = a + np.einsum("ij...,j...->i...", A, mean[:, kept])
    cov = _sandwich(A, cov[:, :, kept]) + np.einsum("ip...,jp...->ij...", G, G)
    size = cells.size
    cell, regions = _all_regions(cells, mean[:size], cov[:size, :size])
    parent = np.repeat(np.arange(kept.size), cell.size)
    child = np.tile(np.arange(cell.size), kept.size)
    whole, still = _identity(size, kept.size), np.zeros((size, kept.size))
    spread = Branches(kept, regions, whole, still, mean, cov, log_weight[kept])
    return spread.pieces(parent, cell[child], regions.take(child))


def alive(log_unit: np.ndarray) -> np.ndarray:
    """Indices of the branches that some data set still has; one at least, to keep the arrays."""
    index = np.flatnonzero((log_unit > -np.inf).any(axis=1))
    return index if index.size else np.zeros(1, dtype=int)


def measure(branches: Branches, c: Coefficients, y: np.ndarray) -> tuple[Branches, np.ndarray]:
    """Correct every branch linearly and put the likelihoods into U, without normalising.

    Parameters
    ----------
    branches : Branches
    c : Coefficients
        Sensor.
    y : ndarray, shape (m, N)
        NaN marks a missing component.

    Returns
    -------
    Branches
    innovation : ndarray, shape (m, m, B, 1 or N)
        Predicted covariances of the measurement, W.
    """
    size, cell = len(branches.shift), branches.cell
    b, B, H = c.offset[:, cell], c.matrix[:, :, cell], c.noise[:, :, cell]
    sensor = np.concatenate(
        [np.einsum("ijbd,jkb->ikbd", B[:, :size], branches.slope), B[:, size:]], axis=1
    )
    offset = b + np.einsum("ijbd,jb->ibd", B[:, :size], branches.shift)
    predicted = offset + np.einsum("ij...,j...->i...", sensor, branches.mean)
    root = factor(branches.cov)
    seen = np.einsum("ij...,jk...->ik...", sensor, root)
    cross = np.einsum("ij...,kj...->ik...", root, seen)
    innovation = gram(seen) + gram(H)
    with np.errstate(over="ignore", invalid="ignore"):
        mean, cov, loglik = correct(
            branches.mean, branches.cov, y[:, None, :], Moments(predicted, cross, innovation)
        )
        log_unit = branches.log_unit + loglik
    cov = sharpened(cov, root, sensor, H, innovation, y)
    bad = ~(np.isfinite(log_unit) & np.isfinite(mean).all(axis=0))
    if bad.any():
        log_unit = np.where(bad, -np.inf, log_unit)
        mean = np.where(bad, 0.0, mean)
    return branches._replace(mean=mean, cov=cov, log_unit=log_unit), innovation


def _follows(branches: Branches, slope: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Which regions are replaced by their images under ``s -> shift + slope s``, shape (B,).

    Those whose volume the map does not reduce; on a line also those that it shrinks moderately,
    as long as interval and law stay wide beside the size of the numbers that describe them.
    """
    volume = np.abs(np.linalg.det(np.moveaxis(slope, 2, 0)))
    if len(slope) == 2:
        return volume >= 1.0
    ends = np.stack([branches.regions.lower, branches.regions.upper])
    width = np.minimum(ends[1] - ends[0], np.sqrt(branches.cov[0, 0].min(axis=1)))
    finite = np.isfinite(ends)
    image = np.abs(shift[0] + slope[0, 0] * np.where(finite, ends, 0.0))
    size = np.where(finite, image, 0.0).max(axis=0)
    return (volume >= 1.0) | ((volume >= _SHRINK) & (volume * width >= _RESOLVED * size))


def _identity(size: int, count: int) -> np.ndarray:
    return np.repeat(np.eye(size)[:, :, None], count, axis=2)


def _sandwich(matrix: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """``matrix cov matrix'``, exactly symmetric."""
    half = np.einsum("ij...,jk...->ik...", matrix, cov)
    full = np.einsum("ij...,kj...->ik...", half, matrix)
    return 0.5 * (full + np.swapaxes(full, 0, 1))


def _all_regions(cells: Intervals | Polygons, mean: np.ndarray, cov: np.ndarray) -> tuple:
    """Regions of all cells; plane cells cut off far beyond every predicted law."""
    if isinstance(cells, Intervals):
        return np.arange(cells.count), IntervalRegions(cells.lower, cells.upper)
    flat = mean.reshape(2, -1)
    center = 0.5 * (flat.min(axis=1) + flat.max(axis=1))
    widest = np.array([cov[0, 0].max(), cov[1, 1].max()])
    reach = np.ptp(flat, axis=1) / 80.0 + np.sqrt(widest)
    return prior_regions(cells, center, np.diag(reach**2))
