"""Two-dimensional quadrature of the normal density over trapezoids with horizontal bases.

A panel is ``y <= y' <= y + height``, ``left <= x <= right`` with sides that are straight lines,
in whitened coordinates measured from the point p of its convex region that is nearest to the
mean. The factor ``exp(-|p|^2/2)`` is left out; all sums have positive terms. The inner integrals
are the interval's rule, the outer one is Gauss-Legendre; a panel is halved until the Legendre
coefficients of its outer integrand have died out.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from seedslib.gaussian.arguments import blockwise
from seedslib.gaussian.regions.nodes import peak_rule, reach_of, unit_nodes

_OUTER = 20
_TAIL = 1e-8  # what the rule of degree 39 misses is about the square of coefficients 17 to 19
_FLOOR = 1e-20  # a panel below this part of its region's mass is never halved
_BLOCK = 2048  # panels evaluated together, 20 ordinates each
_DEPTH = 60


class Panels(NamedTuple):
    """Trapezoids.

    `owner`, shape (N,), is the index of the convex region. The rows of `sides`, shape (8, N), are
    the lower ordinate, the height, and at the lower and upper base in turn the left abscissa, the
    right abscissa and the width; the width is kept beside the difference since it may be far more
    accurate.
    """

    owner: np.ndarray
    sides: np.ndarray

    def split(self, parts: int) -> Panels:
        """Each panel cut into `parts` of equal height."""
        sides = np.repeat(self.sides, parts, axis=1)
        step = np.tile(np.arange(parts), self.owner.size)
        cut = sides.copy()
        cut[1] /= parts
        cut[0] += step * cut[1]
        for k in (2, 4, 6):
            low, high = sides[k], sides[k + 1]
            cut[k] = (low * (parts - step) + high * step) / parts
            cut[k + 1] = (low * (parts - step - 1) + high * (step + 1)) / parts
        return Panels(np.repeat(self.owner, parts), cut)


class Gathered(NamedTuple):
    """Per convex region: mass without ``exp(-|p|^2/2)``, mean from p, covariance."""

    mass: np.ndarray
    x: np.ndarray
    y: np.ndarray
    xx: np.ndarray
    xy: np.ndarray
    yy: np.ndarray


def integrate(panels: Panels, px: np.ndarray, py: np.ndarray) -> Gathered:
    """Moments of the convex regions made up by the panels; `px`, `py` have one entry for each."""
    regions = px.size
    owners, moments, floor = [], [], None
    for _ in range(_DEPTH):
        values, tail = _evaluate_all(panels, px, py)
        if floor is None:
            floor = _FLOOR * np.bincount(panels.owner, weights=values[0], minlength=regions)
        fine = ~(tail > np.maximum(_TAIL * values[0], floor[panels.owner]))
        owners.append(panels.owner[fine])
        moments.append(values[:, fine])
        if fine.all():
            break
        panels = Panels(panels.owner[~fine], panels.sides[:, ~fine]).split(2)
    return _gather(np.concatenate(owners), np.concatenate(moments, axis=1), regions)


def _evaluate_all(panels: Panels, px: np.ndarray, py: np.ndarray) -> list[np.ndarray]:
    """Block by block: moments (6, N) and tails (N,)."""
    px, py = px[panels.owner], py[panels.owner]
    return blockwise(
        lambda block: _evaluate(panels.sides[:, block], px[block], py[block]), px.size, _BLOCK
    )


def _evaluate(sides: np.ndarray, px: np.ndarray, py: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass, mean and covariance of panels, and the tail of their Legendre expansion."""
    nodes, weights, tail_rows = _outer_rule()
    lower, height = sides[0], sides[1]
    y = lower + height * nodes
    left, right, width = (sides[k] + (sides[k + 1] - sides[k]) * nodes for k in (2, 4, 6))
    # the point of the horizontal segment that is nearest to the mean
    from_left, from_right = px + left, px + right
    at_left, at_right = from_left > 0.0, from_right < 0.0
    peak = np.where(at_left, from_left, np.where(at_right, -from_right, 0.0))
    base = np.where(at_left, left, np.where(at_right, right, -px))
    reach = reach_of(peak)
    at_end = at_left | at_right
    begin = np.where(at_end, 0.0, np.maximum(from_left, -reach))
    length = np.minimum(np.where(at_end, width, from_right), reach) - begin
    inner, offset, spread = (
        item.reshape(y.shape) for item in peak_rule(peak.ravel(), begin.ravel(), length.ravel())
    )
    # no point is nearer to the mean than p: what rounding says below zero is zero
    inner *= np.exp(-0.5 * np.maximum(base * (base + 2.0 * px) + y * (y + 2.0 * py), 0.0))
    tail = np.abs(tail_rows @ inner).max(axis=0) * height
    inner *= weights
    total = inner.sum(axis=0)
    inner /= np.where(total > 0.0, total, 1.0)
    x = base + np.where(at_right, -offset, offset)
    mean_x, mean_y = (inner * x).sum(axis=0), (inner * y).sum(axis=0)
    dx, dy = x - mean_x, y - mean_y
    xx = (inner * (spread + dx * dx)).sum(axis=0)
    xy, yy = (inner * dx * dy).sum(axis=0), (inner * dy * dy).sum(axis=0)
    return np.stack([total * height, mean_x, mean_y, xx, xy, yy]), tail


@cache
def _outer_rule() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes and weights as columns, and the rows that give the last Legendre coefficients."""
    nodes, weights = unit_nodes(_OUTER)
    degrees = np.arange(_OUTER - 3, _OUTER)
    values = legendre.legvander(2.0 * nodes - 1.0, _OUTER - 1).T[degrees]
    return nodes[:, None], weights[:, None], (2 * degrees + 1)[:, None] * values * weights


def _gather(owner: np.ndarray, moments: np.ndarray, regions: int) -> Gathered:
    """Mixture of the panels of each region."""

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(owner, weights=values, minlength=regions)

    mass = total(moments[0])
    share = moments[0] / np.where(mass > 0.0, mass, 1.0)[owner]
    x, y = total(share * moments[1]), total(share * moments[2])
    dx, dy = moments[1] - x[owner], moments[2] - y[owner]
    xx = total(share * (moments[3] + dx * dx))
    xy = total(share * (moments[4] + dx * dy))
    return Gathered(mass, x, y, xx, xy, total(share * (moments[5] + dy * dy)))
