"""The table of readings of the falling body: smaller runs agree with it, and what it says."""

import csv

import numpy as np
import pytest

from oracles.programs import BENCHMARKS, load

readings = load("piecewise_readings")
PRINTED = np.array([18, 24, 7, 5, 4, 3, 1, 1, 1, 1])
RUNS = 100


@pytest.fixture(scope="module")
def table():
    names = ("noise", "deviation", "speed")
    with (BENCHMARKS / "piecewise_readings.csv").open() as file:
        return {
            (*(float(row[name]) for name in names), row["body"], row["quantity"]): np.array(
                [float(row[str(t)]) for t in range(1, 11)]
            )
            for row in csv.DictReader(file)
        }


def distance(found, lines):
    """Largest distance of the sample's means from lines of the table, in standard errors."""
    worst = 0.0
    for name, values in found.items():
        if name == "ratio" or " " in name:
            expected = lines["tau" if name == "ratio" else name]
            error = np.sqrt((1 / RUNS + 1 / readings.RUNS) * values.var(axis=1))
            gap = np.abs(values.mean(axis=1) - expected)
            worst = max(worst, (gap / (error + 1 / RUNS + 5e-4 * expected)).max())
    return worst


@pytest.mark.parametrize("reading", [(1e-3, 13.0, 1.0), (1e-4, 11.25, -1.0)])
def test_live_samples_agree_with_the_table(table, reading):
    lines = {
        body: {key[4]: line for key, line in table.items() if key[:4] == (*reading, body)}
        for body in readings.BODIES
    }
    for body in readings.BODIES:
        found = readings.study(*reading, body, RUNS, 3)
        assert distance(found, lines[body]) < 5
        others = [other for other in readings.BODIES if other != body]
        assert all(distance(found, lines[other]) > 5 for other in others)


def test_what_the_table_says(table):
    cases = {key[:3] for key in table}
    assert len(cases) == 36

    def close(case):
        ratio = np.array([table[*case, body, "tau"] for body in ("5", "50")])
        return (np.abs(ratio - 1) < 2 * np.sqrt(2 / 20)).all()

    found = [case for case in cases if close(case)]
    assert found
    assert all(case[:2] == (1e-3, 22.5) for case in found)
    counts = [line for key, line in table.items() if " " in key[4]]
    assert len(counts) == 36 * 3 * 18
    near = [key for key in table if " " in key[4] and key[3] == "5"]
    counts += [(table[key] + table[*key[:3], "50", key[4]]) / 2 for key in near]
    assert 1 <= max((np.abs(line - PRINTED) <= 0.5).sum() for line in counts) <= 6


def test_criteria_by_hand():
    weights = np.array([[0.5], [0.3], [0.15], [0.04], [0.01]])
    found = {name: int(count[0]) for name, count in readings.counts(weights).items()}
    assert found["relative 0.1"] == 3
    assert found["relative 0.02"] == 5
    assert found["absolute 0.1"] == 3
    assert found["absolute 0.02"] == 4
    assert found["cumulative 0.1"] == 3
    assert found["cumulative 0.02"] == 4


def test_bodies_that_are_drawn_lie_between_the_windows():
    drawn = readings.starts("drawn", 22.5, 500, np.random.default_rng(0))
    assert drawn.shape == (500,)
    assert ((drawn > 5) & (drawn < 50)).all()
