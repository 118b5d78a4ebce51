"""One forward pass of a design: the filter runs on the paths, each forecast is fitted before it is
used.
"""

from __future__ import annotations

import math
import warnings
from functools import partial

import numpy as np

from seedslib.filters.finite_order_rules import FiniteOrderState, Prediction, Start
from seedslib.linearization import Moments
from seedslib.memory import Past
from seedslib.synthesis.predictors import Affine
from seedslib.synthesis.regression import ABSOLUTE

DOMINATED = 0.35
"""A root-mean-square error whose standard error is more than this part of it (0.5 where a single
path makes up the mean) is no statistic."""


class ForwardPass:
    """The paths, the filter's state on them, and what was found so far.

    Parameters
    ----------
    walk : Walk
    rules : Rules
    predictor : Affine, Polynomial or Continuous
    """

    def __init__(self, walk, rules, predictor):
        self.walk, self.rules, self.predictor = walk, rules, predictor
        self.states = []
        self.size = np.zeros(rules.components)
        self.scores = []

    def design(self, times, grid):
        """Start, fits for the measurements, fits for the nodes, and the predicted errors."""
        start = self._start(times[0])
        fits, node_fits = [], []
        for k, nodes in enumerate(grid):
            last = k + 1 == len(times)
            if self.rules.velocity is None:
                between, u = self._nodes(times[k], nodes)
            else:
                between, u = self._moves(times[k], nodes if last else [*nodes, times[k + 1]], last)
            node_fits.append(tuple(between))
            if not last:
                fits.append(self._tact(k + 1, times[k + 1], u))
        stamps, rms, error = (np.array(part) for part in zip(*self.scores, strict=True))
        return start, tuple(fits), tuple(node_fits), Prediction(stamps, rms, error, True)

    def _start(self, t):
        walk = self.walk
        walk.begin(t)
        y = walk.measure(t)
        n = len(walk.states[0])
        found = walk.gather(lambda x, y: np.concatenate([x, y]), y)
        mean, cov = found.mean, found.cov
        moments = Moments(mean[n:], cov[:n, n:], cov[n:, n:])
        start = Start(mean[:n], cov[:n, :n], moments)

        def first(y):
            here = np.broadcast_to(start.mean[:, None], (n, y.shape[1]))
            state = FiniteOrderState(0, here, start.cov, Past(), None, 0.0, None, False)
            return self.rules.first(state, y, moments, spread=False)

        self.states = walk.each(first, y)
        self._score(t, [state.mean for state in self.states], corrected=True)
        return start

    def _fit(self, predictor, u, targets, size):
        """Fit a forecast of the first `targets` components from u, (d, paths) in each block."""
        return predictor.fit(
            lambda rows: self.walk.gather(lambda x, u: rows(x[:targets], u), u), targets, size
        )

    def _nodes(self, t, nodes):
        """Fits of the discrete forecasts; also what the next measurement is forecast from."""
        u = self.walk.each(self.rules.node_memory, self.states)
        n, fits = self.rules.components, []
        for node in nodes:
            self.walk.advance(t, node)
            t = node
            fits.append(self._fit(Affine(), u, n, self._sizes(len(u[0]))))
            self._score(t, self.walk.each(fits[-1].mean, u))
        return fits, self.walk.each(lambda state: state.past.vector, self.states)

    def _moves(self, t, stops, last):
        """Fits of the continuous forecast at each integration step, and where it leads."""
        z, fits = [state.mean for state in self.states], []
        for j, stop in enumerate(stops):
            fit = self._fit(self.predictor, z, self.walk.n, self.size)
            z = self.walk.each(partial(self.rules.move, fit, t, stop - t), z)
            fits.append(fit)
            if last or j + 1 < len(stops):
                self.walk.advance(t, stop)
                self._score(stop, z)
                t = stop
        return fits, z

    def _tact(self, k, t, u):
        self.walk.advance(self.scores[-1][0], t)
        fit = self._fit(self.predictor, u, self.walk.n, self._sizes(len(u[0])))
        y = self.walk.measure(t)

        def step(state, u, y):
            mean, cov = fit.forecast(u)
            state = state._replace(index=k, mean=mean, cov=cov, corrected=False)
            return self.rules.correct(state, t, y, spread=False)

        self.states = self.walk.each(step, self.states, u, y)
        self._score(t, [state.mean for state in self.states], corrected=True)
        return fit

    def _sizes(self, dimension):
        """Magnitudes of the memory's components; measurements are measured by themselves."""
        known = np.tile(self.size, len(self.states[0].past.estimates))
        return np.concatenate([known, np.zeros(dimension - len(known))])

    def _score(self, t, estimates, corrected=False):
        """Note the error of the estimates, and how large state and estimate are."""
        n = self.rules.components
        self.walk.leave_out(estimates)

        def rows(x, z):
            return np.concatenate([(x[:n] - z) ** 2, x[:n] ** 2, x[:n], z])

        found = self.walk.gather(rows, estimates)
        mse, self.size = found.mean[:n], np.sqrt(found.mean[n : 2 * n])
        rms = np.sqrt(mse)
        spread = np.sqrt(np.maximum(np.diagonal(found.cov), 0.0))
        error = spread[:n] / math.sqrt(found.count)
        error = np.divide(error, 2.0 * rms, out=np.zeros(n), where=rms > 0)
        if np.any(error > DOMINATED * rms):
            warnings.warn(
                f"bound: the errors at time {t:g} rest on very few paths ({rms.max():.3g} ± "
                f"{error.max():.3g}); a bound would leave out paths that diverge",
                stacklevel=2,
            )
        if corrected:
            moving = spread[2 * n : 3 * n] > ABSOLUTE * self.size
            for i in np.flatnonzero(moving & (spread[3 * n :] <= ABSOLUTE * self.size)):
                warnings.warn(
                    f"memory: the estimate of component {i} at time {t:g} is the same on all "
                    "paths; it carries no information",
                    stacklevel=2,
                )
        self.scores.append((t, rms, error))
