"""Filters of switching systems: the IMM filter, and filters of finite order designed offline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.circle import nearest
from seedslib.base.clock import Clock, when
from seedslib.base.linalg import lower_triangle, symmetric
from seedslib.base.values import Values
from seedslib.designed.accuracy import Accuracy, Design, page
from seedslib.designed.base import DesignedFilter, freeze, nan_where, require_corrected
from seedslib.designed.between import Interval
from seedslib.designed.cells import cell_number, require_memory
from seedslib.designed.lemmas import ModeDistribution, total_covariance
from seedslib.designed.memory import Memory
from seedslib.designed.program import DesignedProgram
from seedslib.designed.rules import SwitchingRules, SwitchingState, compiled_rules
from seedslib.filters.base import Estimates, first_step
from seedslib.filters.program import Program
from seedslib.filters.weights import mix, most_probable, normalised
from seedslib.linearization.moments import Linearization, as_linearization
from seedslib.models.kinds import as_system
from seedslib.models.switching import SwitchingSystem


@dataclass(frozen=True, eq=False, repr=False)
class SwitchingFilter(DesignedFilter):
    """Mode and state of a switching system, by a Gaussian distribution in each mode.

    Without a memory it carries the posterior in all modes: the normal approximation of the
    optimal filter (AOF), an IMM filter with the timing of this model and state-dependent
    switching. With a memory it is the filter of theorem 3 of the switching paper: only the memory
    is carried (decided modes and estimates for the large-order filter, FBP; indicators and
    measurements for the filter with finite memory, FKP), and the distribution given the memory
    comes from a design; `seedslib.design.synthesize` makes it.

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
        Mode and state given the memory after each measurement but the last. Anything with
        ``forecast(cell, z) -> ModeDistribution`` will do.
    normalisation : {"consistent", "printed"}
        How the moments of a measurement are formed where the indicator depends on the state: from
        the moments of the mixture, or as (6.21) is printed, which is wrong there.
    predicted : Accuracy, optional
    design : Design, optional
    cycle : int
        See `DesignedFilter`.
    held_out : Accuracy, optional

    Raises
    ------
    TypeError, ValueError
        Arguments that do not fit together.
    NoClosedForm
        The linearization has no formulas for a branch; the message offers one that works.

    Warns
    -----
    UserWarning
        In a step, that the mean of the probability of a switch is out of [0, 1].
    """

    node_times = node_fits = ()  # forecasts are for the next measurement only

    system: SwitchingSystem
    linearization: Linearization
    memory: Memory | None = None
    times: MaybeArray = None
    fits: Sequence[Any] = ()
    normalisation: str = "consistent"
    predicted: Any = None
    design: Design | None = None
    cycle: int = 0
    held_out: Accuracy | None = None

    def __post_init__(self) -> None:
        as_system("system", self.system, "SwitchingSystem")
        as_linearization(self.linearization)
        vars(self).update(fits=tuple(self.fits))
        if self.memory is not None:
            require_memory(self.memory, self.system)
            if self.times is None:
                raise ValueError("times: wanted the times of the design with a memory")
            self.check()
            vars(self).update(clock=Clock(self.times))
        _ = self.rules  # a linearization without formulas is refused now
        freeze((self.times, self.predicted, self.held_out, self.fits))

    @cached_property
    def rules(self) -> SwitchingRules:
        """The compiled steps."""
        return compiled_rules(self.system, self.linearization, self.normalisation)

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

    def predict(
        self, state: SwitchingState, t: float, *, inputs: Mapping[Any, Any] | None = None
    ) -> SwitchingState:
        """Forecast for time t, the next measurement time; the first state is only given it.

        Raises
        ------
        ValueError
            A time that is not later, or for a designed filter not the next one of the design; a
            state that was not corrected.
        """
        t = float(t)
        if self.memory is not None:
            return super().predict(state, t, inputs=inputs)
        if state.index < 0:
            return self.propagate(state, t, ())
        require_corrected(state)
        if not t > state.time:
            raise ValueError(f"t: wanted a time after {when(state.time)}, got {when(t)}")
        interval = first_step(state, t, self.system)
        p = self.values(inputs, t - state.time)
        return self.propagate(state, t, p)._replace(interval=interval)

    def propagate(
        self, state: SwitchingState, t: float, p: Values, interval: Interval | None = None
    ) -> SwitchingState:
        """See `DesignedFilter.propagate`."""
        if state.index < 0:
            return state._replace(index=0, time=t)
        dist = self.rules.predict(state.time, self.posterior(state), p)
        return state._replace(
            index=state.index + 1,
            time=t,
            dist=dist,
            mean=None,
            mode=None,
            loglik=0.0,
            corrected=False,
        )

    def posterior(self, state: SwitchingState) -> ModeDistribution:
        """Mode and state after a correction, given the memory alone where there is one."""
        if self.memory is None:
            return state.dist
        system, past = self.system, state.past
        cell = cell_number(past, system.modes, system.indicators, state.mode.shape)
        return self.fits[self.served(state.index + 1) - 1].forecast(cell, past.vector)

    def update(
        self,
        state: SwitchingState,
        y: np.ndarray,
        p: Values,
        indicator: MaybeArray = None,
        covariance: bool = True,
    ) -> SwitchingState:
        """See `DesignedFilter.update`."""
        return self.rules.correct(state, y, indicator, self.memory, p)

    def batch_of(self, state: SwitchingState) -> tuple[int, ...]:
        """Batch axes of a forecast."""
        return state.dist.log_prob.shape[2:]

    def without_claims(self, state: SwitchingState, before: Any, gap: Any) -> SwitchingState:
        """See `DesignedFilter.without_claims`."""
        dist = state.dist._replace(cov=nan_where(gap, state.dist.cov))
        return state._replace(dist=dist, loglik=np.where(before, np.nan, state.loglik), gap=gap)

    def report(self, state: SwitchingState, covariance: bool = True) -> Estimates:
        """What is estimated after a correction."""
        cov = total_covariance(state.dist) if covariance else None
        return Estimates(state.mean, cov, state.dist.prob, state.loglik, modes=state.mode)

    def predictive(self, state: SwitchingState, p: Values) -> tuple[np.ndarray, np.ndarray]:
        """See `Filter.predictive`: moments of the mixture over modes, whatever the indicator."""
        batch = self.batch_of(state)
        unknown = np.full(batch, -1) if self.system.indicators else None
        sensed = self.rules.sense(state.time, state.dist, unknown, p)
        prob, (mean, _, cov) = np.exp(normalised(sensed.log_prob, 0)[0]), sensed.moments
        central = np.take_along_axis(mean, most_probable(prob)[None, None], axis=1)
        mixed = mix(prob, nearest(mean, central, self.rules.periods), cov)
        return mixed.mean, nan_where(state.gap, mixed.cov)

    def forecast(
        self, state: SwitchingState, t: float, *, inputs: Mapping[Any, Any] | None = None
    ) -> Estimates:
        """Mean (n, *batch), covariance and probabilities of the modes at the next time."""
        dist = self.predict(state, t, inputs=inputs).dist
        parts, batch = (dist.prob, dist.mean, dist.cov), dist.prob.shape[2:]
        mixed = mix(*(part.reshape(*part.shape[:c], -1, *batch) for c, part in enumerate(parts)))
        prob = parts[0].sum(axis=1)
        cov = nan_where(state.gap, mixed.cov)
        return Estimates(mixed.mean, cov, prob, modes=most_probable(prob))

    def program(self, **options: Any) -> Program:
        """See `Filter.program`; moments must be formulas, fits in cells."""
        from seedslib.designed.mode_programs import switching

        step = (Program if self.memory is None else DesignedProgram)(self, **options)
        switching(step)
        return step

    def steps_alone(self, state: SwitchingState, t: float) -> bool:
        """See `Filter.steps_alone`."""
        started = state.index >= 0
        if self.memory is None and started:
            first_step(state, t, self.system)
        return state.corrected == started and state.dist.log_prob.ndim == 2 - started

    def numbers_of(self, state: SwitchingState) -> dict[str, Any]:
        """See `Filter.numbers_of`."""
        if self.memory is not None:
            return super().numbers_of(state)
        started = state.index >= 0
        log_prob, mean, cov = state.dist if started else (part[..., 0] for part in state.dist)
        moments = np.concatenate([mean, cov[lower_triangle(len(mean))]]).T
        time = {"t": state.time if started else 0.0, "started": started}
        return time | {"carried_log_prob": log_prob, "carried_moments": moments}

    def state_of(self, parts: dict[str, Any], t: float, before: SwitchingState) -> SwitchingState:
        """See `Filter.state_of`."""
        n, interval, past = self.system.state_size, before.interval, before.past
        if self.memory is None:
            index = before.index + 1
            if interval is None and before.index >= 0:
                interval = t - before.time
        else:
            index = self.index_of(parts)
            past = self.recalled(parts, index + 1)
        moments, gap = parts["carried_moments"].T, parts.get("gap", 0.0) > 0.0
        cov = nan_where(gap, symmetric(moments[n:], n))
        return SwitchingState(
            index,
            t,
            ModeDistribution(parts["carried_log_prob"], moments[:n], cov),
            parts["mean"],
            np.intp(parts["mode"]),
            past,
            np.nan if before.gap else parts["loglik"],
            True,
            gap,
            interval,
            before.repaired,
        )

    def __repr__(self) -> str:
        carried = "distributions of all modes" if self.memory is None else str(self.memory)
        return f"<SwitchingFilter: {carried}; {self.linearization}>"

    def __str__(self) -> str:
        carried = (
            "carries the distributions of all modes" if self.memory is None else f"of {self.memory}"
        )
        return page(
            self,
            f"Filter of {self.system.modes} modes, {carried}; {self.linearization}",
            f"order        {self.order}",
        )
