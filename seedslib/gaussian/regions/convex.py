"""Convex polygons cut into panels, with all geometry in twofold numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.gaussian.regions.nodes import reach_of
from seedslib.gaussian.regions.panels import Gathered, Panels, integrate
from seedslib.gaussian.regions.trapezoids import slabs
from seedslib.gaussian.regions.twofold import Twofold, cross, dot, where

# Points with |z|^2 > |p|^2 + 120 are left out. In a convex region with nearest point p they hold
# less than 1e-18 of the mass and 1e-17 of the second moment: shrink the region towards p.
_RANGE = 120.0
# Farther from the mean than this (ln P = -1e15) the exponents themselves are rounding.
_FARTHEST = 2e15
# Between vertices farther away even twofold numbers do not place an oblique edge near the mean.
_REACH = 1e18


class ConvexMoments(NamedTuple):
    """Conditional moments of convex regions in whitened coordinates, arrays of shape (N,).

    The mass is ``exp(-square/2) mass / (2 pi)``, given as zero where `square` is beyond 2e15; the
    mean is ``p + x e + y f`` with the frame ``f = (fx, fy)``, ``e = (fy, -fx)``; `xx`, `xy`, `yy`
    is the covariance in that frame.
    """

    square: Twofold
    px: Twofold
    py: Twofold
    fx: Twofold
    fy: Twofold
    gathered: Gathered


def convex_moments(zx: Twofold, zy: Twofold) -> ConvexMoments:
    """Moments of the standard normal law over convex polygons.

    Parameters
    ----------
    zx, zy : Twofold, shape (V, N)
        Vertices in counter-clockwise order; repeated ones are padding.

    Raises
    ------
    ValueError
        A region whose boundary comes near the mean has vertices farther away than 1e18, or a
        region is so small that squares of its lengths underflow.
    """
    ex, ey = zx.roll() - zx, zy.roll() - zy
    length = dot(ex, ey, ex, ey).sqrt()
    real = length.hi > 0.0
    if not real.any(axis=0).all():
        raise ValueError("vertices: wanted polygons larger than 1e-150 standard deviations")
    unit = where(real, length, Twofold.of(np.ones_like(length.hi)))
    edges = _Edges(zx, zy, ex / unit, ey / unit, length, real)
    px, py, boundary = _nearest(edges)
    square = dot(px, py, px, py)
    reach = np.maximum(np.abs(zx.hi), np.abs(zy.hi)).max(axis=0)
    if ((boundary < _FARTHEST) & (reach > _REACH)).any():
        raise ValueError(
            f"vertices: wanted vertices within {_REACH:g} standard deviations of the mean, got "
            f"{reach.max():.3g}; an unbounded region is given by rays"
        )
    fx, fy = _frame(edges, square.hi)
    # from here on: coordinates from p, with the chosen edge along the second axis
    ox, oy = zx - px, zy - py
    x, y = ox * fy - oy * fx, ox * fx + oy * fy
    qx, qy = px * fy - py * fx, px * fx + py * fy
    panels = _panels(x, y, qx.hi, qy.hi, square.hi)
    return ConvexMoments(square, px, py, fx, fy, integrate(panels, qx.hi, qy.hi))


class _Edges(NamedTuple):
    """Edges (V, N): where they start, their unit directions, lengths, and which have one."""

    zx: Twofold
    zy: Twofold
    tx: Twofold
    ty: Twofold
    length: Twofold
    real: np.ndarray


def _nearest(edges: _Edges) -> tuple[Twofold, Twofold, np.ndarray]:
    """The point of each polygon nearest to the origin, and the squared distance of the edges."""
    zx, zy, tx, ty, length, real = edges
    along = -dot(zx, zy, tx, ty)
    zero = Twofold.of(np.zeros_like(along.hi))
    along = where(along.hi <= 0.0, zero, where(along.hi >= length.hi, length, along))
    x, y = zx + tx * along, zy + ty * along
    square = np.where(real, dot(x, y, x, y).hi, np.inf)
    # ties are points equally near: any of them is a good place to start from
    index = np.argmin(square, axis=0)[None]
    inside = ((cross(zx, zy, tx, ty).hi >= 0.0) | ~real).all(axis=0)
    origin = Twofold.of(np.zeros(inside.shape))
    px, py = x.along(index)[0], y.along(index)[0]
    return where(inside, origin, px), where(inside, origin, py), square.min(axis=0)


def _frame(edges: _Edges, square: np.ndarray) -> tuple[Twofold, Twofold]:
    """Direction of the edge with the longest part within the range of the density.

    A slender region, or one far in the tail, is then slender along the axes, and neither its
    exponents nor its covariance cancel.
    """
    zx, zy, tx, ty, length, real = edges
    h = cross(zx, zy, tx, ty).hi
    nearest = np.sqrt(square)
    half = np.sqrt(np.maximum(_RANGE + (nearest - h) * (nearest + h), 0.0))
    start = dot(zx, zy, tx, ty).hi
    inside = np.minimum(start + length.hi, half) - np.maximum(start, -half)
    # where no edge comes near, the longest one
    score = np.maximum(inside, 0.0) + 1e-9 * length.hi / length.hi.max(axis=0)
    # a tie turns the frame by another edge: the integral is the same up to rounding
    index = np.argmax(np.where(real, score, -1.0), axis=0)[None]
    return tx.along(index)[0], ty.along(index)[0]


class _Lines(NamedTuple):
    """Sides of slabs, shape (N,): abscissa ``x + (y' - y) slope`` at ordinate y'."""

    x: Twofold
    y: Twofold
    slope: Twofold
    end: Twofold

    @property
    def level(self) -> Twofold:
        """Abscissa at the ordinate of p: from here numbers near the mean do not cancel."""
        return self.x - self.y * self.slope

    def at(self, ordinate: np.ndarray) -> Twofold:
        """Abscissa at ordinates of shape (..., N), never beyond the ends of the side."""
        x = self.x + (Twofold.of(ordinate) - self.y) * self.slope
        # an almost horizontal side is long compared with the rounding of an ordinate
        forth = self.end.hi >= self.x.hi
        low, high = where(forth, self.x, self.end), where(forth, self.end, self.x)
        return where(x.hi < low.hi, low, where(x.hi > high.hi, high, x))


class _Strips(NamedTuple):
    """Slabs of convex polygons, shape (N,): ``low <= y' <= high`` between two sides.

    `px`, `py` is the polygon's nearest point p, from which all is measured, `square` is |p|^2.
    """

    left: _Lines
    right: _Lines
    low: np.ndarray
    high: np.ndarray
    px: np.ndarray
    py: np.ndarray
    square: np.ndarray


def _panels(x: Twofold, y: Twofold, px: np.ndarray, py: np.ndarray, square: np.ndarray) -> Panels:
    """Slabs between consecutive ordinates of vertices, cut further by `_cut`."""
    levels, up, down = slabs(y)
    slope_x, slope_y = x.roll() - x, y.roll() - y
    slope = slope_x / where(slope_y.hi != 0.0, slope_y, Twofold.of(np.ones_like(slope_y.hi)))
    height = (levels[1:] - levels[:-1]).hi
    used = (height > 0.0) & (square < _FARTHEST)
    owner = np.broadcast_to(np.arange(px.size), height.shape)[used]
    sides = []
    for mask in (down, up):
        index = np.argmax(mask, axis=1)
        sides.append([item.along(index) for item in (x, y, slope, x.roll())])
    left, right = (_Lines(*(item[used] for item in side)) for side in sides)
    low, high = levels.hi[:-1][used], levels.hi[1:][used]
    return _cut(owner, _Strips(left, right, low, high, px[owner], py[owner], square[owner]))


def _cut(owner: np.ndarray, strips: _Strips) -> Panels:
    """Slabs to panels: within a panel no side crosses the range of the density abruptly.

    What counts lies within ``R = sqrt(120)`` of p, or of the nearest point of a level line. A
    slab is cut at the ordinates where

    - its visible part begins and ends,
    - a side meets the range about the mean, ``px + left(y) = -R`` or ``px + right(y) = R``,
    - its width ``right(y) - left(y)`` grows beyond 2 R, or beyond what the density reaches from
      the nearest point of the level line at either end.
    """
    left, right, low, _, px, _, _ = strips
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        begin, end = _visible(strips)
        edge = np.sqrt(_RANGE)
        cuts = [begin, end]
        cuts.append((-edge - px - left.level.hi) / left.slope.hi)
        cuts.append((edge - px - right.level.hi) / right.slope.hi)
        # the width is linear in the ordinate: at_level + y growth
        at_level, growth = (right.level - left.level).hi, (right.slope - left.slope).hi
        widths = [np.full_like(low, 2.0 * edge)]
        for level in (begin, end):
            nearest = np.maximum(px + left.at(level).hi, -(px + right.at(level).hi))
            widths.append(reach_of(np.maximum(nearest, 0.0)))
        for width in widths:
            cuts.append((width - at_level) / growth)
        # what is met nowhere, or outside, makes panels without height
        cuts = np.stack(cuts)
        cuts = np.sort(np.clip(np.where(np.isnan(cuts), begin, cuts), begin, end), axis=0)
    height = cuts[1:] - cuts[:-1]
    used = height > 0.0
    x_left, x_right = left.at(cuts), right.at(cuts)
    # of a narrow slab the abscissas have no digits of the width, their twofold difference has
    width = np.maximum((x_right - x_left).hi, 0.0)
    rows = [cuts[:-1], height]
    for item in (x_left.hi, x_right.hi, width):
        rows += [item[:-1], item[1:]]
    return Panels(np.broadcast_to(owner, height.shape)[used], np.stack([row[used] for row in rows]))


def _visible(strips: _Strips) -> tuple[np.ndarray, np.ndarray]:
    """Ordinates between which a slab meets the disc of the range; equal if nowhere.

    The disc ``|z|^2 <= |p|^2 + 120`` enters or leaves a slab where a side meets its circle, at
    its top or bottom, or at the slab's own ends.
    """
    left, right, low, high, px, py, square = strips
    nearest = np.sqrt(square)
    radius = np.sqrt(square + _RANGE)
    points = []
    for line in (left, right):
        # signed distance h of the line from the mean, its direction, its chord of the disc
        norm = np.hypot(line.slope.hi, 1.0)
        tau_x, tau_y = line.slope.hi / norm, 1.0 / norm
        h = (line.level.hi + px) * tau_y - py * tau_x
        half = np.sqrt(_RANGE + (nearest - h) * (nearest + h))
        for sign in (-1.0, 1.0):
            points.append(-h * tau_x + sign * half * tau_y - py)
    for sign in (-1.0, 1.0):
        top = sign * radius - py
        between = (left.at(top).hi + px <= 0.0) & (right.at(top).hi + px >= 0.0)
        points.append(np.where(between, top, np.nan))
    points = [np.where((point >= low) & (point <= high), point, np.nan) for point in points]
    for level in (low, high):
        l, r = left.at(level).hi, right.at(level).hi
        base = np.where(px + l > 0.0, l, np.where(px + r < 0.0, r, -px))
        fall = base * (base + 2.0 * px) + level * (level + 2.0 * py)
        points.append(np.where(fall <= _RANGE, level, np.nan))
    points = np.stack(points)
    seen = ~np.isnan(points)
    begin = np.where(seen, points, np.inf).min(axis=0)
    end = np.where(seen, points, -np.inf).max(axis=0)
    some = seen.any(axis=0)
    return np.where(some, begin, low), np.where(some, end, low)
