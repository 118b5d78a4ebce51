"""Convex polygons of the plane: area, centre of gravity, clipping by half-planes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

ON_LINE = 16.0 * np.finfo(float).eps  # relative distance that only rounding can have made


class HalfPlanes(NamedTuple):
    """Convex cell ``{x : normals[:, j] . x <= offsets[j] for every j}``, possibly unbounded.

    Attributes
    ----------
    normals : ndarray, shape (2, p)
    offsets : ndarray, shape (p,)
    """

    normals: np.ndarray
    offsets: np.ndarray


def box(center: np.ndarray, half_width: np.ndarray) -> np.ndarray:
    """Rectangle with sides along the axes, counter-clockwise, shape (2, 4)."""
    corners = np.array([[-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0]])
    return np.asarray(center)[:, None] + np.asarray(half_width)[:, None] * corners


def area(vertices: np.ndarray) -> float:
    """Signed area of a polygon, shape (2, N); positive counter-clockwise."""
    return 0.5 * float(np.sum(_fan(vertices)[1])) if vertices.shape[1] > 2 else 0.0


def clip(vertices: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Part of a convex polygon in the half-plane ``normal . x <= offset`` (Sutherland-Hodgman).

    A vertex within rounding of the line counts as lying on it, so that a polygon cut along one
    of its own edges does not leave a sliver.
    """
    if not vertices.shape[1]:
        return vertices
    value = normal @ vertices - offset
    scale = np.abs(normal) @ np.abs(vertices).max(axis=1) + abs(offset)
    value[np.abs(value) <= ON_LINE * scale] = 0.0
    if (value <= 0.0).all():
        return vertices
    if (value >= 0.0).all():
        return vertices[:, :0]
    kept = []
    for i in range(vertices.shape[1]):
        j = (i + 1) % vertices.shape[1]
        if value[i] <= 0.0:
            kept.append(vertices[:, i])
        if value[i] * value[j] < 0.0:
            s = value[i] / (value[i] - value[j])
            kept.append(vertices[:, i] + s * (vertices[:, j] - vertices[:, i]))
    return np.array(kept).T


def half_planes(vertices: np.ndarray) -> HalfPlanes:
    """The half-planes whose intersection is a convex polygon, counter-clockwise, (2, N)."""
    edges = np.roll(vertices, -1, axis=1) - vertices
    normals = np.array([edges[1], -edges[0]])
    return HalfPlanes(normals, np.sum(normals * vertices, axis=0))


def clip_all(vertices: np.ndarray, cell: HalfPlanes) -> np.ndarray:
    """Part of a convex polygon in a cell."""
    for normal, offset in zip(cell.normals.T, cell.offsets, strict=True):
        vertices = clip(vertices, normal, offset)
    return vertices


def centroid(vertices: np.ndarray) -> np.ndarray:
    """Centre of gravity of a polygon of positive area, shape (2,)."""
    spokes, cross = _fan(vertices)
    moment = np.array([(x[:-1] + x[1:]) @ cross for x in spokes])
    return vertices[:, 0] + moment / (3.0 * cross.sum())


def _fan(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Spokes (2, N - 1) from the first vertex, and twice the areas (N - 2,) between them."""
    x, y = spokes = vertices[:, 1:] - vertices[:, :1]
    return spokes, x[:-1] * y[1:] - x[1:] * y[:-1]
