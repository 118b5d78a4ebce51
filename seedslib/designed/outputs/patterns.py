"""Output functions that know which components of a measurement have arrived.

There is a function for each pattern of what was seen, and the class of histories of what arrived
before is an argument of it, as a remembered mode is; see `seedslib.designed.patterns`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.designed.arrivals import check_arrivals
from seedslib.designed.outputs.lookup import Output, Table, step_axes
from seedslib.designed.shapes import check_verbs


class ByPattern(NamedTuple):
    """Output functions of the components of a measurement that were seen.

    Attributes
    ----------
    tables : tuple of Table or None, length 2^m - 1
        Number i is that of the components whose powers of two add up to i + 1; None where one of
        them is not read.
    """

    tables: tuple[Table | None, ...]

    @property
    def fullest(self) -> Table | None:
        """The table of all components that are read; None where none is."""
        return next((table for table in reversed(self.tables) if table is not None), None)

    def __call__(self, points: Any) -> Output:
        """Values where all that is read was seen, see `Table`."""
        if self.fullest is None:
            raise ValueError("y: wanted no measurement, the schedule has none")
        return self.fullest(points)

    def check(self, name: str, axes: Any, told: int, *rest: Any) -> None:
        """As `Table.check`, of each table; `axes` are those with all components.

        Raises
        ------
        TypeError, ValueError
            Another number of tables, or tables with other axes.
        """
        m = (len(self.tables) + 1).bit_length() - 1
        if len(self.tables) != 2**m - 1:
            raise ValueError(f"{name}: wanted 2^m - 1 tables, got {len(self.tables)}")
        for i, table in enumerate(self.tables, start=1):
            if table is not None:
                part = tuple(axes[told + j] for j in components(i, m))
                wanted = (*axes[:told], *part, *axes[told + m :])
                table.check(f"{name}.tables[{i - 1}]", wanted, *rest)


def components(number: int, size: int) -> list[int]:
    """The components of a pattern, from its number."""
    return [i for i in range(size) if number >> i & 1]


def check_patterns(filter: Any) -> None:
    """Refuse functions of patterns that do not fit the memory, or classes that do not fit them.

    Raises
    ------
    TypeError, ValueError
        What does not fit.
    """
    system, memory, n = filter.system, filter.memory, filter.components
    m, told = system.measurement_size, int(system.indicators > 0)
    check_arrivals(filter, n)
    for k, step in enumerate(filter.steps):
        if isinstance(step.shown, ByPattern):
            if len(step.shown.tables) != 2**m - 1:
                raise ValueError(f"steps[{k}].shown: wanted {2**m - 1} tables")
            axes = step_axes(system, memory, (None,) * m, (None,) * n, k, classes_at(filter, k))
            modes = getattr(system, "modes", 0)
            step.shown.check(f"steps[{k}].shown", axes[0], told, n, modes, memory)
        elif filter.measured is None or step.shown is not None:
            check_verbs([(f"steps[{k}].shown", step.shown)], "__call__")
        check_verbs([(f"steps[{k}].blind", step.blind)], "__call__")


def classes_at(filter: Any, k: int) -> int:
    """Classes before measurement k, which its functions have as an argument; 0 without such."""
    if not filter.arrivals:
        return 0
    return len(filter.arrivals[k].table if k < len(filter.steps) else filter.arrivals[-1].prob)


def by_pattern(step: Any, y: np.ndarray, call: Any) -> Output:
    """What the functions of a step find for measurements (m, *batch) of any patterns.

    Parameters
    ----------
    step : Step
    y : ndarray, shape (m, *batch)
    call : callable
        ``call(function, y)`` with the components (a sequence) that the function looks at.

    Raises
    ------
    ValueError
        A component that the schedule leaves out.
    """
    m, there = len(y), ~np.isnan(y)
    number = np.tensordot(2 ** np.arange(m), there, 1)
    found: Any = None
    for i in np.unique(number).tolist():
        function = step.shown.tables[i - 1] if i else step.blind
        if function is None:
            raise ValueError("y: wanted what the schedule of the design has")
        part = call(function, [np.where(number == i, y[j], 0.0) for j in components(i, m)])
        found = part if found is None else _where(number == i, part, found)
    return found


def _where(here, one, other):
    pairs = zip(one, other, strict=True)
    return Output(*(None if a is None else np.where(here, a, b) for a, b in pairs))
