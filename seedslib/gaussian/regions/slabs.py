"""Robust moments over any simple polygon: quadrature that is accurate where the closed form is not.

The polygon is whitened in twofold numbers, closed far away where it is unbounded, and cut into
trapezoids where it is not convex; each convex piece is integrated around its own nearest point to
the mean, and the pieces are put together as a mixture. Nothing but positive sums enters a moment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.gaussian.regions.convex import ConvexMoments, convex_moments
from seedslib.gaussian.regions.law import scaled
from seedslib.gaussian.regions.twofold import Twofold, cross, dot, two_product, where

_BLOCK = 2048  # polygons at a time, fewer if
_PAIRS = 2_000_000  # they have many vertices: pairs of slab and edge at a time
_LARGEST = 1e140  # standard deviations
_ARC = 8  # chords of a full turn that close an unbounded region
_BEYOND = 40.0  # standard deviations: nothing is left there


class SlabMoments(NamedTuple):
    """Moments in components first, batch last."""

    log_mass: np.ndarray
    mean: np.ndarray
    cov: np.ndarray


class _Whitening(NamedTuple):
    """Lower triangular root of the covariance, ``[[first, 0], [mixed, second]]`` times `scale`."""

    first: Twofold
    mixed: Twofold
    second: Twofold
    scale: np.ndarray

    def apply(self, x: Twofold, y: Twofold) -> tuple[Twofold, Twofold]:
        """Whitened components of a displacement."""
        x, y = x.scaled(1.0 / self.scale[0]), y.scaled(1.0 / self.scale[1])
        zx = x / self.first
        return zx, (y - zx * self.mixed) / self.second

    def restore(self, zx: Twofold, zy: Twofold) -> tuple[Twofold, Twofold]:
        """The displacement of whitened components."""
        y = zx * self.mixed + zy * self.second
        return (zx * self.first).scaled(self.scale[0]), y.scaled(self.scale[1])

    def take(self, index: np.ndarray) -> _Whitening:
        """The roots of the given batch indices."""
        return _Whitening(*(part[index] for part in self[:3]), self.scale[:, index])


def slab_moments(
    mean: np.ndarray,
    cov: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    rays: np.ndarray | None,
    convex: np.ndarray,
) -> SlabMoments:
    """Moments over simple counter-clockwise polygons, by quadrature.

    Parameters
    ----------
    mean : ndarray, shape (2, B)
    cov : ndarray, shape (2, 2, B)
        Positive definite, with a determinant above `_law.SINGULAR` of the variances' product.
    x, y : ndarray, shape (V, B)
        Vertices.
    rays : ndarray, shape (2, 2, B), or None
        As in `Outline`.
    convex : ndarray of bool, shape (B,)
    """
    size = x.shape[1]
    log_mass, centre, spread = np.empty(size), np.empty((2, size)), np.empty((2, 2, size))
    step = max(1, min(_BLOCK, _PAIRS // x.shape[0] ** 2))
    for start in range(0, size, step):
        block = slice(start, start + step)
        part = None if rays is None else rays[:, :, block]
        log_mass[block], centre[:, block], spread[:, :, block] = _block(
            mean[:, block], cov[:, :, block], x[:, block], y[:, block], part, convex[block]
        )
    return SlabMoments(log_mass, centre, spread)


def _block(
    mean: np.ndarray,
    cov: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    rays: np.ndarray | None,
    convex: np.ndarray,
) -> SlabMoments:
    white = _whitening(cov)
    with np.errstate(over="ignore", invalid="ignore"):
        zx, zy = white.apply(Twofold.difference(x, mean[0]), Twofold.difference(y, mean[1]))
    _check_reach(zx, zy)
    if rays is not None:
        zx, zy = _close(zx, zy, rays, white)
    owners, pieces = [], []
    index = np.flatnonzero(convex)
    if index.size:
        owners.append(index)
        pieces.append(convex_moments(zx[:, index], zy[:, index]))
    index = np.flatnonzero(~convex)
    if index.size:
        owner, *corners = trapezoids(zx[:, index], zy[:, index])
        owners.append(index[owner])
        pieces.append(convex_moments(*corners))
    return _mixture(mean, white, owners, pieces)


def _check_reach(zx: Twofold, zy: Twofold) -> None:
    """Squares of distances must not overflow."""
    reach = np.maximum(np.abs(zx.hi), np.abs(zy.hi))
    if not (reach <= _LARGEST).all():
        raise ValueError(
            f"vertices: wanted vertices within {_LARGEST:g} standard deviations of the mean, got "
            f"{reach.max():.3g}; an unbounded region is given by rays"
        )


def _whitening(cov: np.ndarray) -> _Whitening:
    s, t, a, b, c = scaled(cov)
    determinant = Twofold(*two_product(a, c)) - Twofold(*two_product(b, b))
    first = Twofold.of(a).sqrt()
    second = (determinant / Twofold.of(a)).sqrt()
    return _Whitening(first, Twofold.of(b) / first, second, np.stack([s, t]))


def _close(
    zx: Twofold, zy: Twofold, rays: np.ndarray, white: _Whitening
) -> tuple[Twofold, Twofold]:
    """Unbounded regions closed by chords of a circle beyond everything that counts."""
    unbounded = rays.any(axis=(0, 1))
    radius = 4.0 * (np.hypot(zx.hi, zy.hi).max(axis=0) + _BEYOND)
    ends = []
    for ray, k in ((rays[1], -1), (rays[0], 0)):
        dx, dy = white.apply(Twofold.of(ray[0]), Twofold.of(ray[1]))
        norm = dot(dx, dy, dx, dy).sqrt()
        norm = where(unbounded, norm, Twofold.of(np.ones_like(radius)))
        dx, dy = dx / norm, dy / norm
        vx, vy = zx[k], zy[k]
        along = dot(vx, vy, dx, dy).hi
        square = dot(vx, vy, vx, vy).hi
        step = Twofold.of(np.sqrt(along**2 + (radius**2 - square)) - along)
        ends.append((vx + dx * step, vy + dy * step))
    (ox, oy), (ix, iy) = ends
    angle = np.arctan2(cross(ox, oy, ix, iy).hi, dot(ox, oy, ix, iy).hi)
    angle = np.where(angle < 0.0, angle + 2.0 * np.pi, angle)
    chords = np.maximum(np.ceil(angle * (_ARC / (2.0 * np.pi))), 1.0)
    step = np.arange(1, _ARC)[:, None]
    direction = np.arctan2(oy.hi, ox.hi) + angle * step / chords
    arc_x, arc_y = Twofold.of(radius * np.cos(direction)), Twofold.of(radius * np.sin(direction))
    on_arc = step < chords
    arc_x, arc_y = where(on_arc, arc_x, ix), where(on_arc, arc_y, iy)

    def join(z: Twofold, out: Twofold, arc: Twofold, back: Twofold) -> Twofold:
        more = [where(unbounded, item, z[-1]) for item in (out, arc, back)]
        parts = [z, more[0][None], more[1], more[2][None]]
        return Twofold(*(np.concatenate([getattr(p, n) for p in parts]) for n in ("hi", "lo")))

    return join(zx, ox, arc_x, ix), join(zy, oy, arc_y, iy)


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
    order = np.lexsort((y.lo, y.hi), axis=0)
    rank = np.empty_like(order)
    np.put_along_axis(rank, order, np.arange(order.shape[0])[:, None], axis=0)
    levels = y.along(order)
    partner = _partners(x, y, rank, levels)
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
    cx = Twofold(*(np.stack([getattr(c, n) for c in corners]) for n in ("hi", "lo")))
    ordinates = (y_low, y_low, y_high, y_high)
    cy = Twofold(*(np.stack([getattr(c, n) for c in ordinates]) for n in ("hi", "lo")))
    used = (y_high - y_low).hi > 0.0
    owner, cx, cy = owner[used], cx[:, used], cy[:, used]
    tx, ty = tx[owner], ty[owner]
    return owner, cx * ty + cy * tx, cy * ty - cx * tx


def _partners(x: Twofold, y: Twofold, rank: np.ndarray, levels: Twofold) -> np.ndarray:
    """For each slab and each edge that goes down through it, the edge across; -1 elsewhere."""
    slabs, edges = rank.shape[0] - 1, rank.shape[0]
    following = np.roll(rank, -1, axis=0)
    slab = np.arange(slabs)[:, None, None]
    up = (rank <= slab) & (following > slab)
    down = (following <= slab) & (rank > slab)
    middle = (levels[:-1] + levels[1:]).scaled(0.5)[:, None]
    dy = y.roll() - y
    slope = (x.roll() - x) / where(dy.hi != 0.0, dy, Twofold.of(np.ones_like(dy.hi)))
    at = x + (middle - y) * slope
    crossing = up | down
    order = np.lexsort((at.lo, np.where(crossing, at.hi, np.inf)), axis=1)
    pairs = edges // 2
    left, right = order[:, 0 : 2 * pairs : 2], order[:, 1 : 2 * pairs : 2]
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


def _mixture(
    mean: np.ndarray,
    white: _Whitening,
    owners: list[np.ndarray],
    pieces: list[ConvexMoments],
) -> SlabMoments:
    """Pieces of each polygon put together, in the coordinates of the caller."""
    owner = np.concatenate(owners)
    size = mean.shape[1]

    def joined(items: list[Twofold]) -> Twofold:
        return Twofold(*(np.concatenate([getattr(i, n) for i in items]) for n in ("hi", "lo")))

    square, px, py, fx, fy = (joined([piece[k] for piece in pieces]) for k in range(5))
    mass, x, y, xx, xy, yy = (
        np.concatenate([piece.gathered[k] for piece in pieces]) for k in range(6)
    )
    with np.errstate(divide="ignore"):
        log_piece = np.log(mass)
    rough = log_piece - 0.5 * square.hi
    # the heaviest piece is the reference, for exponents as for positions
    # only a reference for exponents: pieces that tie serve alike
    order = np.lexsort((rough, owner))
    best = order[np.flatnonzero(np.diff(owner[order], append=size))]
    reference = best[owner]
    some = mass[best] > 0.0
    scale = np.where(some, log_piece[best], 0.0)
    weight = np.exp(log_piece - scale[owner] - 0.5 * (square - square[reference]).hi)
    total = np.bincount(owner, weights=weight, minlength=size)
    share = weight / np.where(some, total, 1.0)[owner]
    root = white.take(owner)
    ox, oy = root.restore(px, py)
    e = [part.hi for part in root.restore(fy, -fx)]
    f = [part.hi for part in root.restore(fx, fy)]
    away = [(ox - ox[reference]).hi, (oy - oy[reference]).hi]
    away = [away[i] + (e[i] * x + f[i] * y) for i in range(2)]
    offset = [np.bincount(owner, weights=share * item, minlength=size) for item in away]
    gap = [away[i] - offset[i][owner] for i in range(2)]
    spread = np.empty((2, 2, size))
    for i in range(2):
        for j in range(i + 1):
            inner = e[i] * e[j] * xx + (e[i] * f[j] + f[i] * e[j]) * xy + f[i] * f[j] * yy
            spread[i, j] = spread[j, i] = np.bincount(
                owner, weights=share * (inner + gap[i] * gap[j]), minlength=size
            )
    origin = (ox[best], oy[best])
    centre = [(Twofold.of(mean[i]) + (origin[i] + Twofold.of(offset[i]))).hi for i in range(2)]
    log_mass = np.log(np.where(some, total, 1.0)) + scale - 0.5 * square.hi[best]
    log_mass = np.where(some, np.minimum(log_mass - np.log(2.0 * np.pi), 0.0), -np.inf)
    return SlabMoments(
        log_mass, np.where(some, np.stack(centre), np.nan), np.where(some, spread, np.nan)
    )
