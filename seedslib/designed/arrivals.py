"""Forecasts that know which measurements have arrived: a class of histories, and a fit of each.

What arrives is independent of state and noise: given the history of what arrived, a filter is one
with that history for a schedule. Histories after which its errors have almost one covariance are a
class. The class of a path is a discrete state that its patterns alone decide, by a table at each
step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.designed.predictors import Fit


class ClassFits(NamedTuple):
    """A forecast for each class of histories.

    Attributes
    ----------
    table : ndarray of int, shape (classes before, patterns)
        Class after a measurement, by the one before it and the number of the pattern: the sum of
        2^i over the components that have arrived, counted among those that may be missing.
    prob : ndarray, shape (classes,)
        Probabilities of the classes; the most probable is the first.
    fits : AffineFit or PolynomialFit
        Arrays with a leading axis of classes.
    """

    table: np.ndarray
    prob: np.ndarray
    fits: Fit

    @classmethod
    def of(cls, table: np.ndarray, prob: np.ndarray, fits: list[Fit]) -> ClassFits:
        """From the fits of the classes, one by one."""
        columns = zip(*fits, strict=True)
        parts = (c[0] if isinstance(c[0], int) else np.stack(c) for c in columns)
        return cls(table, prob, type(fits[0])(*parts))

    def one(self, c: int) -> Fit:
        """Fit of a class."""
        return type(self.fits)(*(p if isinstance(p, int) else p[c] for p in self.fits))

    @property
    def cov(self) -> np.ndarray:
        """Mean of the forecast covariances of the classes, (n, n)."""
        return np.tensordot(self.prob, self.fits.cov, 1)


class FitsOfPaths(NamedTuple):
    """The forecast for paths whose classes, (*batch), are known."""

    fits: ClassFits
    history: np.ndarray

    def mean(self, u: np.ndarray) -> np.ndarray:
        """Forecast (n, *batch) from the memory (d, *batch)."""
        return self.forecast(u)[0]

    def forecast(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forecast (n, *batch) and its covariance (n, n, *batch) from the memory (d, *batch)."""
        flat, history, n = u.reshape(len(u), -1), self.history.ravel(), self.fits.cov.shape[-1]
        mean, cov = np.empty((n, history.size)), np.empty((n, n, history.size))
        for c in np.unique(history):
            paths = history == c
            mean[:, paths], one = self.fits.one(int(c)).forecast(flat[:, paths])
            cov[..., paths] = one.reshape(n, n, -1)
        return mean.reshape(-1, *u.shape[1:]), cov.reshape(n, n, *u.shape[1:])


def fit_of(fit: Any, history: np.ndarray | int) -> Any:
    """The fit for a history or several, where there are classes; any other fit is itself."""
    if type(fit) is not ClassFits:
        return fit
    return fit.one(int(history)) if np.ndim(history) == 0 else FitsOfPaths(fit, history)


def uncertain(availability: np.ndarray) -> np.ndarray:
    """Numbers of the components that may be missing."""
    return np.flatnonzero((availability > 0.0) & (availability < 1.0))


def with_history(filter: Any, state: Any, y: np.ndarray) -> Any:
    """A state after the measurement y (m, *batch), in its new class for the next forecast."""
    if state.index == len(filter.fits):
        return state
    arrived = ~np.isnan(y[uncertain(filter.availability)])
    pattern = np.tensordot(2 ** np.arange(len(arrived)), arrived, 1)
    return state._replace(history=filter.fits[state.index].table[state.history, pattern])
