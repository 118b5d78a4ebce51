"""Outliers: measurements too far from what was expected are left out."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from seedslib.base.checks import as_count, unmasked
from seedslib.base.correction import correct
from seedslib.base.objects import Remade
from seedslib.filters.estimates import Estimates
from seedslib.filters.verbs import Filter


class GatedState(NamedTuple):
    """State of the filter itself, and what became of its last measurements.

    ``rejected`` (*batch) marks the records whose last measurement was left out, ``refusals``
    (*batch) counts how many were, one after the other.
    """

    inner: Any
    rejected: np.ndarray
    refusals: np.ndarray

    @property
    def time(self) -> float | None:
        """Time of the state."""
        return self.inner.time


class Gated(Filter, Remade):
    """A filter that takes no measurement that is too far from what it expects.

    The normalised square of the innovation, with the covariance that the filter expects, is
    held against the quantile of the chi-square law with as many degrees of freedom as there are
    components: a good measurement is lost with probability 1 - `probability` where the filter's
    moments are right and its errors Gaussian, and somewhat oftener after one that was lost: what
    was far once is far again. One that is left out is a missing one, so it counts
    nothing in the log-likelihood.

    A filter that is sure of a wrong state would refuse everything from then on. After `patience`
    refusals in a row the next measurement is taken.

    Parameters
    ----------
    filter : Filter
        One that says what it expects to measure: with ``expect(state) -> Moments``.
    probability : float
        That a good measurement is taken.
    patience : int

    Raises
    ------
    TypeError, ValueError
        A filter that expects nothing, a probability that is not between 0 and 1.
    """

    _shown = "filter", "probability", "patience"

    def __init__(self, filter: Filter, probability: float = 0.999, patience: int = 5) -> None:
        if not (isinstance(filter, Filter) and hasattr(filter, "expect")):
            raise TypeError(
                f"filter: wanted one that says what it expects to measure, got {filter!r}"
            )
        if not 0 < probability < 1:
            raise ValueError(f"probability: wanted a number between 0 and 1, got {probability}")
        self.filter, self.probability = filter, float(probability)
        self.patience: int = as_count("patience", patience)
        self.system: Any = filter.system
        self.records, self.alone = filter.records, filter.alone
        m = self.system.measurement_size
        self._most = 2.0 * gammaincinv(0.5 * np.arange(1, m + 1), self.probability)
        self._most = np.concatenate([[np.inf], self._most])

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> GatedState:
        """State before any measurement."""
        none = np.zeros(batch, dtype=bool), np.zeros(batch, dtype=int)
        return GatedState(self.filter.initial(batch, seed), *none)

    def predict(self, state: GatedState, t: float, *told: ArrayLike) -> GatedState:
        """Forecast to time t; see `Filter.predict`."""
        return state._replace(inner=self.filter.predict(state.inner, t, *told))

    def correct(self, state: GatedState, y: ArrayLike) -> GatedState:
        """Correct by the measurement y, shape (m, *batch), where it is near enough."""
        y = np.asarray(unmasked("y", y, missing=np.nan), dtype=float)
        far = self.distance(state.inner, y) > self._most[np.isfinite(y).sum(axis=0)]
        rejected = far & (state.refusals < self.patience)
        refusals = np.where(far, np.where(rejected, state.refusals + 1, 0), 0)
        # what is missing altogether is no answer
        refusals = np.where(np.isnan(y).all(axis=0), state.refusals, refusals)
        inner = self.filter.correct(state.inner, np.where(rejected, np.nan, y))
        return GatedState(inner, rejected, refusals)

    def distance(self, state: Any, y: np.ndarray) -> np.ndarray:
        """Normalised square (*batch) of the innovation of y, (m, *batch).

        Of the components that are there; 0 while the state hangs on numbers that no measurement
        has told.
        """
        if getattr(state, "effect", None) is not None:
            return np.zeros(y.shape[1:])
        moments, still = self.filter.expect(state), np.zeros((1, *(1,) * (y.ndim - 1)))
        blind = moments._replace(cross=np.zeros_like(moments.cross[:1]))
        periods = self.system.sensor.period
        expected = np.where(np.isfinite(y), moments.mean, np.nan)
        # the Gaussian log-density at the expected place and at y differ by half of the square
        most, here = (correct(still, None, z, blind, periods=periods)[2] for z in (expected, y))
        return 2.0 * (most - here)

    def report(self, state: GatedState) -> Estimates:
        """What the filter says, and whether the last measurement was left out."""
        return self.filter.report(state.inner)._replace(rejected=state.rejected)

    def completed(self, found: Estimates) -> Estimates:
        """See `Filter.completed`."""
        return self.filter.completed(found)
