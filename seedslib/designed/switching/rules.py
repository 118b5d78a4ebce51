"""The steps of a switching filter that its design and its run share, compiled for one system."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.linalg import nearest_psd, variances
from seedslib.base.values import Values, of_paths
from seedslib.designed.memory import Memory, Past
from seedslib.designed.switching.branches import (
    alone_moments,
    forecast_row,
    plain_moments,
    split_row,
    switch_row,
)
from seedslib.designed.switching.lemmas import ModeLaw, Sensed, decide, propagate, sense, weigh
from seedslib.filters.weights import relative
from seedslib.linearization.moments import Moments
from seedslib.linearization.points import PointRule
from seedslib.models.kinds import AnySystem

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
    law : ModeLaw
        After `predict` the forecast Q, lambda, Psi with its parts; after `correct` the posterior
        P, rho, Upsilon.
    mean : ndarray, shape (n, *batch), or None
        Estimate after `correct`.
    mode : ndarray of int, shape (*batch), or None
        Decided mode.
    past : Past
        The memory; empty where nothing but the law is carried.
    loglik : ndarray
        Log-density of the last measurement and indicator.
    mended : int
        Covariances whose eigenvalues had to be raised so far.
    corrected : bool
    gap : ndarray of bool or bool
        Whether something was missing so far, which the design of a filter with a memory does not
        know.
    interval : float or None
        Length of the first step.
    """

    index: int
    time: float | None
    law: ModeLaw
    mean: MaybeArray
    mode: MaybeArray
    past: Past
    loglik: np.ndarray | float
    mended: int
    corrected: bool
    gap: np.ndarray | bool = False
    interval: float | None = None


class SwitchingRules:
    """Moment functions of a system under a linearization.

    A forecast has one Gaussian part for each value of an indicator that depends on the state,
    (6.19), where the linearization has formulas for them, and one part otherwise.

    Parameters
    ----------
    system : SwitchingSystem
    linearization : Linearization
    normalisation : {"consistent", "printed"}

    Raises
    ------
    NoClosedForm
        The linearization has no formulas for a branch; the message offers one that works.
    """

    def __init__(
        self, system: AnySystem, linearization: Any, normalisation: str = "consistent"
    ) -> None:
        if normalisation not in NORMALISATIONS:
            raise ValueError(
                f"normalisation: wanted one of {', '.join(NORMALISATIONS)}, got {normalisation!r}"
            )
        self.system = system
        self.periods: Any = system.sensors[0].period
        # rules of points may have negative weights
        self.guarded: bool = isinstance(linearization, PointRule)
        modes = range(system.modes)
        self.rows, self.split = None, not system.indicator_is_blind
        if self.split:
            try:
                self.rows = [split_row(system, i, linearization) for i in modes]
            except ValueError:  # no formulas, or an indicator that changes with time
                self.split = False
        if not self.split:
            self.rows = [forecast_row(system, i, linearization) for i in modes]
        self.printed: bool = self.split and normalisation == "printed"
        self.switch: list[Any] | None = None
        if system.drives == "new":
            self.switch = [switch_row(system, i, linearization) for i in modes]
        self.readings: list[Any] = [
            [reading and alone_moments(reading, linearization) for reading in row]
            for row in system.readings
        ]
        self.unseen: list[Any] | None = None
        if system.indicators:
            self.unseen = [plain_moments(sensor, 1.0, linearization) for sensor in system.sensors]

    def initial(self, batch: tuple[int, ...]) -> ModeLaw:
        """Law of mode and state before any measurement, one part for each mode."""
        parts, tail = self.system.initial, (1,) * len(batch)

        def spread(values):
            values = np.stack(values, axis=-1)[..., None]
            return np.broadcast_to(values.reshape(*values.shape, *tail), (*values.shape, *batch))

        return ModeLaw.of(
            spread([part.probability for part in parts]),
            spread([part.mean for part in parts]),
            spread([part.cov for part in parts]),
        )

    def start(self, batch: tuple[int, ...]) -> SwitchingState:
        """State before any measurement."""
        return SwitchingState(-1, None, self.initial(batch), None, None, Past(), 0.0, 0, False)

    def predict(self, t: float, law: ModeLaw, p: Values = ()) -> ModeLaw:
        """Forecast for the next time from the law at time t."""
        with np.errstate(over="ignore", invalid="ignore"):  # lost paths show as NaN
            return propagate(with_numbers(self.rows, p), t, self.switched(t, law, p))

    def switched(self, t: float, law: ModeLaw, p: Values = ()) -> ModeLaw:
        """Law after the switch at time t and before the move, which the new mode drives.

        The mixing of the interacting multiple model filter; the law itself where the old mode
        drives the step, for then `rows` do both at once.
        """
        if self.switch is None:
            return law
        prob, mean, cov = propagate(with_numbers(self.switch, p), t, law)
        cov = cov[:, :, :, 0]
        return ModeLaw(prob[:, 0], mean[:, :, 0], nearest_psd(cov)[0] if self.guarded else cov)

    def sense(self, t: float, law: ModeLaw, indicator: np.ndarray | None, p: Values = ()) -> Sensed:
        """Law given the indicator, and moments of the measurement.

        Parameters
        ----------
        t : float
        law : ModeLaw
            With parts.
        indicator : ndarray of int, shape (*batch), or None
            -1 where it is missing.
        p : tuple
            Numbers of the parameters.
        """
        if indicator is None:
            readings = [row[0] for row in self.readings]
            return sense(with_numbers(readings, p), t, law, self._column(law, 0))
        values = np.unique(indicator)
        if len(values) <= 1:
            return self._sense(t, law, int(values[0]) if len(values) else 0, p)
        batch, whole = indicator.shape, []
        flat = ModeLaw(*(part.reshape(*part.shape[: part.ndim - len(batch)], -1) for part in law))
        for j in values:
            here = np.flatnonzero(indicator.ravel() == j)
            law = ModeLaw(*(part[..., here] for part in flat))
            piece = self._sense(t, law, int(j), of_paths(p, batch, here))
            parts = (*piece[:3], *piece.moments)
            whole = whole or [np.empty((*part.shape[:-1], indicator.size)) for part in parts]
            for target, part in zip(whole, parts, strict=True):
                target[..., here] = part
        found = [part.reshape(*part.shape[:-1], *batch) for part in whole]
        return Sensed(*found[:3], Moments(*found[3:]))

    def _sense(self, t, law, j, p):
        if j < 0:
            return sense(with_numbers(self.unseen, p), t, law)
        if not any(row[j] for row in self.readings):  # a value that no mode ever shows
            blind = sense(with_numbers(self.unseen, p), t, law)
            return blind._replace(log_prob=np.full_like(blind.log_prob, -np.inf))
        readings = [row[j] for row in self.readings]
        return sense(with_numbers(readings, p), t, law, self._column(law, j))

    def _noise(self, t, sensed, p):
        """Covariance of the measurement at a known state in each mode, (m, m, L, *batch)."""
        readings = self.unseen or [row[0] for row in self.readings]
        still, depth = np.zeros_like(sensed.cov[:, :, 0]), sensed.log_prob.ndim - 1
        noise = np.empty_like(sensed.moments.cov)
        for i, reading in enumerate(readings):
            cov = reading(t, sensed.mean[:, i, None], still[:, :, None], p).value.cov
            cov = cov[:, :, 0] if cov.ndim > 2 else cov.reshape(*cov.shape, *(1,) * depth)
            noise[:, :, i] = cov
        return noise

    def _column(self, law, j):
        """Part of the forecast that (6.21) divides by, where the printed form is wanted."""
        return j if self.printed and law.log_prob.shape[1] > 1 else None

    def correct(
        self,
        state: SwitchingState,
        y: np.ndarray,
        indicator: ArrayLike | None,
        memory: Memory,
        p: Values = (),
    ) -> SwitchingState:
        """State after a measurement y (m, *batch) and an indicator."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return self._corrected(state, y, indicator, memory, p)

    def _corrected(self, state, y, indicator, memory, p):
        raised = 0
        if self.guarded:
            cov, raised = nearest_psd(state.law.cov)
            scaled = state.law.log_prob - np.log(state.law.prob.sum(axis=(0, 1)))
            state = state._replace(law=state.law._replace(log_prob=scaled, cov=cov))
        sensed = self.sense(state.time, state.law, indicator, p)
        impossible = (sensed.log_prob == -np.inf).all(axis=0)
        if indicator is not None and impossible.any():  # what no mode can show says nothing
            seen = np.where(impossible, -1, indicator)
            sensed = self.sense(state.time, state.law, seen, p)
        if self.printed:
            spread, more = nearest_psd(sensed.moments.cov)
            sensed = sensed._replace(moments=sensed.moments._replace(cov=spread))
            raised += more
        elif self.guarded:
            sensed, more = _semidefinite(sensed)
            raised += more
        law, loglik = weigh(sensed, y, lambda: self._noise(state.time, sensed, p), self.periods)
        if impossible.any():
            loglik = np.where(impossible, -np.inf, loglik)
        cov, more = nearest_psd(law.cov, variances(sensed.cov))
        law = law._replace(cov=cov)
        mode, mean = decide(law)
        past = state.past
        if memory is not None:
            shown, missing = y, np.isnan(y)
            if memory.measurements and missing.any():
                # a missing measurement is remembered as what was expected
                weight = relative(sensed.log_prob, 0)[0]
                weight = weight / weight.sum(axis=0)
                expected = (weight * sensed.moments.mean).sum(axis=1)
                shown = np.where(missing, expected, y)
            if memory.indicators and (indicator < 0).any():
                raise ValueError("indicator: wanted by the memory, got a missing one")
            past = memory.push(
                past,
                estimate=mean,
                measurement=shown,
                mode=mode,
                indicator=indicator,
                log_odds=log_odds(law.log_prob) if memory.log_odds else None,
            )
        return state._replace(
            law=law,
            mean=mean,
            mode=mode,
            past=past,
            loglik=loglik,
            mended=state.mended + raised + more,
            corrected=True,
        )


@lru_cache(maxsize=16)
def compiled_rules(system: AnySystem, linearization: Any, normalisation: str) -> SwitchingRules:
    """Rules of a system and a linearization, the same object for the same arguments."""
    return SwitchingRules(system, linearization, normalisation)


def with_numbers(rows: Sequence[Any], p: Values) -> list[Any]:
    """Moment functions (t, mean, cov) of such that take the numbers of the parameters too."""
    return [row and partial(row, p=p) for row in rows]


def _semidefinite(sensed):
    """The same with joint covariances that are semidefinite, and how many had to be mended."""
    n, (mean, cross, spread) = len(sensed.cov), sensed.moments
    upper = np.concatenate([sensed.cov, cross], axis=1)
    lower = np.concatenate([np.swapaxes(cross, 0, 1), spread], axis=1)
    joint, raised = nearest_psd(np.concatenate([upper, lower]))
    moments = Moments(mean, joint[:n, n:], joint[n:, n:])
    return sensed._replace(cov=joint[:n, :n], moments=moments), raised


def log_odds(log_prob: np.ndarray) -> np.ndarray:
    """Log-odds of the modes against mode 0, cut to ±8: (L - 1, *batch)."""
    with np.errstate(invalid="ignore"):
        odds = log_prob[1:] - log_prob[0]
    return np.clip(np.nan_to_num(odds, nan=0.0, posinf=SOFTEST, neginf=-SOFTEST), -SOFTEST, SOFTEST)
