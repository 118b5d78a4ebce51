"""Synthesis of the conditionally minimax filter: two linear regressions at each measurement."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import BLOCK
from seedslib.base.progress import followed
from seedslib.design.regression import Scatter, combine, fit_affine, fit_forecast, scatter
from seedslib.design.samples import MemoryPaths, Sample
from seedslib.designed.memory import Memory
from seedslib.designed.minimax import (
    Basic,
    Basics,
    BoundedFit,
    BoundedPolynomial,
    Minimax,
    MinimaxFilter,
    MinimaxFit,
)
from seedslib.designed.predictors import AffineFit, Polynomial
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.kinds import as_system


def minimax_synthesis(
    system: DiscreteSystem,
    memory: Memory,
    times: ArrayLike,
    *,
    paths: Count,
    seed: Seed,
    prediction: Basic | None = None,
    correction: Basic | BoundedPolynomial | None = None,
    workers: int = 1,
) -> MinimaxFilter:
    """Conditionally minimax filter, with chosen functions of the memory and of the measurement.

    Step by step, on simulated paths that carry the memory: the state is regressed on a basic
    prediction of the memory, x~ = F xi(u) + f, and what is left of it on a basic correction,
    Z = x~ + H zeta(x~, y) + h. Of all errors that have these first and second moments theirs is
    the least in the worst case (A. R. Pankov, A. V. Bosov, IEEE Trans. Autom. Control 39 (1994)
    1617-1620), and its covariances are known before any data.

    Parameters
    ----------
    system : DiscreteSystem
    memory : Memory
        Of estimates, of measurements, or of both.
    times : array_like, shape (K+1,)
        Times of the measurements; the first is that of the initial distribution.
    paths : int
        Paths that each regression is made on.
    seed : int, SeedSequence or Generator
    prediction : callable, optional
        xi: ``prediction(t, u) -> (p, *batch)`` of the memory u (d, *batch), estimates newest
        first, then measurements, and the time t that it leaves. By default every remembered
        estimate, moved to the present by the mean of the dynamics, and the measurements.
    correction : callable or BoundedPolynomial, optional
        zeta: ``correction(t, forecast, y) -> (q, *batch)`` of the predicted state (n, *batch)
        and the measurement (m, *batch) at t. By default the residual, the measurement less its
        mean at the predicted state.
    workers : int
        Threads of the simulation.

    Returns
    -------
    MinimaxFilter
        Its predicted errors are those on paths that the regressions at that time have not seen.

    Raises
    ------
    TypeError, ValueError
        An argument that does not fit; a basic function that gives another shape.

    Warns
    -----
    UserWarning
        As `binned_synthesis`; paths that diverged and were left out.
    """
    as_system("system", system, "DiscreteSystem")
    method, fits = Minimax(prediction, correction), []
    samples = MemoryPaths(system, memory, times, paths, 2, seed, workers)
    for k in followed(range(len(samples.times)), "regressions"):
        basics = Basics.of(system, memory, method, samples.times, k)
        fits.append(_fitted(basics, samples.sample()))
        samples.apply(basics.functions(fits[-1]).update)
    return samples.designed(MinimaxFilter, fits=tuple(fits), method=method)


def _fitted(basics: Basics, sample: Sample) -> MinimaxFit:
    """The regressions of one measurement."""
    system, n = basics.system, basics.system.state_size
    x, y, xi = sample.states, sample.measurements, basics.prediction(sample.memory)
    if len(basics.times) == 1:
        forecast = AffineFit(np.zeros((n, 0)), system.mean0, system.cov0)
    else:
        forecast = _affine(x, xi)
    predicted, bounded = forecast.mean(xi), None
    if basics.method.bounded:
        bounded = _bounded(basics.method.correction.degree, x, predicted, xi, y)
    zeta = basics.correction(predicted, xi, y, bounded)
    return MinimaxFit(forecast, _affine(x - predicted, zeta), bounded)


def _bounded(degree, x, predicted, xi, y) -> BoundedFit:
    """The polynomial of what an affine map leaves, and the ranges."""
    given, points = np.concatenate([predicted, y]), np.concatenate([xi, y])
    rest = x - predicted - _affine(x - predicted, given).mean(given)
    zero = np.zeros(len(points))
    powers = fit_forecast(Polynomial(degree, 0), _over(rest, points), len(x), zero)
    blocks = [powers.mean(points[:, a : a + BLOCK]) for a in range(0, x.shape[1], BLOCK)]
    values = np.concatenate(blocks, axis=1)
    return BoundedFit(powers, *(np.stack([v.min(axis=1), v.max(axis=1)]) for v in (values, x)))


def _affine(x: np.ndarray, u: np.ndarray) -> AffineFit:
    """Regression of x (n, N) on u (d, N)."""
    return fit_affine(_over(x, u), len(x), np.zeros(len(u)))


def _over(x: np.ndarray, u: np.ndarray) -> Callable[[Callable[..., np.ndarray]], Scatter]:
    """Moments of rows of two arrays over the paths, block by block."""
    parts = [slice(a, a + BLOCK) for a in range(0, x.shape[1], BLOCK)]
    return lambda rows: combine(scatter(rows(x[:, part], u[:, part])) for part in parts)
