"""Re-entry: the model, the turned residual, the backward pass and the rows of the table."""

import csv

import numpy as np
import pytest

from oracles.programs import BENCHMARKS, load
from seedslib.filters import CovarianceFilter, smooth
from seedslib.linearization import Cubature


@pytest.fixture(scope="module")
def program():
    return load("field_reentry")


@pytest.fixture(scope="module")
def table():
    with (BENCHMARKS / "field_reentry.csv").open(newline="") as file:
        return {(row["row"], row["setting"]): row for row in csv.DictReader(file)}


def test_forces_are_along_velocity_and_radius(program):
    """The change of the velocity, taken apart along two directions, has the printed sizes."""
    x = np.array([6440.0, 200.0, -1.5, -5.0, 0.4])
    found = program.move(1e-6).value(0.0, x, np.zeros(3))
    np.testing.assert_allclose(found[:2], x[:2] + 0.1 * x[2:4])
    assert found[4] == x[4]
    basis = np.stack([x[2:4], x[:2]], axis=1)
    drag, pull = np.linalg.solve(basis, (found[2:4] - x[2:4]) / 0.1)
    far, fast = np.hypot(*x[:2]), np.hypot(*x[2:4])
    assert drag == pytest.approx(-0.59783 * np.exp(0.4) * np.exp((6374 - far) / 13.406) * fast)
    assert pull * far == pytest.approx(-0.00981 * (6374 / far) ** 2, rel=1e-3)  # free fall


def test_the_turned_residual_is_a_displacement(program):
    """Of a radar without noise it is, to first order, where the state is less where it was held."""
    x = np.array([6450.0, 260.0, -1.6, -6.0, 0.5])
    apart = np.array([0.01, -0.02, 0, 0, 0])
    y = program.SENSOR.value(0.0, x + apart, np.zeros(2))
    found = program.turned(0.0, x, y)
    np.testing.assert_allclose(found[:2] + found[2:4], apart[:2], atol=1e-5)
    np.testing.assert_allclose(np.hypot(*found[:2]), abs(found[4]), rtol=1e-12)


def test_the_backward_pass_is_the_smoother(program):
    times = program.TIMES[:30]
    data = program.truth().simulate(times, 3, 2)
    y = data.measurements.copy()
    y[0] = np.nan
    filter = CovarianceFilter(program.reentry(), Cubature())
    wanted = smooth(filter, times, y).mean[1:]
    kept = filter.run(times, y)
    np.testing.assert_allclose(program.backward(kept, times, 1), wanted, atol=1e-8)
    assert np.abs(program.backward(kept, times, 3) - wanted).max() > 1e-5


def test_rows_of_the_table(table):
    row = {name: (float(r["rmse"]), float(r["error"])) for (name, _), r in table.items()}
    for name in ("extended", "unscented", "cubature", "Gauss-Hermite 3"):
        assert abs(row[name][0] - 0.0084) < 0.0002
        assert abs(row[f"{name} smoother"][0] - 0.0044) < 0.0002
    above = float(table["forecasts", "1"]["above"]) / row["extended"][0]
    assert 0 < above < 0.04
    assert float(table["minimax residual", "1"]["rmse"]) > 10 * row["extended"][0]
    assert float(table["minimax turned", "1"]["rmse"]) < 1.04 * row["extended"][0]
