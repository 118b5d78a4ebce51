"""The steps of a switching filter that its design and its run share, compiled for one system."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import outside
from seedslib.base.circle import Periods
from seedslib.base.linalg import nearest_psd, variances
from seedslib.base.values import Values, of_paths
from seedslib.designed.branches import (
    MomentFunction,
    constant_moments,
    forecast_row,
    reading_moments,
    split_row,
    switch_row,
)
from seedslib.designed.lemmas import ModeDistribution, Sensed, decide, propagate, sense, weigh
from seedslib.designed.memory import Memory, Past
from seedslib.filters.weights import relative
from seedslib.linearization.moments import Linearization, Moments
from seedslib.linearization.points import PointRule
from seedslib.models.switching import SwitchingSystem

NORMALISATIONS = ("consistent", "printed")

SOFTEST = 8.0
"""Remembered log-odds of the modes are cut to this range."""


class SwitchingState(NamedTuple):
    """What the filter remembers.

    Attributes
    ----------
    index : int
        Number k of the last measurement time reached; -1 before the first.
    time : float or None
        That time.
    dist : ModeDistribution
        After `predict` the forecast Q, lambda, Psi with its parts; after `correct` the posterior
        P, rho, Upsilon.
    mean : ndarray, shape (n, *batch), or None
        Estimate after `correct`.
    mode : ndarray of int, shape (*batch), or None
        Decided mode.
    past : Past
        The memory; empty where the posterior itself is carried.
    loglik : ndarray
        Log-density of the last measurement and indicator.
    corrected : bool
        Whether the measurement at `index` has been used.
    gap : ndarray of bool or bool
        Whether something that the design of a filter with a memory expects has been missing.
    interval : float or None
        Length of the first step.
    repaired : int
        Covariances whose negative eigenvalues had to be raised so far.
    """

    index: int
    time: float | None
    dist: ModeDistribution
    mean: MaybeArray
    mode: MaybeArray
    past: Past
    loglik: np.ndarray | float
    corrected: bool
    gap: np.ndarray | bool = False
    interval: float | None = None
    repaired: int = 0


class SwitchingRules:
    """Moment functions of a system under a linearization.

    Where the probability of an indicator depends on the state (and not on time or an input), a
    forecast has one Gaussian part for each of its values, (6.19), and one part otherwise. Without
    formulas for the parts a warning says so, and one part has to do.

    Parameters
    ----------
    system : SwitchingSystem
    linearization : Linearization
    normalisation : {"consistent", "printed"}

    Attributes
    ----------
    rows : list of callable
        Moments of the move from each mode, see `seedslib.designed.branches`.
    switch : list of callable, or None
        Those of the switch before it, where the new mode drives the step.
    readings : list of list of callable
        Moments of the measurement in each mode with each value of the indicator.
    unlabelled : list of callable, or None
        Those without the indicator's value, where there is one.
    split : bool
        Whether forecasts have a part for each value of the indicator.

    Raises
    ------
    NoClosedForm
        The linearization has no formulas for a branch; the message offers one that works.

    Warns
    -----
    UserWarning
        No formulas for the parts of a forecast.
    """

    def __init__(
        self,
        system: SwitchingSystem,
        linearization: Linearization,
        normalisation: str = "consistent",
    ) -> None:
        if normalisation not in NORMALISATIONS:
            raise ValueError(
                f"normalisation: wanted one of {', '.join(NORMALISATIONS)}, got {normalisation!r}"
            )
        self.system = system
        self.periods: Periods = system.sensors[0].period
        # rules of points may have negative weights
        self.guarded: bool = isinstance(linearization, PointRule)
        modes, rows = range(system.modes), None
        if not system.indicator_ignores_state:
            try:
                rows = [split_row(system, i, linearization) for i in modes]
            except ValueError as error:
                from seedslib.gaussian.algebra import NoClosedForm

                if isinstance(error, NoClosedForm):  # otherwise the system has no such parts
                    warnings.warn(
                        f"linearization: {linearization} has no moments of a forecast for each "
                        f"value of the indicator, one Gaussian serves all of them ({error})",
                        stacklevel=outside(),
                    )
        self.split: bool = rows is not None
        self.rows: list[MomentFunction] = (
            [forecast_row(system, i, linearization) for i in modes] if rows is None else rows
        )
        self.printed: bool = self.split and normalisation == "printed"
        self.switch: list[MomentFunction] | None = None
        if system.drives == "new":
            self.switch = [switch_row(system, i, linearization) for i in modes]
        self.readings: list[list[Any]] = [
            [reading and reading_moments(reading, linearization) for reading in row]
            for row in system.readings
        ]
        self.unlabelled: list[MomentFunction] | None = None
        if system.indicators:
            self.unlabelled = [constant_moments(s, linearization) for s in system.sensors]

    def initial(self, batch: tuple[int, ...]) -> ModeDistribution:
        """Mode and state before any measurement, one part for each mode."""
        parts, tail = self.system.initial, (1,) * len(batch)

        def repeated(values):
            values = np.stack(values, axis=-1)[..., None]
            return np.broadcast_to(values.reshape(*values.shape, *tail), (*values.shape, *batch))

        return ModeDistribution.of(
            repeated([part.probability for part in parts]),
            repeated([part.mean for part in parts]),
            repeated([part.cov for part in parts]),
        )

    def start(self, batch: tuple[int, ...]) -> SwitchingState:
        """State before any measurement."""
        return SwitchingState(-1, None, self.initial(batch), None, None, Past(), 0.0, False)

    @np.errstate(over="ignore", invalid="ignore")  # diverged paths show as NaN
    def predict(self, t: float, dist: ModeDistribution, p: Values = ()) -> ModeDistribution:
        """Forecast for the next time from the posterior at time t."""
        return propagate(with_numbers(self.rows, p), t, self.switched(t, dist, p))

    def switched(self, t: float, dist: ModeDistribution, p: Values = ()) -> ModeDistribution:
        """Mode and state after the switch at time t and before the move.

        The mixing of the interacting multiple model filter, where the new mode drives the step;
        `dist` itself where the old mode does, for then `rows` do both at once.
        """
        if self.switch is None:
            return dist
        log_prob, mean, cov = propagate(with_numbers(self.switch, p), t, dist)
        cov = cov[:, :, :, 0]
        return ModeDistribution(
            log_prob[:, 0], mean[:, :, 0], nearest_psd(cov)[0] if self.guarded else cov
        )

    def sense(
        self, t: float, dist: ModeDistribution, indicator: np.ndarray | None, p: Values = ()
    ) -> Sensed:
        """Mode and state given the indicator, and moments of the measurement.

        Parameters
        ----------
        t : float
        dist : ModeDistribution
            A forecast, with parts.
        indicator : ndarray of int, shape (*batch), or None
            -1 where it is missing.
        p : tuple
            Numbers of the parameters.
        """
        if indicator is None:
            return self._sense(t, dist, 0, p)
        values = np.unique(indicator)
        if len(values) <= 1:
            return self._sense(t, dist, int(values[0]) if len(values) else 0, p)
        batch, arrays = indicator.shape, []
        flat = ModeDistribution(
            *(part.reshape(*part.shape[: part.ndim - len(batch)], -1) for part in dist)
        )
        for j in values:
            paths = np.flatnonzero(indicator.ravel() == j)
            dist = ModeDistribution(*(part[..., paths] for part in flat))
            piece = self._sense(t, dist, int(j), of_paths(p, batch, paths))
            parts = (*piece[:3], *piece.moments)
            arrays = arrays or [np.empty((*part.shape[:-1], indicator.size)) for part in parts]
            for array, part in zip(arrays, parts, strict=True):
                array[..., paths] = part
        arrays = [part.reshape(*part.shape[:-1], *batch) for part in arrays]
        return Sensed(*arrays[:3], Moments(*arrays[3:]))

    def _sense(self, t, dist, j, p):
        """As `sense`, of one value of the indicator for all paths."""
        if j < 0:
            return sense(with_numbers(self.unlabelled, p), t, dist)
        if not any(row[j] for row in self.readings):  # a value that no mode ever gives
            sensed = sense(with_numbers(self.unlabelled, p), t, dist)
            return sensed._replace(log_prob=np.full_like(sensed.log_prob, -np.inf))
        readings = [row[j] for row in self.readings]
        # the part of the forecast that (6.21) divides by, where the printed form is wanted
        column = j if self.printed and dist.log_prob.shape[1] > 1 else None
        return sense(with_numbers(readings, p), t, dist, column)

    def _noise(self, t, sensed, p):
        """Covariance of the measurement at a known state in each mode, (m, m, L, *batch)."""
        readings = self.unlabelled or [row[0] for row in self.readings]
        zero, depth = np.zeros_like(sensed.cov[:, :, 0]), sensed.log_prob.ndim - 1
        noise = np.empty_like(sensed.moments.cov)
        for i, reading in enumerate(readings):
            cov = reading(t, sensed.mean[:, i, None], zero[:, :, None], p).value.cov
            cov = cov[:, :, 0] if cov.ndim > 2 else cov.reshape(*cov.shape, *(1,) * depth)
            noise[:, :, i] = cov
        return noise

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def correct(
        self,
        state: SwitchingState,
        y: np.ndarray,
        indicator: MaybeArray,
        memory: Memory | None,
        p: Values = (),
    ) -> SwitchingState:
        """State after a measurement y (m, *batch) and an indicator."""
        forecast, repaired = state.dist, state.repaired
        if self.guarded:
            cov, count = nearest_psd(forecast.cov)
            scaled = forecast.log_prob - np.log(forecast.prob.sum(axis=(0, 1)))
            forecast = ModeDistribution(scaled, forecast.mean, cov)
            repaired += count
        sensed = self.sense(state.time, forecast, indicator, p)
        impossible = (sensed.log_prob == -np.inf).all(axis=0)
        if indicator is not None and impossible.any():  # in any mode: as if it were missing
            possible = np.where(impossible, -1, indicator)
            sensed = self.sense(state.time, forecast, possible, p)
        if self.printed:
            cov, count = nearest_psd(sensed.moments.cov)
            sensed = sensed._replace(moments=sensed.moments._replace(cov=cov))
            repaired += count
        elif self.guarded:
            sensed, count = _semidefinite(sensed)
            repaired += count
        dist, loglik = weigh(sensed, y, lambda: self._noise(state.time, sensed, p), self.periods)
        if impossible.any():
            loglik = np.where(impossible, -np.inf, loglik)
        cov, count = nearest_psd(dist.cov, variances(sensed.cov))
        dist = dist._replace(cov=cov)
        mode, mean = decide(dist)
        past = state.past
        if memory is not None:
            past = _pushed(memory, past, mean, mode, y, indicator, dist, sensed)
        return state._replace(
            dist=dist,
            mean=mean,
            mode=mode,
            past=past,
            loglik=loglik,
            repaired=repaired + count,
            corrected=True,
        )


@lru_cache(maxsize=16)
def compiled_rules(
    system: SwitchingSystem, linearization: Linearization, normalisation: str
) -> SwitchingRules:
    """Rules of a system and a linearization, the same object for the same arguments."""
    return SwitchingRules(system, linearization, normalisation)


def with_numbers(rows: Sequence[MomentFunction | None], p: Values) -> list[Any]:
    """Moment functions (t, mean, cov) of those that take the numbers of the parameters too."""
    return [row and partial(row, p=p) for row in rows]


def _pushed(memory, past, mean, mode, y, indicator, dist, sensed) -> Past:
    """The memory with a step more; a missing measurement is remembered as what was expected."""
    missing = np.isnan(y)
    if memory.measurements and missing.any():
        weight = relative(sensed.log_prob, 0)[0]
        weight = weight / weight.sum(axis=0)
        y = np.where(missing, (weight * sensed.moments.mean).sum(axis=1), y)
    if memory.indicators and (indicator < 0).any():
        raise ValueError("indicator: wanted by the memory, got a missing one")
    odds = log_odds(dist.log_prob) if memory.log_odds else None
    return memory.push(
        past, estimate=mean, measurement=y, mode=mode, indicator=indicator, log_odds=odds
    )


def _semidefinite(sensed):
    """The same with joint covariances that are semidefinite, and how many had to be repaired."""
    n, (mean, cross, cov) = len(sensed.cov), sensed.moments
    upper = np.concatenate([sensed.cov, cross], axis=1)
    lower = np.concatenate([np.swapaxes(cross, 0, 1), cov], axis=1)
    joint, repaired = nearest_psd(np.concatenate([upper, lower]))
    moments = Moments(mean, joint[:n, n:], joint[n:, n:])
    return sensed._replace(cov=joint[:n, :n], moments=moments), repaired


def log_odds(log_prob: np.ndarray) -> np.ndarray:
    """Log-odds of the modes against mode 0, cut to ±8: (L - 1, *batch)."""
    odds = log_prob[1:] - log_prob[0]
    return np.clip(np.nan_to_num(odds, nan=0.0, posinf=SOFTEST, neginf=-SOFTEST), -SOFTEST, SOFTEST)
