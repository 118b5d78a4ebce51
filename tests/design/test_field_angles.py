"""The random sine and the bearings: programs of their committed tables, and the rows."""

import csv
import importlib

import numpy as np
import pytest
import sympy
from scipy.linalg import expm

from oracles.programs import BENCHMARKS
from seedslib.filters import CovarianceFilter, KalmanFilter, ParticleFilter, extended_kalman
from seedslib.linearization import ExactGaussian, Unscented
from seedslib.models import LinearSystem


@pytest.fixture(scope="module")
def programs():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield tuple(importlib.import_module(f"field_{name}") for name in ("sine", "bearings"))


@pytest.fixture(scope="module")
def sine(programs):
    return programs[0]


@pytest.fixture(scope="module")
def bearings(programs):
    return programs[1]


def rows(name):
    with (BENCHMARKS / name).open(newline="") as file:
        return {
            row.pop("row"): {key: float(value) for key, value in row.items() if value}
            for row in csv.DictReader(file)
        }


def test_second_derivatives_by_differences(sine, bearings):
    at, h = np.array([0.4, -0.7, 0.0, 0.0]), 1e-4
    for part in bearings.SIGHTS:
        value = sympy.lambdify([bearings.STATE], part)
        wanted = [
            (value(at + s * e) - 2 * value(at) + value(at - s * e)) / s**2
            for e, s in ((np.eye(4)[0], h), (np.eye(4)[1], h))
        ]
        here = dict(zip(bearings.STATE, at, strict=True))
        right, printed = (
            np.array(rule.hessian(part, bearings.STATE).subs(here), dtype=float)
            for rule in (sine.SecondOrder(), bearings.Misprinted())
        )
        np.testing.assert_allclose(np.diag(right)[:2], wanted, atol=1e-5)
        assert np.abs(np.diag(printed)[:2] - wanted).min() > 0.05
        assert right[0, 1] == printed[0, 1]


def test_second_order_is_right_to_second_order(sine):
    """Halving the deviations takes the distance from exact means down by sixteen."""
    system = sine.sine(np.eye(3))
    mean = np.array([0.7, 10.0, 1.2])
    cov = np.array([[0.04, 0.01, 0.02], [0.01, 0.5, 0.0], [0.02, 0.0, 0.09]])
    second, exact = (rule.moments(system.sensor) for rule in (sine.SecondOrder(), ExactGaussian()))
    for pick in (lambda m: m.mean, lambda m: m.cov - 1):
        apart = [
            abs(pick(second(0.0, mean, c)) - pick(exact(0.0, mean, c))).item()
            for c in (cov, cov / 4)
        ]
        assert 10 < apart[0] / apart[1] < 64


def test_particles_of_the_angle_are_those_of_the_state(sine):
    times, runs = np.arange(61.0), 6
    system = sine.sine(0.1 * np.eye(3))
    y = sine.late(system.simulate(times, runs, 3).measurements[1:])
    found = sine.rao_blackwell(y[1:, 0], 0.1, 2000, 1)
    wanted = ParticleFilter(system, 8000).run(times, y, seed=2)
    deviation = np.sqrt(np.einsum("kiir->kir", wanted.cov))
    # both are draws
    assert np.abs((found[:, :3] - wanted.mean[1:]) / deviation[1:]).max() < 0.25


def test_noises_in_the_points_change_little_where_the_dynamics_are_linear(sine):
    times = np.arange(81.0)
    system = sine.sine(0.5 * np.eye(3))
    y = sine.late(system.simulate(times, 20, 3).measurements[1:])
    plain, other = (
        CovarianceFilter(system, Unscented(alpha, 2.0, 0.0)).run(times, y).mean[1:]
        for alpha in (0.5, 1.0)
    )
    found = sine.augmented(y[1:, 0], 0.5, 0.5, 2.0, -4.0)
    apart = [np.sqrt(((means - found) ** 2).mean()) for means in (plain, other)]
    assert apart[0] < 0.2 * apart[1]


def test_covariances_that_all_paths_share_are_their_mean(sine):
    system = LinearSystem([[1, 0.1], [0, 0.9]], 0.1 * np.eye(2), [[1, 0]], 0.5, [0, 1], np.eye(2))
    times = np.arange(12.0)
    y, others = (
        system.simulate(times, count, seed).measurements for count, seed in ((5, 1), (7, 2))
    )
    found = sine.averaged(KalmanFilter(system), times, y, others)
    np.testing.assert_allclose(found, KalmanFilter(system).run(times, y).mean, atol=1e-12)


def test_the_target_by_exponentials_of_matrices(bearings):
    place, bearing = bearings.target(1, 4)
    rng, turn = np.random.default_rng(4), np.zeros(bearings.STEPS)
    for start, stop in ((50, 100), (200, 250), (350, 400)):
        turn[start - 1 : stop] = np.pi / 2 / 51 + 0.0001 * rng.standard_normal((51, 1))[:, 0]
    x, path = np.array([0.0, 0.0, 1.0, 0.0]), []
    for angle in turn:
        rate = np.zeros((4, 4))
        rate[0, 2] = rate[1, 3] = bearings.DT
        rate[2, 3], rate[3, 2] = angle, -angle
        x = expm(rate) @ x
        path.append(x[:2])
    np.testing.assert_allclose(place[..., 0], path, atol=1e-10)
    for i, (a, b) in enumerate(bearings.SENSORS):
        rest = bearing[:, i, 0] - np.arctan2(place[:, 1, 0] - b, place[:, 0, 0] - a)
        rest = (rest + np.pi) % (2 * np.pi) - np.pi
        assert rest.std() == pytest.approx(0.05, rel=0.15)
    assert np.abs(bearing).max() <= np.pi


def test_rows_of_both_tables(sine, bearings):
    told = rows("field_sine.csv")["EKF1"]
    times, count = sine.TIMES, 60
    data = sine.sine(np.zeros((3, 3))).simulate(times[1:], count, 9)
    found = (
        extended_kalman(sine.sine(3 * np.eye(3))).run(times, sine.late(data.measurements)).mean[1:]
    )
    error = np.sqrt(((sine.with_signal(found) - sine.with_signal(data.states)) ** 2).mean(axis=0))
    for part, values in zip(("theta", "omega", "a", "signal"), error, strict=True):
        doubt = np.hypot(values.std() / np.sqrt(count), told[f"{part}_error"])
        assert abs(values.mean() - told[part]) < 4 * doubt
    told = rows("field_bearings.csv")["EKF1"]
    place, bearing = bearings.target(count, 9)
    means = extended_kalman(bearings.tracked(10.0)).run(times, sine.late(bearing)).mean
    values = bearings.errors(means, place)
    doubt = np.hypot(values.std() / np.sqrt(count), told["error"])
    assert abs(values.mean() - told["rmse"]) < 4 * doubt
