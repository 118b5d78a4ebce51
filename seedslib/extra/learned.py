"""Optimal filters of finite order whose output functions are learned, step by step."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_count, optional
from seedslib.base.progress import followed
from seedslib.design.regression import ABSOLUTE, fit_forecast, scatter
from seedslib.design.samples import MemoryPaths, Sample
from seedslib.designed.memory import Memory
from seedslib.designed.predictors import Polynomial, PolynomialFit
from seedslib.designed.tables import Output, OutputFilter, Step, prior
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.jump_diffusion import JumpDiffusion
from seedslib.models.kinds import as_system
from seedslib.models.maps import StochasticMap

FORECAST = Polynomial(3, 0)
"""How the memory forecasts the state where there is no measurement."""


@dataclass(frozen=True)
class Learned:
    """Estimates by a learned function of measurement and memory.

    Attributes
    ----------
    regressor : str
        Name of the regressor.
    draws : int
        Simulated measurements of each path that it learned from.
    """

    regressor: str
    draws: int

    def __str__(self) -> str:
        more = "" if self.draws == 1 else f" on {self.draws} measurements of each path"
        return f"{self.regressor}{more}"


class LearnedOutput:
    """f(y, u) by fitted regressors on standardised arguments, constant beyond what was learned.

    Parameters
    ----------
    centre, scale : ndarray, shape (m + d,)
        Mean and inverse deviation of the arguments; zero for a constant one.
    ends : ndarray, shape (2, m + d)
        Smallest and largest standardised arguments that were learned from.
    models : list
        One fitted regressor, or one for each component.
    """

    def __init__(
        self, centre: np.ndarray, scale: np.ndarray, ends: np.ndarray, models: list[Any]
    ) -> None:
        self.centre: np.ndarray = centre
        self.scale: np.ndarray = scale
        self.ends: np.ndarray = ends
        self.models: list[Any] = models

    def __call__(self, points: Sequence[np.ndarray]) -> Output:
        """Value (n', *batch) at points, the components of y and u, that broadcast to (*batch)."""
        points = np.stack(np.broadcast_arrays(*points))
        given = np.clip((points.reshape(len(points), -1).T - self.centre) * self.scale, *self.ends)
        found = [np.asarray(m.predict(given)).reshape(len(given), -1).T for m in self.models]
        return Output(np.concatenate(found).reshape(-1, *points.shape[1:]))


class LearnedForecast(NamedTuple):
    """A forecast from the memory, where there is no measurement."""

    fit: PolynomialFit

    def __call__(self, points: Sequence[np.ndarray]) -> Output:
        """Forecast (n', *batch) at points, the components of the memory, each (*batch)."""
        return Output(self.fit.mean(np.stack(points)))


class LearnedFilter(OutputFilter):
    """Filter of finite order whose output functions were learned; `learn` makes it.

    It is not written to files or as C, since a regressor is a program.
    """


def learn(
    system: JumpDiffusion | DiscreteSystem,
    memory: Memory,
    times: ArrayLike,
    *,
    paths: int,
    seed: int | np.random.SeedSequence | np.random.Generator,
    regressor: Any = None,
    draws: int = 1,
    sets: int = 4,
    joint: bool = False,
    workers: int = 1,
) -> LearnedFilter:
    """Learn the optimal output functions from simulated paths, one measurement after another.

    The optimal f_k(y, u) = M[X | y, u] of theorem 1 is the best regression of the state on
    measurement and memory, so any regressor trained on squared errors approximates it. There
    are several sets of paths, and functions are fitted to them in turn, so that the memory a
    function learns from comes from functions that have not seen those paths.

    Parameters
    ----------
    system : JumpDiffusion or DiscreteSystem
    memory : Memory
    times : array_like, shape (K+1,)
        Times of the measurements; the first is that of the initial distribution.
    paths : int
        Paths that each function is fitted to.
    seed : int, SeedSequence or Generator
        Of the paths; every random state of the regressor that is None is drawn from it too.
    regressor : scikit-learn regressor, optional
        Anything with ``fit(X, y)`` and ``predict(X)``; by default gradient boosting of trees
        on histograms, which wants scikit-learn.
    draws : int
        Measurements simulated for each path to learn from: they cost no more paths.
    sets : int
        Sets of paths, at least 2.
    joint : bool
        Fit one regressor to all components together; it must take several targets.
    workers : int
        Threads of the simulation.

    Returns
    -------
    LearnedFilter
        Its predicted errors are those on paths that the function at that time has not seen.

    Raises
    ------
    ImportError
        No regressor was given and scikit-learn is not installed.
    TypeError, ValueError
        An argument that does not fit.
    """
    as_system("system", system, "JumpDiffusion", "DiscreteSystem")
    draws = as_count("draws", draws)
    regressor = _boosting() if regressor is None else regressor
    if not (hasattr(regressor, "fit") and hasattr(regressor, "predict")):
        raise TypeError(f"regressor: wanted something with fit and predict, got {regressor!r}")
    sets = as_count("sets", sets, 2)
    samples = MemoryPaths(system, memory, times, paths, sets, seed, workers)
    sensing, fitting = samples.spare.spawn(2)
    sensing = [np.random.default_rng(s) for s in sensing.spawn(len(samples.times))]
    fitting = np.random.default_rng(fitting)
    steps = []
    for k, t in enumerate(followed(samples.times, "learning")):
        sample = samples.sample()
        forecast = _forecast(sample) if k else prior(system, system.state_size)
        update = _output(regressor, system.sensor, t, sample, draws, joint, sensing[k], fitting)
        steps.append(Step(update, forecast))
        samples.apply(update)
    method = Learned(type(regressor).__name__, draws)
    return samples.designed(LearnedFilter, steps=tuple(steps), method=method)


def _output(
    regressor: Any,
    sensor: StochasticMap,
    t: float,
    sample: Sample,
    draws: int,
    joint: bool,
    rng: np.random.Generator,
    fitting: np.random.Generator,
) -> LearnedOutput:
    """The function of one measurement, fitted to `draws` measurements of each path."""
    x, observed, u = sample.states, sample.measurements, sample.memory
    more = [sensor.sample(float(t), x, rng) for _ in range(draws - 1)]
    given = np.concatenate([np.concatenate([y, u]) for y in (observed, *more)], axis=1)
    centre, deviation = given.mean(axis=1), given.std(axis=1)
    varies = deviation > ABSOLUTE * np.sqrt(centre**2 + deviation**2)
    scale = np.where(varies, 1.0 / np.where(varies, deviation, 1.0), 0.0)
    given, wanted = (given.T - centre) * scale, np.tile(x, draws).T
    models = []
    for target in [wanted] if joint else wanted.T:
        models.append(copy.deepcopy(regressor))
        _settle(models[-1], fitting)
        models[-1].fit(given, target)
    return LearnedOutput(centre, scale, np.array([given.min(axis=0), given.max(axis=0)]), models)


def _forecast(sample: Sample) -> LearnedForecast:
    """Cubic forecast of the state from the memory."""
    x, u = sample.states, sample.memory
    return LearnedForecast(
        fit_forecast(FORECAST, lambda rows: scatter(rows(x, u)), len(x), np.zeros(len(u)))
    )


def _boosting() -> object:
    with optional("learn"):
        from sklearn.ensemble import HistGradientBoostingRegressor
    return HistGradientBoostingRegressor(max_iter=80, max_leaf_nodes=24, early_stopping=False)


def _settle(model: object, rng: np.random.Generator) -> None:
    """Fix every random state of a regressor, and of those inside it, that was left open."""
    if not hasattr(model, "get_params"):
        return
    for name, value in sorted(model.get_params().items()):
        if name.rpartition("__")[2] == "random_state" and value is None:
            model.set_params(**{name: int(rng.integers(2**31))})
