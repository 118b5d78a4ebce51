"""Lorenz's system: designs whose last step is frozen, on a path that is chaotic."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from oracles.programs import BENCHMARKS, load
from seedslib.design import BoundedPolynomial, minimax_synthesis
from seedslib.designed import Memory


@pytest.fixture(scope="module")
def program():
    return load("lorenz")


@pytest.fixture(scope="module")
def table():
    with (BENCHMARKS / "lorenz.csv").open(newline="") as file:
        return {(row["filter"], row["setting"]): row for row in csv.DictReader(file)}


def errors(program, filter, paths, measurements, seed):
    return program.held(filter, paths, measurements, seed)[0][program.SPIN :]


def test_the_flow_is_that_of_the_equations(program):
    """Against a method of Adams and Gear with a tolerance of 1e-10."""
    from scipy.integrate import solve_ivp

    x = np.array([1.509, -1.531, 25.46])
    exact = solve_ivp(lambda t, x: program.slope(x), (0, 0.25), x, rtol=1e-10, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(program.flow(0.0, x), exact, rtol=1e-5)


def test_a_row_of_the_table(program, table):
    """A smaller design of degree two has nearly its error, and the promises are in the table."""
    filter, _ = program.designed(2, 1, 5000, steps=20)
    found = errors(program, filter, 100, 300, 3).mean(axis=0)
    row = table["degree 2", "1"]
    assert abs(found.mean() - float(row["rmse"])) < 4 * found.std() / 10 + 0.02
    long = table["frozen", "1"]
    assert int(long["paths"]) * int(long["measurements"]) == 10**7
    assert float(long["rmse"]) + 4 * float(long["error"]) < 0.54
    assert float(table["degree 3", "1"]["rmse"]) < 0.54


def test_bounds_keep_it_from_running_away(program):
    """The same polynomial on the same paths, with its bounds and without."""
    made = minimax_synthesis(
        program.lorenz(), Memory(1), 0.25 * np.arange(28), paths=5000, seed=1,
        correction=BoundedPolynomial(4),
    )  # fmt: skip
    frozen, last = replace(made, cycle=1), made.fits[-1]
    wide = 1e300 * np.array([[-1.0] * 3, [1.0] * 3])
    free = last._replace(bounded=last.bounded._replace(values=wide, states=wide))
    wild = replace(frozen, fits=(*made.fits[:-1], free))
    kept = errors(program, frozen, 200, 200, 5)
    assert kept.mean() < 0.62
    assert kept.max() < 50
    with np.errstate(all="ignore"):
        assert not np.isfinite(errors(program, wild, 200, 200, 5)).all()
