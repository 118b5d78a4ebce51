"""Filters of the manoeuvring target against the committed table, and by paired differences."""

import csv
import warnings
from pathlib import Path

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.evaluation import compare
from seedslib.filters import KnownModeFilter
from seedslib.linearization import Taylor

TIMES = np.arange(41.0)
BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def scored(indicator, memories, design=6000, paths=4000):
    system = zoo.manoeuvring_target(indicator)
    filters = {"known modes": KnownModeFilter(system), "IMM": SwitchingFilter(system, Taylor())}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, memory in memories.items():
            filters[name] = synthesize(system, memory, Taylor(), TIMES, paths=design, seed=11)
    return compare(filters, system, TIMES, paths, 22, window=(10, 40))


@pytest.fixture(scope="module")
def noisy():
    return scored(
        "noisy",
        {
            "FBP 1": large_order(1), "FBP 2": large_order(2), "FKP 1": Memory(0, 1, 1),
            "FKP 3": Memory(0, 3, 3), "soft FBP 1": Memory(1, log_odds=True),
            "FBP 1 with J": Memory(1, 0, 1),
        },
    )  # fmt: skip


def near(found, error, value, other):
    """Within four standard errors of both numbers together."""
    assert abs(found - value) < 4 * np.hypot(error, other)


def as_in_the_table(found, indicator):
    """Each filter within four standard errors and one per cent, for the design on fewer paths."""
    with (BENCHMARKS / "switching_target.csv").open(newline="") as file:
        table = {r["name"]: r for r in csv.DictReader(file) if r["indicator"] == indicator}
    for name, row in found.items():
        ours = [(row.average_mode_error or 0.0, row.average_mode_error_error or 0.0)]
        ours += zip(row.average, row.average_error, strict=True)
        for (value, error), column in zip(ours, ("mode", "position", "velocity"), strict=True):
            there, doubt = (float(table[name][c]) for c in (column, f"{column}_error"))
            assert abs(value - there) <= 4 * np.hypot(error, doubt) + 0.01 * there, (name, column)


def test_noisy_indicator_against_the_table(noisy):
    """The reference, too: IMM .0776/1.0581/.4746 on 40 000 paths; FBP 1 minus IMM +.0127, +.259."""
    as_in_the_table(noisy, "noisy")
    row = noisy["IMM"]
    near(row.average_mode_error, row.average_mode_error_error, 0.0776, 0.0004)
    near(row.average[0], row.average_error[0], 1.0581, 0.0024)
    near(row.average[1], row.average_error[1], 0.4746, 0.001)
    apart = noisy.difference("FBP 1", "IMM")
    near(apart.average_mode, apart.average_mode_error, 0.0127, 0.0010)
    near(apart.average_square, apart.average_square_error, 0.259, 0.012)
    apart = noisy.difference("FBP 2", "FBP 1")
    near(apart.average_mode, apart.average_mode_error, -0.0035, 0.0009)
    near(apart.average_square, apart.average_square_error, -0.048, 0.014)


def test_estimates_are_better_to_remember_than_measurements(noisy):
    """Root-mean-square errors at equal length; not the wrong modes of three measurements."""
    apart = noisy.difference("FBP 1", "FKP 1")
    assert apart.average_square < -10 * apart.average_square_error
    assert apart.average_mode < -3 * apart.average_mode_error
    for order in ("FBP 1", "FBP 2"):
        apart = noisy.difference(order, "FKP 3")
        assert apart.average_square < -10 * apart.average_square_error
        assert apart.average_mode > 3 * apart.average_mode_error


def test_what_else_is_worth_remembering(noisy):
    """Log-odds and the indicator: 1.0952 and 1.1097 against 1.1293 of the position."""
    for name, gain in (("soft FBP 1", 1.1293 - 1.0952), ("FBP 1 with J", 1.1293 - 1.1097)):
        apart = noisy.difference(name, "FBP 1")
        near(apart.average[0], apart.average_error[0], -gain, 0.003)
        assert apart.average_mode < -4 * apart.average_mode_error


def test_exact_indicator_orders_approach_the_bound():
    """The reference: mean squares l = 2 minus 1 -.0577, 1 minus the bound +.1127."""
    memories = {f"FBP {l}": large_order(l) for l in (1, 2, 3)}
    table = scored("exact", memories, paths=3000)
    as_in_the_table(table, "exact")
    same = table.difference("IMM", "known modes")
    assert abs(same.average_square) < 1e-10
    apart = table.difference("FBP 1", "known modes")
    near(apart.average_square, apart.average_square_error, 0.1127, 0.0058)
    apart = table.difference("FBP 2", "FBP 1")
    near(apart.average_square, apart.average_square_error, -0.0577, 0.0044)
    apart = table.difference("FBP 3", "FBP 2")
    near(apart.average_square, apart.average_square_error, -0.0270, 0.0033)
    apart = table.difference("FBP 3", "FBP 1")
    assert apart.average_square < -3 * apart.average_square_error
    assert table["FBP 1"].average_mode_error == 0


def test_no_indicator():
    """IMM .1437 of the modes; FBP 1 minus IMM +.0301, +.166."""
    soft = Memory(1, log_odds=True)
    memories = {"FBP 1": large_order(1), "soft FBP 1": soft, "FKP 1": Memory(0, 1, 0)}
    table = scored("none", memories, paths=2500)
    as_in_the_table(table, "none")
    row = table["IMM"]
    near(row.average_mode_error, row.average_mode_error_error, 0.1437, 0.0025)
    apart = table.difference("FBP 1", "IMM")
    near(apart.average_mode, apart.average_mode_error, 0.0301, 0.0016)
    near(apart.average_square, apart.average_square_error, 0.166, 0.010)
