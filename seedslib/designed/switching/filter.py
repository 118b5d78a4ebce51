"""Filters of switching systems: the IMM filter, and filters of finite order designed offline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_times
from seedslib.base.clock import Clock, when
from seedslib.base.values import Course
from seedslib.designed.arrivals import Arrivals, check_arrivals, number_of, ways
from seedslib.designed.gaps import law_unclaimed
from seedslib.designed.guards import freeze, want_corrected, want_forecast, want_next
from seedslib.designed.memory import Memory
from seedslib.designed.prediction import Design, HeldOut, Prediction, switching_page
from seedslib.designed.runs import DesignedFilter
from seedslib.designed.shapes import check_verbs
from seedslib.designed.switching.fits import (
    CellFit,
    ClassFit,
    cell_count,
    cell_number,
    require_memory,
)
from seedslib.designed.switching.lemmas import ModeLaw, total_covariance
from seedslib.designed.switching.rules import SwitchingRules, SwitchingState, compiled_rules
from seedslib.filters.base import Estimates, first_step
from seedslib.filters.weights import mix, most_probable
from seedslib.linearization.moments import Linearization, as_linearization
from seedslib.models.kinds import as_system, elapsed


@dataclass(frozen=True, eq=False, repr=False)
class SwitchingFilter(DesignedFilter):
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
    cycle : int
        See `DesignedFilter`.
    held_out : HeldOut, optional
    measured, availability : ndarray, optional
        See `DesignedFilter`.
    arrivals : tuple of Arrivals, length K+1 or 0
        Classes of histories, where something may be missing: cells of the memory are those of the
        first class, then of the next.

    Raises
    ------
    TypeError, ValueError
        Arguments that do not fit together.
    NoClosedForm
        The linearization has no formulas for a branch; the message offers one that works.
    """

    system: object
    linearization: Linearization
    memory: Memory | None = None
    times: MaybeArray = None
    fits: Sequence[Any] = ()
    normalisation: str = "consistent"
    split: bool = True
    predicted: Prediction | None = None
    design: Design | None = None
    cycle: int = 0
    held_out: HeldOut | Any = None
    measured: MaybeArray = None
    availability: MaybeArray = None
    arrivals: tuple[Arrivals, ...] = ()
    ways: tuple[np.ndarray, ...] = field(init=False)
    rules: SwitchingRules | None = None

    def __post_init__(self) -> None:
        as_system("system", self.system, "SwitchingSystem")
        as_linearization(self.linearization)
        if self.memory is not None:
            self._check_memory()
        if self.rules is None:
            rules = compiled_rules(self.system, self.linearization, self.normalisation, self.split)
            object.__setattr__(self, "rules", rules)
        object.__setattr__(self, "fits", tuple(self.fits))
        object.__setattr__(self, "ways", ways(self.arrivals, self.cycle))
        freeze((self.held_out, self.measured, self.availability, self.arrivals, *self.fits))

    def _check_memory(self):
        require_memory(self.memory, self.system)
        if self.times is None:
            raise ValueError("times: wanted the times of the design with a memory")
        times = as_times("times", self.times)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "clock", Clock(times))
        if len(self.fits) != len(times) - 1:
            raise ValueError(f"fits: wanted {len(times) - 1}, got {len(self.fits)}")
        self.check_shapes()
        freeze(times)

    def check_parts(self) -> None:
        """Laws of mode and state in the cells of the memory."""
        check_arrivals(self, self.system.state_size)
        check_verbs([(f"fits[{k}]", fit) for k, fit in enumerate(self.fits)], "forecast")
        for k, fit in enumerate(self.fits):
            if isinstance(fit, ClassFit) != bool(self.arrivals):
                raise ValueError(f"fits[{k}]: wanted laws of classes for an availability only")
            classes = len(self.arrivals[k + 1].table) if self.arrivals else 1
            known = fit.fit if self.arrivals else fit
            if isinstance(known, CellFit):
                known.check(f"fits[{k}]", self.memory, self.system, k, classes)

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
        if self.memory is not None:
            want_next(self.clock, k, t, self.cycle)
        if k == 0:
            return state._replace(index=0, time=t)
        want_corrected(state)
        if not t > state.time:
            raise ValueError(f"t: wanted a time after {when(state.time)}, got {when(t)}")
        interval = first_step(state, t, self.system)
        with elapsed(self.system, state.time, t):
            law = self.rules.predict(state.time, self.known(state))
        return state._replace(
            index=k, time=t, law=law, mean=None, mode=None, loglik=0.0, corrected=False,
            interval=interval,
        )  # fmt: skip

    def known(self, state: SwitchingState) -> ModeLaw:
        """Law after a correction that the forecast starts from: given the memory, if any."""
        if self.memory is None:
            return state.law
        system, past = self.system, state.past
        cell = cell_number(past, system.modes, system.indicators, state.mode.shape)
        row = self.served(state.index + 1) - 1
        if self.arrivals:
            cell = cell + state.group * cell_count(self.memory, system, state.index)
        return self.fits[row].forecast(cell, past.vector)

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
        y, seen, gap = self.admitted(y, indicator, state.law.log_prob.shape[2:], state.index)
        found = self._regrouped(self.rules.correct(state, y, seen, self.memory), y, seen)
        return found if self.memory is None else law_unclaimed(found, state, gap)

    def _regrouped(self, state, y, indicator):
        if not self.arrivals:
            return state
        way, number = self.ways[self.served(state.index)], number_of(self, y, indicator)
        return state._replace(group=way[state.group, number])

    def _claimed(self, state):
        """Covariance of what is estimated: of its class, where there are classes."""
        cov = total_covariance(state.law)
        if not self.arrivals:
            return cov
        scale = self.arrivals[self.served(state.index)].scale(state.group)
        return scale[:, None] * scale * cov

    def report(self, state: SwitchingState) -> Estimates:
        """What is estimated after a correction."""
        cov = self._claimed(state)
        return Estimates(state.mean, cov, state.law.prob, state.loglik, modes=state.mode)

    def forecast(self, state: SwitchingState, t: float) -> Estimates:
        """Mean (n, *batch), covariance and probabilities of the modes at the next time."""
        law = self.predict(state, t).law
        parts, batch = (law.prob, law.mean, law.cov), law.prob.shape[2:]
        mixed = mix(*(part.reshape(*part.shape[:c], -1, *batch) for c, part in enumerate(parts)))
        prob = parts[0].sum(axis=1)
        cov = np.where(state.gap, np.nan, mixed.cov) if np.any(state.gap) else mixed.cov
        return Estimates(mixed.mean, cov, prob, modes=most_probable(prob))

    def smoother(self) -> Any:
        """See `Filter.smoother`: of whole laws, which a filter with a memory does not carry."""
        if self.memory is not None:
            return super().smoother()
        from seedslib.designed.switching.smoothing import SwitchingSmoother

        return SwitchingSmoother(self)

    def sizes(self, covariances: bool) -> Estimates:
        """Shapes of what is found at each time."""
        n = self.system.state_size
        return Estimates((n,), (n, n) if covariances else None, (self.system.modes,), (), None, ())

    def parts(self, chosen: list[int]) -> dict[str, Any]:
        """Fits of the chosen steps."""
        arrivals = tuple(self.arrivals[k] for k in chosen) if self.arrivals else ()
        return {"fits": tuple(self.fits[k - 1] for k in chosen[1:]), "arrivals": arrivals}

    def placed(self, times: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Number of the measurement at each time: there are none between."""
        return np.arange(len(times))

    def fill(
        self, rows: Estimates, times: np.ndarray, index: np.ndarray, y: np.ndarray,
        indicators: np.ndarray | None, held: Course,
    ) -> int:  # fmt: skip
        """Run over a block of records."""
        state = self.initial(y.shape[2:])
        for k, t in enumerate(times):
            shown = None if indicators is None else indicators[k]
            with held.at(max(k - 1, 0)):
                state = self.predict(state, t)
            with held.at(k):
                state = self.rules.correct(state, y[k], shown, self.memory)
            state = self._regrouped(state, y[k], shown)
            rows.mean[k], rows.mode_prob[k] = state.mean, state.law.prob
            rows.modes[k], rows.loglik[k] = state.mode, state.loglik
            if rows.cov is not None:
                rows.cov[k] = self._claimed(state)
        return state.mended

    def finish(self, found: Estimates, lost: np.ndarray, index: np.ndarray) -> Estimates:
        """What no mode can have shown is lost too."""
        return found._replace(diverged=lost | (found.loglik == -np.inf).any(axis=0))

    def __repr__(self) -> str:
        held = "laws of all modes" if self.memory is None else str(self.memory)
        return f"<SwitchingFilter: {held}; {self.linearization}>"

    def __str__(self) -> str:
        return switching_page(self)
