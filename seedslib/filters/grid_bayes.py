"""Bayes filter of a scalar switching system on a grid: the exact posterior law, for reference."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.base.tables import Axis
from seedslib.filters.estimates import Estimates, as_indicators, require_time, stays
from seedslib.filters.verbs import run_in_blocks
from seedslib.filters.weights import relative
from seedslib.models.chain_switching import SwitchingChain
from seedslib.models.switching import SwitchingSystem

BLOCK = 512
"""Records in a block: the laws of a block stay in the processor's cache."""


class GridState(NamedTuple):
    """Law of mode and state on the nodes, (L, S, *batch), and the last estimate.

    ``mode_prob`` has shape (L, *batch), ``mean`` (1, *batch), ``cov`` (1, 1, *batch);
    ``diverged`` marks the records with a measurement that no node explains.
    """

    time: float | None
    law: np.ndarray
    mode_prob: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray
    diverged: np.ndarray


class GridBayesFilter:
    """Posterior law of mode and state on evenly spaced nodes.

    The absolutely optimal filter (the paper's AOF) of a system with one state component:
    (4.1) to (4.3) of the switching paper with the law of the object itself in place of its law
    given a finite memory. It uses no random numbers. Columns of the transition matrix are
    normalised, so what would leave the axis is spread over its nodes.

    Parameters
    ----------
    system : SwitchingSystem
        With one state component, whose next value and whose measurement have densities.
    x : Axis or (low, high, count)
        Nodes of the state; the range should hold all but a millionth of the probability.

    Raises
    ------
    TypeError, ValueError
        No switching system, more state components, branches without a density.
    """

    def __init__(self, system, x=(-8.0, 8.0, 161)):
        if not isinstance(system, SwitchingSystem):
            raise TypeError(f"system: wanted a SwitchingSystem, got {system!r}")
        self.system, self.axis = system, Axis.of("x", x)
        self._chain = SwitchingChain(system, self.axis)

    def initial(self, batch=(), seed=None) -> GridState:
        """State before any measurement; `seed` is not used, every filter has the same verbs."""
        shape = (self.system.modes, self.axis.count)
        law = self._chain.start().reshape(*shape, *(1,) * len(batch))
        law = np.broadcast_to(law, (*shape, *batch))
        return GridState(
            None, law, *self._moments(law), np.zeros(batch), np.zeros(batch, dtype=bool)
        )

    def predict(self, state: GridState, t: float) -> GridState:
        """One step of the system, to time t; a state without a time is only given one.

        Raises
        ------
        ValueError
            A time before that of the state.
        """
        if stays(state, t):
            return state._replace(time=float(t))
        shape = state.law.shape
        move = self._chain.transition(state.time, float(t))
        law = (move @ state.law.reshape(len(move), -1)).reshape(shape)
        prob, mean, cov = self._moments(law)
        return state._replace(time=float(t), law=law, mode_prob=prob, mean=mean, cov=cov)

    def correct(self, state: GridState, y, indicator=None) -> GridState:
        """Weight the law by a measurement.

        Parameters
        ----------
        state : GridState
        y : array_like, shape (m, *batch)
            NaN where missing.
        indicator : array_like of int, shape (*batch), optional
            -1 where missing.

        Raises
        ------
        ValueError
            A state without a time: `predict` gives it one.
        """
        require_time(state)
        y = np.asarray(y, dtype=float)
        shown = as_indicators(indicator, self.system, y.shape[1:], "indicator")
        seen = y if shown is None else np.concatenate([shown[None].astype(float), y])
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            weight = self._chain.log_likelihood(state.time, seen.reshape(len(seen), -1)).T
        weight = np.where(np.isfinite(weight), weight, -np.inf)
        weight = weight.reshape(state.law.shape)
        weight, highest, lost = relative(weight, (0, 1))
        weight *= state.law
        total = weight.sum(axis=(0, 1))
        lost |= ~(total > 0)
        if lost.any():
            weight = np.where(lost, state.law, weight)
        weight /= np.where(lost, 1.0, total)
        with np.errstate(divide="ignore"):
            loglik = np.where(lost, -np.inf, highest + np.log(total))
        return GridState(state.time, weight, *self._moments(weight), loglik, state.diverged | lost)

    def step(self, state: GridState, t: float, y, indicator=None) -> GridState:
        """One step of the system to time t, and the correction there."""
        return self.correct(self.predict(state, t), y, indicator)

    def forecast(self, state: GridState, t: float) -> Estimates:
        """Mean (1, *batch), covariance and mode probabilities one step later, at time t."""
        later = self.predict(state, t)
        return Estimates(later.mean, later.cov, later.mode_prob)

    def run(self, times, measurements, *, indicators=None, workers=1) -> Estimates:
        """Filter a record, or many at once.

        Parameters
        ----------
        times : array_like, shape (K+1,)
        measurements : array_like, shape (K+1, m, *batch)
            NaN marks a missing component.
        indicators : array_like of int, shape (K+1, *batch), optional
            -1 where missing; wanted if the system has an indicator.
        workers : int
            Threads over blocks of records.

        Returns
        -------
        Estimates
            Mean (K+1, 1, *batch), covariance, mode probabilities (K+1, L, *batch), decided
            modes, logarithms of the predictive densities, `diverged`.

        Raises
        ------
        TypeError, ValueError
            Times that do not increase, infinite measurements, shapes that do not fit.
        """
        return run_in_blocks(self, times, measurements, indicators, block=BLOCK, workers=workers)

    def _moments(self, law):
        prob, marginal, x = law.sum(axis=1), law.sum(axis=0), self.axis.nodes
        mean = np.tensordot(x, marginal, 1)
        variance = np.tensordot(x**2, marginal, 1) - mean**2
        return prob, mean[None], np.maximum(variance, 0.0)[None, None]
