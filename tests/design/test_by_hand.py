"""The examples against a second program, which uses nothing of the library.

It is `benchmarks/jump_diffusion_by_hand.py`; what it has computed at full size is in its table,
and the ledger's references are from there.
"""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest

from bookkit.claims import read_ledger
from seedslib import zoo
from seedslib.design import affine_synthesis, grid_synthesis, synthesize
from seedslib.designed import finite_memory, large_order
from seedslib.linearization import ExactGaussian, Taylor

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def by_hand():
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        import jump_diffusion_by_hand

        return jump_diffusion_by_hand
    finally:
        sys.path.remove(str(ROOT / "benchmarks"))


@pytest.fixture(scope="module")
def table():
    with (ROOT / "benchmarks" / "jump_diffusion_by_hand.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {
        (row["claim"], row["quantity"]): (float(row["value"]), float(row["standard_error"]))
        for row in rows
    }


@pytest.mark.parametrize("claim", ["JD-X1", "JD-X2", "JD-X3", "JD-X4"])
def test_references_of_the_ledger_are_those_of_the_table(table, claim):
    wanted = [value for (name, _), (value, _) in table.items() if name == claim]
    ledger = {entry.id: entry.reference for entry in read_ledger(ROOT / "book" / "claims.yml")}
    assert ledger[claim] == pytest.approx(wanted, abs=6e-6 if claim != "JD-X1" else 6e-11)


def orders(kind, by_hand):
    best = by_hand.linear_errors("state", 1)[-1]
    return {l: 100 * (by_hand.linear_errors(kind, l)[-1] / best - 1) for l in range(1, 7)}


def test_orders_of_the_linear_example(by_hand, table):
    """Vectors of coefficients in the one program, a covariance recursion in the other."""
    times, system = 0.5 * np.arange(21), zoo.linear_gaussian()
    for kind, l in (("state", 1), ("position", 1), ("position", 3), ("measurements", 2)):
        memory = finite_memory(l) if kind == "measurements" else large_order(l)
        made = synthesize(
            system, memory, Taylor(), times, components=1 if kind == "position" else 2, nodes=0,
            exact_moments=True,
        )  # fmt: skip
        found = by_hand.linear_errors(kind, l)
        assert made.predicted.rms[:, 0] ** 2 == pytest.approx(found, abs=1e-10)
    assert found[-1] == pytest.approx(table["JD-X1", "last measurements, l = 2"][0], abs=1e-11)


def test_order_that_a_target_asks_for(by_hand):
    """30, 10, 1, 0.1 and 0.01 per cent above the Kalman filter; measurements need more."""

    def chosen(kind):
        excess = orders(kind, by_hand)
        return [
            next((l for l, e in excess.items() if e < target), 9)
            for target in (30, 10, 1, 0.1, 0.01)
        ]

    assert chosen("position") == [1, 2, 3, 4, 5]
    assert chosen("measurements") != [1, 2, 3, 4, 5]


def test_density_recursion_of_the_flip_process(by_hand):
    system, times = zoo.flip_process(), 0.25 * np.arange(4)
    axes = {"x": (-3.5, 3.5, 101), "z": (-3.0, 3.0, 61), "y": (-8.0, 8.0, 65)}
    for l in (1, 2):
        made = grid_synthesis(system, large_order(l), times, **axes, nodes=0)
        found = by_hand.flip_errors("exact", l, (101, 61, 65), 4)
        assert made.predicted.rms[:, 0] ** 2 == pytest.approx(found, rel=2e-3)
    for name, rule in (("gaussian", ExactGaussian()), ("linearised", Taylor())):
        _, risk = affine_synthesis(system, large_order(1), rule, times, **axes)
        assert risk.mse == pytest.approx(by_hand.flip_errors(name, 1, (101, 61, 65), 4), rel=2e-3)


def near(rows, claim, table):
    """Whether a small run has the differences of the table, within four standard errors."""
    return all(
        abs(value - table[claim, name][0]) < 4 * np.hypot(error, table[claim, name][1])
        for name, value, error in rows
    )


def test_kinds_of_forecast(by_hand, table):
    rows = by_hand.forecast_kinds(10_000, 10_000, 7)
    assert near(rows, "JD-X4", table)
    names = [row[0] for row in rows]
    swapped = [(names[k], *rows[k][1:]) for k in range(5)]
    swapped[0], swapped[1] = (names[0], *rows[1][1:]), (names[1], *rows[0][1:])
    assert not near(swapped, "JD-X4", table)


def test_kicked_oscillator(by_hand, table):
    rows = by_hand.duffing_differences(4000, 4000, 7)
    # the design of so few paths has an error of its own
    assert near([(name, value, 2 * error) for name, value, error in rows], "JD-X3", table)
    signs = {name: np.sign(value) for name, value, _ in rows}
    assert signs == {"position": 1, "continuous": -1, "EKF": 1}
