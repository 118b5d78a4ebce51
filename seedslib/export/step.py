"""The program of one measurement: arrays of state and arguments, refusals, what designs share."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from seedslib.base.values import assigned
from seedslib.export.tape import Scalar, Tape, choose, isfinite, isinf, isnan
from seedslib.filters.covariance import CovarianceFilter
from seedslib.models.kinds import mentioned

CODES = ("OK", "END", "INFINITE", "PARTLY", "TIME", "RANGE", "STRAY", "UNTOLD")
"""What a step returns: the number of the code in this list."""


class Step(Tape):
    """The program of one measurement, with what every kind of filter has.

    Its arguments are, as far as the filter has them, the time ``t``, the measurement ``y``, the
    ``indicator``, the inputs ``held`` since the last time and ``u`` at this time, the parameters
    ``p``.

    Parameters
    ----------
    filter : Filter
    parameters : bool
        Whether parameters are arguments, or constants with their present values.
    """

    def __init__(self, filter: Any, parameters: bool = False) -> None:
        super().__init__()
        self.filter, system = filter, filter.system
        self.n, self.m = system.state_size, system.measurement_size
        self.rows = getattr(filter, "components", self.n)
        self.designed = getattr(filter, "memory", None) is not None
        self.indicators = int(getattr(system, "indicators", 0))
        self.modes = int(getattr(system, "modes", 0))
        if self.designed:
            self.k = self.array("k", (), "int", "state")
            self.laps = self.array("laps", (), "real", "state") if filter.cycle else None
        else:
            self.last_time = self.array("t", (), "time", "state")
            self.started = self.array("started", (), "int", "state")
            self.now = self.array("time", (), "time", "argument")
        self.mean = self.array("mean", (self.rows,), owner="state")
        self.cov = self.array("cov", (self.rows, self.rows), owner="state")
        self.loglik = self.array("loglik", (), owner="state")
        self.y = self.array("y", (self.m,), owner="argument").all
        by_role: dict[str, list[Any]] = {"parameter": [], "input": [], "elapsed": []}
        for p in sorted(mentioned(system), key=str):
            by_role[p.role].append(p)
        self.inputs = [] if self.designed else by_role["input"]  # a design knows them
        self.elapsed = by_role["elapsed"]
        self.parameters = by_role["parameter"] if parameters else []
        self.held = self._argument("held", self.inputs)
        self.values = self._argument("u", self.inputs) | self._argument("p", self.parameters)
        self.indicator = None
        for part in self.y:
            self.refuse(isinf(part), "INFINITE")
        if self.indicators:
            self.indicator = self.array("indicator", (), "int", "argument").all
            wrong = (self.indicator < -1.0) | (self.indicator >= float(self.indicators))
            self.refuse(wrong, "RANGE")

    def _argument(self, name: str, parameters: list[Any]) -> dict[Any, Scalar]:
        if not parameters:
            return {}
        array = self.array(name, (len(parameters),), owner="argument")
        return dict(zip(parameters, array.all, strict=True))

    def since(self, dt: Scalar) -> AbstractContextManager[None]:
        """``with step.since(dt):`` the dynamics have the inputs and the length of the step."""
        return assigned({**self.held, **dict.fromkeys(self.elapsed, dt)})

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

    def begin(self) -> tuple[Scalar, Scalar]:
        """Number of the measurement and its time, of a designed filter."""
        times, k = self.filter.times, self.k.all
        if not self.filter.cycle:
            self.refuse(k >= float(len(times)), "END")
        t = self.table("times", times, "time")[k]
        if self.filter.cycle:
            t = t + self.laps.all * (times[-1] - times[-1 - self.filter.cycle])
        return k, t

    def end(self, k: Scalar) -> None:
        """Count the measurement; the last steps of a design without end serve in turn."""
        last, cycle = len(self.filter.times), self.filter.cycle
        self.k.store(k + 1.0)
        if cycle:
            over = k + 1.0 >= float(last)
            self.k.store(choose(over, float(last - cycle), k + 1.0))
            self.laps.store(self.laps.all + choose(over, 1.0, 0.0))

    def gaps(self, missing_now: Scalar) -> tuple[Scalar, Scalar]:
        """Whether the design knows no covariance: before this measurement, and after it."""
        before = isnan(self.cov[0, 0])
        return before, before | missing_now

    def any_missing(self) -> Scalar:
        """Whether a component of the measurement is missing."""
        return any_of(isnan(self.y))

    def push(self, memory: Any, mean: Any, measurement: Any, lead: Any = ()) -> None:
        """Newest first: estimates, then measurements; `lead` stands before each block."""
        block, kept = self.filter.memory, memory.all
        one = [*lead, *mean] if block.estimates else []
        two = [*(lead if not block.estimates else ()), *measurement] if block.measurements else []
        cut = block.estimates * len(one)
        first = [*one, *kept[: cut - len(one)]] if one else []
        second = [*two, *kept[cut : len(kept) - len(two)]] if two else []
        memory.store(np.array([*first, *second], dtype=object))


def any_of(truths: Any) -> Any:
    """Whether one of several truths holds."""
    result = truths[0]
    for truth in truths[1:]:
        result = result | truth
    return result
