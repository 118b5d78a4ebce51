"""Forecasts that know which measurements have arrived: a class of histories, and a fit of each.

What arrives is independent of state and noise: given the history of what arrived, a filter is one
with that history for a schedule. Histories after which its errors have almost one covariance are a
class. The class of a path is a discrete state that its patterns alone decide, by a table at each
step.
"""

from __future__ import annotations

from itertools import pairwise
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
    before : ndarray, shape (classes before, n, n)
        Forecast covariances of the classes before.
    prob : ndarray, shape (classes,)
        Probabilities of the classes; the most probable is the first.
    fits : AffineFit or PolynomialFit
        Arrays with a leading axis of classes.
    """

    table: np.ndarray
    before: np.ndarray
    prob: np.ndarray
    fits: Fit

    @classmethod
    def of(
        cls, table: np.ndarray, before: np.ndarray, prob: np.ndarray, fits: list[Fit]
    ) -> ClassFits:
        """From the fits of the classes, one by one."""
        columns = zip(*fits, strict=True)
        parts = (c[0] if isinstance(c[0], int) else np.stack(c) for c in columns)
        return cls(table, before, prob, type(fits[0])(*parts))

    def one(self, c: int) -> Fit:
        """Fit of a class."""
        return type(self.fits)(*(p if isinstance(p, int) else p[c] for p in self.fits))

    @property
    def covs(self) -> np.ndarray:
        """Forecast covariances of the classes, (classes, n, n)."""
        return self.fits.cov

    @property
    def cov(self) -> np.ndarray:
        """Their mean, (n, n)."""
        return np.tensordot(self.prob, self.covs, 1)

    @property
    def dimension(self) -> int:
        """How many numbers they forecast from."""
        return self.one(0).dimension


class FitsOfPaths(NamedTuple):
    """The forecast for paths whose classes, (*batch), are known."""

    fits: ClassFits
    history: np.ndarray

    def mean(self, u: np.ndarray) -> np.ndarray:
        """Forecast (n, *batch) from the memory (d, *batch)."""
        return self.forecast(u)[0]

    def forecast(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forecast (n, *batch) and its covariance (n, n, *batch) from the memory (d, *batch)."""
        flat, history, n = u.reshape(len(u), -1), self.history.ravel(), self.fits.covs.shape[-1]
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
    k, last = state.index, len(filter.times) - 1
    if k >= last and not filter.cycle:
        return state
    first_again = k >= last and (k - last) % filter.cycle == 0
    table = filter.transitions[-1 if first_again else filter.served(k + 1) - 1]
    arrived = ~np.isnan(y[uncertain(filter.availability)])
    pattern = np.tensordot(2 ** np.arange(len(arrived)), arrived, 1)
    return state._replace(history=table[state.history, pattern])


def transitions(fits: tuple[Any, ...], cycle: int) -> tuple[np.ndarray, ...] | None:
    """Table into the classes of each fit from those of the fit before it, then those in a cycle.

    Steps that did not follow each other in the design are joined by the nearest covariances. The
    last table leads from the last fit to the first of the cycle. None without classes.
    """
    if not fits or not isinstance(fits[0], ClassFits):
        return None
    tables = [fits[0].table[:1]]  # from the most probable class
    tables += [_joined(one, other) for one, other in pairwise(fits)]
    if cycle:
        tables.append(_joined(fits[-1], fits[len(fits) - cycle]))
    return tuple(tables)


def _joined(one: ClassFits, other: ClassFits) -> np.ndarray:
    """Table from the classes of a fit into those of another."""
    if np.array_equal(one.covs, other.before):
        return other.table
    if not len(other.before):
        return np.repeat(other.table, len(one.prob), axis=0)
    return other.table[np.argmin(distances(one.covs, other.before), axis=1)]


def distances(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """How far covariances (a, n, n) are from others (b, n, n), shape (a, b).

    The largest |log r| of the ratios r of the variances of any linear function under the two: it
    does not depend on the basis. What is below 1e-9 of their mean covariance is not compared.
    """
    mean = np.concatenate([one, other]).mean(axis=0)
    scale = np.sqrt(np.diagonal(mean))
    scale = np.outer(scale, scale)
    scale[scale == 0.0] = 1.0
    floor = 1e-9 * np.eye(len(mean))
    one, other = one / scale + floor, other / scale + floor
    root = np.linalg.cholesky(other)
    half = np.linalg.solve(root[None], one[:, None])
    ratio = np.linalg.solve(root[None], np.swapaxes(half, -1, -2))
    ratio = (ratio + np.swapaxes(ratio, -1, -2)) / 2.0
    values = np.linalg.eigvalsh(ratio)
    return np.abs(np.log(np.maximum(values, 1e-12))).max(axis=-1)
