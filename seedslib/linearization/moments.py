"""Conditional moments: what a map y = g(t, x, v) does to a Gaussian state.

A linearization turns such a map and N(m, D) into the mean of y, its covariance with x, and its
covariance; every filter that takes means uses nothing else. A new one writes `moments`, from which
continuous-time flows follow, and `row` where it is for systems that switch.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray, align, product
from seedslib.base.linalg import lower_triangle, symmetric, symmetrized
from seedslib.base.values import Values
from seedslib.models.linear import LinearMap
from seedslib.models.maps import StochasticMap

TINY = np.finfo(float).tiny
"""Branches of a smaller mass count as empty."""


class Moments(NamedTuple):
    """Moments of y = g(t, x, v) for a state x with a given mean and covariance.

    Attributes
    ----------
    mean : ndarray, shape (m, *batch)
        E y.
    cross : ndarray, shape (n, m, *batch)
        cov(x, y). It is the primitive rather than a gain matrix: it needs no inverse of the
        covariance of x and exists for sigma points too.
    cov : ndarray, shape (m, m, *batch), or None
        cov y, the noise included; None where it was not asked for.
    """

    mean: np.ndarray
    cross: np.ndarray
    cov: MaybeArray


class Gaussian(NamedTuple):
    """Mean, shape (n, *batch), and covariance, shape (n, n, *batch)."""

    mean: np.ndarray
    cov: np.ndarray


class Weighted(NamedTuple):
    """What a branch of a switching map does to a Gaussian state.

    Attributes
    ----------
    mass : ndarray, shape (*batch)
        Probability of the branch, E w(x, v).
    state : Gaussian
        Moments of x in the branch.
    value : Moments
        Moments of y, and its covariance with x, in the branch.

    Notes
    -----
    All moments are centred, so no digits are lost far from the origin. Where the mass is zero
    they are NaN.
    """

    mass: np.ndarray
    state: Gaussian
    value: Moments


class Linearization(ABC):
    """How means of functions of a Gaussian state are taken."""

    @abstractmethod
    def moments(self, map: StochasticMap, spread: bool = True) -> Callable[..., Moments]:
        """Moments of y = g(t, x, v) for x ~ N(mean, cov).

        Parameters
        ----------
        map : StochasticMap
        spread : bool
            Whether the covariance of y is wanted.

        Returns
        -------
        callable
            ``f(t, mean, cov, p) -> Moments`` for arrays of shapes (n, *batch), (n, n, *batch)
            and the numbers p of the map's `parameters`, () by default; a covariance common to all
            items comes as (n, n). `cross` and `cov` of the result need batch axes only where they
            depend on them.

        Raises
        ------
        ValueError
            A map with a weight, for which `weighted` is meant.
        """

    def flow(self, system: object) -> Callable[..., Moments]:
        """Rates of the moments of a jump-diffusion, (8.1) of the jump-diffusion paper.

        With b = a + mu s̄ and Sigma = B Bᵀ + mu S₂ the mean changes by E b and the covariance by
        cov(b, x) + cov(x, b) + E Sigma.

        Parameters
        ----------
        system : JumpDiffusion
            Or anything with a `drift_map` and a `spread_map`.

        Returns
        -------
        callable
            ``f(t, mean, cov, p) -> Moments(E b, cov(x, b), E Sigma)``.
        """
        velocity = self.moments(system.drift_map, spread=False)
        diffusion = self.moments(system.spread_map, spread=False)

        def rates(t: float, mean: np.ndarray, cov: np.ndarray, p: Values = ()) -> Moments:
            b, lower = velocity(t, mean, cov, p), diffusion(t, mean, cov, p).mean
            return Moments(b.mean, b.cross, symmetric(lower, len(mean)))

        return rates

    def rate(self, system: object) -> Callable[..., list[Any]]:
        """The same on a list of components, for the integration of many paths at once.

        Returns
        -------
        callable
            ``f(t, components, p) -> list`` of time derivatives; the components are those of the
            mean, then of the covariance on and below the diagonal row by row.
        """
        flow, n = self.flow(system), system.state_size

        def derivative(t: float, components: Sequence, p: Values = ()) -> list:
            batch = np.broadcast_shapes(*(np.shape(c) for c in components))
            full = np.stack([np.broadcast_to(c, batch) for c in components])
            mean, cross, diffusion = flow(t, full[:n], symmetric(full[n:], n), p)
            change = cross + np.swapaxes(cross, 0, 1) + diffusion
            return [*mean, *change[lower_triangle(n)]]

        return derivative

    def row(self, maps: Sequence[StochasticMap]) -> Callable[..., list[Weighted]]:
        """Moments of branches of one state that are taken with probabilities weight(t, x, v).

        Parameters
        ----------
        maps : sequence of StochasticMap
            Such as the moves from one mode; those with the same value share its evaluation where
            the linearization can.

        Returns
        -------
        callable
            ``f(t, mean, cov, p) -> list of Weighted``, one for each map.

        Raises
        ------
        NotImplementedError
            A linearization that was not written for branches.
        """
        raise NotImplementedError(f"{type(self).__name__}: wanted one with `row`, for branches")

    def weighted(self, map: StochasticMap) -> Callable[..., Weighted]:
        """Moments of one branch, ``f(t, mean, cov, p) -> Weighted``; see `row`."""
        row = self.row([map])
        return lambda t, mean, cov, p=(): row(t, mean, cov, p)[0]


@dataclass(frozen=True)
class Matrices(Linearization):
    """Moments of linear maps from their matrices, exact and without compilation."""

    def moments(self, map: StochasticMap, spread: bool = True) -> Callable[..., Moments]:
        """See `Linearization.moments`.

        Raises
        ------
        TypeError
            The map is not a `LinearMap`.
        """
        if not isinstance(map, LinearMap):
            raise TypeError(f"map: wanted one of a LinearSystem, got {map!r}")

        def f(t: float, mean: np.ndarray, cov: np.ndarray, p: Values = ()) -> Moments:
            slope = map.slope_at(t, p)
            y = product(slope, mean, 1)
            y = y + align(map.offset_at(t, p), 1, y.ndim - 1)
            cross = product(slope, cov, 2).swapaxes(0, 1)
            if not spread:
                return Moments(y, cross, None)
            square = product(slope, cross, 2)
            square, noise = symmetrized(square), map.cov_at(t, p)
            depth = max(square.ndim, noise.ndim) - 2  # one of them may be common to all paths
            return Moments(y, cross, align(square, 2, depth) + align(noise, 2, depth))

        return f


def as_linearization(value: Any) -> Linearization:
    """The linearization that was passed.

    Raises
    ------
    TypeError
        Something else.
    """
    if not isinstance(value, Linearization):
        raise TypeError(f"linearization: wanted a Linearization, got {value!r}")
    return value


def refuse_weight(map: StochasticMap) -> None:
    """Raise ValueError for a branch of a switching map where a whole map is wanted."""
    if map.weighted:
        raise ValueError("map: wanted a map that always applies, got a branch; use weighted()")
