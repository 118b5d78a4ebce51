"""Linearizations that evaluate the map at points: unscented, cubature, Gauss-Hermite."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray, align
from seedslib.base.checks import as_count
from seedslib.base.circle import nearest
from seedslib.base.linalg import cholesky, symmetric
from seedslib.base.values import Values
from seedslib.gaussian.quadrature import cubature, rule_of_rank, unscented
from seedslib.linearization.moments import (
    Gaussian,
    Linearization,
    Moments,
    Weighted,
    refuse_weight,
)
from seedslib.models.maps import Conditional, Noise, StochasticMap

SMALL = 1e-150
"""Points of a smaller weight count for nothing: its square is out of the range of numbers."""


class Points(NamedTuple):
    """Points of a rule for N(mean, cov), with the weights of means and of centred squares."""

    unit: np.ndarray  # (n, S), of the standard normal state
    root: np.ndarray  # (n, n, *batch), factor of the covariance
    x: np.ndarray  # (n, S, *batch)
    v: np.ndarray | None  # (q, S, *batch); None where noise is averaged otherwise
    weights: np.ndarray  # (S,)
    centred: np.ndarray  # (S,)

    def cross(self, deviations: np.ndarray) -> np.ndarray:
        """Covariance (n, m, *batch) of the state with values less their mean (m, S, *batch)."""
        slope = np.einsum("js,is...,s->ji...", self.unit, deviations, self.centred)
        return np.einsum("kj...,ji...->ki...", self.root, slope)


class PointRule(Linearization):
    """Means as weighted sums over points of a standard normal vector, moved to N(m, D).

    Remark 3 of the jump-diffusion paper. Where the map knows its mean and covariance given x,
    points are laid in the space of x; otherwise in the joint space of x and the noise. A new
    rule has to write `rule` only.
    """

    @abstractmethod
    def rule(self, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (size, S), weights (S,) of means and weights (S,) of centred squares."""

    def _points(self, mean: np.ndarray, cov: np.ndarray, noise: Noise | None = None) -> Points:
        """Points of the state, and of a noise where one is given."""
        return self._along(mean, cholesky(cov), noise)

    def _along(self, mean: np.ndarray, root: np.ndarray, noise: Noise | None = None) -> Points:
        """The same along the columns of a root of the covariance."""
        n, depth = len(mean), max(mean.ndim - 1, root.ndim - 2)
        mean, root = align(mean, 1, depth), align(root, 2, depth)
        unit, weights, centred = _rule(self, n if noise is None else n + noise.size)
        x, v = mean[:, None] + np.einsum("ij...,js->is...", root, unit[:n]), None
        if noise is not None:
            v = noise.mean[:, None] + noise.root @ unit[n:]
            v = np.broadcast_to(align(v, 2, depth), v.shape + x.shape[2:])
        return Points(unit[:n], root, x, v, weights, centred)

    def moments(self, map: StochasticMap, spread: bool = True) -> Callable[..., Moments]:
        """See `Linearization.moments`."""
        refuse_weight(map)
        given = _conditional(map)
        noise = map.noise if given is None else None

        def f(t: float, mean: np.ndarray, cov: np.ndarray, p: Values = ()) -> Moments:
            points = self._points(np.asarray(mean, dtype=float), cov, noise)
            h, deviations = _averaged(map, given, t, points, p)
            cross = points.cross(deviations)
            if not spread:
                return Moments(h, cross, None)
            square = np.einsum("is...,js...,s->ij...", deviations, deviations, points.centred)
            if given is not None:
                noise_cov = given.cov(t, points.x, p)
                square = square + np.einsum("ijs...,s->ij...", noise_cov, points.weights)
            return Moments(h, cross, square)

        return f

    def roots(self, map: StochasticMap) -> Callable[..., tuple[np.ndarray, ...]]:
        """Moments without a square: those of a state given by a root of its covariance.

        Returns
        -------
        callable
            ``f(t, mean, root, p) -> (E y, X, Y, noise)`` with X Xᵀ = cov x, X Yᵀ = cov(x, y) and
            Y Yᵀ + noise = cov y, shapes (m, *batch), (n, S, *batch), (m, S, *batch) and
            (m, m, *batch).

        Raises
        ------
        ValueError
            A rule whose weights of squares are negative or do not give the covariance of the
            state, a map with a weight.
        """
        refuse_weight(map)
        given = _conditional(map)
        noise = map.noise if given is None else None
        size = map.state_size + (0 if noise is None else noise.size)
        unit, _, centred = _rule(self, size)
        if (centred < 0).any() or not np.allclose((unit * centred) @ unit.T, np.eye(size)):
            raise ValueError(
                "linearization: wanted weights that are not negative and give the covariance, got "
                f"those of {self!r} for {size} numbers; see Cubature"
            )

        def f(t: float, mean: np.ndarray, root: np.ndarray, p: Values = ()) -> tuple[Any, ...]:
            points = self._along(np.asarray(mean, dtype=float), root, noise)
            h, deviations = _averaged(map, given, t, points, p)
            scale = np.sqrt(points.centred)
            X = np.einsum("ij...,js,s->is...", points.root, points.unit, scale)
            Y = np.einsum("is...,s->is...", deviations, scale)
            if given is None:
                return h, X, Y, np.zeros((map.size, map.size))
            noise_cov = given.cov(t, points.x, p)
            return h, X, Y, np.einsum("ijs...,s->ij...", noise_cov, points.weights)

        return f

    def flow(self, system: object) -> Callable[..., Moments]:
        """See `Linearization.flow`; both means are taken at the same points."""
        none = np.empty((0, 1))

        def rates(t: float, mean: np.ndarray, cov: np.ndarray, p: Values = ()) -> Moments:
            points = self._points(np.asarray(mean, dtype=float), cov)
            b = system.drift_map.value(t, points.x, none, p)
            velocity, diffusion = (
                np.einsum("is...,s->i...", y, points.weights)
                for y in (b, system.spread_map.value(t, points.x, none, p))
            )
            cross = points.cross(b - velocity[:, None])
            return Moments(velocity, cross, symmetric(diffusion, system.state_size))

        return rates

    def row(self, maps: Sequence[StochasticMap]) -> Callable[..., list[Weighted]]:
        """See `Linearization.row`; the weights of the points are those of means.

        Where mean and covariance of a branch given x have closed forms, so that they may stand
        for a weight that mentions the noise, (6.23) and (6.27) of the switching paper, points are
        laid in the space of x. Equal values at equal points are taken once.
        """
        branches = [(map, given := _conditional(map), _kind(map, bool(given))) for map in maps]

        def f(t: float, mean: np.ndarray, cov: np.ndarray, p: Values = ()) -> list[Weighted]:
            clouds: dict[int | None, Points] = {}
            values: dict[object, tuple] = {}
            result = []
            for map, given, kind in branches:
                space = None if given else id(map.noise)
                if space not in clouds:
                    clouds[space] = self._points(mean, cov, None if given else map.noise)
                _, _, x, v, weights, _ = clouds[space]
                if kind not in values:
                    with np.errstate(divide="ignore", invalid="ignore"):  # points without weight
                        moments = (given.mean(t, x, p), given.cov(t, x, p)) if given else None
                        values[kind] = moments or (map.value(t, x, v, p), None)
                share = given.weight(t, x, p) if given else map.weight(t, x, v, p)
                share = share * weights.reshape(-1, *(1,) * (x.ndim - 2))
                result.append(_branch(x, share, *values[kind]))
            return result

        return f


def _averaged(
    map: StochasticMap, given: Conditional | None, t: float, points: Points, p: Values
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (m, *batch) of the values of a map at points, and what they deviate from it by."""
    y = given.mean(t, points.x, p) if given else map.value(t, points.x, points.v, p)
    # about one of the values, so that equal ones are exactly their mean
    start = y[:, :1]
    y = nearest(y, start, map.period)
    h = start[:, 0] + np.einsum("is...,s->i...", y - start, points.weights)
    return h, y - h[:, None]


def _kind(map: StochasticMap, conditional: bool) -> object:
    """What branches have in common whose values and their noise are the same at each point."""
    if not map.symbolic:
        return id(map)

    weight = conditional
    if conditional and map.weight_expression.free_symbols & set(map.noise.symbols):
        weight = map.weight_expression  # the noise in the branch depends on it
    return tuple(map.expressions), id(map.noise), weight


def _branch(x: np.ndarray, share: np.ndarray, y: np.ndarray, noise_cov: MaybeArray) -> Weighted:
    """Moments of a branch from points x, its part of their weights, E y and cov y given each."""
    empty = np.abs(share) < SMALL  # there the mean in the branch may be 0 / 0
    share, y = np.where(empty, 0.0, share), np.where(empty, 0.0, y)
    mass = share.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = share / mass
    mean_x, mean_y = ((share * part).sum(axis=1) for part in (x, y))
    dx, dy = x - mean_x[:, None], y - mean_y[:, None]
    squares = "is...,js...,s...->ij..."
    square = np.einsum(squares, dy, dy, share)
    if noise_cov is not None:
        square = square + (share * np.where(empty, 0.0, noise_cov)).sum(axis=2)
    state = Gaussian(mean_x, np.einsum(squares, dx, dx, share))
    return Weighted(mass, state, Moments(mean_y, np.einsum(squares, dx, dy, share), square))


@lru_cache(maxsize=64)
def _rule(rule: PointRule, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return rule.rule(size)


def _conditional(map: StochasticMap) -> Conditional | None:
    """Conditional moments of a map as functions, or None where points must cover the noise."""
    if not map.symbolic and map.weighted:
        return None
    try:
        return map.conditional
    except ValueError:
        return None


@dataclass(frozen=True)
class Cubature(PointRule):
    """Third-degree spherical rule: 2n points m ± sqrt(n) L e_i of equal weight."""

    def rule(self, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `PointRule.rule`."""
        rule = cubature(size)
        return rule.points, rule.weights, rule.weights


@dataclass(frozen=True)
class Unscented(PointRule):
    """Unscented transform: 2n + 1 points m and m ± sqrt(alpha² (n + kappa)) L e_i.

    Parameters
    ----------
    alpha, beta : float
        Spread of the points and correction of the central weight of squares.
    kappa : float, optional
        3 - n by default, which with alpha = 1 and beta = 0 makes fourth moments right along
        each axis.
    """

    alpha: float = 1.0
    beta: float = 0.0
    kappa: float | None = None

    def rule(self, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `PointRule.rule`.

        Raises
        ------
        ValueError
            alpha² (n + kappa) is not positive.
        """
        kappa = 3.0 - size if self.kappa is None else self.kappa
        rule = unscented(size, self.alpha**2 * (size + kappa) - size)
        centred = rule.weights.copy()
        centred[0] += 1.0 - self.alpha**2 + self.beta
        return rule.points, rule.weights, centred


@dataclass(frozen=True)
class GaussHermite(PointRule):
    """Product rule with `order` Gauss-Hermite nodes in each direction, order**n points.

    Exact for polynomials of degree below 2 `order` in each variable.
    """

    order: int = 5

    def __post_init__(self) -> None:
        as_count("order", self.order)

    def rule(self, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `PointRule.rule`."""
        points, weights = rule_of_rank(size, self.order)
        return points, weights, weights
