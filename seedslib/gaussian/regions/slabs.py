"""Robust moments over any simple polygon: quadrature that is accurate where the closed form is not.

The polygon is whitened in twofold numbers, closed far away where it is unbounded, and cut into
trapezoids where it is not convex; each convex piece is integrated around its own nearest point to
the mean, and the pieces are put together as a mixture. Nothing but positive sums enters a moment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.gaussian.arguments import blockwise
from seedslib.gaussian.regions.convex import ConvexMoments, convex_moments
from seedslib.gaussian.regions.geometry import closing_chords
from seedslib.gaussian.regions.law import Cases, FlatMoments, scaled
from seedslib.gaussian.regions.trapezoids import trapezoids
from seedslib.gaussian.regions.twofold import Twofold, cross, dot, together, two_product, where

_BLOCK = 2048  # polygons at a time, fewer if
_PAIRS = 2_000_000  # they have many vertices: pairs of slab and edge at a time
_LARGEST = 1e140  # standard deviations
_BEYOND = 40.0  # standard deviations: nothing is left there


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


def slab_moments(cases: Cases) -> FlatMoments:
    """Moments over simple counter-clockwise polygons, by quadrature.

    The determinant of a covariance is above `law.SINGULAR` of the variances' product.
    """
    step = max(1, min(_BLOCK, _PAIRS // cases.x.shape[0] ** 2))
    return FlatMoments(*blockwise(lambda block: _block(cases.take(block)), cases.convex.size, step))


def _block(cases: Cases) -> FlatMoments:
    mean, cov, x, y, rays, convex = cases
    white = _whitening(cov)
    with np.errstate(over="ignore", invalid="ignore"):
        zx, zy = white.apply(Twofold.difference(x, mean[0]), Twofold.difference(y, mean[1]))
    _check_reach(zx, zy)
    if rays is not None:
        zx, zy = _close(zx, zy, rays, white)
    whole, cut = np.flatnonzero(convex), np.flatnonzero(~convex)
    owners, pieces = [], []
    if whole.size:
        owners.append(whole)
        pieces.append(convex_moments(zx[:, whole], zy[:, whole]))
    if cut.size:
        owner, *corners = trapezoids(zx[:, cut], zy[:, cut])
        owners.append(cut[owner])
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
    direction, on_arc = closing_chords(np.arctan2(oy.hi, ox.hi), angle)
    arc_x, arc_y = Twofold.of(radius * np.cos(direction)), Twofold.of(radius * np.sin(direction))
    arc_x, arc_y = where(on_arc, arc_x, ix), where(on_arc, arc_y, iy)

    def join(z: Twofold, out: Twofold, arc: Twofold, back: Twofold) -> Twofold:
        more = [where(unbounded, item, z[-1]) for item in (out, arc, back)]
        return together(np.concatenate, [z, more[0][None], more[1], more[2][None]])

    return join(zx, ox, arc_x, ix), join(zy, oy, arc_y, iy)


def _mixture(
    mean: np.ndarray, white: _Whitening, owners: list[np.ndarray], pieces: list[ConvexMoments]
) -> FlatMoments:
    """Pieces of each polygon put together, in the coordinates of the caller.

    Piece k has the mass ``exp(-square_k / 2) mass_k / (2 pi)``, the mean ``p_k + x e + y f`` and
    the covariance ``xx e e' + xy (e f' + f e') + yy f f'``. With the shares s_k of the masses the
    mixture has

        mean  sum_k s_k mean_k,    cov  sum_k s_k [cov_k + (mean_k - mean)(mean_k - mean)'].
    """
    owner = np.concatenate(owners)
    size = mean.shape[1]
    square, px, py, fx, fy = (
        together(np.concatenate, [piece[k] for piece in pieces]) for k in range(5)
    )
    mass, x, y, xx, xy, yy = (
        np.concatenate([piece.gathered[k] for piece in pieces]) for k in range(6)
    )
    with np.errstate(divide="ignore"):
        log_piece = np.log(mass)
    rough = log_piece - 0.5 * square.hi
    # the heaviest piece is the reference, for exponents as for positions; pieces that tie serve
    # alike
    order = np.lexsort((rough, owner))
    best = order[np.flatnonzero(np.diff(owner[order], append=size))]
    reference = best[owner]
    some = mass[best] > 0.0
    scale = np.where(some, log_piece[best], 0.0)
    weight = np.exp(log_piece - scale[owner] - 0.5 * (square - square[reference]).hi)
    total = np.bincount(owner, weights=weight, minlength=size)
    share = weight / np.where(some, total, 1.0)[owner]
    # back to the caller's coordinates: nearest points in twofold numbers, frames in plain ones
    root = white.take(owner)
    ox, oy = root.restore(px, py)
    e = [part.hi for part in root.restore(fy, -fx)]
    f = [part.hi for part in root.restore(fx, fy)]
    # means, measured from the nearest point of the heaviest piece: short displacements
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
    # the last sum, that of the far origin, again in twofold numbers
    origin = (ox[best], oy[best])
    centre = [(Twofold.of(mean[i]) + (origin[i] + Twofold.of(offset[i]))).hi for i in range(2)]
    log_mass = np.log(np.where(some, total, 1.0)) + scale - 0.5 * square.hi[best]
    log_mass = np.where(some, np.minimum(log_mass - np.log(2.0 * np.pi), 0.0), -np.inf)
    return FlatMoments(
        log_mass, np.where(some, np.stack(centre), np.nan), np.where(some, spread, np.nan)
    )
