"""A map together with the probability that it is the one that happens, and its density."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.models.densities import noise_of
from seedslib.models.maps import StochasticMap
from seedslib.models.noise import Noise

CLOSE = 1e-9
"""Probabilities may miss their sum or their range by this much."""


class Branch:
    """One branch of a switching map: y = value(t, x, v), taken with probability w(t, x, v).

    Parameters
    ----------
    map : StochasticMap
        With its weight.
    apart : bool
        Whether a weight given as an array function is known not to look at the noise.

    Attributes
    ----------
    map, whole : StochasticMap
        With the weight, and without.
    """

    def __init__(self, map: StochasticMap, apart: bool = False) -> None:
        self.map: StochasticMap = map
        self.apart: bool = apart
        self.whole: StochasticMap = map.whole()

    def __reduce__(self) -> tuple[Any, ...]:
        return Branch, (self.map, self.apart)  # what was compiled stays behind

    @cached_property
    def still(self) -> Branch:
        """The switch alone, the state left where it is; of a probability without noise."""
        map = self.map
        if map.symbolic:
            return Branch(
                StochasticMap(map.state, map.state, None, map.weight_expression, time=map.time)
            )
        weight = partial(_calm, map) if map.weighted else None
        n = map.state_size
        return Branch(StochasticMap.from_functions(n, n, _same, weight=weight), True)

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
            return map.weighted and not self.apart
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
        y = np.asarray(y, dtype=float)
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
        found = noise_of(self.map)
        if found is None:
            return None
        from seedslib.models.codegen import compile_array

        y, noise, _ = found
        return compile_array((self.map.time, self.map.state, y), noise)


def branch_table(
    name: str, table: Sequence, noise: Noise, x: np.ndarray, v: np.ndarray, new: bool = False
) -> tuple[tuple[Branch | None, ...], ...]:
    """Branches without those of probability zero; all probabilities are looked at first.

    Parameters
    ----------
    name : str
        Of the probabilities, for messages.
    table : sequence of sequence of StochasticMap, shape (L, L) or (L, M)
    noise : Noise
        That of all maps.
    x, v : ndarray, shapes (n, N) and (noise size, N)
        States and noises where the maps are looked at.
    new : bool
        Whether the maps of a column have one value, those of the new mode, and not those of a row.

    Raises
    ------
    ValueError
        No probabilities, or maps that differ where they must not.
    """
    size, found = table[0][0].size, []
    for i, row in enumerate(table):
        for l, other in enumerate(row):
            if not other.noise.alike(noise):
                raise ValueError(f"{name}: wanted maps with one noise, got another in mode {i}")
            if other.size != size:
                raise ValueError(f"{name}: wanted maps of {size} values in mode {i}")
            mode, first = (l, table[0][l]) if new else (i, row[0])
            values = other.value(0.0, x, v), first.value(0.0, x, v)
            if not np.allclose(*values, rtol=CLOSE, equal_nan=True):
                raise ValueError(f"{name}: wanted maps of one value in mode {mode}, got several")
            if new and _noisy(other, x, v):
                raise ValueError(
                    f"{name} of mode {i}: wanted probabilities without the noise, which comes "
                    "after the switch where the new mode drives the step"
                )
        weight = np.stack([np.broadcast_to(m.weight(0.0, x, v), x.shape[1:]) for m in row])
        want_probabilities(f"{name} of mode {i}", weight)
        never = [m.symbolic and m.weight_expression.is_zero for m in row]
        pairs = zip(row, never, strict=True)
        found.append(tuple(None if none else Branch(m, new) for m, none in pairs))
    return tuple(found)


def want_probabilities(name: str, weights: ArrayLike) -> None:
    """Probabilities along the first axis, or ValueError."""
    weights = np.asarray(weights, dtype=float)
    if not (np.isfinite(weights).all() and (weights >= -CLOSE).all()):
        raise ValueError(f"{name}: wanted probabilities of at least 0, got {np.min(weights):.6g}")
    total = weights.sum(axis=0)
    worst = np.ravel(total)[np.argmax(np.abs(total - 1.0))]
    if abs(worst - 1.0) > CLOSE:
        raise ValueError(f"{name}: wanted probabilities that sum to 1, got {worst:.10g}")


def _noisy(map, x, v) -> bool:
    """Whether the weight of a map depends on the noise: it is looked at with other noises too."""
    if map.symbolic:
        return bool(map.weight_expression.free_symbols & set(map.noise.symbols))
    return not np.array_equal(map.weight(0.0, x, v), map.weight(0.0, x, v[:, ::-1]))


def _same(t, x, v):
    """The state itself."""
    return x


def _calm(map, t, x, v):
    """Weight of a map that does not look at its noise."""
    return map.weight(t, x, np.zeros((map.noise.size, *(1,) * (np.ndim(x) - 1))))


def map_rows(name: str, table: object) -> tuple[tuple[StochasticMap, ...], ...]:
    """Rows of maps, as tuples."""
    try:
        rows = tuple(tuple(row) for row in table)
    except TypeError:
        rows = ()
    if not rows or not all(rows) or any(not isinstance(m, StochasticMap) for r in rows for m in r):
        raise TypeError(f"{name}: wanted rows of StochasticMap, one row for each mode")
    return rows
