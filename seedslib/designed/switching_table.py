"""Filter of a switching system that looks mode and state up: theorem 2 as tables."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_real, as_times, unmasked
from seedslib.base.clock import Clock
from seedslib.designed.finite_order_rules import Design, freeze
from seedslib.designed.lookup import StepTables, TableState, arguments, summary
from seedslib.designed.memory import Memory, Past
from seedslib.designed.prediction import HeldOut, SwitchingPrediction, dropouts, unclaimed
from seedslib.filters.estimates import Estimates, as_indicators, as_record


@dataclass(frozen=True, eq=False, repr=False)
class SwitchingTableFilter:
    """Optimal filter of a switching system with a given memory, as tables.

    The functions (3.1), (3.2) of the switching paper: decided mode iota_k(j, y, z) and estimate
    g_k(j, y, z), where z is the memory; `seedslib.design` makes them. A missing measurement or
    indicator is left out: there are tables for these cases too, which are exact for that step
    given the memory. What was found is remembered like any other estimate.

    Attributes
    ----------
    system : SwitchingSystem
    memory : Memory
        Of estimates with their decided modes (large order, FBP), or of measurements (finite
        memory, FKP); of indicators too where it says so.
    times : ndarray, shape (K+1,)
    tables : tuple of StepTables, length K+1
    method : str
        How the tables were made.
    predicted : SwitchingPrediction
        Accuracy; without standard errors where no random numbers were used.
    changes : ndarray, shape (2, K+1)
        How far each table is from the one before: root of the mean square of the difference of
        the estimates, and probability of another mode. NaN where the memory was still filling.
    covariances : ndarray, shape (K+1, n', n')
        Error covariances that the design found.
    design : Design
    lasting : bool
        Whether the last table serves all later steps.
    held_out : HeldOut, optional
        Errors on paths that the design has not seen; none where it took no paths.
    """

    system: object
    memory: Memory
    times: np.ndarray
    tables: tuple[StepTables, ...]
    method: str
    predicted: SwitchingPrediction
    changes: np.ndarray
    covariances: np.ndarray
    design: Design
    lasting: bool = False
    held_out: HeldOut | None = None

    def __post_init__(self):
        object.__setattr__(self, "clock", Clock(self.times))
        for part in (self.times, self.changes, self.covariances, self.predicted, self.held_out):
            freeze(part)
        for step in self.tables:
            for table in step:
                freeze(tuple(table))

    @property
    def components(self) -> int:
        """n': how many state components are estimated."""
        return len(self.tables[0].blind.estimate)

    @property
    def order(self) -> int:
        """Numbers that are remembered, modes and indicators included: l (n + 1) for FBP."""
        memory = self.memory
        numbers = memory.order(self.components, self.system.measurement_size)
        return numbers + memory.estimates + memory.indicators

    @property
    def bytes(self) -> int:
        """Memory of the tables."""
        parts = (part for step in self.tables for table in step for part in table[1:])
        return sum(part.nbytes for part in parts if part is not None)

    # Step by step

    def initial(self, batch=(), seed=None) -> TableState:
        """State before any measurement; the filter draws nothing from `seed`."""
        return TableState(-1, None, None, None, None, Past(), tuple(batch), False)

    def predict(self, state: TableState, t: float) -> TableState:
        """Forecast for the next measurement time.

        Raises
        ------
        ValueError
            Another time than the next one; a state that was not corrected.
        """
        k, t = state.index + 1, float(t)
        if k and not state.corrected:
            raise ValueError("state: wanted a state after a correction, got a forecast")
        self._check_time(k, t, state.time)
        given = state._replace(index=k, time=t, corrected=False)
        mean, mode, prob = self._found(given, None, None)
        return given._replace(mean=mean, mode=mode, mode_prob=prob)

    def correct(self, state: TableState, y, indicator=None) -> TableState:
        """Correct the forecast by a measurement and the indicator.

        Parameters
        ----------
        state : TableState
        y : array_like, shape (m, *batch)
            NaN where it is missing, in all components or none.
        indicator : array_like of int, shape (*batch), optional
            -1 where it is missing; wanted where the system has one.

        Raises
        ------
        TypeError, ValueError
            A state without a forecast, a wrong shape, an infinite measurement, an indicator out
            of range; a missing measurement or indicator that is to be remembered.
        """
        if state.index < 0 or state.corrected:
            raise ValueError("state: wanted a forecast, got a state without; call predict first")
        y = as_real("y", y, nan=True)
        wanted = (self.system.measurement_size, *state.batch)
        if y.shape != wanted:
            raise ValueError(f"y: wanted shape {wanted}, got {y.shape}")
        if np.isinf(y).any():
            raise ValueError("y: wanted finite numbers or NaN, got an infinite one")
        if indicator is not None:
            indicator = np.asarray(unmasked("indicator", indicator, missing=-1))[None]
        indicator = as_indicators(indicator, self.system, (1, *state.batch), "indicator")
        return self._correct(state, y, None if indicator is None else indicator[0])

    def step(self, state: TableState, t: float, y, indicator=None) -> TableState:
        """Forecast to time t and correct there."""
        return self.correct(self.predict(state, t), y, indicator)

    def _found(self, state, y, indicator):
        """Estimate, decided mode and probabilities; y is None where it is missing."""
        step = self._step(state.index)
        table = step.blind if y is None else step.shown
        shown = () if y is None else y
        points = arguments(self.system, self.memory, shown, indicator, state.past)
        return table.look_up(points, state.batch)

    def _step(self, k):
        return self.tables[min(k, len(self.tables) - 1)]

    def _correct(self, state, y, indicator):
        lost = np.isnan(y)
        if not lost.any():
            found = self._found(state, y, indicator)
        else:
            found = self._without(state, y, indicator, lost)
        if indicator is not None and self.memory.indicators and (indicator < 0).any():
            raise ValueError("indicator: wanted by the memory, got a missing one")
        mean, mode, prob = found
        past = self.memory.push(
            state.past, estimate=mean, measurement=y, mode=mode, indicator=indicator
        )
        return state._replace(mean=mean, mode=mode, mode_prob=prob, past=past, corrected=True)

    def _without(self, state, y, indicator, lost):
        """What is found where some measurements are missing."""
        missing = lost.all(axis=0)
        if not np.array_equal(lost.any(axis=0), missing):
            raise ValueError("y: wanted all components of a measurement or none, got some NaN")
        if self.memory.measurements:
            raise ValueError("y: wanted a measurement, it is to be remembered; got NaN")
        seen = self._found(state, np.where(lost, 0.0, y), indicator)
        unseen = self._found(state, None, indicator)
        return tuple(
            None if a is None else np.where(missing, b, a)
            for a, b in zip(seen, unseen, strict=True)
        )

    def _check_time(self, k, t, before):
        times = self.times
        if k < len(times):
            wanted = times[k]
        elif self.lasting:
            wanted = before + (times[-1] - times[-2])
        else:
            raise ValueError(f"t: wanted at most the last measurement time {times[-1]:g}")
        if not self.clock.same(t, wanted):
            raise ValueError(f"t: wanted the next measurement time {wanted:g}, got {t:g}")

    def run(
        self, times, measurements, *, indicators=None, covariances=False, workers=1
    ) -> Estimates:
        """Filter a record, or many at once.

        Parameters
        ----------
        times : array_like, shape (J+1,)
            Those of the design up to some of them, or evenly on beyond them where the last table
            is lasting.
        measurements : array_like, shape (J+1, m, *batch)
            NaN marks a missing measurement.
        indicators : array_like of int, shape (J+1, *batch), optional
            -1 marks a missing one; wanted where the system has an indicator.
        covariances : bool
            Whether `cov` is wanted, the unconditional one that the design found: (J+1, n', n'),
            or, with missing measurements or indicators, (J+1, n', n', *batch), NaN from the first
            missing one to the end of its record.
        workers : int
            Threads over blocks of paths.

        Returns
        -------
        Estimates
            With `modes`, and `mode_prob` where the tables have them; without likelihoods.

        Raises
        ------
        TypeError, ValueError
            As `predict` and `correct`.

        Warns
        -----
        UserWarning
            Records with missing measurements where `covariances` are wanted.
        """
        times, size = as_times("times", times), self.system.measurement_size
        y = as_record(measurements, len(times), size)
        batch = y.shape[2:]
        seen = as_indicators(indicators, self.system, (len(times), *batch))
        before = None
        for k, t in enumerate(times):
            self._check_time(k, t, before)
            before = t
        flat = y.reshape(len(times), size, -1)
        lost = dropouts(y, indicators=seen)
        seen = None if seen is None else seen.reshape(len(times), -1)
        paths = flat.shape[2]
        mean = np.empty((len(times), self.components, paths))
        modes = np.empty((len(times), paths), dtype=int)
        prob = None
        if self.tables[0].blind.prob is not None:
            prob = np.empty((len(times), self.system.modes, paths))

        def work(a, b, _):
            state = self.initial((b - a,))
            for k, row in enumerate(flat):
                told = None if seen is None else seen[k, a:b]
                state = self._correct(state._replace(index=k), row[:, a:b], told)
                mean[k, :, a:b], modes[k, a:b] = state.mean, state.mode
                if prob is not None:
                    prob[k, :, a:b] = state.mode_prob

        in_blocks(work, paths, 0, workers=workers)
        cov = None
        if covariances:
            cov = self.covariances[np.minimum(np.arange(len(times)), len(self.covariances) - 1)]
        shaped = [
            None if a is None else a.reshape(*a.shape[:-1], *batch) for a in (mean, prob, modes)
        ]
        found = Estimates(shaped[0], cov, shaped[1], None, None, shaped[2])
        return unclaimed(found, lost, times)

    def stationary(self, tolerance: float = 0.02) -> SwitchingTableFilter:
        """The same filter with its last table for all later steps, evenly on in time.

        Parameters
        ----------
        tolerance : float
            Largest change over the last step: of the estimates, in units of the root-mean-square
            error, and of the decided modes, as a probability.

        Raises
        ------
        ValueError
            The tables have not converged; the message says how far they are apart.
        """
        if not tolerance > 0:
            raise ValueError(f"tolerance: wanted a positive number, got {tolerance}")
        moved, modes = self.change
        if not max(moved, modes) <= tolerance:
            raise ValueError(
                f"tolerance: wanted tables that change by at most {tolerance:g} over the last "
                f"step, got {moved:.3g} of the error in the estimates and {modes:.3g} in the "
                "probability of another mode; design for more times"
            )
        return replace(self, lasting=True)

    @property
    def change(self) -> tuple[float, float]:
        """Change of estimates and modes over the last step; NaN where there is none to compare.

        The first in units of the root-mean-square error.
        """
        moved, modes = self.changes[:, -1]
        return float(moved / np.sqrt(np.trace(self.covariances[-1]))), float(modes)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of order {self.order}: {self.memory}; {self.method}>"

    def __str__(self) -> str:
        return summary(self)
