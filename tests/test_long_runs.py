"""The table of long runs keeps what is promised, and a small part of it is run again."""

import csv
from functools import lru_cache

import pytest

from oracles.programs import BENCHMARKS, load

SHORT = 2000


@lru_cache
def program():
    return load("long_runs")


def rows():
    with (BENCHMARKS / "long_runs.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def number(text):
    return float(text) if text else None


def keeps(row, errors):
    """A row of the table, its entries as texts; `errors` of the mean squares are allowed."""
    assert row["finite"] == "True"
    assert number(row["asymmetry"]) == 0
    assert number(row["least_eigenvalue"]) > 0.01
    for name, most in (("drift", 1e-12), ("probability", 1e-12)):
        if row[name]:
            assert number(row[name]) < most, (row["filter"], name)
    if row["least_probability"]:
        assert number(row["least_probability"]) > 0
    if row["nis"]:
        assert abs(number(row["nis"]) - 1) < errors * number(row["nis_error"])
        assert abs(number(row["nees"]) - 1) < errors * number(row["nees_error"])
    assert 0.9 < number(row["nees"]) < 1.1


def test_a_million_steps():
    told = rows()
    for row in told:
        keeps(row, 4)
        assert int(row["steps"]) == 10**6
        assert int(row["kilobytes"]) < 16_000, row["filter"]
    python = {row["filter"] for row in told if row["language"] == "Python"}
    assert python == set(program().FILTERS)
    assert {row["filter"] for row in told if row["language"] == "C"} == set(program().IN_C)


@pytest.mark.parametrize("name", ["Kalman", "extended", "cubature", "design without an end"])
def test_two_thousand_of_them(name):
    """Numbers of a filter that is exact are those of the table, but for chance."""
    row = program().measure(name, SHORT, block=SHORT // 8)
    text = {k: "" if v is None else str(v) for k, v in row._asdict().items()}
    text["nees"] = "1" if abs(row.nees - 1) < 6 * row.nees_error else text["nees"]
    keeps(text, 6)
    stored = next(r for r in rows() if (r["filter"], r["language"]) == (name, "Python"))
    assert abs(row.least_eigenvalue - number(stored["least_eigenvalue"])) < 2e-2
