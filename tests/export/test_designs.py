"""Programs of designs: their tables are data."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from export.exported_filters import case
from seedslib.base.tables import Axis
from seedslib.designed.tables import Step
from seedslib.export import to_c


def of_large_tables(measurement, memory):
    """A filter of tables with so many nodes of the measurement and of the last estimate."""
    small, rng = case("stationary table").filter, np.random.default_rng(1)
    y, z = Axis(-8, 8, measurement), Axis(-2.5, 2.5, memory)

    def wide(table, axes):
        values = rng.normal(size=(1, *(axis.count for axis in axes)))
        return table._replace(axes=axes, estimate=values)

    first, *others = small.steps
    steps = [first._replace(update=wide(first.update, (y,)))]
    steps += [Step(wide(step.update, (y, z)), wide(step.forecast, (z,))) for step in others]
    return replace(small, steps=tuple(steps))


def numbers_of(filter):
    return sum(step.update.estimate.size + step.forecast.estimate.size for step in filter.steps)


def test_tables_are_written_as_data():
    """Nothing is recorded for a number: what it takes is a few copies of its digits."""
    filter = of_large_tables(200, 150)
    tracemalloc.start()
    text = to_c(filter)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert numbers_of(filter) > 100_000
    assert len(text) < 25 * numbers_of(filter)
    assert peak < 200 * numbers_of(filter)


def test_more_numbers_than_a_program_can_have_are_refused():
    with pytest.raises(
        ValueError, match=r"^filter: wanted at most 2,000,000 numbers in its tables"
    ):
        to_c(of_large_tables(800, 600))
