"""The growth model and the volatility: programs of their committed tables, and the rows."""

import csv
import warnings

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from oracles.programs import BENCHMARKS, load
from seedslib.base import Nodes
from seedslib.design import grid_synthesis, optimal_risk
from seedslib.designed import Memory
from seedslib.filters import GridBayesFilter, KalmanFilter, extended_kalman
from seedslib.models import LinearSystem, Noise, StochasticMap, SwitchingSystem


@pytest.fixture(scope="module")
def growth():
    return load("field_growth")


@pytest.fixture(scope="module")
def volatility():
    return load("field_volatility")


def rows(name):
    with (BENCHMARKS / name).open(newline="") as file:
        return {
            row.pop("row"): {key: float(value) for key, value in row.items() if value}
            for row in csv.DictReader(file)
        }


def test_nodes_that_are_even_design_as_an_axis_does(growth):
    system, times = growth.growth(8.5, 1.0), np.arange(1.0, 6.0)
    axes = {"z": (-30, 30, 61), "y": (-6, 58, 65)}
    wanted = grid_synthesis(system, Memory(1), times, x=(-34, 34, 137), **axes)
    found = grid_synthesis(system, Memory(1), times, x=Nodes(np.linspace(-34, 34, 137)), **axes)
    np.testing.assert_allclose(found.predicted.rms, wanted.predicted.rms, rtol=1e-12)
    # nodes that are dense where the dynamics are steep are worth many even ones
    axes = {"z": (-30, 30, 61), "y": (-6, 58, 257)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        risk = [
            optimal_risk(system, Memory(1), times, x=x, **axes).mse.mean()
            for x in (growth.dense(361, 34), growth.dense(201, 34), (-34, 34, 273))
        ]
    assert abs(risk[1] - risk[0]) < 0.2 * abs(risk[2] - risk[0])


def test_nodes_are_refused_where_a_chain_wants_an_axis():
    x, v, w = sympy.symbols("x v w", real=True)
    move, see = StochasticMap([x], [x / 2 + v], Noise([v])), StochasticMap([x], [x + w], Noise([w]))
    system = SwitchingSystem.from_maps([[move]], [[see]], [(1, [0], [[1]])])
    with pytest.raises(TypeError, match="Axis"):
        grid_synthesis(system, Memory(1), range(3), x=Nodes(np.linspace(-6, 6, 49)))


def test_weights_of_dense_nodes(growth):
    nodes = growth.dense(241, 36)
    for mean, deviation in ((0.0, 0.1), (0.2, 1.0), (-20.0, 1.0)):
        law = norm.pdf(nodes.nodes, mean, deviation)
        assert law @ nodes.weights == pytest.approx(1.0, abs=2e-5)


def test_for_a_line_the_augmented_and_the_minimax_filter_are_kalman_s(growth, monkeypatch):
    monkeypatch.setattr(growth, "moved", lambda x, k: 0.8 * x)
    monkeypatch.setattr(growth, "shown_by", lambda x: 0.5 * x)
    system = LinearSystem(0.8, 1.0, 0.5, 1.0, 0.1, 1.0)
    times = np.arange(9.0)
    data = system.simulate(times, 20_000, 1)
    y = data.measurements.copy()
    y[0] = np.nan
    few = y[..., :50]
    wanted = KalmanFilter(system).run(times, few).mean[1:, 0]
    for given in ((0.5, 2, 0), (1, 0, 0)):
        np.testing.assert_allclose(growth.augmented(few[1:, 0], *given), wanted, atol=1e-12)
    # the first state of these paths is known, and so is that of its filter
    known = LinearSystem(0.8, 1.0, 0.5, 1.0, 0.1, 0.0)
    data = known.simulate(times, 20_000, 1)
    y = data.measurements.copy()
    y[0] = np.nan
    wanted = KalmanFilter(known).run(times, y).mean[1:, 0]
    found = growth.minimax((data.states[1:, 0], y[1:, 0]), y[1:, 0], False)
    assert np.sqrt(((found - wanted) ** 2).mean()) < 0.02


def test_tables_by_phase(growth):
    count = growth.TRANSIENT + growth.TURN
    system, times = growth.growth(8.5, 1.0), np.arange(1.0, count + 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        axes = {"x": growth.dense(41, 34), "z": (-30, 30, 11), "y": (-6, 58, 21)}
        design = grid_synthesis(system, Memory(1), times, **axes)
    made = growth.by_phase(design, 700)
    assert len(made.steps) == 700
    assert all(a is b for a, b in zip(made.steps[:count], design.steps, strict=False))
    number = {id(step): k for k, step in enumerate(design.steps)}
    used = np.array([number[id(step)] for step in made.steps])[growth.TRANSIENT :]
    assert used.min() == growth.TRANSIENT
    turned = 1.2 * (used - np.arange(growth.TRANSIENT, 700))
    assert np.abs((turned + np.pi) % (2 * np.pi) - np.pi).max() < 0.03


def test_rows_of_the_growth_model(growth):
    told = rows("field_growth.csv")
    times = np.arange(1.0, 63.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        risk = optimal_risk(
            growth.growth(float(growth.moved(0.1, 0)), 1.0), Memory(1), times,
            x=growth.dense(161, 34), z=(-30, 30, 241), y=(-6, 58, 257),
        )  # fmt: skip
    wanted = told["risk 1 of 241 nodes"]["predicted"]
    assert risk.mse[20:].mean() == pytest.approx(wanted, abs=2e-6)
    early = np.arange(growth.STEPS + 1.0)
    data = growth.growth(0.1, 0.0).simulate(early, 60, 9)
    y = data.measurements.copy()
    y[0] = np.nan
    found = extended_kalman(growth.growth(0.1, 1.0)).run(early, y).mean
    square = ((found - data.states)[1:, 0] ** 2).mean(axis=0)
    row = told["EKF"]
    assert abs(square.mean() - row["mse"]) < 4 * np.hypot(square.std() / np.sqrt(60), row["error"])
    part = told["one table a step"]
    assert part["above"] + 3 * part["above_error"] < 0.02 * told["Bayes"]["mse"]


def test_rows_of_the_volatility(volatility):
    told = rows("field_volatility.csv")
    for count in (100, 400, 1600):  # the error of particles falls as one over their number
        assert count * told[f"bootstrap {count}"]["e_x"] == pytest.approx(2.67, rel=0.04)
    system = volatility.volatility()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        filter, design, _ = volatility.frozen(system, 1)
    assert design.predicted.rms[-1, 0] ** 2 == pytest.approx(told["order 1"]["predicted"], abs=2e-8)
    data = system.simulate(np.arange(200.0), 200, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        best = GridBayesFilter(system, volatility.STATES).run(data.times, data.measurements).mean
    means = filter.run(data.times, data.measurements).mean
    square = ((means - best) ** 2)[20:, 0].mean(axis=0)
    other = ((means - data.states) ** 2 - (best - data.states) ** 2)[20:, 0].mean(axis=0)
    doubt = np.std(square - other) / np.sqrt(200)
    assert abs((square - other).mean()) < 4 * doubt
    wanted = told["order 1 long"]
    error = np.hypot(square.std() / np.sqrt(200), wanted["error"])
    assert abs(square.mean() - wanted["e_x"]) < 4 * error


def test_a_density_beside_the_estimate(volatility):
    system = volatility.volatility()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        filter, *_ = volatility.frozen(system, 1)
        axes, logs = volatility.predictive(system, 1)
        data = system.simulate(np.arange(120.0), 300, 4)
        exact = GridBayesFilter(system, volatility.STATES).run(data.times, data.measurements).loglik
    total = np.exp(logs[0]).T @ axes[0].weights
    np.testing.assert_allclose(total[20:-20], 1.0, atol=1e-4)
    y = data.measurements[:, 0]
    found = volatility.looked_up(
        axes, logs, y, filter.run(data.times, data.measurements).mean[:, 0]
    )
    loss = (exact[1:] - found)[20:].mean(axis=0)
    mean, error = loss.mean(), loss.std() / np.sqrt(300)
    assert mean > 4 * error  # who forgets is less likely to be right
    e_l = np.abs(1 - np.exp(found - exact[1:])).mean()
    assert e_l == pytest.approx(0.0325, abs=0.002)
    # nearly all of what is lost is of the second order in the distance
    square = np.mean((np.exp(found - exact[1:]) - 1) ** 2)
    assert mean == pytest.approx(square / 2, rel=0.5)
