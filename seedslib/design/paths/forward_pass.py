"""One forward pass of a design: the filter runs on the paths, each forecast is fitted before it is
used.
"""

from __future__ import annotations

import warnings
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.clock import when
from seedslib.base.progress import followed
from seedslib.base.values import Course
from seedslib.design.fitting import fit_forecast
from seedslib.design.regression import ABSOLUTE, root_mean_squares
from seedslib.designed.finite_order_rules import FiniteOrderState, Rules, Start
from seedslib.designed.memory import Past
from seedslib.designed.prediction import Prediction
from seedslib.designed.predictors import Affine
from seedslib.linearization.moments import Moments

DOMINATED = 0.35
"""A root-mean-square error whose standard error is more than this part of it (0.5 where a single
path makes up the mean) is no statistic."""

_estimate = attrgetter("mean")


class Found(NamedTuple):
    """What a forward pass has found so far.

    Attributes
    ----------
    start : Start
    fits, node_fits : tuple
        Forecasts for the measurements, and for the nodes of each interval.
    scores : tuple of (time, rms, error)
    size : ndarray, shape (n',)
        Root mean squares of the estimated components, now.
    """

    start: Start
    fits: tuple[Any, ...]
    node_fits: tuple[Any, ...]
    scores: tuple[Any, ...]
    size: np.ndarray


class ForwardPass:
    """The paths, the filter's state on them, and what was found so far.

    Parameters
    ----------
    walk : Walk
    rules : Rules
    predictor : Affine, Polynomial or Continuous
    measured : ndarray of bool, shape (K+1, m)
        Components that are measured at each time.
    """

    def __init__(self, walk: Any, rules: Any, predictor: Any, measured: np.ndarray) -> None:
        self.walk, self.predictor, self.measured = walk, predictor, measured
        self.memory, self.components = rules.memory, rules.components
        self.continuous: bool = rules.velocity is not None
        self.extra: bool = rules.measured_nodes and not rules.memory.measurements
        self.rules: Any = walk.each.share(rules)
        self.states: list[Any] = []
        self.start: Any = None
        self.fits, self.node_fits = [], []
        self.scores, self.size = [], np.zeros(self.components)
        self.weights: Any = None

    def design(
        self, times: ArrayLike, grid: Any, keep: Any = None, held: Course | None = None
    ) -> Any:
        """Start, fits for the measurements, fits for the nodes, and the predicted errors.

        Parameters
        ----------
        times : ndarray, shape (K+1,)
        grid : tuple of ndarray
            Node times.
        keep : callable, optional
            Called with the pass and whether this was the last step, after each step.
        held : Course, optional
            Inputs at the times.
        """
        held = Course() if held is None else held
        if self.start is None:
            with held.at(0):
                self._start(times[0])
        for k in followed(range(len(self.node_fits), len(grid)), "design"):
            nodes, last = grid[k], k + 1 == len(times)
            with held.at(k):
                if not self.continuous:
                    between, u = self._nodes(k, times[k], nodes)
                else:
                    stops = nodes if last else [*nodes, times[k + 1]]
                    between, u = self._moves(times[k], stops, last)
                self.node_fits.append(tuple(between))
                if not last:
                    self._tact(k + 1, times[k + 1], u, held)
            if keep is not None:
                keep(self, k + 1 == len(grid))
        stamps, rms, error = (np.array(part) for part in zip(*self.scores, strict=True))
        predicted = Prediction(stamps, rms, error, True)
        return self.start, tuple(self.fits), tuple(self.node_fits), predicted

    @property
    def found(self) -> Found:
        """What was found so far."""
        return Found(
            self.start, tuple(self.fits), tuple(self.node_fits), tuple(self.scores), self.size
        )

    def resume(self, found: Any, states: Any) -> Any:
        """Go on from what was found, with the filter's state on the paths."""
        self.start, self.size = found.start, found.size
        self.fits, self.node_fits = list(found.fits), list(found.node_fits)
        self.scores = list(found.scores)
        # in one map, which sends them where they are worked on
        self.states = self.walk.each(lambda state: state, states)

    def _start(self, t):
        walk = self.walk
        walk.begin(t)
        y = walk.measure(t)
        n = walk.n
        found = walk.gather(lambda x, y: np.concatenate([x, y]), y)
        mean, cov = found.mean, found.cov
        moments = Moments(mean[n:], cov[:n, n:], cov[n:, n:])
        self.start = Start(mean[:n], cov[:n, :n], moments)
        self._first(t, y)

    def _first(self, t, y):
        walk, start, n, there = self.walk, self.start, self.walk.n, self.measured[0]

        def first(rules, y):
            here = np.broadcast_to(start.mean[:, None], (n, y.shape[1]))
            state = FiniteOrderState(0, here, start.cov, Past(), None, 0.0, None, False)
            return rules.first(state, t, as_read(there, y), start, spread=False)

        self.states = walk.kept(first, self.rules, y, array=_estimate)
        self._score(t, walk.each(_estimate, self.states), corrected=there.any())

    def _fit(self, predictor, u, targets, size):
        """Fit a forecast of the first `targets` components from u, (d, paths) in each bundle."""
        return fit_forecast(
            predictor, lambda rows: self.walk.gather(lambda x, u: rows(x[:targets], u), u),
            targets, size,
        )  # fmt: skip

    def _nodes(self, k, t, nodes):
        """Fits of the discrete forecasts; also what the next measurement is forecast from."""
        walk, n, fits = self.walk, self.components, []
        u = walk.each(Rules.node_memory, self.rules, self.states)
        size = self._sizes(k, extra=self.extra)
        for node in nodes:
            walk.advance(t, node)
            t = node
            fits.append(self._fit(Affine(), u, n, size))
            self._score(t, walk.kept(fits[-1].mean, u))
        return fits, walk.each(remembered, self.states)

    def _moves(self, t, stops, last):
        """Fits of the continuous forecast at each integration step, and where it leads."""
        walk, fits = self.walk, []
        z = walk.each(_estimate, self.states)
        for j, stop in enumerate(stops):
            fit = self._fit(self.predictor, z, walk.n, self.size)
            z = walk.kept(_mover(fit, t, stop - t), self.rules, z)
            fits.append(fit)
            if last or j + 1 < len(stops):
                walk.advance(t, stop)
                self._score(stop, z)
                t = stop
        return fits, z

    def _tact(self, k, t, u, held):
        walk = self.walk
        walk.advance(self.scores[-1][0], t)
        fit = self._fit(self.predictor, u, walk.n, self._sizes(k - 1))
        with held.at(k):
            self._taken(k, t, u, fit)

    def _taken(self, k, t, u, fit):
        walk, there = self.walk, self.measured[k]
        y = walk.measure(t)

        def step(rules, state, u, y):
            mean, cov = fit.forecast(u)
            state = state._replace(index=k, mean=mean, cov=cov, corrected=False)
            return rules.correct(state, t, as_read(there, y), spread=False)

        self.states = walk.kept(step, self.rules, self.states, u, y, array=_estimate)
        told = self.measured[: k + 1].any()
        self._score(t, walk.each(_estimate, self.states), corrected=told)
        self.fits.append(fit)

    def _sizes(self, k, extra=False):
        """Magnitudes of the components of U_k; measurements are measured by themselves."""
        measured = self.walk.system.sensor.size
        known = np.tile(self.size, min(k + 1, self.memory.estimates))
        total = self.memory.dimension(k, self.components, measured) + measured * extra
        return np.concatenate([known, np.zeros(total - len(known))])

    def _score(self, t, *estimates, corrected=False):
        """Note the error of the estimates, and how large state and estimate are."""
        n, weights = self.components, self.weights

        def rows(x, z, *others):
            square = (x[:n] - z) ** 2
            if others:
                square *= weights[0]
                for weight, other in zip(weights[1:], others, strict=True):
                    square += weight * (x[:n] - other) ** 2
            return np.concatenate([square, x[:n] ** 2, x[:n], z])

        found = self.walk.gather(rows, *estimates)
        (rms, error, spread), self.size = (
            root_mean_squares(found, n),
            np.sqrt(found.mean[n : 2 * n]),
        )
        if np.any(error > DOMINATED * rms):
            warnings.warn(
                f"bound: the errors at time {when(t)} rest on very few paths ({rms.max():.3g} ± "
                f"{error.max():.3g}); a bound would leave out paths that diverge",
                stacklevel=2,
            )
        if corrected:
            moving = spread[2 * n : 3 * n] > ABSOLUTE * self.size
            for i in np.flatnonzero(moving & (spread[3 * n :] <= ABSOLUTE * self.size)):
                warnings.warn(
                    f"memory: the estimate of component {i} at time {when(t)} is the same on all "
                    "paths; it carries no information",
                    stacklevel=2,
                )
        self.scores.append((t, rms, error))


def as_read(there: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Measurements (m, paths) without the components that are not there, (m,)."""
    return y if there.all() else np.where(there[:, None], y, np.nan)


def remembered(state: FiniteOrderState) -> np.ndarray:
    """The memory as a vector."""
    return state.past.vector


def _mover(fit, t, h):
    """Step of the continuous forecast, without anything else of the pass in it."""
    return lambda rules, z: rules.move(fit, t, h, z)
