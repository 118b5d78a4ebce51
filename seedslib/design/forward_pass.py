"""The pass of a design: the filter runs on the paths, each forecast is fitted before it is used.

Where components of a measurement arrive with probabilities, no pattern of them is waited for: each
class of histories goes on with every pattern of the next measurement on all the paths at once.
Patterns after which the errors are alike are put into one class, where each path draws one of them
in their proportions; so the paths of a class have the distribution of state and memory given the
class, see `seedslib.design.histories`. A design whose measurements all arrive has one class.
"""

from __future__ import annotations

import warnings
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from seedslib.base.checks import outside
from seedslib.base.clock import when
from seedslib.base.linalg import lower_triangle, symmetric
from seedslib.base.progress import followed
from seedslib.design.histories import Histories, patterns, shares
from seedslib.design.paths import PathSimulator
from seedslib.design.regression import ABSOLUTE, DOMINATED, fit_forecast, root_mean_squares
from seedslib.designed.accuracy import Accuracy
from seedslib.designed.arrivals import ClassFits
from seedslib.designed.base import FilterState
from seedslib.designed.finite_order import Rules, Start
from seedslib.designed.memory import Past
from seedslib.designed.predictors import Affine, Continuous, Fit, Polynomial
from seedslib.linearization.moments import Moments
from seedslib.models.simulation import ARRIVALS

_estimate, _memory = attrgetter("mean"), attrgetter("past.vector")


class ForwardPass:
    """The paths, the states of the filter on them in each class of histories, and the fits so far.

    Parameters
    ----------
    simulator : PathSimulator
    rules : Rules
    predictor : Affine, Polynomial or Continuous
    measured : ndarray of bool, shape (K+1, m)
        Components that are measured at each time.
    availability : ndarray, shape (m,), or None
        Probability that a component that is measured arrives; None where all do.
    """

    def __init__(
        self,
        simulator: PathSimulator,
        rules: Rules,
        predictor: Affine | Polynomial | Continuous,
        measured: np.ndarray,
        availability: np.ndarray | None,
    ) -> None:
        self.simulator, self.predictor = simulator, predictor
        self.measured = measured
        self.memory, self.components = rules.memory, rules.components
        self.continuous: bool = rules.velocity is not None
        self.rules: Any = simulator.executor.share(rules)
        self.one_class: bool = availability is None
        self.availability = np.ones(measured.shape[1]) if availability is None else availability
        self.histories = Histories(self.availability)
        self.states: list[Any] = []  # of the filter in each class, of all bundles
        self.fits, self.node_fits, self.scores = [], [], []
        self.size = np.zeros(self.components)  # root mean squares of the estimated components

    def design(self, times: np.ndarray, grid: tuple[np.ndarray, ...]) -> dict[str, Any]:
        """Start, fits for the measurements, fits for the nodes, and the predicted errors.

        Parameters
        ----------
        times : ndarray, shape (K+1,)
        grid : tuple of ndarray, length K
            Node times.
        """
        start = self._start(times[0])
        for k in followed(range(len(grid)), "design"):
            t, stop = times[k], times[k + 1]
            if self.continuous:
                fits, memories = self._steps(t, [*grid[k], stop])
            else:
                fits, memories = self._nodes(k, t, grid[k])
            self.simulator.advance(self.scores[-1][0], stop)
            self.node_fits.append(tuple(fits))
            self._measurement(k + 1, stop, memories)
        scores = (np.array(part) for part in zip(*self.scores, strict=True))
        return {
            "start": start,
            "fits": tuple(self.fits),
            "node_fits": tuple(self.node_fits),
            "predicted": Accuracy(*scores, in_sample=True),
        }

    def _start(self, t) -> Start:
        """Moments of the first state and measurement, and the first estimates."""
        simulator, n = self.simulator, self.simulator.n
        simulator.begin()
        y, p = simulator.measure(t), simulator.system.values()
        joint = simulator.gather(lambda x, y: np.concatenate([x, y]), y)
        mean, cov = joint.mean, joint.cov
        start = Start(mean[:n], cov[:n, :n], Moments(mean[n:], cov[:n, n:], cov[n:, n:]))

        def initial(y):
            prior = np.broadcast_to(start.mean[:, None], (n, y.shape[1]))
            return FilterState(0, prior, start.cov, loglik=0.0)

        def correct(rules, state, y):
            return rules.first(state, t, y, p, start, covariance=False)

        self._correct(0, t, y, [simulator.executor(initial, y)], correct)
        return start

    def _fit(self, predictor, u, targets, size) -> Fit:
        """Fit a forecast of the first `targets` components from u, (d, paths) in each bundle."""
        return fit_forecast(
            predictor,
            lambda rows: self.simulator.gather(lambda x, u: rows(x[:targets], u), u),
            targets,
            size,
        )

    def _of_classes(self, fits) -> Fit | ClassFits:
        """One fit of those of the classes."""
        if self.one_class:
            return fits[0]
        return ClassFits.of(self.histories.classes.table, self.histories.prob, fits)

    def _nodes(self, k, t, nodes):
        """Fits of the discrete forecasts; also what the next measurement is forecast from."""
        simulator, n, node_fits = self.simulator, self.components, []
        memories = [simulator.executor(_memory, state) for state in self.states]
        size = self._sizes(k)
        for node in nodes:
            simulator.advance(t, node)
            t = node
            fits = [self._fit(Affine(), u, n, size) for u in memories]
            node_fits.append(self._of_classes(fits))
            pairs = zip(fits, memories, strict=True)
            self._score(t, *(simulator.finite(fit.mean, u) for fit, u in pairs))
        return node_fits, memories

    def _steps(self, t, stops):
        """Fits of the continuous forecast at each integration step, and where it leads."""
        simulator, fits = self.simulator, []
        (state,), p = self.states, simulator.system.values()
        z = simulator.executor(_estimate, state)
        for stop in stops:
            fits.append(self._fit(self.predictor, z, simulator.n, self.size))
            z = simulator.finite(_euler_step(fits[-1], t, stop - t, p), self.rules, z)
            if stop != stops[-1]:
                simulator.advance(t, stop)
                self._score(stop, z)
                t = stop
        return fits, [z]

    def _measurement(self, k, t, memories):
        """Fit the forecasts for a measurement, and correct them."""
        simulator, size = self.simulator, self._sizes(k - 1)
        p = simulator.system.values()
        fits = [self._fit(self.predictor, u, simulator.n, size) for u in memories]
        self.fits.append(self._of_classes(fits))

        def forecast(state, u, fit):
            mean, cov = fit.forecast(u)
            return state._replace(index=k, mean=mean, cov=cov, corrected=False)

        def correct(rules, state, y):
            return rules.correct(state, t, y, p, covariance=False)

        forecasts = [
            simulator.executor(partial(forecast, fit=fit), *pair)
            for fit, *pair in zip(fits, self.states, memories, strict=True)
        ]
        self._correct(k, t, simulator.measure(t), forecasts, correct)

    def _correct(self, k, t, y, forecasts, correct):
        """Correct each class with each pattern, and find the classes that this makes."""
        simulator, cells, moments, prob = self.simulator, {}, {}, {}
        for c, state in enumerate(forecasts):
            for number, arrived, chance in patterns(self.measured[k], self.availability):

                def corrected(rules, state, y, arrived=arrived):
                    return correct(rules, state, np.where(arrived[:, None], y, np.nan))

                cell = c, number
                cells[cell] = simulator.finite(corrected, self.rules, state, y, array=_estimate)
                moments[cell] = _second_moments(simulator, self.components, cells[cell])
                prob[cell] = chance * self.histories.prob[c]
        classes, self.states = self.histories.take(t, moments, prob), []
        several = any(len(members) > 1 for members in classes.members)
        uniform = simulator.uniform(ARRIVALS) if several else None
        for members in classes.members:
            states = [cells[cell] for cell in members]
            if len(states) > 1:
                drawn = partial(_drawn, shares(members, prob))
                states = [simulator.executor(drawn, uniform, *states)]
            self.states += states
        informed = self.one_class and self.measured[: k + 1].any()
        estimates = (simulator.executor(_estimate, state) for state in self.states)
        self._score(t, *estimates, informed=informed)

    def _sizes(self, k):
        """Magnitudes of the components of U_k; measurements are compared with themselves."""
        estimates = np.tile(self.size, min(k + 1, self.memory.estimates))
        total = self.memory.dimension(k, self.components, self.measured.shape[1])
        return np.concatenate([estimates, np.zeros(total - len(estimates))])

    def _score(self, t, *estimates, informed=False):
        """Note the error of the estimates of the classes, and how large state and estimate are."""
        n, prob = self.components, self.histories.prob

        def rows(x, z, *others):
            square = (x[:n] - z) ** 2
            if others:
                square *= prob[0]
                for chance, other in zip(prob[1:], others, strict=True):
                    square += chance * (x[:n] - other) ** 2
            return np.concatenate([square, x[:n] ** 2, x[:n], z])

        moments = self.simulator.gather(rows, *estimates)
        rms, error, deviation = root_mean_squares(moments, n)
        self.size = np.sqrt(moments.mean[n : 2 * n])
        if np.any(error > DOMINATED * rms):
            warnings.warn(
                f"paths: the errors at time {when(t)} rest on very few paths ({rms.max():.3g} ± "
                f"{error.max():.3g}); some of them diverge",
                stacklevel=outside(),
            )
        if informed:
            moving = deviation[2 * n : 3 * n] > ABSOLUTE * self.size
            for i in np.flatnonzero(moving & (deviation[3 * n :] <= ABSOLUTE * self.size)):
                warnings.warn(
                    f"memory: the estimate of component {i} at time {when(t)} is the same on all "
                    "paths; it carries no information",
                    stacklevel=outside(),
                )
        self.scores.append((t, rms, error))


def _euler_step(fit, t, h, p):
    """Step of the continuous forecast, without anything else of the pass in it."""
    return lambda rules, z: rules.move(fit, t, h, z, p)


def _second_moments(simulator, n, states):
    """Second moments of the errors of the estimates of n components, (n, n)."""
    rows, columns = lower_triangle(n)

    def products(x, state):
        error = x[:n] - state.mean
        return error[rows] * error[columns]

    return symmetric(simulator.gather(products, states).mean, n)


def _drawn(parts, uniform, first, *others):
    """State whose paths are those of several, by uniform numbers and parts that sum to one."""
    for end, other in zip(np.cumsum(parts), others, strict=False):
        from_other = uniform >= end

        def either(a, b, from_other=from_other):
            return np.where(from_other, b, a)

        past = (tuple(map(either, *blocks)) for blocks in zip(first.past, other.past, strict=True))
        first = first._replace(mean=either(first.mean, other.mean), past=Past(*past))
    return first
