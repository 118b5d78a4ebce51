"""Gaussian laws without a density in the plane: on a line, or at a point."""

from __future__ import annotations

import numpy as np

from seedslib.gaussian.regions.geometry import closing_chords
from seedslib.gaussian.regions.law import Cases, FlatMoments
from seedslib.gaussian.regions.nodes import flat_interval
from seedslib.gaussian.regions.twofold import Twofold, binary_scale, cross

_BEYOND = 50.0


def singular_moments(cases: Cases) -> FlatMoments:
    """Moments over polygons of laws whose covariance has rank one or zero.

    The line of the law is moved by an infinitesimal ``(e^2, e)``, which makes every polygon
    half-open: a point on a boundary belongs to exactly one cell of a partition.
    """
    mean, cov, x, y, rays, _ = cases
    deviation = np.sqrt(np.stack([cov[0, 0], cov[1, 1]]))
    deviation[1] = np.copysign(deviation[1], cov[0, 1])
    point = ~deviation.any(axis=0)
    if rays is not None:
        x, y = _close(mean, deviation, x, y, rays)
    # the direction in exact numbers: the column of the covariance with the larger variance;
    # for a point any direction serves, along the first axis it is the usual crossing count
    larger = np.where(cov[0, 0] >= cov[1, 1], 0, 1)
    gx = np.where(larger == 0, cov[0, 0], cov[0, 1])
    gy = np.where(larger == 0, cov[0, 1], cov[1, 1])
    scale = binary_scale(np.maximum(np.abs(gx), np.abs(gy)))
    gx, gy = np.where(point, 1.0, gx / scale), gy / scale
    position, crossed = _crossings(mean, gx, gy, x, y)
    # from multiples of (gx, gy) to standard deviations of the coordinate along the line
    lead, unit = np.where(larger == 0, deviation[0], deviation[1]), np.where(larger == 0, gx, gy)
    lead = np.where(point, 1.0, lead)
    position = np.sort(np.where(crossed, position * (unit / lead), np.inf), axis=0)
    return _along_line(mean, deviation, point, position[:-1:2], position[1::2])


def _crossings(
    mean: np.ndarray, gx: np.ndarray, gy: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where each edge is met by the line, and whether it is."""
    dx, dy = Twofold.difference(x, mean[0]), Twofold.difference(y, mean[1])
    along = (Twofold.of(gx), Twofold.of(gy))
    side = cross(*along, dx, dy)
    # the moved line has the points that were on it on the side opposite to the move
    tie = -np.sign(np.where(gx != 0.0, gx, -gy))
    above = np.where(side.hi != 0.0, side.hi, np.broadcast_to(tie, side.hi.shape)) > 0.0
    crossed = above != np.roll(above, -1, axis=0)
    ex, ey = dx.roll() - dx, dy.roll() - dy
    turn = cross(*along, ex, ey)
    turn = Twofold(np.where(crossed & (turn.hi != 0.0), turn.hi, 1.0), turn.lo)
    return -(cross(ex, ey, dx, dy) / turn).hi, crossed


def _along_line(
    mean: np.ndarray, deviation: np.ndarray, point: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> FlatMoments:
    """Mixture of the intervals of a standard normal coordinate, (pairs, B) ends."""
    shape = lower.shape
    var = np.broadcast_to(np.where(point, 0.0, 1.0), shape).ravel()
    found = flat_interval(np.zeros(var.size), var, lower.ravel(), upper.ravel())
    log_masses, means, variances = (item.reshape(shape) for item in found)
    largest = log_masses.max(axis=0)
    some = largest > -np.inf
    weight = np.exp(log_masses - np.where(some, largest, 0.0))
    total = weight.sum(axis=0)
    share = weight / np.where(some, total, 1.0)
    used = weight > 0.0
    centres = np.where(used, means, 0.0)
    centre = (share * centres).sum(axis=0)
    spread = share * (np.where(used, variances, 0.0) + (centres - centre) ** 2)
    spread = np.where(some, spread.sum(axis=0), np.nan)
    centre = np.where(some, centre, np.nan)
    log_mass = np.where(some, np.log(np.where(some, total, 1.0)) + largest, -np.inf)
    return FlatMoments(
        np.minimum(log_mass, 0.0),
        mean + deviation * centre,
        deviation[:, None] * deviation[None, :] * spread,
    )


def _close(
    mean: np.ndarray, deviation: np.ndarray, x: np.ndarray, y: np.ndarray, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Unbounded regions closed beyond everything that counts."""
    unbounded = rays.any(axis=(0, 1))
    far = np.hypot(x - mean[0], y - mean[1]).max(axis=0)
    radius = 4.0 * (far + _BEYOND * np.hypot(*deviation) + np.where(far > 0.0, 0.0, 1.0))
    length = np.where(unbounded, np.hypot(rays[:, 0], rays[:, 1]), 1.0)
    ix, ox = rays[:, 0] / length
    iy, oy = rays[:, 1] / length
    angle = np.arctan2(ox * iy - oy * ix, ox * ix + oy * iy)
    side = ox * (y[0] - y[-1]) - oy * (x[0] - x[-1])
    around = (angle < 0.0) | ((angle == 0.0) & (side < 0.0))
    angle = np.where(around, angle + 2.0 * np.pi, angle)
    direction, on_arc = closing_chords(np.arctan2(oy, ox), angle)

    def join(
        z: np.ndarray, m: np.ndarray, out: np.ndarray, back: np.ndarray, arc: np.ndarray
    ) -> np.ndarray:
        first, last = z[0] + 2.0 * radius * back, z[-1] + 2.0 * radius * out
        middle = np.where(on_arc, m + 2.0 * radius * arc, first)
        more = [np.where(unbounded, item, z[-1]) for item in (last, *middle, first)]
        return np.concatenate([z, np.stack(more)])

    closed = join(x, mean[0], ox, ix, np.cos(direction))
    return closed, join(y, mean[1], oy, iy, np.sin(direction))
