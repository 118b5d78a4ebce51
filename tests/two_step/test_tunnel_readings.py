"""The committed table of readings of example 7, and a part of it computed again."""

import csv

import pytest

from oracles.programs import BENCHMARKS, load
from seedslib.gaussian.errors.forms import quadratic_errors

PROGRAM = load("tunnel_readings")
TABLE = list(csv.DictReader((BENCHMARKS / "tunnel_readings.csv").open()))


def test_no_reading_is_a_hit():
    assert sum(int(row["readings"]) for row in TABLE) == 163_296
    assert [row for row in TABLE if int(row["hits"]) or float(row["miss"]) < 5] == []


@pytest.mark.parametrize("number", [0, 5, 60])
def test_rows_of_the_table_are_computed_again(number):
    row = TABLE[number]
    again = PROGRAM.scan(row["matrix"], row["time"], row["sensors"])
    for stored, value in zip(row.values(), again, strict=True):
        if isinstance(value, str) and value[0].isdigit():
            assert float(stored) == pytest.approx(float(value), rel=1e-4)
        else:
            assert stored == str(value)


def test_errors_of_the_program_are_those_of_theorem_2():
    q, r, error_cov, cov = next(PROGRAM.laws(PROGRAM.PRINTED, "continuous", "x3"))
    weights = PROGRAM.WEIGHTS[1]
    form = [[0.0, 0.0], [0.0, weights[0]]] + weights[1] * PROGRAM.PRINTED[:1].T @ PROGRAM.PRINTED[
        :1
    ]
    exact = quadratic_errors(form, [0, 0], cov, error_cov)
    best, rough, loss = PROGRAM.errors(PROGRAM.PRINTED, weights, error_cov, cov)
    assert (q, r) == (PROGRAM.PROCESS[0], PROGRAM.SENSOR[0])
    assert [best, rough] == pytest.approx([float(exact.optimal), float(exact.plugin)], rel=1e-9)
    assert loss == pytest.approx(100 * (rough / best - 1), rel=1e-9)
