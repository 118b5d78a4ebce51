"""Filters of tables: output functions that are looked up."""

from __future__ import annotations

import numpy as np

from seedslib.designed.outputs.filter import OutputFilter


class TableFilter(OutputFilter):
    """Optimal filter of a given memory as tables; `seedslib.design` makes it.

    Of a system of any kind: where it has modes the tables decide them too.

    Examples
    --------
    >>> from seedslib.design import grid_synthesis
    >>> from seedslib.designed.memory import large_order
    >>> from seedslib import zoo
    >>> filter = grid_synthesis(
    ...     zoo.flip_process(), large_order(1), [0.0, 0.25, 0.5],
    ...     x=(-3.5, 3.5, 141), z=(-3, 3, 121), y=(-8, 8, 121),
    ... )
    >>> filter.order
    1
    """

    @property
    def bytes(self) -> int:
        """Memory of the tables."""
        functions = [function for row in (*self.steps, *self.node_fits) for function in row]
        tables = [t for function in functions for t in getattr(function, "tables", [function])]
        parts = [part for table in tables if table is not None for part in table[1:]]
        return sum(part.nbytes for part in parts if part is not None)

    @property
    def made(self) -> str:
        """How the tables were made, and their axes."""
        step = self.steps[min(1, len(self.steps) - 1)]
        told, classes = bool(self.system.indicators), bool(self.arrivals)
        full = getattr(step.shown, "fullest", step.shown)
        axes = () if full is None else full.axes[: len(full.axes) - len(step.blind.axes) + told]
        shown, memory = _listed(axes), _listed(step.blind.axes[told + classes :])
        return (
            f"tables ({self.method}) over {'indicator and ' * told}measurements ({shown})"
            + (f" and memory ({memory})" if memory else "")
        )  # fmt: skip

    @property
    def change(self) -> tuple[float, float]:
        """Change of estimates and modes over the last step; NaN where there is none to compare.

        The first in units of the root-mean-square error.
        """
        if self.changes is None:
            return np.nan, np.nan
        moved, modes = self.changes[:, -1]
        return float(moved / np.sqrt(np.trace(self.covariances[-1]))), float(modes)


def _listed(axes) -> str:
    return "; ".join(map(str, axes))
