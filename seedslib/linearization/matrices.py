"""The linearization of linear maps, which is none: their matrices are used as they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from seedslib.linearization.moments import Linearization, Moments
from seedslib.models.linear import LinearMap
from seedslib.models.maps import StochasticMap


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

        def f(t: float, mean: np.ndarray, cov: np.ndarray) -> Moments:
            slope = map.slope_at(t)
            lean = np.einsum("ij...,jk...->ik...", slope, cov)  # cov(y, x)
            y = map.pushed(t, np.einsum("ij...,j...->i...", slope, mean))
            cross = np.swapaxes(lean, 0, 1)
            if not spread:
                return Moments(y, cross, None)
            square = np.einsum("ij...,kj...->ik...", lean, slope)
            noise = map.cov_at(t)
            if noise.ndim == 2:
                noise = noise.reshape(*noise.shape, *(1,) * (square.ndim - 2))
            return Moments(y, cross, 0.5 * (square + np.swapaxes(square, 0, 1)) + noise)

        return f
