"""Optimal filters of finite order whose output functions are learned, step by step."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from seedslib.base.blocks import as_count
from seedslib.design.tables.carriers import Carriers
from seedslib.design.tables.tabulation import tabulated
from seedslib.designed.finite_order_rules import Start
from seedslib.designed.predictors import Polynomial
from seedslib.designed.regression import ABSOLUTE, scatter
from seedslib.designed.table import OutputFilter, OutputRules, TableFilter
from seedslib.models.kinds import require_kind

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

    def __init__(self, centre, scale, ends, models):
        self.centre, self.scale, self.ends, self.models = centre, scale, ends, models

    def __call__(self, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Value (n', *batch) at y (m, *batch) and u (d, *batch)."""
        batch = np.broadcast_shapes(y.shape[1:], u.shape[1:])
        given = np.concatenate([np.broadcast_to(a, (len(a), *batch)) for a in (y, u)])
        given = np.clip((given.reshape(len(given), -1).T - self.centre) * self.scale, *self.ends)
        found = [np.asarray(m.predict(given)).reshape(len(given), -1).T for m in self.models]
        return np.concatenate(found).reshape(-1, *batch)


class LearnedFilter(OutputFilter):
    """Filter of finite order whose output functions were learned; `learn` makes it.

    It is not written to files, since a regressor is a program; `tabulated` makes a filter of it
    that is.
    """

    def tabulated(self, *, y, z) -> TableFilter:
        """The same filter with its functions read off at the nodes of axes.

        Parameters
        ----------
        y, z : sequence of Axis or (low, high, count)
            Nodes for each component of a measurement and of an estimate; one alone where there
            is one component.

        Raises
        ------
        TypeError, ValueError
            Axes that are none, or tables that would be too large.
        """
        return tabulated(self, y=y, z=z)


def learn(
    system, memory, times, *, paths, seed, regressor=None, components=None, draws=1, sets=4,
    joint=False, nodes=4, workers=1,
) -> LearnedFilter:  # fmt: skip
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
        Times of the measurements; the first is that of the initial law.
    paths : int
        Paths that each function is fitted to.
    seed : int, SeedSequence or Generator
        Of the paths; every random state of the regressor that is None is drawn from it too.
    regressor : scikit-learn regressor, optional
        Anything with ``fit(X, y)`` and ``predict(X)``; by default gradient boosting of trees
        on histograms, which wants scikit-learn.
    components : int, optional
        n': the first components of the state are estimated (default all).
    draws : int
        Measurements simulated for each path to learn from: they cost no more paths.
    sets : int
        Sets of paths, at least 2.
    joint : bool
        Fit one regressor to all components together; it must take several targets.
    nodes : int
        Number of evenly spaced forecasts inside each interval; they are cubic in the memory.
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
    require_kind(system, "JumpDiffusion", "DiscreteSystem")
    draws = as_count("draws", draws)
    regressor = _boosting() if regressor is None else regressor
    if not (hasattr(regressor, "fit") and hasattr(regressor, "predict")):
        raise TypeError(f"regressor: wanted something with fit and predict, got {regressor!r}")
    carriers = Carriers(system, memory, times, components, paths, sets, nodes, seed, workers)
    components = carriers.components
    sensing, fitting = carriers.streams[-1].spawn(2)
    sensing = [np.random.default_rng(s) for s in sensing.spawn(len(carriers.times))]
    fitting = np.random.default_rng(fitting)
    outputs, ends, between = [], [], []
    for k, t in enumerate(carriers.times):
        lesson = carriers.lesson()
        outputs.append(
            _output(regressor, system.sensor, t, lesson, components, draws, joint,
                    sensing[k], fitting)
        )  # fmt: skip
        carriers.take(outputs[-1])
        if k + 1 == len(carriers.times):
            break
        found = []
        for stop in carriers.stops[k]:
            found.append(_forecast(carriers.forecast_lesson(stop), components))
            if stop != carriers.stops[k][-1]:
                carriers.score(stop, found[-1].mean)
        ends.append(found.pop())
        between.append(tuple(found))
    rules = OutputRules(
        memory, components, sensor=None, outputs=tuple(outputs), covariances=carriers.covariances
    )
    return carriers.examined(LearnedFilter(
        system=system, memory=memory, predictor=Learned(type(regressor).__name__, draws),
        linearization=None, times=carriers.times,
        node_times=tuple(s[:-1] for s in carriers.stops),
        components=components, start=Start(system.mean0, system.cov0, None), fits=tuple(ends),
        node_fits=tuple(between), predicted=carriers.prediction(), design=carriers.design(),
        rules=rules,
    ))  # fmt: skip


def _output(regressor, sensor, t, lesson, components, draws, joint, rng, fitting):
    """The function of one measurement, fitted to `draws` measurements of each path."""
    x, shown, u = lesson
    more = [sensor.sample(float(t), x, rng) for _ in range(draws - 1)]
    given = np.concatenate([np.concatenate([y, u]) for y in (shown, *more)], axis=1)
    centre, deviation = given.mean(axis=1), given.std(axis=1)
    varies = deviation > ABSOLUTE * np.sqrt(centre**2 + deviation**2)
    scale = np.where(varies, 1.0 / np.where(varies, deviation, 1.0), 0.0)
    given, wanted = (given.T - centre) * scale, np.tile(x[:components], draws).T
    models = []
    for target in [wanted] if joint else wanted.T:
        models.append(copy.deepcopy(regressor))
        _settle(models[-1], fitting)
        models[-1].fit(given, target)
    return LearnedOutput(centre, scale, np.array([given.min(axis=0), given.max(axis=0)]), models)


def _forecast(lesson, components):
    """Cubic forecast of the targets from the memory."""
    target, u = lesson.states[:components], lesson.memory
    return FORECAST.fit(lambda rows: scatter(rows(target, u)), components, np.zeros(len(u)))


def _boosting():
    try:
        from sklearn.ensemble import HistGradientBoostingRegressor
    except ImportError:
        raise ImportError(
            "regressor: the default one wants scikit-learn, which is not installed; "
            'pip install "seedslib[learn]", or give a regressor'
        ) from None
    return HistGradientBoostingRegressor(max_iter=80, max_leaf_nodes=24, early_stopping=False)


def _settle(model, rng):
    """Fix every random state of a regressor, and of those inside it, that was left open."""
    if not hasattr(model, "get_params"):
        return
    for name, value in sorted(model.get_params().items()):
        if name.rpartition("__")[2] == "random_state" and value is None:
            model.set_params(**{name: int(rng.integers(2**31))})
