"""Errors of exponential-polynomial functions from two correlated copies of the state.

If x and x' are copies of the state with covariance C each and cross-covariance X, then
``E f(x) f(x')'`` is the second moment of the optimal estimate for ``X = C - P`` and that of f for
``X = C``. Their difference is the optimal error. Where it is too small to be subtracted it is the
integral, over 0 < s < 1, of its derivative ``E grad f(x) P grad f(x')'`` at ``X = C - s P``;
likewise the plug-in's excess is a double integral of second derivatives. Every mean is one of
the same class of functions in 2n variables.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from seedslib.gaussian.means.compile import Compiled
from seedslib.gaussian.means.kernels import Group, HalfSpace
from seedslib.gaussian.means.polynomial import Coefficients, derivative

CANCELLED = 1e-2  # below this share of the second moments the integrals take over
LOST = 1e-6  # the same for conditional variances, where the integral is taken point by point
BLOCK = 1024
RULE_REACH = 3.25
SLOW, FASTEST = 0.05, 1e6  # rates of decay along the path that the rule tells apart


def unit_rule(rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Double-exponential nodes and weights on (0, 1) for functions such as ``exp(-rate s)``.

    In the variable t of the rule such a function falls over a width ``1 / (pi cosh t0)``, where
    ``pi sinh t0 = log(rate)``: the step has to resolve it.
    """
    step = 0.125
    if rate > SLOW:
        step = 0.08 / np.cosh(np.arcsinh(np.log(min(rate, FASTEST)) / np.pi))
    count = int(np.ceil(RULE_REACH / step))
    t = step * np.arange(-count, count + 1)
    lift = np.pi * np.sinh(t)
    node, complement = 1 / (1 + np.exp(-lift)), 1 / (1 + np.exp(lift))
    return node, step * np.pi * np.cosh(t) * node * complement


def decay_rate(function: Compiled, error_cov: np.ndarray) -> float:
    """Largest rate at which the integrand changes along the path, ``|c'Pc|`` and ``|PM|``."""
    rate = 0.0
    for group in function.groups:
        if group.linear is not None:
            c = np.abs(group.linear)
            rate = max(rate, float(np.max(np.einsum("i,ij...,j->...", c, np.abs(error_cov), c))))
        if group.quadratic is not None:
            size = np.abs(error_cov).sum(axis=1).max()
            rate = max(rate, float(2 * size * np.abs(group.quadratic).sum(axis=1).max()))
    return rate


def _blocks(places: np.ndarray) -> list[tuple[np.ndarray, ...]]:
    """Index arrays, one for each batch axis, of blocks of the listed places."""
    return [tuple(places[k : k + BLOCK].T) for k in range(0, len(places), BLOCK)]


def partial(group: Group, axis: int) -> Group:
    """Partial derivative of a group without a plane."""
    image = derivative(group.polynomial, axis)
    slopes: list[tuple[int | None, complex]] = []
    if group.linear is not None:
        slopes.append((None, group.linear[axis]))
    if group.quadratic is not None:
        slopes += [(j, -value) for j, value in enumerate(group.quadratic[axis])]
    for j, slope in slopes:
        if slope == 0:
            continue
        for alpha, c in group.polynomial.items():
            raised = alpha if j is None else (*alpha[:j], alpha[j] + 1, *alpha[j + 1 :])
            image[raised] = image.get(raised, 0.0) + slope * c
    return group._replace(polynomial=image)


def gradient(function: Compiled) -> Compiled:
    """All first derivatives of a function of p values: p n values, the axis fastest."""
    n, p = function.dimension, function.size
    groups = []
    for group in function.groups:
        table: Coefficients = {}
        for axis in range(n):
            for alpha, c in partial(group, axis).polynomial.items():
                column = table.setdefault(alpha, np.zeros((p, n), dtype=complex))
                column[:, axis] += c
        table = {alpha: c.reshape(-1) for alpha, c in table.items()}
        if table:
            groups.append(group._replace(polynomial=table))
    return Compiled(p * n, n, tuple(groups), ())


def product(left: Compiled, right: Compiled, *, joint: bool) -> Compiled:
    """Outer product of two functions without norms, of one x or, if `joint`, of two copies.

    The p q values have the index of the right function fastest; a joint product has 2 n
    variables, the first copy's first.
    """
    n = left.dimension
    merged: dict[bytes, Group] = {}
    for a in left.groups:
        for b in _unfolded(right.groups):
            group = _pair(a, b, n, joint)
            parts = (group.quadratic, group.linear, *(group.plane or ()))
            key = b"|".join(np.asarray(v if v is not None else 0.0).tobytes() for v in parts)
            if key in merged:
                table = dict(merged[key].polynomial)
                for alpha, c in group.polynomial.items():
                    table[alpha] = table.get(alpha, 0.0) + c
                group = group._replace(polynomial=table)
            merged[key] = group
    size = left.size * right.size
    return Compiled(size, n * (2 if joint else 1), tuple(merged.values()), ())


def _unfolded(groups: tuple[Group, ...]) -> list[Group]:
    """Groups whose sum is f itself: of a complex one half, and its conjugate."""
    result = []
    for group in groups:
        parts = (group.quadratic, group.linear)
        if not any(v is not None and np.iscomplexobj(v) for v in parts):
            result.append(group)
            continue
        half = {alpha: 0.5 * c for alpha, c in group.polynomial.items()}
        twin = {alpha: np.conj(c) for alpha, c in half.items()}
        conjugate = [None if v is None else np.conj(v) for v in parts]
        result += [group._replace(polynomial=half), Group(twin, *conjugate, group.plane)]
    return result


def _pair(a: Group, b: Group, n: int, joint: bool) -> Group:
    table: Coefficients = {}
    for alpha, c in a.polynomial.items():
        for beta, d in b.polynomial.items():
            index = (*alpha, *beta) if joint else tuple(map(sum, zip(alpha, beta, strict=True)))
            table[index] = table.get(index, 0.0) + np.outer(c, d).reshape(-1)
    quadratic, linear = [
        _joined(u, v, n, axes, joint)
        for u, v, axes in ((a.quadratic, b.quadratic, 2), (a.linear, b.linear, 1))
    ]
    return Group(table, quadratic, linear, _common_plane(a.plane, b.plane))


def _joined(
    left: np.ndarray | None, right: np.ndarray | None, n: int, axes: int, joint: bool
) -> np.ndarray | None:
    if left is None and right is None:
        return None
    left = np.zeros((n,) * axes) if left is None else left
    right = np.zeros((n,) * axes) if right is None else right
    if not joint:
        total = left + right
        return total if total.any() else None
    total = np.zeros((2 * n,) * axes, dtype=np.result_type(left, right))
    total[(slice(n),) * axes] = left
    total[(slice(n, None),) * axes] = right
    return total


def _common_plane(left: HalfSpace | None, right: HalfSpace | None) -> HalfSpace | None:
    if left is None or right is None:
        return left or right
    return left._replace(edge=left.edge * right.edge)


def pair_cov(first: np.ndarray, second: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """Covariance (2n, 2n, ...) of two copies with covariances `first`, `second` and `cross`."""
    upper = np.concatenate([first, cross], axis=1)
    lower = np.concatenate([np.swapaxes(cross, 0, 1), second], axis=1)
    return np.concatenate([upper, lower], axis=0)


class ReplicaErrors:
    """Errors of a function made of exponential groups; see the module."""

    def __init__(self, function: Compiled) -> None:
        self.function = function
        self.square: Any = product(function, function, joint=False)
        self.pair: Any = product(function, function, joint=True)

    @cached_property
    def slopes(self) -> Compiled:
        """``grad f(x) (x) grad f(x')``."""
        slope = gradient(self.function)
        return product(slope, slope, joint=True)

    @cached_property
    def curvatures(self) -> Compiled:
        """``grad grad f(x) (x) grad grad f(x')``."""
        curvature = gradient(gradient(self.function))
        return product(curvature, curvature, joint=True)

    def errors(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Optimal and plug-in error matrices (p, p)."""
        known = cov - error_cov
        moment = self._second(mean, cov)
        between = self._pair(mean, cov, cov, known)
        optimal = moment - between
        if (np.diag(optimal) < CANCELLED * np.diag(moment)).any():
            optimal = self.conditional(mean, cov, error_cov)
        plugin = self._second(mean, known)
        mixed = self._pair(mean, cov, known, known)
        excess = between - mixed - mixed.T + plugin
        scale = np.abs(np.diag(between)) + np.abs(np.diag(plugin))
        if (np.diag(excess) < CANCELLED * scale).any():
            excess = self._excess(mean, cov, error_cov)
        return optimal, optimal + excess

    def variance(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """Conditional variance (p, p, *batch) of f(x); a covariance has all batch axes or none."""
        size, batch = self.function.size, mean.shape[1:]
        average = self.function.mean(mean, cov)
        moment = self.square.mean(mean, cov).reshape(size, size, *batch)
        value = moment - average[:, None] * average[None]
        diagonals = [np.einsum("ii...->i...", v) for v in (value, moment)]
        lost = (diagonals[0] < LOST * diagonals[1]).any(axis=0)
        for index in _blocks(np.argwhere(lost)):
            part = cov if cov.ndim == 2 else cov[:, :, *index]
            value[:, :, *index] = self.conditional(mean[:, *index], part, part)
        return value

    def _second(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        return self.square.mean(mean, cov).reshape((self.function.size,) * 2)

    def _pair(
        self, mean: np.ndarray, first: np.ndarray, second: np.ndarray, cross: np.ndarray
    ) -> np.ndarray:
        both = pair_cov(first, second, cross)
        return self.pair.mean(np.concatenate([mean, mean]), both).reshape((self.function.size,) * 2)

    def conditional(self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray) -> np.ndarray:
        """Optimal error by the integral over the cross-covariance, nothing subtracted.

        `mean` may be (n, *batch) with covariances (n, n) or (n, n, *batch): then (p, p, *batch).
        """
        n, p, batch = self.function.dimension, self.function.size, mean.shape[1:]
        node, weight = unit_rule(decay_rate(self.function, error_cov))
        if cov.ndim == 2:
            cov, error_cov = (v.reshape(n, n, *(1,) * len(batch)) for v in (cov, error_cov))
        full = np.broadcast_to(cov[..., None], (*cov.shape, node.size))
        cross = cov[..., None] - error_cov[..., None] * node
        means = np.concatenate([mean, mean])[..., None]
        slopes = self.slopes.mean(means, pair_cov(full, full, cross))
        slopes = (slopes @ weight).reshape(p, n, p, n, *batch)
        return np.einsum("aibj...,ij...->ab...", slopes, error_cov)

    def _excess(self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray) -> np.ndarray:
        n, p = self.function.dimension, self.function.size
        node, weight = unit_rule(decay_rate(self.function, error_cov))
        known = (cov - error_cov)[..., None, None]
        share = error_cov[..., None, None]
        shape = (n, n, node.size, node.size)
        first = np.broadcast_to(known + share * node[:, None], shape)
        second = np.broadcast_to(known + share * node, shape)
        both = pair_cov(first, second, np.broadcast_to(known, shape))
        means = np.concatenate([mean, mean])[:, None, None]
        values = self.curvatures.mean(means, both) @ weight @ weight
        values = values.reshape(p, n, n, p, n, n)
        return 0.25 * np.einsum("aijbkl,ij,kl->ab", values, error_cov, error_cov)
