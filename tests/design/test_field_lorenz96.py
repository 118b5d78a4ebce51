"""Lorenz-96: the peers of the program held against linear algebra, and the rows of its table."""

import csv

import numpy as np
import pytest
import sympy

from oracles.programs import BENCHMARKS, load
from seedslib.filters import CovarianceFilter
from seedslib.linearization import Taylor, Unscented
from seedslib.models import StochasticMap


@pytest.fixture(scope="module")
def program():
    return load("field_lorenz96")


def test_the_flow_is_that_of_the_equations(program):
    """Against a method with a tolerance of 1e-10."""
    from scipy.integrate import solve_ivp

    x = program.attractor(np.random.default_rng(1), 1)[:, 0]
    right = [
        (x[(i + 1) % 10] - x[i - 2]) * x[i - 1] - x[i] + 8 for i in range(10)
    ]  # as it is printed
    np.testing.assert_allclose(program.slope(x), right, rtol=1e-13)
    exact = solve_ivp(lambda t, x: program.slope(x), (0, 0.05), x, rtol=1e-10, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(program.flow(0.0, x), exact, atol=2e-3)


def test_differences_are_derivatives(program):
    """Moments of the extended filter without formulas are those with them."""
    x = sympy.symbols("x:2", real=True)
    map = StochasticMap(x, [x[0] * x[1], sympy.sin(x[0]) + x[1] ** 3])
    mean, cov = np.array([0.4, -1.2]), np.array([[0.5, 0.2], [0.2, 0.3]])
    wanted = Taylor().moments(map)(0.0, mean, cov)
    found = program.Differences().moments(map)(0.0, mean, cov)
    for a, b in zip(found, wanted, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_one_component_after_another_is_all_at_once(program):
    """The ensemble's correction is that of Kalman with the covariance of the members."""
    y = np.random.default_rng(3).standard_normal((1, 5, 2))
    found = program.ensemble(y, 20, 1.5, seed=4)[0]
    members = np.sqrt(0.001) * np.random.default_rng(4).standard_normal((10, 20, 2))
    for run in range(2):
        cov, mean = 1.5 * np.cov(members[..., run]), members[..., run].mean(axis=1)
        gain = np.linalg.solve(cov[::2, ::2] + 2.25 * np.eye(5), cov[::2]).T
        wanted = mean + gain @ (y[0, :, run] - mean[::2])
        np.testing.assert_allclose(found[:, run], wanted, atol=1e-14)


def test_particles_that_stand_still(program, monkeypatch):
    """A constant with noise of its own variance: means of the measurements and of zero."""
    monkeypatch.setattr(program, "VARIANCE", 0.001)
    monkeypatch.setattr(program, "flow", lambda t, x: x)
    y = 0.03 * np.random.default_rng(5).standard_normal((2, 5, 1))
    for share in (0.0, 2.0):  # never resampled, always
        found = program.jittered(y, 20_000, share, 0.0)
        np.testing.assert_allclose(found[0, ::2], y[0] / 2, atol=2e-3)
        np.testing.assert_allclose(found[1, ::2], y.sum(axis=0) / 3, atol=3e-3)
        assert np.abs(found[:, 1::2]).max() < 3e-3  # of what is not seen nothing is learned


def test_a_long_span_is_the_whole_filter(program):
    data = program.lorenz96().simulate(program.TIMES[:8], 2, 6)
    filter = CovarianceFilter(program.lorenz96(), Unscented(1.0, 2.0, 0.0))
    wanted = filter.run(data.times, data.measurements).mean
    average = 0.4 * np.eye(10)
    found = program.forgetful(data.measurements, 20, average)
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    short = program.forgetful(data.measurements, 1, average)
    assert np.abs(short - wanted).max() > 1e-2


def test_a_bounded_correction(program):
    """What the gain multiplies does not grow with the forecast."""
    x, y = np.full((10, 1), 1e6), np.full((5, 1), -1e6)
    zeta = program.scheduled(2, 2)
    assert len(zeta(0.0, x, y)) == 5 * (1 + 5 + 15)
    assert np.abs(zeta(0.0, x, y)).max() <= 6.0 * 2.2**2 + 1e-9
    level = (3.0 - program.CLIMATE[0]) / program.CLIMATE[1]
    found = program.scheduled(1, 1)(0.0, np.full((10, 1), 3.0), np.full((5, 1), 4.0))
    np.testing.assert_allclose(found[:, 0], [1] * 5 + [level] * 15)


def test_rows_of_the_table():
    with (BENCHMARKS / "field_lorenz96.csv").open(newline="") as file:
        rows = {f"{r['filter']} {r['setting']}": float(r["rmse"]) for r in csv.DictReader(file)}
    assert rows["unscented inflation 1.02"] < 0.4
    assert rows["extended inflation 1.0"] > rows["climate "]
    gains = [
        next(v for k, v in rows.items() if k.startswith(f"gain {degree}")) for degree in (0, 1, 2)
    ]
    assert gains == sorted(gains, reverse=True)
    spans = [rows[f"span {span} "] for span in (1, 2, 4, 8)]
    assert spans == sorted(spans, reverse=True)
    assert spans[-1] < 0.5 < min(gains)
