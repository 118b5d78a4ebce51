"""Simple polygons cut along the ordinates of their vertices, in twofold numbers."""

from __future__ import annotations

import numpy as np

from seedslib.gaussian.regions.twofold import Twofold, dot, together, where


def trapezoids(zx: Twofold, zy: Twofold) -> tuple[np.ndarray, Twofold, Twofold]:
    """Simple polygons cut into trapezoids between pairs of edges.

    Parameters
    ----------
    zx, zy : Twofold, shape (V, N)
        Vertices, counter-clockwise.

    Returns
    -------
    owner : ndarray, shape (M,)
        The polygon of each trapezoid.
    x, y : Twofold, shape (4, M)
        Corners, counter-clockwise.
    """
    ex, ey = zx.roll() - zx, zy.roll() - zy
    length = dot(ex, ey, ex, ey).sqrt()
    # a tie turns the frame by another edge: the integral is the same up to rounding
    longest = np.argmax(length.hi, axis=0)[None]
    norm = length.along(longest)[0]
    tx, ty = ex.along(longest)[0] / norm, ey.along(longest)[0] / norm
    x, y = zx * ty - zy * tx, zx * tx + zy * ty
    levels, up, down = slabs(y)
    partner = _partners(x, y, levels, up, down)
    # a pair of edges that bounds several slabs in succession makes one trapezoid
    same = np.zeros((partner.shape[0] + 1, *partner.shape[1:]), dtype=bool)
    same[1:-1] = partner[1:] == partner[:-1]
    starts = np.moveaxis((partner >= 0) & ~same[:-1], 0, -1)
    ends = np.moveaxis((partner >= 0) & ~same[1:], 0, -1)
    left, owner, low = np.nonzero(starts)
    high = np.nonzero(ends)[2] + 1
    right = partner[low, left, owner]
    y_low, y_high = levels[low, owner], levels[high, owner]
    corners = [
        _corner(x, y, edge, owner, level)
        for edge, level in ((left, y_low), (right, y_low), (right, y_high), (left, y_high))
    ]
    cx = together(np.stack, corners)
    cy = together(np.stack, [y_low, y_low, y_high, y_high])
    used = (y_high - y_low).hi > 0.0
    owner, cx, cy = owner[used], cx[:, used], cy[:, used]
    tx, ty = tx[owner], ty[owner]
    return owner, cx * ty + cy * tx, cy * ty - cx * tx


def slabs(y: Twofold) -> tuple[Twofold, np.ndarray, np.ndarray]:
    """Sorted ordinates (V, N), and which edges go up and down through each slab between them.

    The latter have shape (V - 1, V, N).
    """
    order = np.lexsort((y.lo, y.hi), axis=0)
    rank = np.empty_like(order)
    np.put_along_axis(rank, order, np.arange(order.shape[0])[:, None], axis=0)
    following = np.roll(rank, -1, axis=0)
    slab = np.arange(order.shape[0] - 1)[:, None, None]
    up, down = (rank <= slab) & (following > slab), (following <= slab) & (rank > slab)
    return y.along(order), up, down


def _partners(
    x: Twofold, y: Twofold, levels: Twofold, up: np.ndarray, down: np.ndarray
) -> np.ndarray:
    """For each slab and each edge that goes down through it, the edge across; -1 elsewhere."""
    dy = y.roll() - y
    slope = (x.roll() - x) / where(dy.hi != 0.0, dy, Twofold.of(np.ones_like(dy.hi)))
    middle = (levels[:-1] + levels[1:]).scaled(0.5)[:, None]
    at = x + (middle - y) * slope
    crossing = up | down
    order = np.lexsort((at.lo, np.where(crossing, at.hi, np.inf)), axis=1)
    left, right = order[:, :-1:2], order[:, 1::2]
    thick = ((levels[1:] - levels[:-1]).hi > 0.0)[:, None]
    valid = np.take_along_axis(crossing, left, axis=1) & thick
    sound = np.take_along_axis(down, left, axis=1) & np.take_along_axis(up, right, axis=1)
    if (valid & ~sound).any():
        raise ValueError(
            "vertices: wanted a simple polygon, got one whose boundary touches itself to within "
            "rounding once the law is made standard"
        )
    partner = np.full(crossing.shape, -1)
    np.put_along_axis(partner, left, np.where(valid, right, -1), axis=1)
    return partner


def _corner(x: Twofold, y: Twofold, edge: np.ndarray, owner: np.ndarray, level: Twofold) -> Twofold:
    """Abscissa of edges at levels; exactly that of the vertex where the level is a vertex's."""
    following = (edge + 1) % x.hi.shape[0]
    ax, ay = x[edge, owner], y[edge, owner]
    bx, by = x[following, owner], y[following, owner]
    at = ax + (level - ay) * ((bx - ax) / (by - ay))
    at = where((level.hi == ay.hi) & (level.lo == ay.lo), ax, at)
    return where((level.hi == by.hi) & (level.lo == by.lo), bx, at)
