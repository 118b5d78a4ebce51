"""Filters of switching systems: the IMM filter, and filters of finite order designed offline."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_real, as_times, unmasked
from seedslib.base.clock import Clock
from seedslib.designed.gaps import dropouts, law_unclaimed, unclaimed
from seedslib.designed.guards import freeze, want_corrected, want_forecast, want_next
from seedslib.designed.lemmas import ModeLaw, total_covariance
from seedslib.designed.memory import Memory
from seedslib.designed.prediction import Design, HeldOut, Prediction, switching_page
from seedslib.designed.shapes import check_shapes
from seedslib.designed.switching_fits import (
    CellFit,
    cell_number,
    fits_apart,
    require_memory,
)
from seedslib.designed.switching_rules import SwitchingRules, SwitchingState, compiled_rules
from seedslib.filters.estimates import Estimates, as_indicators, as_record
from seedslib.filters.mixture import mix
from seedslib.filters.verbs import Filter
from seedslib.filters.weights import most_probable
from seedslib.linearization.moments import Linearization
from seedslib.models.kinds import as_grid, as_system


@dataclass(frozen=True, eq=False, repr=False)
class SwitchingFilter(Filter):
    """Mode and state of a switching system, by Gaussian laws in each mode.

    Without a memory it carries the posterior laws of all modes: the normal approximation of the
    optimal filter (AOF), an IMM filter with the timing of this model and state-dependent
    switching. With a memory it is the filter of theorem 3 of the switching paper: only the memory
    is carried (decided modes and estimates for the large-order filter, FBP; indicators and
    measurements for the filter with finite memory, FKP), and the law given the memory comes from
    a design; `seedslib.design.synthesize` makes it.

    Parameters
    ----------
    system : SwitchingSystem
    linearization : Linearization
        `Taylor` gives the linearised filter (an IMM of extended Kalman filters), `ExactGaussian`
        the Gaussian one.
    memory : Memory, optional
    times : array_like, shape (K+1,), optional
        Times of the design.
    fits : sequence of CellFit, length K
        What the memory says after each measurement but the last. Anything with
        ``forecast(cell, z) -> ModeLaw`` will do.
    normalisation : {"consistent", "printed"}
        How the moments of a measurement are formed where the indicator depends on the state: from
        the moments of the mixture, or as (6.21) is printed, which is wrong there.
    split : bool
        Whether forecasts have one Gaussian part for each value of such an indicator.
    predicted : Prediction, optional
    design : Design, optional
    lasting : bool
        Whether the last fit serves all later steps.
    held_out : HeldOut, optional

    Raises
    ------
    TypeError, ValueError
        Arguments that do not fit together.
    NoClosedForm
        The linearization has no formulas for a branch; the message offers one that works.
    """

    takes = ("indicators", "covariances")

    takes = ("indicators", "covariances")

    system: object
    linearization: Linearization
    memory: Memory | None = None
    times: np.ndarray | None = None
    fits: tuple[CellFit, ...] = ()
    normalisation: str = "consistent"
    split: bool = True
    predicted: Prediction | None = None
    design: Design | None = None
    lasting: bool = False
    held_out: HeldOut | None = None
    rules: SwitchingRules | None = None

    def __post_init__(self):
        as_system("system", self.system, "SwitchingSystem")
        if not isinstance(self.linearization, Linearization):
            raise TypeError(f"linearization: wanted a Linearization, got {self.linearization!r}")
        if self.memory is not None:
            self._check_memory()
        if self.rules is None:
            rules = compiled_rules(self.system, self.linearization, self.normalisation, self.split)
            object.__setattr__(self, "rules", rules)
        object.__setattr__(self, "fits", tuple(self.fits))
        freeze((self.held_out, *self.fits))

    def _check_memory(self):
        require_memory(self.memory, self.system)
        if self.times is None:
            raise ValueError("times: wanted the times of the design with a memory")
        times = as_times("times", self.times)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "clock", Clock(times))
        if len(self.fits) != len(times) - 1:
            raise ValueError(f"fits: wanted {len(times) - 1}, got {len(self.fits)}")
        check_shapes(self)
        freeze(times)

    @property
    def order(self) -> int:
        """Numbers that are remembered, modes and indicators included: l (n + 1) at full memory."""
        n, memory = self.system.state_size, self.memory
        if memory is None:
            return self.system.modes * (1 + n + n * (n + 1) // 2) - 1
        numbers = memory.order(n, self.system.measurement_size, self.system.modes)
        return numbers + memory.estimates + memory.indicators

    # Step by step

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> SwitchingState:
        """State before any measurement; the filter draws nothing from `seed`."""
        return self.rules.start(tuple(batch))

    def predict(self, state: SwitchingState, t: float) -> SwitchingState:
        """Forecast for time t, the next measurement time; a first state is only given it.

        Raises
        ------
        ValueError
            A time that is not later, or for a designed filter not the next one of the design; a
            state that was not corrected.
        """
        t, k = float(t), state.index + 1
        if self.memory is not None and not (self.lasting and k >= len(self.times)):
            want_next(self.clock, k, t)
        if k == 0:
            return state._replace(index=0, time=t)
        want_corrected(state)
        if not t > state.time:
            raise ValueError(f"t: wanted a time after {state.time:g}, got {t:g}")
        law = self.rules.predict(state.time, self.known(state))
        kept = state.past, 0.0, state.mended, False, state.gap
        return SwitchingState(k, t, law, None, None, *kept)

    def known(self, state: SwitchingState) -> ModeLaw:
        """Law after a correction that the forecast starts from: given the memory, if any."""
        if self.memory is None:
            return state.law
        system, past = self.system, state.past
        cell = cell_number(past, system.modes, system.indicators, state.mode.shape)
        return self.fits[min(state.index, len(self.fits) - 1)].forecast(cell, past.vector)

    def correct(
        self, state: SwitchingState, y: ArrayLike, indicator: ArrayLike | None = None
    ) -> SwitchingState:
        """Correct the forecast by a measurement and the indicator.

        Parameters
        ----------
        state : SwitchingState
        y : array_like, shape (m, *batch)
            NaN components are left out exactly; with a memory see `run`.
        indicator : array_like of int, shape (*batch), optional
            -1 where it is missing; wanted where the system has one.

        Raises
        ------
        TypeError, ValueError
            A state without a forecast, a wrong shape, an infinite measurement, an indicator out
            of range.
        """
        want_forecast(state)
        y = as_real("y", y, nan=True)
        wanted = (self.system.measurement_size, *state.law.log_prob.shape[2:])
        if y.shape != wanted:
            raise ValueError(f"y: wanted shape {wanted}, got {y.shape}")
        if indicator is not None:
            indicator = np.asarray(unmasked("indicator", indicator, missing=-1))[None]
        indicator = as_indicators(indicator, self.system, (1, *wanted[1:]), "indicator")
        seen = None if indicator is None else indicator[0]
        found = self.rules.correct(state, y, seen, self.memory)
        return found if self.memory is None else law_unclaimed(found, state, y, seen)

    def report(self, state: SwitchingState) -> Estimates:
        """What is estimated after a correction."""
        cov = total_covariance(state.law)
        return Estimates(state.mean, cov, state.law.prob, state.loglik, modes=state.mode)

    def forecast(self, state: SwitchingState, t: float) -> Estimates:
        """Mean (n, *batch), covariance and probabilities of the modes at the next time."""
        law = self.predict(state, t).law
        parts, batch = (law.prob, law.mean, law.cov), law.prob.shape[2:]
        mixed = mix(*(part.reshape(*part.shape[:c], -1, *batch) for c, part in enumerate(parts)))
        prob = parts[0].sum(axis=1)
        cov = np.where(state.gap, np.nan, mixed.cov) if np.any(state.gap) else mixed.cov
        return Estimates(mixed.mean, cov, prob, modes=most_probable(prob))

    def run(
        self, times: ArrayLike, measurements: ArrayLike, *, indicators: ArrayLike | None = None,
        covariances: bool = False, workers: int = 1,
    ) -> Estimates:  # fmt: skip
        """Filter a record, or many at once.

        Parameters
        ----------
        times : array_like, shape (J+1,)
            For a designed filter the times of its design up to some of them.
        measurements : array_like, shape (J+1, m, *batch)
            NaN marks a missing component.
        indicators : array_like of int, shape (J+1, *batch), optional
            -1 marks a missing one; wanted where the system has an indicator.
        covariances : bool
            Whether `cov` is wanted.
        workers : int
            Threads over blocks of paths.

        Returns
        -------
        Estimates
            With ``mode_prob`` (J+1, L, *batch), ``modes``, ``loglik`` (J+1, *batch), and
            ``diverged`` (*batch): what became NaN, or what no mode can have shown. With a memory
            ``cov`` is NaN from a gap on, and ``loglik`` after it: the design knows none.

        Raises
        ------
        TypeError, ValueError
            As `predict` and `correct`.

        Warns
        -----
        UserWarning
            Covariances that had to be mended; records with gaps of a filter with a memory.
        """
        designed = self.memory is not None  # then they are those of the design
        times = as_times("times", times) if designed else as_grid("times", times, self.system)
        y = as_record(measurements, len(times), self.system.measurement_size)
        batch = y.shape[2:]
        told = as_indicators(indicators, self.system, (len(times), *batch))
        flat, n = y.reshape(*y.shape[:2], -1), self.system.state_size
        seen = None if told is None else told.reshape(len(times), -1)
        whole = len(times), flat.shape[2]
        mean, prob = (np.empty((whole[0], size, whole[1])) for size in (n, self.system.modes))
        cov = np.empty((whole[0], n, n, whole[1])) if covariances else None
        loglik, modes = np.empty(whole), np.empty(whole, dtype=int)

        def work(a, b, _):
            state = self.initial((b - a,))
            for k, t in enumerate(times):
                shown = None if seen is None else seen[k, a:b]
                state = self.predict(state, t)
                state = self.rules.correct(state, flat[k, :, a:b], shown, self.memory)
                mean[k, :, a:b], prob[k, :, a:b] = state.mean, state.law.prob
                modes[k, a:b], loglik[k, a:b] = state.mode, state.loglik
                if covariances:
                    cov[k, ..., a:b] = total_covariance(state.law)
            return state.mended

        if raised := sum(in_blocks(work, whole[1], 0, workers=workers)):
            warnings.warn(
                f"covariances: eigenvalues of {raised} were raised to 1e-12 of their scale",
                stacklevel=2,
            )
        mean, cov, prob, loglik, modes = (
            None if part is None else part.reshape(*part.shape[:-1], *batch)
            for part in (mean, cov, prob, loglik, modes)
        )
        diverged = ~np.isfinite(mean).all(axis=(0, 1)) | (loglik == -np.inf).any(axis=0)
        found = Estimates(mean, cov, prob, loglik, diverged, modes)
        lost = None if self.memory is None else dropouts(y, None, told)
        return unclaimed(found, lost, times)

    def stationary(self, tolerance: float = 0.05) -> SwitchingFilter:
        """The same filter with its last fit for all later steps.

        Parameters
        ----------
        tolerance : float
            Largest change of the gains and offsets over the last step, in units of the deviation
            of the state in the design.

        Raises
        ------
        ValueError
            The fits have not converged within the design, or there are none to compare.
        """
        change = self.change()
        if not change <= tolerance:
            raise ValueError(
                f"times: wanted a design that has converged to {tolerance:g}, got a change of "
                f"{change:.3g} at its last step"
            )
        return replace(self, lasting=True)

    def change(self) -> float:
        """How far the forecasts of the last two fits are apart, see `fits_apart`."""
        return fits_apart(self.fits, self.memory)

    def __repr__(self) -> str:
        held = "laws of all modes" if self.memory is None else str(self.memory)
        return f"<SwitchingFilter: {held}; {self.linearization}>"

    def __str__(self) -> str:
        return switching_page(self)
