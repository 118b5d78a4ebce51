"""Moments of Gaussian distributions over polygons, bounded or not, by one quadrature rule.

The region is cut into trapezoids between the abscissae of its vertices. Given x, y lies in an
interval and is normal, so that its mass, mean and variance are those of an interval, known to full
digits; along x Gauss-Legendre panels are halved until each is resolved. The integrand of a
trapezoid, which is convex, is log-concave: straight lines through its logarithms bound what lies
between the nodes, and no peak is overlooked. Every sum has positive terms, and lengths are
measured from the point of the region nearest to the mean: tails and slivers keep their digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from seedslib.base.arrays import align
from seedslib.base.checks import as_real
from seedslib.gaussian.arguments import blockwise, gaussian_arguments
from seedslib.gaussian.regions import (
    SINGULAR,
    RegionMoments,
    difference_of_products,
    flat_interval,
    from_the_peak,
    peak_rule,
    unit_nodes,
)

BLOCK, PAIRS = 512, 100_000  # regions at a time, and pairs of their edges: arrays in the cache
ORDER = 18  # nodes of a panel: of a smooth one the first halving is the last
RESOLVED = 1e-8  # last Legendre coefficients beside the integral of a panel
SMOOTH = 3.0  # nats by which the integrand of a panel varies where only rounding is left
NATS = 46.0  # what is bounded this far below the largest integrand is left out
DEPTH = 80  # halvings of a panel: from any length down to one rounding
CLOSED = 60.0  # standard deviations beyond which an unbounded region may be closed
NEVER = 1e15  # squared distance beyond which the mass is zero
ROUNDING = 2.0**-52  # of a coordinate
LARGEST, TINY = 1e100, 1e-300  # deviations whose squares are in range, widths that are none


def polygon(
    mean: ArrayLike,
    cov: ArrayLike,
    vertices: ArrayLike,
    *,
    rays: ArrayLike | None = None,
) -> RegionMoments:
    """Mass, mean and covariance of a Gaussian vector in the plane over polygons (Kolessa, lemma 3).

    Polygons may be non-convex, slender, huge, far in the tails, and the covariance nearly or
    exactly singular; about twelve digits, six where a rounding of a vertex or of the covariance
    moves the moments that much. A distribution whose determinant is below 1e-15 of the product of
    its variances lives on a line or at a point; polygons are then half-open, so that a boundary
    point belongs to one cell of a partition.

    Parameters
    ----------
    mean, cov : array_like, shapes (2, ...) and (2, 2, ...)
        Batch axes come last and broadcast among all arguments.
    vertices : array_like, shape (V, 2, ...)
        In order, in either orientation; repeated ones are padding (see `pad_regions`). The
        boundary may touch but not cross itself: what an even number of edges separates from
        infinity is outside.
    rays : array_like, shape (2, 2, ...), optional
        Makes the region unbounded: directions from the first and from the last vertex to infinity.
        The boundary comes in along the first ray and goes out along the second one; the region
        lies on its *left*. A half-plane is one vertex with opposite rays, a wedge one vertex with
        two rays. Two zero rays mean a bounded polygon in the batch.

    Returns
    -------
    RegionMoments
        With `log_mass` (...), `mean` (2, ...), `cov` (2, 2, ...). Where the mass is zero, or
        ``ln P`` below -5e14, `log_mass` is ``-inf`` and the conditioned moments are NaN.

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, shapes that do not fit, no covariance; a polygon without area.

    Examples
    --------
    The quadrant ``x > 1, y > 1`` of two independent standard normal numbers:

    >>> import numpy as np
    >>> quadrant = polygon([0, 0], np.eye(2), [[1, 1]], rays=[[0, 1], [1, 0]])
    >>> print(f"{quadrant.mass:.6f} {quadrant.mean[0]:.6f}")
    0.025171 1.525135
    """
    mean, cov = gaussian_arguments(mean, cov, 2)
    vertices = as_real("vertices", vertices)
    if vertices.ndim < 2 or vertices.shape[1] != 2 or vertices.shape[0] < 1:
        raise ValueError(f"vertices: wanted shape (V, 2, ...), got {vertices.shape}")
    rays = np.zeros((2, 2)) if rays is None else as_real("rays", rays)
    if rays.shape[:2] != (2, 2) or (rays[0].any(axis=0) != rays[1].any(axis=0)).any():
        raise ValueError("rays: wanted two directions (2, 2, ...), or two zero ones")
    parts = [(mean, 1), (cov, 2), (vertices, 2), (rays, 2)]
    shapes = [part.shape[axes:] for part, axes in parts]
    try:
        batch = np.broadcast_shapes(*shapes)
    except ValueError:
        names = "mean, cov, vertices, rays"
        raise ValueError(f"{names}: wanted batch axes that broadcast, got {shapes}") from None
    flat = [
        np.broadcast_to(align(part, axes, len(batch)), (*part.shape[:axes], *batch)).reshape(
            *part.shape[:axes], -1
        )
        for part, axes in parts
    ]
    parts = blockwise(
        lambda block: _moments(*(part[..., block] for part in flat)),
        flat[0].shape[-1],
        max(1, min(BLOCK, PAIRS // len(vertices) ** 2)),
    )
    return RegionMoments(*(part.reshape((*part.shape[:-1], *batch)) for part in parts))


def pad_regions(regions: Sequence[ArrayLike]) -> np.ndarray:
    """Vertices of several polygons in one array, the shorter ones padded by their last vertex.

    Parameters
    ----------
    regions : sequence of array_like, each of shape (V_i, 2)

    Returns
    -------
    ndarray, shape (max V_i, 2, len(regions))
        As `polygon` takes it.

    Raises
    ------
    TypeError, ValueError
        A region that is not a table of finite vertices.
    """
    tables = [as_real(f"regions[{i}]", region, (None, 2)) for i, region in enumerate(regions)]
    longest = max(map(len, tables))
    padded = [np.pad(t, ((0, longest - len(t)), (0, 0)), mode="edge") for t in tables]
    return np.stack(padded, axis=-1)


class Whitened(NamedTuple):
    """Correlation, deviation of y given x and nearest point, all for unit variances.

    The point (u, v) of the region nearest to the mean is that of the whitened coordinates: x, and
    what y has beyond its regression on x in its own deviations.
    """

    correlation: np.ndarray
    rest: np.ndarray
    u: np.ndarray
    v: np.ndarray

    def coordinates(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A vector in deviations, whitened."""
        return x, (y - self.correlation * x) / self.rest


def _moments(
    mean: np.ndarray, cov: np.ndarray, vertices: np.ndarray, rays: np.ndarray
) -> list[np.ndarray]:
    """Log-mass (B,), mean (2, B) and covariance (2, 2, B)."""
    (a, b), (_, c) = cov
    deviation = np.sqrt(np.array([a, c]))
    unbounded = rays.any(axis=(0, 1))
    unit = np.where(deviation > 0, deviation, 1.0)
    if unbounded.any():
        ends = _far_points((vertices - mean) / unit, rays / unit, unbounded)
        vertices = np.concatenate([vertices, np.where(unbounded, mean + unit * ends, vertices[-1])])
    product = np.where(a * c > 0, a * c, 1.0)
    determinant = np.where(a * c > 0, difference_of_products(a, c, b, b) / product, 0.0)
    plane = determinant > SINGULAR
    whitened = Whitened(b / np.sqrt(product), np.sqrt(np.maximum(determinant, 0.0)), 0 * a, 0 * a)
    result = [np.empty(plane.shape), np.empty(mean.shape), np.empty(cov.shape)]
    for chosen in (plane, ~plane):
        if not chosen.any():
            continue
        region = (part[..., chosen] for part in (mean, vertices, deviation))
        if chosen is plane:
            parts = _in_the_plane(*region, Whitened(*(part[chosen] for part in whitened)))
        else:
            parts = _on_a_line(*region, np.where(b < 0, -1.0, 1.0)[chosen])
        for whole, part in zip(result, parts, strict=True):
            whole[..., chosen] = part
    return result


def _in_the_plane(
    mean: np.ndarray, vertices: np.ndarray, deviation: np.ndarray, whitened: Whitened
) -> tuple[np.ndarray, ...]:
    away = (vertices - mean) / deviation
    z = whitened.coordinates(away[:, 0], away[:, 1])
    if not (np.abs(z) < LARGEST).all():
        raise ValueError("vertices: wanted vertices within 1e100 standard deviations; use rays")
    edge, share, inside = _nearest(*z)
    corner = np.take_along_axis(vertices, edge[None, None], 0)[0]
    following = np.take_along_axis(np.roll(vertices, -1, axis=0), edge[None, None], 0)[0]
    origin = np.where(inside, mean, corner + share * (following - corner))
    u, v = whitened.coordinates(*((origin - mean) / deviation))
    square = u * u + v * v
    none = square > NEVER
    whitened = whitened._replace(u=np.where(none, 0.0, u), v=np.where(none, 0.0, v))
    x, y = np.moveaxis((vertices - origin) / deviation, 1, 0)
    mass, mx, my, xx, xy, yy = _integrated(_trapezoids(x, y, whitened), whitened)
    if ((mass == 0) & ~none).any():
        raise ValueError("vertices: wanted polygons with an area, got a degenerate polygon")
    log_mass = np.log(np.where(none, 1.0, mass)) - 0.5 * square - np.log(2.0 * np.pi)
    centre = origin + deviation * np.stack([mx, my])
    cov = deviation[:, None] * deviation * np.array([[xx, xy], [xy, yy]])
    return (
        np.where(none, -np.inf, np.minimum(log_mass, 0.0)),
        np.where(none, np.nan, centre),
        np.where(none, np.nan, cov),
    )


def _on_a_line(
    mean: np.ndarray, vertices: np.ndarray, deviation: np.ndarray, sign: np.ndarray
) -> tuple[np.ndarray, ...]:
    """A distribution along one direction, or at a point: a mixture of intervals.

    A point of the line on the boundary belongs to one of two neighbours.
    """
    along = deviation * np.stack([np.ones_like(sign), sign])
    point = ~along.any(axis=0)
    direction = np.where(point, np.array([[1.0], [0.0]]), along)
    # the line is x = 0, 1 at one deviation from the mean, and y across it
    away = (vertices - mean) / (direction**2).sum(axis=0)
    x = (away * direction).sum(axis=1)
    y = away[:, 1] * direction[0] - away[:, 0] * direction[1]
    nx, ny = np.roll(x, -1, axis=0), np.roll(y, -1, axis=0)
    crossed = (y > 0) != (ny > 0)
    at = x - y * (nx - x) / np.where(crossed, ny - y, 1.0)
    at = np.sort(np.where(crossed, at, np.inf), axis=0)
    pairs = len(at) // 2
    low, high = at[: 2 * pairs : 2], at[1::2]
    var, zero = np.broadcast_to(np.where(point, 0.0, 1.0), low.shape), np.zeros(low.size)
    logs, means, variances = flat_interval(zero, var.ravel(), low.ravel(), high.ravel())
    owner = np.broadcast_to(np.arange(low.shape[1]), low.shape).ravel()
    top = logs.reshape(low.shape).max(axis=0)
    none = top == -np.inf
    top = np.where(none, 0.0, top)
    weight = np.exp(logs - top[owner])
    parts = [np.where(weight > 0, part, 0.0) for part in (weight, means, zero, variances)]
    mass, centre, _, square, _, _ = _mixed(owner, [*parts, zero, zero], low.shape[1])
    return (
        np.where(none, -np.inf, np.minimum(np.log(np.where(none, 1.0, mass)) + top, 0.0)),
        np.where(none, np.nan, mean + along * centre),
        np.where(none, np.nan, along[:, None] * along * square),
    )


def _far_points(away: np.ndarray, rays: np.ndarray, unbounded: np.ndarray) -> np.ndarray:
    """Points (9, 2, B) that close an unbounded region: from the last vertex to the first one."""
    norm = np.where(unbounded, np.hypot(rays[:, 0], rays[:, 1]), 1.0)
    inward, outward = rays / norm[:, None]
    turn = np.arctan2(
        outward[0] * inward[1] - outward[1] * inward[0], (outward * inward).sum(axis=0)
    )
    # equal directions: the strip between the rays, or all but it
    across = away[0] - away[-1]
    around = (turn == 0) & (outward[0] * across[1] - outward[1] * across[0] < 0)
    turn = np.where((turn < 0) | around, turn + 2 * np.pi, turn)
    radius = 4.0 * (np.hypot(away[:, 0], away[:, 1]).max(axis=0) + CLOSED)
    angle = np.arctan2(outward[1], outward[0]) + turn * np.linspace(0.0, 1.0, 9)[1:-1, None]
    arc = 2.0 * radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = (away[-1] + radius * outward)[None], (away[0] + radius * inward)[None]
    return np.concatenate([ends[0], arc, ends[1]])


def _nearest(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edge (B,) and place on it of the point of polygons (V, B) nearest to the origin.

    Last whether the origin is inside.
    """
    nx, ny = np.roll(x, -1, axis=0), np.roll(y, -1, axis=0)
    ex, ey = nx - x, ny - y
    square = ex * ex + ey * ey
    share = np.clip(-(x * ex + y * ey) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    edge = np.argmin((x + share * ex) ** 2 + (y + share * ey) ** 2, axis=0)
    crossed = (y > 0) != (ny > 0)
    beyond = x - y * ex / np.where(crossed, ey, 1.0) > 0
    inside = (crossed & beyond).sum(axis=0) % 2 == 1
    return edge, np.take_along_axis(share, edge[None], 0)[0], inside


class Panels(NamedTuple):
    """Trapezoids (N,): whose they are, where x begins and its length, the sides in y.

    `sides` (3, 2, N) holds the lower and the upper side and the width, at both ends of x. Last
    what rounding makes of the integrand, relatively.
    """

    owner: np.ndarray
    start: np.ndarray
    step: np.ndarray
    sides: np.ndarray
    noise: np.ndarray

    def halved(self) -> Panels:
        """Each cut in two of half the length."""
        half = 0.5 * self.step
        low, high = self.sides[:, :1], self.sides[:, 1:]
        middle = 0.5 * (low + high)
        pairs = [np.concatenate(pair, axis=1) for pair in ((low, middle), (middle, high))]
        start = np.concatenate([self.start, self.start + half])
        owner, half, noise = (np.tile(part, 2) for part in (self.owner, half, self.noise))
        return Panels(owner, start, half, np.concatenate(pairs, axis=2), noise)

    def take(self, chosen: np.ndarray) -> Panels:
        """Some of them."""
        return Panels(*(part[..., chosen] for part in self))


def _trapezoids(x: np.ndarray, y: np.ndarray, whitened: Whitened) -> Panels:
    """Polygons (V, B), from their nearest point, cut at the abscissae of their vertices."""
    distance = np.hypot(whitened.u, whitened.v)
    reach = np.sqrt(distance**2 + 2.0 * NATS)
    levels = np.sort(np.clip(x, -whitened.u - reach, -whitened.u + reach), axis=0)
    nx, ny = np.roll(x, -1, axis=0), np.roll(y, -1, axis=0)
    slope = (ny - y) / np.where(nx != x, nx - x, 1.0)
    bottom, top = np.minimum(y, ny), np.maximum(y, ny)
    # a side is known best at the nearer of its ends, a long one at its crossing of the axis
    nearer = np.abs(nx) + np.abs(ny) < np.abs(x) + np.abs(y)
    ax, ay = np.where(nearer, nx, x), np.where(nearer, ny, y)
    across = difference_of_products(y, nx, ny, x) / np.where(nx != x, nx - x, 1.0)
    passes = ((x < 0) != (nx < 0)) & (np.abs(across) < np.abs(ax) + np.abs(ay))
    ax, ay = np.where(passes, 0.0, ax), np.where(passes, across, ay)

    def at(level: np.ndarray) -> np.ndarray:
        return np.clip(ay + (level[:, None] - ax) * slope, bottom, top)

    middle = 0.5 * (levels[:-1] + levels[1:])
    crossing = (x <= middle[:, None]) != (nx <= middle[:, None])
    crossing &= (levels[1:] > levels[:-1])[:, None]
    order = np.argsort(np.where(crossing, at(middle), np.inf), axis=1)
    crossing = np.take_along_axis(crossing, order, 1)
    low, high = (np.take_along_axis(at(level), order, 1) for level in (levels[:-1], levels[1:]))
    size = np.take_along_axis((np.abs(ay) + np.abs(ax * slope))[None], order, 1)
    size = np.maximum(size[:, :-1], size[:, 1:])
    gaps = np.stack([end[:, 1:] - end[:, :-1] for end in (low, high)])
    used = crossing[:, :-1] & (gaps.max(axis=0) > 0)
    used[:, 1::2] = False
    slab, _, owner = np.nonzero(used)
    width = np.maximum(gaps[:, used], 0.0)
    sides = [[end[:, :-1][used] for end in (low, high)], [end[:, 1:][used] for end in (low, high)]]
    start, stop = levels[slab, owner], levels[slab + 1, owner]
    noise = ROUNDING * size[used] / width.max(axis=0)
    steepness = 2.0 * (distance + 10.0) / whitened.rest
    noise += ROUNDING * np.maximum(np.abs(start), np.abs(stop)) * steepness[owner]
    return Panels(owner, start, stop - start, np.stack([*np.array(sides), width]), noise)


def _integrated(panels: Panels, whitened: Whitened) -> list[np.ndarray]:
    """Mass beside the density of the nearest point, mean and covariance of each region."""
    best = np.full(whitened.u.size, -np.inf)
    done = []
    for _ in range(DEPTH):
        values, missed, (least, height), bound = _evaluated(panels, whitened)
        np.maximum.at(best, panels.owner, height)
        smooth = (height - least < SMOOTH) & (missed <= 8.0 * panels.noise)
        fine = (missed <= RESOLVED) | smooth | (bound < best[panels.owner] - NATS)
        done.append((panels.owner[fine], *values[:, fine]))
        if fine.all():
            break
        panels = panels.take(~fine).halved()
    else:
        raise ValueError("vertices: wanted a region that panels resolve, got one beyond rounding")
    owner, *parts = map(np.concatenate, zip(*done, strict=True))
    return _mixed(owner, parts, best.size)


def _evaluated(panels: Panels, whitened: Whitened) -> tuple[np.ndarray, ...]:
    """Mass, mean and covariance (6, N) of panels; how much of the mass the rule may have missed.

    Then the range of the logarithm of the integrand at the nodes, and its bound between them.
    """
    nodes, weights, last, ends = _rule()
    correlation, rest, u, v = (part[panels.owner] for part in whitened)
    x = panels.start + panels.step * nodes
    low, high, width = (side[0] + (side[1] - side[0]) * nodes for side in panels.sides)
    # the interval of the whitened y: steps from the nearest point, then places
    below, above = (low - correlation * x) / rest, (high - correlation * x) / rest
    interval = from_the_peak(v + below, v + above, width / rest)
    mirrored, tail, peak, left, extent = interval
    total, offset, shrunk = (
        part.reshape(x.shape)
        for part in peak_rule(peak.ravel(), left.ravel(), np.maximum(extent, TINY).ravel())
    )
    step = np.where(tail, np.where(mirrored, above, below), -v)
    height = np.log(total) - 0.5 * (x * (x + 2.0 * u) + step * (step + 2.0 * v))
    beyond = np.where(mirrored, high - rest * offset, low + rest * offset)
    y = np.where(tail, beyond, correlation * x + rest * (offset - v))
    bound, inside = _bound(height, nodes), slice(1, -1)
    edges = height[[0, -1]]
    x, y, shrunk, height = x[inside], y[inside], shrunk[inside], height[inside]
    top = height.max(axis=0)
    inner = np.exp(height - top)
    missed = np.abs(last @ inner).max(axis=0)
    # what the nodes do not see, a fall of the integrand at an end
    missed += nodes[1] * np.abs(ends @ inner - np.exp(np.minimum(edges - top, 1.0))).max(axis=0)
    inner *= weights
    mass = inner.sum(axis=0)
    share = inner / mass
    mx, my = (share * x).sum(axis=0), (share * y).sum(axis=0)
    dx, dy = x - mx, y - my
    square = [
        (share * part).sum(axis=0) for part in (dx * dx, dx * dy, rest * rest * shrunk + dy * dy)
    ]
    values = np.stack([mass * panels.step * np.exp(top), mx, my, *square])
    return values, missed / mass, (height.min(axis=0), top), bound


def _bound(height: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Largest value of a concave function with these values at the nodes, ends included."""
    gap = np.diff(nodes, axis=0)
    slope = np.diff(height, axis=0) / gap
    inf = np.full((1, height.shape[1]), np.inf)
    # between two nodes: below the line through the two before, and below that of the two behind
    before = np.concatenate([inf, height[1:-1] + np.maximum(slope[:-1], 0.0) * gap[1:]])
    behind = np.concatenate([height[1:-1] - np.minimum(slope[1:], 0.0) * gap[:-1], inf])
    return np.minimum(before, behind).max(axis=0)


@cache
def _rule() -> tuple[np.ndarray, ...]:
    """Gauss-Legendre on (0, 1) as columns, the ends among the nodes.

    Then rows that give the last Legendre coefficients, and the interpolated values at the ends.
    """
    nodes, weights = unit_nodes(ORDER)
    degrees = np.arange(ORDER)
    values = (
        (2 * degrees + 1)[:, None] * legendre.legvander(2.0 * nodes - 1.0, ORDER - 1).T * weights
    )
    ends = legendre.legvander([-1.0, 1.0], ORDER - 1) @ values
    return np.array([0.0, *nodes, 1.0])[:, None], weights[:, None], values[-3:], ends


def _mixed(owner: np.ndarray, parts: Sequence[np.ndarray], size: int) -> list[np.ndarray]:
    """Mixture of the parts of each region: mass, mean and covariance, (size,) each."""

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(owner, values, size)

    mass = total(parts[0])
    share = parts[0] / np.where(mass > 0, mass, 1.0)[owner]
    mx, my = total(share * parts[1]), total(share * parts[2])
    dx, dy = parts[1] - mx[owner], parts[2] - my[owner]
    squares = zip(parts[3:], (dx * dx, dx * dy, dy * dy), strict=True)
    return [mass, mx, my, *(total(share * (inner + between)) for inner, between in squares)]
