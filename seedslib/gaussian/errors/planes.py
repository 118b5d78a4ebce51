"""Mean-square errors of polynomials with one switching plane, by nested quadrature.

The conditional variance and the bias of the plug-in estimate are a rule over ``x - xhat``, their
means one over ``xhat``. Across the plane both rules are Gauss-Legendre panels split at the kink,
along it Gauss-Hermite rules that are exact. Differences are taken from ``f(xhat)`` on, so that
errors far smaller than f keep their digits. Without a plane only the exact rule is left.
"""

from __future__ import annotations

from math import prod

import numpy as np

from seedslib.base.semidefinite import square_root
from seedslib.gaussian.arguments import blockwise
from seedslib.gaussian.errors.joint import joint_factor
from seedslib.gaussian.means.compile import Compiled
from seedslib.gaussian.means.kernels import HalfSpace, inner_product
from seedslib.gaussian.means.polynomial import polynomial_value
from seedslib.gaussian.quadrature import rule_of_rank

SIDE = np.polynomial.legendre.leggauss(52)
PANEL = np.polynomial.legendre.leggauss(18)
REACH = 9.5
# breaks in deviations of the estimate and of its error
WIDE = np.array([0.0, 2.0, 4.0, 6.5, REACH])
NARROW = np.array([0.0, 1.0, 2.5, 5.0, 9.5, 16.0])
POINTS = 250_000  # evaluations at a time
SMALL = 1e-12  # deviations along the plane beside the largest one that are rounding
NEGLIGIBLE = 4e-16


class SwitchedMoments:
    """Conditional moments of ``base(x) + 1{u > 0} jump(x)`` given the estimate of x, and errors.

    On the plane itself the function is ``base(x) + edge(x)``.
    """

    def __init__(self, function: Compiled) -> None:
        planes = [group.plane for group in function.groups if group.plane]
        self.size = function.size
        self.plane: HalfSpace | None = planes[-1] if planes else None
        self.base, self.jump, self.edge = {}, {}, {}
        for group in function.groups:
            if group.plane is None:
                shares = (1.0, 0.0, 0.0)
            elif np.array_equal(group.plane.normal, self.plane.normal):
                shares = (0.0, 1.0, group.plane.edge)
            else:  # p 1{-u > 0} is p - p 1{u > 0}
                shares = (1.0, -1.0, group.plane.edge - 1.0)
            for table, share in zip((self.base, self.jump, self.edge), shares, strict=True):
                for alpha, c in group.polynomial.items():
                    table[alpha] = table.get(alpha, 0.0) + share * c
        self.degree = max(map(sum, (*self.base, *self.jump)), default=0)

    def moments(self, xhat: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Variance (p, p, *batch) and bias ``E f - f(xhat)`` (p, *batch).

        `xhat` is (n, *batch), `cov` is (n, n) or (n, n, *batch).
        """
        n, batch = len(xhat), xhat.shape[1:]
        flat, spread = xhat.reshape(n, prod(batch)), cov.reshape(n, n, prod(cov.shape[2:]))
        nodes = (self.degree + 1) ** n if self.plane is None else (self.degree + 1) ** (n - 1) * 104
        parts = blockwise(
            lambda k: self._block(flat[:, k], spread[..., k] if cov.ndim > 2 else spread),
            flat.shape[1],
            max(1, POINTS // nodes),
        )
        return tuple(part.reshape(*part.shape[:-1], *batch) for part in parts)

    def _block(self, xhat: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.plane is None:
            side = np.zeros(xhat.shape[1])
            step, weights = _along(cov, self.degree + 1)
            value = polynomial_value(self.base, xhat[:, None] + step, self.size)
        else:
            level = inner_product(self.plane.normal, xhat) + self.plane.offset
            side = np.sign(level) + 1.0  # 0 below the plane, 1 on it, 2 above
            direction = np.einsum("ijk,j->ik", cov, self.plane.normal)
            spread = inner_product(self.plane.normal, direction)
            varies = spread > 0
            deviation = np.sqrt(np.where(varies, spread, 1.0))
            gain = np.where(varies, direction / deviation, 0.0)
            z, across = _split_normal(-level / deviation)
            along, weights = _along(cov - gain[:, None] * gain, self.degree + 1, self.plane.normal)
            step = gain[:, None, None] * z[:, None] + along[:, None]
            above = np.arange(len(z))[:, None, None] >= len(z) // 2  # by the panel, not by rounding
            place = np.where(varies, 2.0 * above, side)
            value = self._value(place, xhat[:, None, None] + step)
            count = len(z) * len(weights)
            value = value.reshape(self.size, count, xhat.shape[1])
            weights = (across[:, None] * weights).reshape(count, xhat.shape[1])
        gap = value - self._value(side, xhat)[:, None]
        bias = np.einsum("pjk,jk->pk", gap, weights)
        away = gap - bias[:, None]
        return np.einsum("pjk,qjk,jk->pqk", away, away, weights), bias

    def _value(self, side: np.ndarray, point: np.ndarray) -> np.ndarray:
        total = polynomial_value(self.base, point, self.size)
        for number, table in ((2.0, self.jump), (1.0, self.edge)):
            if self.plane is not None and (side == number).any():
                total = total + (side == number) * polynomial_value(table, point, self.size)
        return total

    def errors(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Optimal and plug-in error matrices (p, p) of a function with a plane."""
        normal = self.plane.normal
        factor, shares = joint_factor(cov, error_cov)
        known = (factor * (1.0 - shares)) @ factor.T
        direction, centre = known @ normal, normal @ mean + self.plane.offset
        spread, rest = normal @ direction, known
        gain, across, weights = np.zeros(len(mean)), np.zeros(1), np.ones(1)
        if spread > NEGLIGIBLE * (normal @ cov @ normal):
            deviation = np.sqrt(spread)
            error = np.sqrt(max(normal @ error_cov @ normal, 0.0))
            across, weights = split_rule(centre, deviation, error)
            gain = direction / deviation
            rest = known - np.outer(gain, gain)
        root = square_root(rest)
        scale = np.abs(root).max(axis=0)
        root = root[:, (scale > SMALL * scale.max(initial=0.0)) & (self.degree > 0)]
        grid, along = rule_of_rank(root.shape[1], self.degree + 1)
        points = (
            mean[:, None, None] + gain[:, None, None] * across[:, None] + (root @ grid)[:, None]
        )
        weights = weights[:, None] * along
        variance, bias = self.moments(points, error_cov)
        optimal = np.tensordot(variance, weights, axes=2)
        return optimal, optimal + np.tensordot(bias[:, None] * bias, weights, axes=2)


def _along(cov: np.ndarray, order: int, normal: np.ndarray | None = None) -> tuple:
    """Gauss-Hermite steps (n, G, K) and weights (G, 1) of N(0, cov), where given in a plane."""
    n = len(cov)
    pivot = None if normal is None else int(np.argmax(np.abs(normal)))
    others = [i for i in range(n) if i != pivot]
    grid, weights = rule_of_rank(len(others) if order > 1 else 0, order)
    step = np.zeros((n, len(weights), cov.shape[2]))
    if order > 1 and others:
        root = square_root(np.moveaxis(cov[np.ix_(others, others)], -1, 0))
        step[others] = np.einsum("kij,jg->igk", root, grid)
    if normal is not None:  # the component with the largest part in the normal follows
        step[pivot] = -np.tensordot(normal[others], step[others], 1) / normal[pivot]
    return step, weights[:, None]


def _split_normal(kink: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights (J, K) of the standard normal law, half of them beyond each kink (K,)."""
    kink = np.clip(kink, -REACH, REACH)
    nodes, lengths = 0.5 * (SIDE[0][:, None] + 1.0), 0.5 * SIDE[1][:, None]
    z = np.concatenate([-REACH + (kink + REACH) * nodes, kink + (REACH - kink) * nodes])
    share = np.concatenate([(kink + REACH) * lengths, (REACH - kink) * lengths])
    share = share * np.exp(-0.5 * z * z)
    return z, share / share.sum(axis=0)


def split_rule(mean: np.ndarray, deviation: np.ndarray, error: np.ndarray) -> tuple:
    """Nodes z and weights (S, ...) for ``mean + deviation z``, z normal, split where that is zero.

    They are graded on the scale of the estimate and, about the kink, on that of its error.
    """
    safe = np.where(deviation > 0, deviation, 1.0)
    kink, narrow = -mean / safe, error / safe
    steps = np.concatenate([-NARROW[::-1], NARROW])
    edges = [*(w + 0 * kink for w in (*-WIDE, *WIDE)), *(kink + s * narrow for s in steps)]
    edges = np.sort(np.clip(np.stack(edges), -REACH, REACH), axis=0)
    half = 0.5 * np.diff(edges, axis=0)
    nodes = PANEL[0].reshape(-1, 1, *[1] * np.ndim(kink))
    weights = PANEL[1].reshape(nodes.shape)
    z = (edges[:-1] + half * (1.0 + nodes)).reshape(-1, *np.shape(kink))
    weights = (half * weights).reshape(z.shape) * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    return z, weights
