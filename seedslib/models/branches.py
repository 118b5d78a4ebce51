"""A map together with the probability that it is the one that happens, and its density."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np

from seedslib.base.checks import unmasked
from seedslib.base.parameters import Parameter, parameters_of
from seedslib.models.densities import noise_of
from seedslib.models.maps import StochasticMap


def parameters_in(table: Iterable[Iterable[Branch | None]]) -> tuple[Parameter, ...]:
    """The parameters that the formulas of branches mention."""
    maps = [b.map for row in table for b in row if b is not None and b.map.symbolic]
    return parameters_of(e for m in maps for e in (m.weight_expression, *m.expressions))


class Branch:
    """One branch of a switching map: y = value(t, x, v), taken with probability w(t, x, v).

    Parameters
    ----------
    map : StochasticMap
        With its weight.

    Attributes
    ----------
    map, whole : StochasticMap
        With the weight, and without.
    """

    def __init__(self, map: StochasticMap) -> None:
        self.map: StochasticMap = map
        self.whole: StochasticMap = map.whole()

    def __reduce__(self) -> tuple[Any, ...]:
        return Branch, (self.map,)  # what was compiled stays behind

    @cached_property
    def constant(self) -> bool:
        """Whether the probability depends on neither state nor noise."""
        map = self.map
        if not map.symbolic:
            return not map.weighted
        return not map.weight_expression.free_symbols & {*map.state, *map.noise.symbols}

    @cached_property
    def depends_on_noise(self) -> bool:
        """Whether the probability mentions the noise of the map: dependent noises."""
        map = self.map
        if not map.symbolic:
            return map.weighted
        return bool(map.weight_expression.free_symbols & set(map.noise.symbols))

    @cached_property
    def has_log_density(self) -> bool:
        """Whether `log_density` exists."""
        if not self.whole.has_log_density:
            return False
        return not self.depends_on_noise or self._residual_noise is not None

    @cached_property
    def probability_expression(self) -> Any:
        """SymPy probability of the branch given the state.

        Raises
        ------
        NoClosedForm
            The mean over the noise has no closed form, or the map is not symbolic.
        """
        if not self.map.symbolic:
            from seedslib.gaussian.means.classes import NoClosedForm

            raise NoClosedForm("probability: array functions have no closed form")
        if not self.depends_on_noise:
            return self.map.weight_expression
        return self.map.noise.expectation(self.map.weight_expression)

    @cached_property
    def _probability(self):
        from seedslib.models.codegen import compile_array

        return compile_array((self.map.time, self.map.state), self.probability_expression)

    def probability(self, t: float, x: np.ndarray) -> np.ndarray:
        """Probability of the branch given the state, shape (*batch).

        Where it depends on the noise: the closed form if there is one, otherwise nine
        Gauss-Hermite nodes per component of Gaussian noise.

        Raises
        ------
        ValueError
            No closed form, and noise that is not Gaussian.
        """
        x = np.asarray(x, dtype=float)
        if not self.depends_on_noise:
            none = np.zeros((self.map.noise.size, *(1,) * (x.ndim - 1)))
            return np.broadcast_to(self.map.weight(t, x, none), x.shape[1:])
        try:
            return np.broadcast_to(self._probability(t, x), x.shape[1:])
        except ValueError:
            if not self.map.noise.gaussian:
                raise
        states, v, weights = self.map.noise.nodes(x)
        shares = np.broadcast_to(self.map.weight(t, states, v), v.shape[1:])
        return np.einsum("s...,s->...", shares, weights)

    def log_density(self, t: float, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Logarithm of the joint density of y and the branch given x, shape (*batch).

        A measurement that is missing as a whole (NaN) leaves the probability of the branch.

        Raises
        ------
        ValueError
            There is no closed form: the noise enters nonlinearly, is not Gaussian, or is not
            determined by the measurement although the probability depends on it.
        """
        plain = self.whole.log_density(t, y, x)
        y = np.asarray(unmasked("y", y, missing=np.nan), dtype=float)
        x = np.asarray(x, dtype=float)
        with np.errstate(divide="ignore"):
            if not self.depends_on_noise:
                return plain + np.log(self.probability(t, x))
            if not self.has_log_density:
                raise ValueError(
                    "log_density: wanted noise that the value determines where the probability "
                    "of a branch depends on it"
                )
            missing = np.isnan(y).any(axis=0)
            v = self._residual_noise(t, x, np.where(missing, 0.0, y))
            found = plain + np.log(self.map.weight(t, x, v))
            if missing.any():
                blind = plain + np.log(self.probability(t, x))
                found = np.where(missing, blind, found)
            return found

    @cached_property
    def _residual_noise(self):
        """The noise as a function of (t, x, y) where the value is affine in it and invertible."""
        found = noise_of(self.map) if self.whole.has_log_density else None
        if found is None:
            return None
        from seedslib.models.codegen import compile_array

        y, noise, _ = found
        return compile_array((self.map.time, self.map.state, y), noise)
