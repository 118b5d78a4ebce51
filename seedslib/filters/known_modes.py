"""Filter of a switching system that is told the modes: a bound for all that have to guess them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.base.blocks import BLOCK, in_blocks
from seedslib.base.checks import unmasked
from seedslib.base.correction import correct
from seedslib.base.semidefinite import settled
from seedslib.filters.estimates import Estimates, as_indicators, as_record, require_time, stays
from seedslib.filters.verbs import as_modes
from seedslib.linearization.moments import Gaussian, Linearization
from seedslib.linearization.points import PointRule
from seedslib.models.kinds import as_grid, require_kind


class KnownModeState(NamedTuple):
    """Time, known mode (*batch), mean (n, *batch), covariance (n, n, *batch), log-likelihood."""

    time: float | None
    mode: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray


class KnownModeFilter:
    """Mean and covariance of the state given measurements and the true modes.

    For a jump-linear system it is the Kalman filter with known modes, and no filter that has to
    recognise the modes has a smaller mean-square error. Where the switch or the indicator depends
    on the state, seeing them says something of the state: the moments are those in the branch
    that was taken, so that a good linearization comes close to the bound.

    Parameters
    ----------
    system : SwitchingSystem
    linearization : Linearization, optional
        `Taylor` by default, which is exact for jump-linear systems.

    Raises
    ------
    TypeError
        No switching system, or something that is no linearization.
    NoClosedForm
        The linearization has no formulas for this system; the message offers one that works.
    """

    def __init__(self, system, linearization=None):
        require_kind(system, "SwitchingSystem")
        if linearization is None:
            from seedslib.linearization.symbolic import Taylor

            linearization = Taylor()
        if not isinstance(linearization, Linearization):
            raise TypeError(f"linearization: wanted a Linearization, got {linearization!r}")
        self.system, self.linearization = system, linearization
        self._moves = [
            [self._move(i, branch) for branch in row] for i, row in enumerate(system.branches)
        ]
        self._sensors = [linearization.moments(map) for map in system.sensors]
        self._readings = [
            [None if b is None or b.constant else linearization.weighted(b.map) for b in row]
            for row in system.readings
        ]

    def _move(self, i, branch):
        """Function (t, mean, cov) -> Gaussian of the next state in a branch; None for none."""
        if branch is None:
            return None
        if branch.constant:
            return self.linearization.transition(self.system.dynamics[i])
        weighted = self.linearization.weighted(branch.map)

        def move(t, mean, cov):
            _, _, y = weighted(t, mean, cov)
            return Gaussian(y.mean, y.cov)

        return move

    def initial(self, batch=(), seed=None, *, mode=0) -> KnownModeState:
        """State before any measurement, for known modes of shape (*batch) or one for all.

        `seed` is not used, every filter has the same verbs.
        """
        mode = as_modes("mode", np.broadcast_to(mode, batch), batch, self.system.modes)
        mean = np.stack([part.mean for part in self.system.initial], axis=1)[:, mode]
        cov = np.stack([part.cov for part in self.system.initial], axis=2)[:, :, mode]
        return KnownModeState(None, mode, mean, cov, np.zeros(batch))

    def predict(self, state: KnownModeState, t: float, mode=None) -> KnownModeState:
        """One step of the system to time t, where the mode is `mode` (*batch).

        A state without a time is only given one, and keeps its mode.

        Raises
        ------
        ValueError
            A time before that of the state, a step without its mode, a switch that never
            happens.
        """
        if stays(state, t):
            return state._replace(time=float(t))
        if mode is None:
            raise ValueError("mode: wanted the mode at the later time, got None")
        mode = as_modes("mode", mode, state.mode.shape, self.system.modes)
        mean, cov = np.empty(state.mean.shape), np.empty(state.cov.shape)
        for i, row in enumerate(self._moves):
            for l, move in enumerate(row):
                here = (state.mode == i) & (mode == l)
                if not here.any():
                    continue
                if move is None:
                    raise ValueError(f"mode: wanted possible switches, got one from {i} to {l}")
                _put(mean, cov, here, move(state.time, state.mean[:, here], state.cov[:, :, here]))
        return state._replace(time=float(t), mode=mode, mean=mean, cov=cov)

    def correct(self, state: KnownModeState, y, indicator=None) -> KnownModeState:
        """Correct by a measurement, shape (m, *batch).

        An indicator (*batch) is used only where it depends on the state; -1 is missing.

        Raises
        ------
        ValueError
            A state without a time: `predict` gives it one.
        """
        require_time(state)
        y = np.asarray(unmasked("y", y, missing=np.nan), dtype=float)
        shown = as_indicators(indicator, self.system, y.shape[1:], "indicator")
        mean, cov = np.empty(state.mean.shape), np.empty(state.cov.shape)
        loglik = np.empty(state.mode.shape)
        for i, row in enumerate(self._readings):
            for j, reading in ((-1, None), *enumerate(row)):
                here = (state.mode == i) & (shown == j if shown is not None else j < 0)
                if not here.any():
                    continue
                prior = state.mean[:, here], state.cov[:, :, here]
                if reading is None:
                    moments = self._sensors[i](state.time, *prior)
                else:
                    _, prior, moments = reading(state.time, *prior)
                plain, still = self._sensors[i], np.zeros_like(prior[1])
                *found, loglik[here] = correct(
                    *prior, y[:, here], moments,
                    noise=lambda f=plain, m=prior[0], d=still: f(state.time, m, d).cov,
                )  # fmt: skip
                if isinstance(self.linearization, PointRule):
                    found[1] = settled(found[1], prior[1])
                _put(mean, cov, here, found)
        return state._replace(mean=mean, cov=cov, loglik=loglik)

    def step(self, state: KnownModeState, t: float, y, indicator=None, *, mode) -> KnownModeState:
        """One step of the system to time t and mode `mode`, and the correction there."""
        return self.correct(self.predict(state, t, mode), y, indicator)

    def run(self, times, measurements, *, modes, indicators=None, workers=1) -> Estimates:
        """Filter a record, or many at once.

        Parameters
        ----------
        times : array_like, shape (K+1,)
        measurements : array_like, shape (K+1, m, *batch)
            NaN marks a missing component.
        modes : array_like of int, shape (K+1, *batch)
            The true modes.
        indicators : array_like of int, shape (K+1, *batch), optional
            -1 where missing; wanted if the system has an indicator.
        workers : int
            Threads over blocks of records.

        Returns
        -------
        Estimates
            Mean (K+1, n, *batch), covariance, logarithms of the predictive densities given the
            modes, `diverged`; ``modes`` are those given, ``mode_prob`` is one for them.

        Raises
        ------
        TypeError, ValueError
            Times that do not increase, infinite measurements, shapes that do not fit, modes out
            of range or switches that never happen.
        """
        times = as_grid("times", times, self.system)
        y = as_record(measurements, len(times), self.system.measurement_size)
        batch, count = y.shape[2:], len(times)
        modes = as_modes("modes", modes, (count, *batch), self.system.modes)
        shown = as_indicators(indicators, self.system, (count, *batch))
        shown = None if shown is None else shown.reshape(count, -1)
        flat, labels = y.reshape(*y.shape[:2], -1), modes.reshape(count, -1)

        def work(start, stop, _):
            own = slice(start, stop)
            state = self.initial((stop - start,), mode=labels[0, own])
            rows = []
            for k, t in enumerate(times):
                seen = None if shown is None else shown[k, own]
                state = self.step(state, t, flat[k, :, own], seen, mode=labels[k, own])
                rows.append((state.mean, state.cov, state.loglik))
            return [np.stack(part) for part in zip(*rows, strict=True)]

        parts = in_blocks(work, flat.shape[2], 0, workers=workers, block=BLOCK)
        mean, cov, loglik = (
            joined.reshape((*joined.shape[:-1], *batch))
            for joined in (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
        )
        certain = np.stack([modes == i for i in range(self.system.modes)], axis=1).astype(float)
        lost = ~np.isfinite(mean).all(axis=(0, 1))
        return Estimates(mean, cov, certain, loglik, lost, modes)


def _put(mean, cov, here, found):
    """Write moments, of which the covariance may be common to all items, where they belong."""
    mean[:, here] = found[0]
    square = np.asarray(found[1])
    cov[:, :, here] = square if square.ndim == 3 else square[:, :, None]
