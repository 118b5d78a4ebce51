"""Coordinates in which plane regions keep their digits over long records.

Where the dynamics stretch one direction and shrink another, the posterior law becomes very
narrow in the coordinates that a branch keeps its region in, while the region still reaches as
far as the prior did. Before the two scales differ by the digits that a float has, the branch is
given coordinates of its own law, and what is out of reach of the law is cut off.
"""

from __future__ import annotations

import numpy as np

from seedslib.piecewise.branches import Branches
from seedslib.piecewise.clipping import area, box, centroid, clip_all, half_planes
from seedslib.piecewise.geometry import PRIOR_REACH, PolygonRegions

_FAR = 1e4  # extent of a region, or distance from the origin, in standard deviations of the law


def localise(branches: Branches) -> Branches:
    """Branches of which those with plane regions too large for their laws have new coordinates.

    The new coordinates of a region are ``L^-1 (s - c)`` with L a factor of the covariance and c
    its centre of gravity. It is then cut to a square that holds, for every data set, all points
    within 40 standard deviations of the mean plus the distance of the mean from the region.
    """
    if not isinstance(branches.regions, PolygonRegions):
        return branches
    moved = {}
    for b, vertices in enumerate(branches.regions.vertices):
        change = _change(vertices, branches.cov[:2, :2, b].mean(axis=-1))
        here = branches.log_unit[b] > -np.inf
        if change is not None and here.any():
            center, root = change
            local = np.linalg.solve(root, vertices - center[:, None])
            mean = np.linalg.solve(root, branches.mean[:2, b] - center[:, None])
            reach = PRIOR_REACH + _distance(local, mean[:, here])
            low, high = (mean[:, here] - reach).min(axis=1), (mean[:, here] + reach).max(axis=1)
            square = half_planes(box(0.5 * (low + high), 0.5 * (high - low)))
            part = clip_all(local, square)
            if area(part) > 0.0:
                moved[b] = (center, root, mean, part)
    if not moved:
        return branches
    mean, cov = branches.mean.copy(), branches.cov.copy()
    slope, shift = branches.slope.copy(), branches.shift.copy()
    regions = list(branches.regions.vertices)
    for b, (center, root, local_mean, part) in moved.items():
        shift[:, b] += slope[:, :, b] @ center
        slope[:, :, b] = slope[:, :, b] @ root
        mean[:2, b] = local_mean
        half = np.linalg.solve(root, cov[:2, :, b].reshape(2, -1)).reshape(cov[:2, :, b].shape)
        cov[:2, 2:, b] = half[:, 2:]
        cov[2:, :2, b] = np.swapaxes(half[:, 2:], 0, 1)
        inner = np.swapaxes(half[:, :2], 0, 1).reshape(2, -1)
        inner = np.linalg.solve(root, inner).reshape(2, 2, -1)
        cov[:2, :2, b] = 0.5 * (inner + np.swapaxes(inner, 0, 1))
        regions[b] = part
    return branches._replace(
        regions=PolygonRegions(tuple(regions)), slope=slope, shift=shift, mean=mean, cov=cov
    )


def _change(vertices: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Centre and factor of the new coordinates, or None where the old ones will do."""
    try:
        root = np.linalg.cholesky(cov)
    except np.linalg.LinAlgError:
        return None  # a law without spread has no coordinates of its own
    center = centroid(vertices)
    extent = np.abs(np.linalg.solve(root, np.column_stack([vertices - center[:, None], center])))
    return (center, root) if extent.max() > _FAR else None


def _distance(vertices: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of points (2, N) from a convex polygon, zero inside, shape (N,)."""
    edge = np.roll(vertices, -1, axis=1) - vertices
    offset = points[:, None] - vertices[:, :, None]  # (2, edges, N)
    outward = edge[1][:, None] * offset[0] - edge[0][:, None] * offset[1]
    length = np.maximum((edge**2).sum(axis=0), 1e-300)[:, None]
    along = np.clip(np.einsum("ie,ien->en", edge, offset) / length, 0.0, 1.0)
    nearest = np.hypot(*(offset - along * edge[:, :, None])).min(axis=0)
    return np.where((outward <= 0.0).all(axis=0), 0.0, nearest)
