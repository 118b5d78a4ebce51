"""The program of one measurement: its arrays, its arguments, what it refuses."""

from __future__ import annotations

import sys
from itertools import chain
from typing import Any

import numpy as np

from seedslib.base.values import Values
from seedslib.tape.tape import Array, Scalar, Tape, isfinite, isinf

CODES = ("OK", "END", "INFINITE", "PARTLY", "TIME", "RANGE", "STRAY", "UNTOLD")
"""What a step returns: the number of the code in this list."""

MOST_NUMBERS = 2_000_000
"""Numbers in the tables of one program: about 40 megabytes of text."""


MOST_LISTED = 200_000
"""The same for floats, whose tables are lists."""

MOST_VALUES = 10_000
"""Named values of a program for floats; with more of them matrices of NumPy are as fast."""

VERBS = {"initial", "predict", "propagate", "correct", "update", "report", "values", "rules"}
"""What a program stands for: a filter that has its own has to have its own program."""


class Program(Tape):
    """The program of one measurement, with what every kind of filter has.

    Its arguments are, as far as the filter has them, the ``time``, the measurement ``y``, the
    ``indicator``, the inputs ``held`` since the last time and ``u`` at this time, the parameters
    ``p``. Where its state has a time it is called ``t``.

    Parameters
    ----------
    filter : Filter
    parameters : bool
        Whether parameters are arguments, or constants with their present values.
    floats : bool
        Whether it runs on Python's floats beside the filter's arrays. They do what it cannot: where
        covariances would have to be repaired it refuses the step with the code ``ARRAYS``, and a
        program as long as `MOST_VALUES` is none. Without them it goes on.

    Raises
    ------
    TypeError
        A filter whose steps are not those of the class that has its program.
    """

    designed = False

    def __init__(
        self,
        filter: Any,
        parameters: bool = False,
        floats: bool = False,
    ) -> None:
        super().__init__(MOST_VALUES if floats else sys.maxsize)
        kinds = type(filter).__mro__
        first = next(k for k, kind in enumerate(kinds) if "program" in vars(kind))
        if own := sorted(VERBS.intersection(chain.from_iterable(map(vars, kinds[:first])))):
            raise TypeError(f"filter: wanted a program for its own {', '.join(own)}, got none")
        self.numbers, self.most_numbers = 0, MOST_LISTED if floats else MOST_NUMBERS
        self.filter, system = filter, filter.system
        self.with_parameters, self.floats = parameters, floats
        self.n, self.m = system.state_size, system.measurement_size
        self.rows = getattr(filter, "components", self.n)
        self.indicators = int(getattr(system, "indicators", 0))
        self.modes = int(getattr(system, "modes", 0))
        by_role: dict[str, list[Any]] = {"parameter": [], "input": [], "elapsed": []}
        for p in system.parameters:
            by_role[p.role].append(p)
        self.inputs = [] if self.designed else by_role["input"]  # a design knows them
        self.parameters = by_role["parameter"] if parameters else []
        self.initial: dict[str, Any] = {}
        self._begin_state()
        self.mean = self.array("mean", (self.rows,), owner="state")
        self.cov = self.array("cov", (self.rows, self.rows), owner="state")
        self.loglik = self.array("loglik", (), owner="state")
        self.y = self.array("y", (self.m,), owner="argument").all
        before, now = (self._argument(name, self.inputs) for name in ("held", "u"))
        arguments = self._argument("p", self.parameters)
        self._before, self._now = {**before, **arguments}, {**now, **arguments}
        self.indicator = None
        self.refuse(any_of(isinf(self.y)), "INFINITE")
        if self.indicators:
            self.indicator = self.array("indicator", (), "int", "argument").all
            wrong = (self.indicator < -1.0) | (self.indicator >= float(self.indicators))
            self.refuse(wrong, "RANGE")

    def _begin_state(self) -> None:
        """Arrays of the time, the first of the state."""
        self.last_time = self.array("t", (), "time", "state")
        self.started = self.array("started", (), "int", "state")
        self.now = self.array("time", (), "time", "argument")

    def _argument(self, name: str, parameters: list[Any]) -> dict[Any, Scalar]:
        if not parameters:
            return {}
        array = self.array(name, (len(parameters),), owner="argument")
        return dict(zip(parameters, array.all, strict=True))

    def since(self, dt: Scalar | float = np.nan) -> Values:
        """Numbers of the model's parameters in the dynamics, over a step of length `dt`."""
        return self.filter.values(self._before, dt)

    def at_time(self) -> Values:
        """Numbers of the model's parameters in the sensor at the time of the measurement."""
        return self.filter.values(self._now)

    def timed(self, again: bool = False) -> Scalar:
        """The time of the measurement; one before that of the state is refused.

        Parameters
        ----------
        again : bool
            Whether it may be that of the state.
        """
        t = self.now.all
        early = t < self.last_time.all if again else t <= self.last_time.all
        self.refuse(~isfinite(t) | ((self.started.all > 0.0) & early), "TIME")
        return t

    def defer(self, condition: Scalar) -> None:
        """Leave the step to the filter's arrays where a truth holds, if there are any."""
        if self.floats:
            self.refuse(condition, "ARRAYS")

    def table(self, name: str, values: Any, kind: str = "real") -> Array:
        """See `Tape.table`.

        Raises
        ------
        ValueError
            More numbers in all tables together than there may be.
        """
        self.numbers += np.size(values)
        if self.numbers > self.most_numbers:
            raise ValueError(
                f"filter: wanted at most {self.most_numbers:,} numbers in its tables, got at "
                f"least {self.numbers:,}"
            )
        return super().table(name, values, kind)


def any_of(truths: Any) -> Any:
    """Whether one of several truths holds."""
    result = truths[0]
    for truth in truths[1:]:
        result = result | truth
    return result
