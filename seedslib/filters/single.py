"""One record on Python's floats: the program of a filter, run step by step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import index as whole
from typing import TYPE_CHECKING, Any

import numpy as np

from seedslib.tape.floats import as_function

if TYPE_CHECKING:
    from seedslib.filters.base import Estimates, Filter, Record


class Single:
    """The program of a filter as a function on floats, recorded when it is first wanted.

    A filter shares it with those that are bound to other numbers of parameters, which are
    arguments. Where the program cannot go on, with a number that Python's floats do not have or
    what it leaves to arrays, a step is that of the filter's arrays; so are all steps of a filter
    that has no program.
    """

    possible: bool | None = None

    def of(self, filter: Filter) -> bool:
        """Whether there is a program for the filter."""
        if self.possible is not None:
            return self.possible
        try:
            with np.errstate(all="ignore"):
                step = filter.program(parameters=True, floats=True)
        except (ArithmeticError, AttributeError, TypeError, ValueError):  # no formulas, or too many
            self.possible = False
            return False
        self._function = as_function(step)
        self._fields, size = {}, 0
        for array in step.arrays.values():
            if array.owner == "state":
                start, size = size, size + math.prod(array.shape)
                self._fields[array.name] = slice(start, size), array.shape
        self._shape, self._indicators = (step.m,), step.indicators > 0
        self._timed = "time" in step.arrays
        known = filter.system.parameters
        self._inputs, self._parameters = (
            [known.index(p) for p in part] for part in (step.inputs, step.parameters)
        )
        self.possible = True
        return True

    def _given(self, before: Any, p: Any) -> list[float]:
        """Inputs since the last time and at this time, and parameters, from their numbers."""
        earlier, now = ([part[k] for k in self._inputs] for part in (before, p))
        given = [*earlier, *now, *(p[k] for k in self._parameters)]
        if any(map(np.ndim, given)):
            raise TypeError("parameters: wanted numbers for one record")
        return [float(number) for number in given]

    def _flat(self, parts: dict[str, Any]) -> list[float]:
        """The numbers of a state, of which some may be missing."""
        flat: list[float] = []
        for name, (part, shape) in self._fields.items():
            value = parts.get(name)
            if value is None:
                flat += [0.0] * (part.stop - part.start)
            elif not shape:
                flat.append(float(value))
            elif type(value) is tuple:  # labels, of which some may be missing
                flat += [*map(float, value), *[0.0] * (shape[0] - len(value))]
            else:
                flat += value if type(value) is list else value.ravel().tolist()
        return flat

    def _parts(self, numbers: Sequence[float]) -> dict[str, Any]:
        """The arrays of a state, by their names."""
        array, parts = np.array(numbers), {}
        for name, (part, shape) in self._fields.items():
            if not shape:
                parts[name] = numbers[part.start]
            else:
                parts[name] = array[part] if len(shape) == 1 else array[part].reshape(shape)
        return parts

    def step(
        self, filter: Filter, state: Any, t: float, y: Any, indicator: Any, inputs: Any
    ) -> Any:
        """The state after a measurement; None where arrays have to do it."""
        try:
            t, y = float(t), np.asarray(y, dtype=float)
            if y.ndim != 1 or not self.of(filter):  # batches must not record a program
                return None
            if y.shape != self._shape or not filter.steps_alone(state, t):
                return None
            given = [t, *y.tolist()] if self._timed else y.tolist()
            if self._inputs or self._parameters:
                p = filter.values(inputs)
                given += self._given(p, p)
            if self._indicators:
                given.append(whole(indicator))
            elif indicator is not None:
                return None
        except (TypeError, ValueError):  # arrays say why
            return None
        later = self._later(self._flat(filter.numbers_of(state)), given)
        return None if later is None else filter.state_of(self._parts(later), t, state)

    def _later(self, numbers: Sequence[float], given: list[float]) -> Sequence[float] | None:
        """Numbers of the next state; None where arrays have to find it."""
        try:
            later = self._function(numbers, given)
        except (ArithmeticError, ValueError):
            return None
        return None if type(later) is str else later

    def run(
        self, filter: Filter, record: Record, state: Any = None, begin: int = 0
    ) -> dict[str, np.ndarray]:
        """What the states of a record have by name, (K+1, ...).

        Parameters
        ----------
        filter : Filter
        record : Record
        state : NamedTuple, optional
            Of the time before the row `begin`, from which on the record is run.
        begin : int
        """
        times, y = record.times, record.y.reshape(record.y.shape[:2])
        columns = [times, *y.T] if self._timed else [*y.T]
        if self._inputs or self._parameters:
            changes = len(times) if record.inputs.values else 1
            p = [filter.values(record.inputs.at(k)) for k in range(changes)]
            given = np.array(list(map(self._given, [p[0], *p], p)))
            columns += [*np.broadcast_to(given, (len(times), given.shape[1])).T]
        indicators = record.indicators
        if self._indicators:
            columns.append(indicators := record.indicators.reshape(-1))
        state, rows = filter.initial() if state is None else state, []
        numbers, arrays = self._flat(filter.numbers_of(state)), not filter.carries(state)
        for k, given in enumerate(np.column_stack(columns).tolist()[begin:], begin):
            later = None if arrays else self._later(numbers, given)
            if later is None:
                if k > begin and not arrays:
                    state = filter.state_of(self._parts(numbers), times[k - 1], state)
                indicator = () if indicators is None else (indicators[k],)
                state = filter.predict(state, times[k], inputs=record.inputs.at(max(k - 1, 0)))
                state = filter.correct(state, y[k], *indicator, inputs=record.inputs.at(k))
                arrays = not filter.carries(state)
                later = self._flat(filter.numbers_of(state) | _results(filter.report(state)))
            rows.append(numbers := later)
        array = np.array(rows)
        return {
            name: array[:, part].reshape(len(array), *shape)
            for name, (part, shape) in self._fields.items()
        }


def _results(estimates: Estimates) -> dict[str, Any]:
    """What a program finds in a state, by the names of its arrays."""
    mean, cov, prob, loglik, _, mode = estimates
    return {"mean": mean, "cov": cov, "prob": prob, "loglik": loglik, "mode": mode}
