"""Synthesis of the conditionally minimax filter: two linear regressions at each measurement."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import BLOCK
from seedslib.base.progress import followed
from seedslib.design.carriers import Carriers, Lesson
from seedslib.design.regression import Scatter, combine, fit_affine, fit_forecast, scatter
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
    sets: int = 2,
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
        Times of the measurements; the first is that of the initial law.
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
    sets : int
        Sets of paths that functions are fitted to in turn, at least 2.
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
    carriers = Carriers(system, memory, times, None, paths, sets, 0, seed, workers)
    for k in followed(range(len(carriers.times)), "regressions"):
        basics = Basics.of(system, memory, method, carriers.times, k)
        fits.append(_fitted(basics, carriers.lesson()))
        carriers.take(basics.functions(fits[-1]).update)
    return carriers.examined(
        MinimaxFilter(
            system=system,
            memory=memory,
            times=carriers.times,
            fits=tuple(fits),
            method=method,
            predicted=carriers.prediction(),
            covariances=carriers.covariances,
            design=carriers.design(),
        )
    )


def _fitted(basics: Basics, lesson: Lesson) -> MinimaxFit:
    """The regressions of one measurement."""
    system, n = basics.system, basics.system.state_size
    x, y, xi = lesson.states, lesson.measurements, basics.prediction(lesson.memory)
    if len(basics.times) == 1:
        forecast = AffineFit(np.zeros((n, 0)), system.mean0, system.cov0)
    else:
        forecast = fit_affine(_over(x, xi), n, np.zeros(len(xi)))
    ahead, bounded = forecast.mean(xi), None
    rest = x - ahead
    if isinstance(basics.method.correction, BoundedPolynomial):
        bounded = _bounded(basics.method.correction, x, ahead, xi, y)
    zeta = basics.correction(ahead, xi, y, bounded)
    return MinimaxFit(forecast, fit_affine(_over(rest, zeta), n, np.zeros(len(zeta))), bounded)


def _bounded(chosen, x, ahead, xi, y) -> BoundedFit:
    """The polynomial of what an affine map leaves, and the ranges."""
    given, points = np.concatenate([ahead, y]), np.concatenate([xi, y])
    n, count = x.shape
    line = fit_affine(_over(x - ahead, given), n, np.zeros(len(given)))
    rest = x - ahead - line.mean(given)
    powers: Any = fit_forecast(
        Polynomial(chosen.degree, 0), _over(rest, points), n, np.zeros(len(points))
    )
    values = np.concatenate(
        [powers.mean(points[:, a : a + BLOCK]) for a in range(0, count, BLOCK)], axis=1
    )
    return BoundedFit(powers, *(np.stack([v.min(axis=1), v.max(axis=1)]) for v in (values, x)))


def _over(x: np.ndarray, u: np.ndarray) -> Callable[[Callable[..., Any]], Scatter]:
    """Moments of rows of two arrays over the paths, block by block."""
    parts = [slice(a, a + BLOCK) for a in range(0, x.shape[1], BLOCK)]
    return lambda rows: combine(scatter(rows(x[:, part], u[:, part])) for part in parts)
