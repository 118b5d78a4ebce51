"""The projection, minimax and sweep pages: programs of their committed tables, and the rows."""

import csv
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from oracles.programs import load
from seedslib.filters import GridBayesFilter
from seedslib.models import PlaneChain

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def plane():
    return load("field_projection")


@pytest.fixture(scope="module")
def minimax():
    return load("field_minimax")


def test_the_law_of_the_oscillator_and_normal_laws(plane):
    axes = [(-6.5, 6.5, 53), (-8.0, 8.0, 53)]
    chain = PlaneChain(plane.oscillator(1.0), axes, 0.05)
    start = plane.first_law(chain.values)[None, :, None]
    mean, cov = plane.moments(chain.values, start)
    np.testing.assert_allclose(mean[0, :, 0], 0, atol=1e-12)
    np.testing.assert_allclose(cov[0, :, :, 0], [[2, -1], [-1, 2]], atol=1e-5)
    # two normal laws of one covariance: the distance in closed form
    given = np.array([[1.5, 0.4], [0.4, 0.8]])
    a, b = np.array([0.3, -0.2]), np.array([-0.5, 1.0])
    laws = [plane.normal_laws(chain.values, m[None, :, None], given[None]) for m in (a, b)]
    closed = np.sqrt(1 - np.exp(-(a - b) @ np.linalg.solve(given, a - b) / 8))
    assert plane.hellinger(*laws)[0, 0] == pytest.approx(closed, abs=1e-6)


def test_projection_is_exact_within_its_family(plane):
    filter = plane.Projection(0.7, axes=((-6.5, 6.5, 41), (-8.0, 8.0, 41)))
    theta, law = filter.start(), plane.first_law(filter.values)
    np.testing.assert_allclose(
        filter.known @ filter.law(theta)[:, 0], filter.known @ law, atol=1e-11
    )
    # a measurement is Bayes' formula on the nodes
    y = np.array([[0.4], [-1.1]])
    seen = filter.law(theta)[:, 0] * norm.pdf(y, np.sin(filter.values), 0.7).prod(axis=0)
    found = filter.law(filter.see(theta, y))[:, 0]
    np.testing.assert_allclose(found, seen / seen.sum(), atol=1e-14)
    # and the means of the functions move as those of the law do, while it is of the family
    chain = PlaneChain(plane.oscillator(0.7), [(-6.5, 6.5, 41), (-8.0, 8.0, 41)], 0.005)
    moved = filter.known @ chain.move(filter.law(theta), 0.0, 0.02)[:, 0]
    ours = filter.known @ filter.law(filter.move(theta, 0.02))[:, 0]
    still = filter.known @ filter.law(theta)[:, 0]
    change = np.abs(moved - still)
    assert (np.abs(ours - moved)[change > 1e-4] < 0.03 * change[change > 1e-4]).all()
    assert (change > 1e-4).sum() > 5


def test_the_design_begins_with_the_law_of_the_first_measurement(plane):
    system = plane.seen_first(1.0)
    late = system.simulate(plane.TIMES[1:], 5000, 1).states[0]
    early = plane.oscillator(1.0).simulate(plane.TIMES, 5000, 2).states[1]
    assert np.abs(late.mean(axis=1)).max() < 4 * np.sqrt(2.5 / 5000)
    np.testing.assert_allclose(np.cov(late), system.cov0, atol=0.17)
    np.testing.assert_allclose(np.cov(early), system.cov0, atol=0.17)


def test_models_of_the_minimax_program(minimax):
    with np.errstate(divide="ignore"):
        np.testing.assert_allclose(minimax.thrown(np.array([8.0, -1e-9, 0.0])), [0.5, -5, 5])
    x = np.array([2.9, 3.0, 6.9, 7.0])
    np.testing.assert_allclose(minimax.line(x, 2), [0.9, 1.5, 1.5, 2.5])
    problem = minimax.switching()
    points = np.linspace(-400, 400, 40_001)
    density = np.exp(minimax.mixed(0.0, points[None], np.full((1, points.size), 7.0)))
    sensor = problem.system.sensor.conditional
    wanted = density @ points / density.sum(), density @ points**2 / density.sum()
    mean, cov = (part(0.0, np.array([[7.0]])).ravel()[0] for part in (sensor.mean, sensor.cov))
    assert mean == pytest.approx(wanted[0], rel=1e-9)
    assert cov == pytest.approx(wanted[1] - wanted[0] ** 2, rel=1e-6)
    # what is drawn is of that law
    v = np.random.default_rng(1).standard_normal((2, 40_000))
    drawn = minimax.through(0.0, np.full((1, 40_000), 7.0), v)[0]
    assert abs(drawn.mean() - mean) < 4 * np.sqrt(cov / 40_000)
    assert drawn.var() == pytest.approx(cov, rel=0.03)


def test_functions_of_the_minimax_program(minimax):
    # one channel alone: the averaged correction is Kalman's
    v, ahead, y = 5.0, np.array([[1.0]]), np.array([[9.0]])
    shares = minimax.SHARES.copy()
    minimax.SHARES[:] = [0, 1, 0]
    found = minimax.weighed(v)(0.0, ahead, y)
    minimax.SHARES[:] = shares
    np.testing.assert_allclose(found, v / (v + 1) * (y - ahead))
    # near the mean of a range's own law, far from the others, the prediction is its line
    np.testing.assert_allclose(minimax.averaged(0, np.array([[25.0]])), 0.7 * 25 + 3, rtol=1e-6)


def test_a_row_of_the_minimax_table(minimax):
    with (ROOT / "benchmarks/field_minimax.csv").open(newline="") as file:
        rows = {(r["problem"], r["row"]): r for r in csv.DictReader(file)}
    told = rows["sampled regression", "minimax residual"]
    problem = minimax.regression()
    times = minimax.TIMES[:15]
    data = problem.system.simulate(times, 300, 9)
    filter = minimax.minimax_synthesis(problem.system, minimax.Memory(1), times, paths=8000, seed=2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        best = GridBayesFilter(problem.system, (-8.05, 31.95, 201)).run(times, data.measurements)
    found = filter.run(times, data.measurements)
    far = ((found.mean - best.mean)[10:, 0] ** 2).mean(axis=0)
    error = np.hypot(far.std() / np.sqrt(300), float(told["far_error"]))
    assert abs(far.mean() - float(told["far"])) < 4 * error
    predicted = (filter.predicted.rms[10:, 0] ** 2).mean()
    assert predicted == pytest.approx(float(told["predicted"]), rel=0.04)


def test_points_of_the_sweep():
    with (ROOT / "sweeps/field_growth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    point = {(r["sensor"], r["process"], r["order"]): r for r in rows}
    assert len(rows) == len(point) == 24
    growth = load("field_growth")
    # the state and the order one's promise at the published pair, by another program
    told, times = point["1.0", "1.0", "1"], np.arange(1.0, 31.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        risk = growth.optimal_risk(
            growth.growth(float(growth.moved(0.1, 0)), 1.0), growth.Memory(1), times,
            x=growth.dense(161, 34), z=(-26, 26, 79), y=(-5, 58, 73),
        )  # fmt: skip
    assert risk.mse[10:].mean() == pytest.approx(float(told["predicted"]), rel=0.02)
    rng, x, square = np.random.default_rng(4), None, []
    x = growth.moved(0.1, 0) + rng.standard_normal(4000)
    for k in range(1, 31):
        square.append(x**2)
        x = growth.moved(x, k) + rng.standard_normal(4000)
    each = np.mean(square[10:], axis=0)
    error = each.std() * np.sqrt(1 / 400 + 1 / 4000)
    assert abs(each.mean() - float(told["state"])) < 4 * error
    # the runs of a point are common to its orders
    for (sensor, process, _), row in point.items():
        assert row["least"] == point[sensor, process, "1"]["least"]
