"""Closed form of the moments over a polygon: a sum over its edges, with a bound of its error.

The paper's lemma 3 without its special cases. In whitened coordinates z an edge is its unit
direction tau, its signed distance h from the mean (positive with the mean on the left) and the
positions t1, t2 of its ends along tau. Green's theorem turns the first and second moments into
sums of normal densities and distribution functions of h, t1, t2; the mass needs Owen's T.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, owens_t

from seedslib.gaussian.regions.law import Cases
from seedslib.gaussian.regions.twofold import determinant

_U = 0.5 * np.finfo(float).eps
_TWO_PI = 2.0 * np.pi
# The bound adds up all roundings as if they conspired. On some 1e5 polygons of all kinds the
# largest error was a fourteenth of it wherever it was of use; a fifth of it is reported.
_SHARE = 0.2
_NONSENSE = 1e-6  # a mass that is itself rounding noise cannot vouch for its relative error


class EdgeMoments(NamedTuple):
    """Moments in components first, batch last; `estimate` is of the largest relative error."""

    log_mass: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    estimate: np.ndarray


def edge_moments(cases: Cases) -> EdgeMoments:
    """Moments over counter-clockwise polygons, by the closed form.

    Covariances have to be positive definite.

    Returns
    -------
    EdgeMoments
        `estimate` covers the error of ``ln P``, of the mean in standard deviations and of the
        covariance in units of the standard deviations; it is infinite where the closed form
        says nothing. It stems from a first-order bound of all roundings, from the coordinates to
        the sums.
    """
    with np.errstate(all="ignore"):
        return _moments(cases)


class _Lines(NamedTuple):
    """Edges in whitened coordinates, shape (M, B), and how far off rounding may have put them."""

    h: np.ndarray
    tau1: np.ndarray
    tau2: np.ndarray
    start: np.ndarray
    end: np.ndarray
    real: np.ndarray
    shift: np.ndarray
    tilt: np.ndarray


def _moments(cases: Cases) -> EdgeMoments:
    mean, cov, x, y, rays, _ = cases
    sigma = np.sqrt(cov[0, 0])
    slope = cov[0, 1] / cov[0, 0]
    rest = np.sqrt(determinant(cov[0, 0], cov[0, 1], cov[0, 1], cov[1, 1])) / sigma
    d1, d2 = x - mean[0], y - mean[1]
    z1, z2 = d1 / sigma, (d2 - slope * d1) / rest
    # the second component cancels when the law is nearly singular
    error = _U * (3.0 * np.abs(z1) + 4.0 * np.abs(z2))
    error += _U * (np.abs(d2) + 3.0 * np.abs(slope * d1)) / rest
    lines = _finite_edges(z1, z2, error)
    turn = 0.0
    if rays is not None:
        r1 = rays[:, 0] / sigma
        r2 = (rays[:, 1] - slope * rays[:, 0]) / rest
        ray_error = _U * (np.abs(rays[:, 1]) + 3.0 * np.abs(slope * rays[:, 0])) / rest
        unbounded = rays.any(axis=(0, 1))
        lines.real[-1] &= ~unbounded
        turn = np.where(unbounded, _angle(r1, r2, z1, z2), 0.0) / _TWO_PI
        ends = z1[[0, -1]], z2[[0, -1]], error[[0, -1]]
        more = _rays(ends, (r1, r2, ray_error), unbounded)
        lines = _Lines(*(np.concatenate(pair) for pair in zip(lines, more, strict=True)))
    mass, mass_error = _mass(lines, turn)
    first, second, first_error, second_error = _first_and_second(lines, mass)
    centre = first / mass
    spread = second / mass - centre[:, None] * centre[None, :]
    trace, det = spread[0, 0] + spread[1, 1], spread[0, 0] * spread[1, 1] - spread[0, 1] ** 2
    smallest = det / (0.5 * trace + np.sqrt(np.maximum(0.25 * trace**2 - det, 0.0)))
    away = np.hypot(*centre)
    change = second_error + 2.0 * away * first_error + (1.0 + away**2) * mass_error
    change = change / mass + 4.0 * _U * (1.0 + away**2)
    estimate = 8.0 * _U + _SHARE * (mass_error / mass + change / np.minimum(1.0, smallest))
    sound = (estimate < _NONSENSE) & (mass > 0.0) & (smallest > 0.0) & (trace > 0.0)
    root = np.array([[sigma, np.zeros_like(sigma)], [slope * sigma, rest]])
    return EdgeMoments(
        np.log(np.minimum(mass, 1.0)),
        mean + np.stack([sigma * centre[0], root[1, 0] * centre[0] + rest * centre[1]]),
        _congruence(root, spread),
        np.where(sound, estimate, np.inf),
    )


def _finite_edges(z1: np.ndarray, z2: np.ndarray, error: np.ndarray) -> _Lines:
    w1, w2 = np.roll(z1, -1, axis=0), np.roll(z2, -1, axis=0)
    v1, v2 = w1 - z1, w2 - z2
    length = np.hypot(v1, v2)
    real = length > 0.0
    unit = np.where(real, length, 1.0)
    tau1, tau2 = v1 / unit, v2 / unit
    both = error + np.roll(error, -1, axis=0)
    reach = np.abs(z1) + np.abs(z2)
    shift = both + 2.0 * _U * (reach + np.roll(reach, -1, axis=0))
    tilt = both / unit + 2.0 * _U
    start, end = z1 * tau1 + z2 * tau2, w1 * tau1 + w2 * tau2
    return _Lines(z1 * tau2 - z2 * tau1, tau1, tau2, start, end, real, shift, tilt)


def _rays(ends: Sequence, directions: Sequence, unbounded: np.ndarray) -> _Lines:
    """The incoming and the outgoing ray as edges, both in the direction of the boundary.

    Ends and directions are each two components, of shape (2, B), and how far off they may be.
    """
    (z1, z2, error), (r1, r2, ray_error) = ends, directions
    norm = np.where(unbounded, np.hypot(r1, r2), 1.0)
    way = np.array([[-1.0], [1.0]])
    tau1, tau2 = way * r1 / norm, way * r2 / norm
    position = z1 * tau1 + z2 * tau2
    infinite = np.full_like(position[0], np.inf)
    start, end = np.stack([-infinite, position[1]]), np.stack([position[0], infinite])
    real = np.broadcast_to(unbounded, tau1.shape)
    tilt = ray_error / norm + 6.0 * _U
    shift = error + 2.0 * _U * (np.abs(z1) + np.abs(z2)) + tilt * (1.0 + np.abs(position))
    return _Lines(z1 * tau2 - z2 * tau1, tau1, tau2, start, end, real, shift, tilt)


def _mass(lines: _Lines, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass and the bound of its error: the winding number less Owen's T at both ends."""
    side = np.copysign(1.0, lines.h)
    distance = np.abs(lines.h)
    owen = np.zeros((2, *distance.shape))
    angle = np.zeros_like(owen)
    for k, position in enumerate((lines.start, lines.end)):
        angle[k] = np.arctan2(position, distance)
        # on the line itself T and the angle cancel exactly; any ratio does for 0 / 0
        ratio = np.where(position == 0.0, 0.0, position / distance)
        owen[k] = owens_t(distance, ratio)
    winding = np.where(lines.real, side * (angle[1] - angle[0]), 0.0).sum(axis=0) / _TWO_PI + turn
    removed = np.where(lines.real, side * (owen[1] - owen[0]), 0.0).sum(axis=0)
    density = np.exp(-0.5 * distance**2) / np.sqrt(_TWO_PI)
    inside = ndtr(lines.end) - ndtr(lines.start)
    # where neighbouring edges disagree about their common vertex the winding is not an integer;
    # it may be rounded to one where the vertices are not so close that T disagrees as well
    fall = np.exp(-0.5 * (distance**2 + np.minimum(lines.start**2, lines.end**2)))
    closest = np.hypot(distance, np.minimum(np.abs(lines.start), np.abs(lines.end)))
    gap = lines.shift * fall / np.where(closest > 0.0, closest, 1e-300)
    per_edge = lines.shift * density * inside
    per_edge += 2.0 * _owen_error(distance) * np.exp(-0.5 * distance**2)
    whole = np.round(winding)
    rounded = _total(per_edge + gap, lines) + _U * np.abs(whole)
    plain = _total(per_edge + 0.2 * lines.shift + 2.0 * _U, lines)
    integral = (np.abs(winding - whole) < 1e-9) & (rounded < plain)
    mass = np.where(integral, whole, winding) - removed
    return mass, np.where(integral, rounded, plain)


def _first_and_second(
    lines: _Lines, mass: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The integrals of z and of z z', and the bounds of their errors."""
    density = np.where(lines.real, np.exp(-0.5 * lines.h**2) / np.sqrt(_TWO_PI), 0.0)
    at_start, at_end = (
        np.exp(-0.5 * position**2) / np.sqrt(_TWO_PI) for position in (lines.start, lines.end)
    )
    inside = ndtr(lines.end) - ndtr(lines.start)
    along = at_start - at_end
    n1, n2 = -lines.tau2, lines.tau1
    flow = density * inside
    normal, mixed = -lines.h * flow, density * along
    first = np.stack([(flow * n1).sum(axis=0), (flow * n2).sum(axis=0)])
    cross = (normal * n1 * n2 + 0.5 * mixed * (lines.tau1 * n2 + lines.tau2 * n1)).sum(axis=0)
    second = np.array(
        [
            [mass + (normal * n1 * n1 + mixed * lines.tau1 * n1).sum(axis=0), cross],
            [cross, mass + (normal * n2 * n2 + mixed * lines.tau2 * n2).sum(axis=0)],
        ]
    )
    # what a rounding may change, weighted with the distance from the mean at which it acts
    change = lines.shift * density * (inside + at_start + at_end)
    change += lines.tilt * density * (inside + np.abs(along)) + 3.0 * _U * density
    nearest = np.where(
        (lines.start < 0.0) & (lines.end > 0.0),
        0.0,
        np.minimum(np.abs(lines.start), np.abs(lines.end)),
    )
    size = 1.0 + lines.h**2 + nearest**2
    errors = _total(change * np.sqrt(size), lines), _total(change * size, lines)
    return first, second, *errors


def _total(per_edge: np.ndarray, lines: _Lines) -> np.ndarray:
    return np.where(lines.real, per_edge, 0.0).sum(axis=0)


def _congruence(root: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The matrix L C L' for lower triangular L."""
    a, b, c = root[0, 0], root[1, 0], root[1, 1]
    cross = a * (b * spread[0, 0] + c * spread[0, 1])
    corner = b * b * spread[0, 0] + 2.0 * b * c * spread[0, 1] + c * c * spread[1, 1]
    return np.array([[a * a * spread[0, 0], cross], [cross, corner]])


def _angle(r1: np.ndarray, r2: np.ndarray, z1: np.ndarray, z2: np.ndarray) -> np.ndarray:
    """Counter-clockwise angle from the outgoing ray to the incoming one, in [0, 2 pi]."""
    sine, cosine = r1[1] * r2[0] - r2[1] * r1[0], r1[1] * r1[0] + r2[1] * r2[0]
    angle = np.arctan2(sine, cosine)
    # equal directions: a half-strip lies between the rays, its complement around them
    side = r1[1] * (z2[0] - z2[-1]) - r2[1] * (z1[0] - z1[-1])
    angle = np.where((sine == 0.0) & (cosine > 0.0) & (side < 0.0), _TWO_PI, angle)
    return np.where(angle < 0.0, angle + _TWO_PI, angle)


def _owen_error(distance: np.ndarray) -> np.ndarray:
    """Error of `scipy.special.owens_t` relative to ``exp(-h^2/2)``, measured and rounded up."""
    bands = [distance < 2.0, distance < 2.5, distance < 4.5, distance < 12.0]
    return np.select(bands, [5e-16, 3e-15, 4e-14, 3e-15], 1e-7)
