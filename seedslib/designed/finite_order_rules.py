"""The steps of a finite-order filter that its design and its run share, and what they hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.circle import Periods, nearest
from seedslib.base.correction import correct
from seedslib.designed.memory import Memory, Past
from seedslib.designed.patterns import chosen
from seedslib.designed.predictors import AffineFit, Continuous
from seedslib.designed.traced import TracedCorrection, mean_velocity, traced_correction
from seedslib.linearization.moments import Linearization, Moments
from seedslib.models.kinds import AnySystem


class Start(NamedTuple):
    """Moments for the first estimate, which is the best affine one in Y_0.

    Attributes
    ----------
    mean, cov : ndarray, shapes (n,) and (n, n)
        Of X_0.
    moments : Moments
        Of Y_0, with cov(X_0, Y_0).
    """

    mean: np.ndarray
    cov: np.ndarray
    moments: Moments


class FiniteOrderState(NamedTuple):
    """What the filter remembers.

    Attributes
    ----------
    index : int
        Number k of the last measurement time reached; -1 before the first.
    mean : ndarray
        After `predict` the forecast of the whole state, (n, *batch); after `correct` the
        estimate Z_k, (n', *batch).
    cov : ndarray or None
        Its covariance as the filter sees it, with or without batch axes.
    past : Past
        The memory U_k; after `predict` still U_{k-1}.
    measurement : ndarray or None
        Last measurement, missing components filled with their forecasts.
    loglik : ndarray
        Log-density of the last measurement as forecast by the filter.
    before : FiniteOrderState or None
        The state after the measurement before the last, needed by linear forecasts.
    corrected : bool
        Whether the measurement at `index` was taken in.
    gap : ndarray of bool, shape (*batch), or False
        Whether something that the design does not know of has been missing so far.
    group : ndarray of int, shape (*batch), or 0
        Class of what has arrived so far, see `seedslib.designed.patterns`.
    """

    index: int
    mean: np.ndarray
    cov: MaybeArray
    past: Past
    measurement: MaybeArray
    loglik: np.ndarray | float
    before: object
    corrected: bool
    gap: np.ndarray | bool = False
    group: np.ndarray | int = 0


def initial_moments(moments: Moments, depth: int) -> Moments:
    """Moments of the first measurement, shaped for `depth` batch axes."""
    return moments._replace(mean=moments.mean.reshape(-1, *(1,) * depth))


@dataclass(frozen=True)
class Rules:
    """The steps of a filter that its design and its run share."""

    memory: Memory
    components: int
    sensor: object
    traced: TracedCorrection | None = None
    velocity: object = None
    measured_nodes: bool = False
    periods: Periods = ()

    @classmethod
    def of(
        cls, system: AnySystem, memory: Memory, predictor: Any, linearization: Linearization,
        components: int, measured_nodes: bool,
    ) -> Rules:  # fmt: skip
        """Rules of a filter; the moment functions are compiled here."""
        velocity = None
        if isinstance(predictor, Continuous):
            velocity = mean_velocity(system, linearization)
        sensor = linearization.moments(system.sensor)
        periods = system.sensor.period
        traced = None if periods else traced_correction(system.sensor, linearization, components)
        return cls(memory, components, sensor, traced, velocity, measured_nodes, periods)

    def first(
        self, state: FiniteOrderState, t: float, y: np.ndarray, start: Start,
        spread: bool = True,
    ) -> FiniteOrderState:  # fmt: skip
        """State after the first measurement, whose moments are fixed."""
        moments = initial_moments(start.moments, state.mean.ndim - 1)
        return self._corrected(state, t, y, moments, spread, start.mean)

    def correct(
        self, state: FiniteOrderState, t: float, y: np.ndarray, spread: bool = True
    ) -> FiniteOrderState:
        """State after the measurement; its `mean` and `cov` hold the forecast before."""
        if self.traced is not None and state.mean.ndim == 1:
            found = self.traced(t, state.mean, state.cov, y, spread)
            if found is not None:
                return self._remembered(state, y, *found)
        moments = self.sensor(t, state.mean, state.cov)
        return self._corrected(state, t, y, moments, spread, state.mean)

    def _corrected(self, state, t, y, moments, spread, place):
        y = nearest(y, moments.mean, self.periods)
        found = correct(
            state.mean, state.cov if spread else None, y, moments, rows=self.components,
            noise=lambda: self.sensor(t, place, np.zeros_like(state.cov)).cov,
        )  # fmt: skip
        # a missing measurement is remembered as what was expected
        missing = np.isnan(y)
        shown = np.where(missing, moments.mean, y) if missing.any() else y
        return self._remembered(state, shown, *found)

    def _remembered(self, state, shown, mean, cov, loglik):
        past = self.memory.push(state.past, estimate=mean, measurement=shown)
        return FiniteOrderState(
            state.index, mean, cov, past, shown, loglik, state.before, True, state.gap, state.group
        )

    def node_memory(self, state: FiniteOrderState) -> np.ndarray:
        """What the node forecasts look at: U_k, and Y_k where remark 1 is used."""
        u = state.past.vector
        if self.measured_nodes and not self.memory.measurements:
            return np.concatenate([u, state.measurement])
        return u

    def nodes(
        self, fits: Sequence[AffineFit], stops: Sequence[float], state: FiniteOrderState
    ) -> tuple[list[np.ndarray], np.ndarray | None]:
        """Estimates at the nodes of an interval, and at its end where they lead there.

        Parameters
        ----------
        fits : tuple of AffineFit
            Forecasts for the nodes; of a continuous forecast those at the start of each step.
        stops : sequence of float
            Start of the interval, its nodes, its end.
        state : FiniteOrderState
        """
        if self.velocity is None:
            u = self.node_memory(state)
            return [chosen(fit, state.group).mean(u) for fit in fits], None
        moved, z = [], state.mean
        for fit, t, after in zip(fits, stops, stops[1:], strict=False):
            z = self.move(fit, t, after - t, z)
            moved.append(z)
        return moved[: len(stops) - 2], moved[-1]

    def move(self, fit: AffineFit, t: float, h: float, z: np.ndarray) -> np.ndarray:
        """Euler step of the continuous forecast, dZ/dt = E b'(t, X) given Z."""
        n = self.components
        if z.ndim == 1:  # numbers: the interpreter's work on tiny arrays would be most of it
            values, moved = z.tolist(), z.copy()
            mean = [
                sum(map(mul, row, values), start)
                for row, start in zip(fit.gain.tolist(), fit.offset.tolist(), strict=True)
            ]
            for k, rate in enumerate(self.velocity(t, mean, fit.cov)[:n]):
                moved[k] += h * rate
            return moved
        with np.errstate(over="ignore", invalid="ignore"):
            mean, moved = fit.mean(z), np.empty_like(z)
            for k, rate in enumerate(self.velocity(t, list(mean), fit.cov)[:n]):
                np.multiply(rate, h, out=moved[k])
                moved[k] += z[k]
        return moved
