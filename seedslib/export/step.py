"""The program of one measurement: arrays of state and arguments, refusals, what designs share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from seedslib.base.clock import ROUNDING, SAME
from seedslib.base.values import Values
from seedslib.designed.memory import Memory
from seedslib.export.tape import Array, Scalar, Tape, choose, isfinite, isinf, isnan
from seedslib.filters.covariance import CovarianceFilter

CODES = ("OK", "END", "INFINITE", "PARTLY", "TIME", "RANGE", "STRAY", "UNTOLD")
"""What a step returns: the number of the code in this list."""

MOST_NUMBERS = 2_000_000
"""Numbers in the tables of one program: about 40 megabytes of text."""


class Step(Tape):
    """The program of one measurement, with what every kind of filter has.

    Its arguments are, as far as the filter has them, the time ``t``, the measurement ``y``, the
    ``indicator``, the inputs ``held`` since the last time and ``u`` at this time, the parameters
    ``p``.

    Parameters
    ----------
    filter : Filter
    parameters : bool
        Whether parameters are arguments, or constants with their present values. Then a design is
        given the time too, and refuses one that is not its next.
    """

    def __init__(self, filter: Any, parameters: bool = False) -> None:
        super().__init__()
        self.numbers = 0
        self.filter, system = filter, filter.system
        self.n, self.m = system.state_size, system.measurement_size
        self.rows = getattr(filter, "components", self.n)
        self.designed = getattr(filter, "memory", None) is not None
        self.indicators = int(getattr(system, "indicators", 0))
        self.modes = int(getattr(system, "modes", 0))
        if self.designed:
            self.k = self.array("k", (), "int", "state")
            self.laps = self.array("laps", (), "real", "state") if filter.cycle else None
            times = np.array(filter.times)
            if filter.cycle:  # the last time begins a lap
                times[-1] = times[-1 - filter.cycle]
            self.times = self.table("times", times, "time")
            if parameters:
                self.array("time", (), "time", "argument")
        else:
            self.last_time = self.array("t", (), "time", "state")
            self.started = self.array("started", (), "int", "state")
            self.now = self.array("time", (), "time", "argument")
        self.mean = self.array("mean", (self.rows,), owner="state")
        self.cov = self.array("cov", (self.rows, self.rows), owner="state")
        self.loglik = self.array("loglik", (), owner="state")
        self.y = self.array("y", (self.m,), owner="argument").all
        by_role: dict[str, list[Any]] = {"parameter": [], "input": [], "elapsed": []}
        for p in system.parameters:
            by_role[p.role].append(p)
        self.inputs = [] if self.designed else by_role["input"]  # a design knows them
        self.parameters = by_role["parameter"] if parameters else []
        held, now = (self._argument(name, self.inputs) for name in ("held", "u"))
        arguments = self._argument("p", self.parameters)
        self._held, self._now = {**held, **arguments}, {**now, **arguments}
        self.indicator = None
        self.refuse(any_of(isinf(self.y)), "INFINITE")
        if self.indicators:
            self.indicator = self.array("indicator", (), "int", "argument").all
            wrong = (self.indicator < -1.0) | (self.indicator >= float(self.indicators))
            self.refuse(wrong, "RANGE")

    def _argument(self, name: str, parameters: list[Any]) -> dict[Any, Scalar]:
        if not parameters:
            return {}
        array = self.array(name, (len(parameters),), owner="argument")
        return dict(zip(parameters, array.all, strict=True))

    def since(self, dt: Scalar | float = np.nan) -> Values:
        """Numbers of the model's parameters in the dynamics, over a step of length `dt`."""
        return self.filter.values(self._held, dt)

    def at_time(self) -> Values:
        """Numbers of the model's parameters in the sensor at the time of the measurement."""
        return self.filter.values(self._now)

    def timed(self) -> Scalar:
        """The time of the measurement; one before that of the state is refused."""
        t = self.now.all
        carries_cov = isinstance(self.filter, CovarianceFilter)
        early = t < self.last_time.all if carries_cov else t <= self.last_time.all
        self.refuse(~isfinite(t) | ((self.started.all > 0.0) & early), "TIME")
        return t

    def start(self) -> dict[str, np.ndarray]:
        """What of the state is not zero before the first measurement, by the names of arrays."""
        if not isinstance(self.filter, CovarianceFilter):
            return {}
        system = self.filter.system
        return {"mean": np.asarray(system.mean0, float), "cov": np.asarray(system.cov0, float)}

    def table(self, name: str, values: Any, kind: str = "real") -> Array:
        """See `Tape.table`.

        Raises
        ------
        ValueError
            More than `MOST_NUMBERS` in all tables together.
        """
        self.numbers += np.size(values)
        if self.numbers > MOST_NUMBERS:
            raise ValueError(
                f"filter: wanted at most {MOST_NUMBERS:,} numbers in its tables, got at least "
                f"{self.numbers:,}"
            )
        return super().table(name, values, kind)

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

        The covariance is NaN from then on. What the schedule leaves out is refused.
        """
        missing = [*isnan(self.y)]
        missing += [self.indicator < 0.0] if self.indicators else []
        if getattr(self.filter, "measured", None) is not None:
            schedule = self.table("schedule", self.filter.measured, "int")[k]
            for i, scheduled in enumerate(schedule):
                self.refuse(~missing[i] & (scheduled < 1.0), "STRAY")
                missing[i] = missing[i] & (scheduled > 0.0)
        before = isnan(self.cov[0, 0])
        return before, before | any_of(missing)

    def push(self, memory: Array, estimate: Sequence[Any], measurement: Sequence[Any]) -> None:
        """Put an estimate and a measurement on the memory, which holds estimates first."""
        old, size = list(memory.all), len(estimate) * self.filter.memory.estimates
        estimates = [*estimate, *old[:size]][:size]
        memory.store([*estimates, *[*measurement, *old[size:]][: len(old) - size]])


def any_of(truths: Any) -> Any:
    """Whether one of several truths holds."""
    result = truths[0]
    for truth in truths[1:]:
        result = result | truth
    return result
