"""Checks of polygons and their normal form: simple, counter-clockwise, convex or not.

Signs of cross products decide everything here. They are taken in double precision with an error
bound, and again with twofold numbers where the bound leaves the sign open.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.gaussian.arguments import blockwise
from seedslib.gaussian.regions.twofold import Twofold, binary_scale, cross, dot, together

_PAIRS = 4_000_000  # pairs of edges looked at together
_ARC = 8  # chords of a full turn that close an unbounded region


@dataclass(frozen=True, eq=False)
class Outline:
    """Simple polygons with the region on the left of the boundary.

    Parameters
    ----------
    x, y : ndarray, shape (V, ...)
        Vertices; repeated consecutive ones are padding.
    rays : ndarray, shape (2, 2, ...), or None
        Directions to infinity from the first and from the last vertex (first axis) by
        components; zero for a bounded polygon in the batch. None if all are bounded.
    convex : ndarray of bool, shape (...)
    """

    x: np.ndarray
    y: np.ndarray
    rays: MaybeArray
    convex: np.ndarray


@dataclass(frozen=True, eq=False)
class _Edges:
    """Directed edges of closed or unbounded chains, shape (M, B).

    An edge starts at (x, y) and runs along (dx, dy); a ray towards infinity has `to_infinity`.
    A ray that comes in from infinity is kept by its finite end, with `from_infinity`.
    """

    x: np.ndarray
    y: np.ndarray
    dx: Twofold
    dy: Twofold
    from_infinity: np.ndarray
    to_infinity: np.ndarray

    @property
    def real(self) -> np.ndarray:
        """Edges of positive length."""
        return (self.dx.hi != 0.0) | (self.dy.hi != 0.0)


def outline(vertices: np.ndarray, rays: np.ndarray | None) -> Outline:
    """Check polygons and bring them into normal form.

    Bounded polygons in clockwise order are reversed. An unbounded region lies on the left of its
    boundary, which decides between it and its complement: its order is never changed.

    Parameters
    ----------
    vertices : ndarray, shape (V, 2, ...)
    rays : ndarray, shape (2, 2, ...), or None
        Of the same batch shape.

    Raises
    ------
    ValueError
        A polygon with fewer than three distinct vertices, without area, with an edge that turns
        back on itself, or whose boundary touches or crosses itself; one zero ray beside a
        nonzero one. The message names the position in the batch.
    """
    batch = vertices.shape[2:]
    flat = vertices.reshape(*vertices.shape[:2], -1)
    flat = flat / binary_scale(np.abs(flat).max(axis=(0, 1)))
    flat_rays = None if rays is None else rays.reshape(2, 2, -1)

    def judged(block: slice) -> tuple[np.ndarray, np.ndarray]:
        part = None if flat_rays is None else flat_rays[..., block]
        return _judge(flat[..., block], part, _Place(batch, block.start))

    clockwise, convex = blockwise(judged, flat.shape[2], max(1, _PAIRS // flat.shape[0] ** 2))
    shaped = np.where(clockwise.reshape(batch), vertices[::-1], vertices)
    return Outline(shaped[:, 0], shaped[:, 1], rays, convex.reshape(batch))


class _Place(NamedTuple):
    """Where a block of the flat batch stands, for messages."""

    batch: tuple[int, ...]
    start: int

    def refuse(self, bad: np.ndarray, name: str, wanted: str) -> None:
        """Raise for the first bad element."""
        if bad.any():
            where = ""
            if self.batch:
                index = np.unravel_index(self.start + int(np.argmax(bad)), self.batch)
                where = f" at batch index {tuple(int(k) for k in index)}"
            raise ValueError(f"{name}: wanted {wanted}{where}")


def _judge(
    flat: np.ndarray, rays: np.ndarray | None, place: _Place
) -> tuple[np.ndarray, np.ndarray]:
    """Whether polygons (V, 2, B) run clockwise, and whether they are convex."""
    unbounded = np.zeros(flat.shape[2], dtype=bool)
    if rays is not None:
        present = rays.any(axis=1)
        place.refuse(present[0] != present[1], "rays", "two nonzero directions, or two zero ones")
        unbounded = present[0]
    edges = _edges(flat, rays, unbounded)
    place.refuse(
        edges.real.sum(axis=0) < np.where(unbounded, 2, 3),
        "vertices",
        "at least three distinct vertices, got a degenerate polygon",
    )
    turns = _turns(edges, place)
    _refuse_contact(edges, place)
    clockwise = ~unbounded & (_doubled_area(flat).hi < 0.0)
    return clockwise, (turns >= 0).all(axis=0) | (clockwise & (turns <= 0).all(axis=0))


def _edges(flat: np.ndarray, rays: np.ndarray | None, unbounded: np.ndarray) -> _Edges:
    x, y = flat[:, 0], flat[:, 1]
    dx = Twofold.difference(np.roll(x, -1, axis=0), x)
    dy = Twofold.difference(np.roll(y, -1, axis=0), y)
    nowhere = np.zeros(x.shape, dtype=bool)
    if rays is None:
        return _Edges(x, y, dx, dy, nowhere, nowhere)
    # the closing edge of an unbounded chain is not there; two rays stand in for it
    none = np.where(unbounded, 0.0, 1.0)
    for part in (dx, dy):
        part.hi[-1] *= none
        part.lo[-1] *= none
    inward, outward = Twofold.of(-rays[0]), Twofold.of(rays[1])

    def chain(d: Twofold, axis: int) -> Twofold:
        return together(np.concatenate, [inward[axis][None], d, outward[axis][None]])

    edge = np.zeros((1, x.shape[1]), dtype=bool)
    first = np.concatenate([edge | unbounded, nowhere, edge])
    return _Edges(
        np.concatenate([x[:1], x, x[-1:]]),
        np.concatenate([y[:1], y, y[-1:]]),
        chain(dx, 0),
        chain(dy, 1),
        first,
        first[::-1],
    )


def _sign(ax: Twofold, ay: Twofold, bx: Twofold, by: Twofold) -> np.ndarray:
    """Sign of the cross product a x b, zero only where it vanishes."""
    p, q = ax.hi * by.hi, ay.hi * bx.hi
    value = p - q
    bound = 1e-15 * (np.abs(p) + np.abs(q))
    open_ = (np.abs(value) <= bound) & (bound > 0.0)
    if open_.any():
        parts = (
            Twofold(*np.broadcast_arrays(part.hi, part.lo, value)[:2])[open_]
            for part in (ax, ay, bx, by)
        )
        value[open_] = cross(*parts).hi
    return np.sign(value)


def _turns(edges: _Edges, place: _Place) -> np.ndarray:
    """Sign of the turn after each edge; zero for padding and at infinity."""
    real, size = edges.real, len(edges.x)
    index = np.where(real, np.arange(size)[:, None], size)
    following = np.minimum.accumulate(index[::-1], axis=0)[::-1]
    following = np.concatenate([following[1:], np.full_like(following[:1], size)])
    following = np.where(following < size, following, index.min(axis=0))
    bx, by = edges.dx.along(following), edges.dy.along(following)
    turns = _sign(edges.dx, edges.dy, bx, by)
    counted = real & ~edges.to_infinity
    forward = edges.dx.hi * bx.hi + edges.dy.hi * by.hi
    place.refuse(
        (counted & (turns == 0) & (forward < 0.0)).any(axis=0),
        "vertices",
        "a polygon with area, got an edge that turns back on itself (degenerate polygon)",
    )
    return np.where(counted, turns, 0)


def _refuse_contact(edges: _Edges, place: _Place) -> None:
    """Refuse polygons two edges of which meet anywhere but in their common vertex."""
    real, closed = edges.real, ~edges.to_infinity.any(axis=0)
    i, j = np.triu_indices(len(real), 1)
    rank = np.cumsum(real, axis=0) - 1
    gap = rank[j] - rank[i]
    neighbours = (gap == 1) | (closed & (gap == rank[-1]))
    pairs = real[i] & real[j] & ~neighbours
    if not pairs.any():
        return
    keep = pairs.any(axis=1)
    i, j, pairs = i[keep], j[keep], pairs[keep]
    a, b = _sides(edges, i, j)
    c, d = _sides(edges, j, i)
    meet = (a * b <= 0) & (c * d <= 0)
    collinear = (a == 0) & (b == 0) & (c == 0) & (d == 0)
    if (collinear & pairs).any():
        meet &= ~collinear | _overlap(edges, i, j)
    place.refuse(
        (pairs & meet).any(axis=0),
        "vertices",
        "a simple polygon, got one whose boundary touches or crosses itself",
    )


def _sides(edges: _Edges, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """On which side of the lines through edges i do edges j start and end."""
    ex, ey = edges.dx[i], edges.dy[i]
    fx, fy = edges.dx[j], edges.dy[j]
    ox = Twofold.difference(edges.x[j], edges.x[i])
    oy = Twofold.difference(edges.y[j], edges.y[i])
    kept = _sign(ex, ey, ox, oy)
    far = _sign(ex, ey, fx, fy)
    ray = edges.from_infinity[j] | edges.to_infinity[j]
    end = np.where(ray, far, _sign(ex, ey, ox + fx, oy + fy))
    # a parallel ray stays on its side for ever
    end = np.where(ray & (far == 0), kept, end)
    start = np.where(edges.from_infinity[j] & (far != 0), -far, kept)
    end = np.where(edges.from_infinity[j], kept, end)
    return start, end


def _overlap(edges: _Edges, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Whether two edges on one line have a point in common."""
    ex, ey = edges.dx[i], edges.dy[i]
    ox = Twofold.difference(edges.x[j], edges.x[i])
    oy = Twofold.difference(edges.y[j], edges.y[i])
    first = dot(ox, oy, ex, ey).hi
    along = dot(edges.dx[j], edges.dy[j], ex, ey).hi
    length = dot(ex, ey, ex, ey).hi

    def span(start: np.ndarray, step: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        tail = np.where(edges.from_infinity[k], -np.inf * np.sign(step), start)
        head = np.where(edges.to_infinity[k], np.inf * np.sign(step), start + step)
        head = np.where(edges.from_infinity[k], start, head)
        return np.minimum(tail, head), np.maximum(tail, head)

    with np.errstate(invalid="ignore"):
        low_i, high_i = span(np.zeros_like(length), length, i)
        low_j, high_j = span(first, along, j)
    return np.maximum(low_i, low_j) <= np.minimum(high_i, high_j)


def closing_chords(start: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How unbounded regions are closed far away: directions from `start` on through `angle`.

    Shape (7, B), and which of them lie within the angle.
    """
    chords = np.maximum(np.ceil(angle * (_ARC / (2.0 * np.pi))), 1.0)
    step = np.arange(1, _ARC)[:, None]
    return start + angle * step / chords, step < chords


def _doubled_area(flat: np.ndarray) -> Twofold:
    """Twice the signed area, a sum of triangles at the first vertex."""
    x = Twofold.difference(flat[1:, 0], flat[:1, 0])
    y = Twofold.difference(flat[1:, 1], flat[:1, 1])
    pieces = cross(x[:-1], y[:-1], x[1:], y[1:])
    total = Twofold.of(np.zeros(flat.shape[2]))
    for piece in zip(pieces.hi, pieces.lo, strict=True):
        total = total + Twofold(*piece)
    return total
