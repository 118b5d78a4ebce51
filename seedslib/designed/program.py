"""The program of one measurement of a designed filter: its clock, its gaps, its memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from seedslib.base.clock import ROUNDING, SAME
from seedslib.designed.memory import Memory
from seedslib.filters.program import Program, any_of
from seedslib.tape.tape import Array, Number, Scalar, choose, isnan


class DesignedProgram(Program):
    """A `Program` at the times of a design: the state counts them.

    Where parameters are arguments it is given the time too, and refuses one that is not its next.
    """

    designed = True

    def _begin_state(self) -> None:
        filter = self.filter
        self.k = self.array("k", (), "int", "state")
        self.laps = self.array("laps", (), "real", "state") if filter.cycle else None
        self.gapped = self.array("gap", (), "int", "state")
        times = np.array(filter.times)
        if filter.cycle:  # the last time begins a lap
            times[-1] = times[-1 - filter.cycle]
        self.times = self.table("times", times, "time")
        if self.with_parameters:
            self.array("time", (), "time", "argument")

    def begin(self) -> tuple[Scalar, Scalar]:
        """Number of the measurement and its time, of a designed filter.

        Raises
        ------
        TypeError
            A memory of one's own, whose rule a program does not know.
        """
        memory, k = self.filter.memory, self.k.all
        if type(memory) is not Memory:
            raise TypeError(f"memory: wanted a Memory, got {type(memory).__name__}")
        if not self.filter.cycle:
            self.refuse(k >= float(len(self.filter.times)), "END")
        t = self.moment(k)
        if "time" in self.arrays:
            clock = self.filter.clock  # `Clock.same`
            near = np.maximum(SAME * clock.interval, ROUNDING * abs(t))
            near = np.maximum(clock.tolerance, np.minimum(near, 0.25 * clock.interval))
            self.refuse(~(abs(self.arrays["time"].all - t) <= near), "TIME")
        return k, t

    def moment(self, k: Scalar) -> Scalar:
        """Time of measurement k, see `seedslib.base.clock.Clock.moment`."""
        times, cycle = self.filter.times, self.filter.cycle
        if not cycle:
            return self.times[k]
        last = len(times) - 1
        lap = self.laps.all + choose(k >= float(last), 1.0, 0.0)
        return self.times[k] + lap * (times[last] - times[last - cycle])

    def end(self, k: Scalar) -> None:
        """Count the measurement; the last steps of a design without end serve in turn."""
        count, cycle = len(self.filter.times), self.filter.cycle
        over = k + 1.0 >= float(count) if cycle else False
        self.k.store(choose(over, float(count - cycle), k + 1.0))
        if cycle:
            self.laps.store(self.laps.all + choose(over, 1.0, 0.0))

    def gap(self, k: Scalar) -> tuple[Scalar, Scalar]:
        """Whether something has been missing that the design has: before measurement k, with it.

        What the schedule leaves out is refused.
        """
        missing = [*isnan(self.y)]
        missing += [self.indicator < 0.0] if self.indicators else []
        if getattr(self.filter, "measured", None) is not None:
            schedule = self.table("schedule", self.filter.measured, "int")[k]
            for i, scheduled in enumerate(schedule):
                self.refuse(~missing[i] & (scheduled < 1.0), "STRAY")
                missing[i] = missing[i] & (scheduled > 0.0)
        before = self.gapped.all > 0.0
        after = before | any_of(missing)
        self.gapped.store(choose(after, 1.0, 0.0))
        return before, after

    def claim(self, cov: Any, loglik: Number, gap_before: Scalar, gap: Scalar) -> None:
        """Store covariance and likelihood, NaN where a gap leaves none; a run does so itself."""
        self.cov.store(cov if self.floats else choose(gap, np.nan, cov))
        self.loglik.store(loglik if self.floats else choose(gap_before, np.nan, loglik))

    def past(self, estimate: int) -> dict[str, Array]:
        """Arrays of what is remembered, newest first: numbers, estimates before measurements, and
        decided modes and indicators. An estimate has so many numbers.
        """
        memory, modes = self.filter.memory, self.modes > 0
        numbers = estimate * memory.estimates + self.m * memory.measurements
        arrays = {"memory": self.array("memory", (numbers,), owner="state")}
        for name, count in (("modes", modes * memory.estimates), ("indicators", memory.indicators)):
            if count:
                arrays[name] = self.array(name, (count,), "int", "state")
        return arrays

    def push(
        self, past: dict[str, Array], estimate: Sequence[Any], measurement: Any, mode: Any = None
    ) -> None:
        """Remember an estimate, a measurement, a mode and the indicator, as far as it is wanted."""
        old, size = list(past["memory"].all), len(estimate) * self.filter.memory.estimates
        estimates = [*estimate, *old[:size]][:size]
        past["memory"].store([*estimates, *[*measurement, *old[size:]][: len(old) - size]])
        for name, newest in (("modes", mode), ("indicators", self.indicator)):
            if name in past:
                past[name].store([newest, *past[name].all[:-1]])
