"""The page that compares all problems, from the rows that it must have chosen."""

import csv

import pytest

from oracles.programs import BENCHMARKS


def row(file, **wanted):
    """The one row of a table with these entries."""
    with (BENCHMARKS / f"{file}.csv").open(newline="") as lines:
        (found,) = (r for r in csv.DictReader(lines) if all(r[k] == v for k, v in wanted.items()))
    return found


@pytest.mark.parametrize(
    ("file", "where", "designed", "least"),
    [
        ("field_growth", {}, "one table a step", "Bayes"),
        ("field_minimax", {"problem": "inverse proportion"}, "order 2", "least"),
        ("field_minimax", {"problem": "sampled regression"}, "order 2", "least"),
        ("field_minimax", {"problem": "switching observations"}, "order 1", "least"),
        ("field_projection", {"noise": "2.0"}, "table of order 1", "least"),
    ],
)
def test_designed_filters_are_near_the_exact_ones(file, where, designed, least):
    near, best = (row(file, row=name, **where) for name in (designed, least))
    assert float(near["mse"]) < 1.02 * float(best["mse"])  # 1 % of the root
    assert 10 * float(near["microseconds"]) < float(best["microseconds"])


def test_extended_filters_suffice_where_measurements_are_precise():
    extended = float(row("field_bearings", row="EKF1")["rmse"])
    for name in ("EKF2", "UKF alpha .5", "UKF alpha 1", "CKF", "Gauss-Hermite 3"):
        assert extended < 1.02 * float(row("field_bearings", row=name)["rmse"])
    for order in (1, 2, 4):
        told = row("field_bearings", row=f"variance 10: designed, order {order}")
        assert float(told["rmse"]) > 1.5 * extended
    extended = float(row("field_reentry", row="extended")["rmse"])
    for name in ("unscented", "cubature", "Gauss-Hermite 3", "forecasts"):
        assert extended < 1.02 * float(row("field_reentry", row=name)["rmse"])
