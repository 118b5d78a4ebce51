"""Designs without an end: settled, in turn, on a schedule, from files, step by step; or refused."""

import warnings

import numpy as np
import pytest
import sympy
from scipy.linalg import solve_discrete_are

from seedslib import zoo
from seedslib.design import Polynomial, grid_synthesis, stationary, synthesize
from seedslib.designed import Memory, large_order, load, save
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, y, v, w = sympy.symbols("x y v w", real=True)
t = sympy.Symbol("t")
MOVE = np.array([[0.9, 0.3], [-0.2, 0.7]])
LOUD = np.array([0.5, 2.0])
TIMES = np.arange(25.0)
LONG = np.arange(160.0)


@pytest.fixture(scope="module")
def pair():
    """Two unlike components that turn into each other, each with a sensor."""
    moves = [0.9 * x + 0.3 * y + v, -0.2 * x + 0.7 * y + 2 * w]
    noise = sympy.symbols("n1 n2", real=True)
    return DiscreteSystem(
        StochasticMap([x, y], moves, Noise([v, w])),
        StochasticMap([x, y], [x + noise[0], y + noise[1]], Noise(noise, cov=np.diag(LOUD))),
        [0.5, -0.5],
        [[4.0, 1.0], [1.0, 3.0]],
    )


def walk(factor=0.9, loud=1.0):
    """X' = factor X + W, Y = X + V, where the variance of V may be a function of time."""
    return DiscreteSystem(
        StochasticMap([x], [factor * x + w], Noise([w])),
        StochasticMap([x], [x + sympy.sqrt(loud) * v], Noise([v])),
        [0.0],
        [[4.0]],
    )


def riccati(mask):
    """Covariances of the Kalman filter of the pair with the components that are read."""
    cov, found = np.array([[4.0, 1.0], [1.0, 3.0]]), []
    for k, here in enumerate(mask):
        if k:
            cov = MOVE @ cov @ MOVE.T + np.diag([1.0, 4.0])
        look = np.eye(2)[here]
        gain = np.linalg.solve(look @ cov @ look.T + np.diag(LOUD[here]), look @ cov).T
        cov = cov - gain @ look @ cov
        found.append(cov)
    return np.array(found)


def test_settled_design_solves_the_riccati_equation(pair):
    """Frozen gains on a record six times as long: claims, errors, and no growth."""
    made = synthesize(pair, Memory(1), Taylor(), TIMES, paths=20_000, seed=1)
    lasting = stationary(made)
    data = pair.simulate(LONG, 400, 5)
    found = lasting.run(LONG, data.measurements, covariances=True)
    before = solve_discrete_are(MOVE.T, np.eye(2), np.diag([1.0, 4.0]), np.diag(LOUD))
    limit = before - before @ np.linalg.solve(before + np.diag(LOUD), before)
    claimed = np.moveaxis(np.broadcast_to(found.cov.reshape(160, 2, 2, -1), (160, 2, 2, 400)), 3, 1)
    np.testing.assert_allclose(claimed[50:], np.broadcast_to(limit, (110, 400, 2, 2)), atol=0.02)
    square = ((found.mean - data.states)[50:] ** 2).mean(axis=0)
    doubt = 4 * square.std(axis=1) / np.sqrt(400)
    assert (np.abs(square.mean(axis=1) - np.diagonal(limit)) < doubt + 0.01).all()


def test_periodic_schedule_goes_on_in_turn(pair):
    mask = np.zeros((25, 2), dtype=bool)
    mask[:, 0], mask[2::3, 1] = True, True
    made = synthesize(pair, Memory(1), Taylor(), TIMES, paths=20_000, seed=1, measured=mask)
    lasting = stationary(made, cycle=3)
    whole = np.tile(mask[:3], (54, 1))[:160]
    records = pair.simulate(LONG, 1, 3, measured=whole).measurements[..., 0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = lasting.run(LONG, records, covariances=True)
    np.testing.assert_allclose(found.cov, riccati(whole), rtol=0.05, atol=0.03)
    with pytest.raises(ValueError, match="cycle"):
        stationary(made, cycle=2)
    with pytest.raises(ValueError, match="transient"):
        stationary(made, cycle=3, transient=5)
    short = stationary(made, cycle=3, transient=4)
    np.testing.assert_array_equal(short.measured, mask[[0, 1, 2, 3, 22, 23, 24]])


def test_steps_are_the_run_and_forecasts_go_on_after_the_design():
    system, times = zoo.van_der_pol(), 0.25 * np.arange(17)
    made = synthesize(
        system, large_order(1), ExactGaussian(), times, paths=4000, seed=1, nodes=3, step=0.05
    )
    lasting = stationary(made, 0.3, paths=500, step=0.05)
    assert lasting.horizon == np.inf
    grid = np.sort(np.concatenate([0.25 * np.arange(25), 0.25 * np.arange(24) + 0.0625]))
    data = system.simulate(grid, 3, 2, measured=np.arange(0, 49, 2), step=0.05)
    run, state = lasting.run(grid, data.measurements), lasting.initial((3,))
    for j, at in enumerate(grid):
        if j % 2:
            np.testing.assert_allclose(lasting.forecast(state, at).mean, run.mean[j], rtol=1e-12)
        else:
            state = lasting.correct(lasting.predict(state, at), data.measurements[j])
            np.testing.assert_allclose(state.mean, run.mean[j], rtol=1e-12)
    # the last fit of the design, and its first node, a quarter into the interval
    known = state.past.vector
    node = lasting.forecast(state, 6.0625).mean
    np.testing.assert_allclose(node, made.node_fits[-1][0].mean(known), rtol=1e-9)
    ahead = lasting.predict(state, 6.25).mean
    np.testing.assert_allclose(ahead, made.fits[-1].mean(known), rtol=1e-12)


def test_a_short_transient_keeps_few_tables_and_the_predicted_error(tmp_path):
    system, times = zoo.scalar_switching("A1H"), np.arange(17.0)
    axes = {"x": (-9, 9, 61), "z": (-6, 6, 41), "y": (-20, 20, 61)}
    made = grid_synthesis(system, large_order(1), times, **axes)
    small = stationary(made, 0.05, transient=3, paths=2000)
    assert (len(small.steps), small.cycle) == (4, 1)
    assert small.bytes < made.bytes / 4
    np.testing.assert_array_equal(small.times, np.arange(4.0))
    save(small, tmp_path / "small.npz")
    data = system.simulate(np.arange(100.0), 600, 7)
    again = load(tmp_path / "small.npz", system)
    found = again.run(data.times, data.measurements).mean
    np.testing.assert_array_equal(small.run(data.times, data.measurements).mean, found)
    square = ((found - data.states)[20:, 0] ** 2).mean(axis=0)
    doubt = square.std() / len(square) ** 0.5
    assert abs(square.mean() - made.predicted.rms[-1, 0] ** 2) < 4 * doubt


def test_what_does_not_settle_or_runs_away_is_refused():
    young = synthesize(walk(0.99), large_order(1), Taylor(), np.arange(6.0), paths=5000, seed=1)
    with pytest.raises(ValueError, match="tolerance"):
        stationary(young, 0.001)
    # a state that grows for ever: affine forecasts follow it, bounded ones lose it
    options = {"paths": 8000, "seed": 1}
    wild = synthesize(walk(1.2), large_order(1), Taylor(), np.arange(17.0), **options)
    assert stationary(wild, 0.05).cycle == 1
    bent = synthesize(
        walk(1.2), large_order(1), Taylor(), np.arange(17.0), predictor=Polynomial(3, 0), **options
    )
    with pytest.raises(ValueError, match="filter"):
        stationary(bent, 3.0)


def test_filter_of_modes_goes_on_step_by_step_as_its_run():
    system, times = zoo.scalar_switching(), np.arange(8.0)
    made = synthesize(system, large_order(1), Taylor(), times, paths=3000, seed=2)
    lasting = stationary(made, 1.0, cycle=2, paths=200)
    data = system.simulate(np.arange(14.0), 5, 4)
    given = {} if data.indicators is None else {"indicators": data.indicators}
    found, state = lasting.run(data.times, data.measurements, **given), lasting.initial((5,))
    for k, t in enumerate(data.times):
        shown = () if data.indicators is None else (data.indicators[k],)
        state = lasting.correct(lasting.predict(state, t), data.measurements[k], *shown)
        np.testing.assert_allclose(state.mean, found.mean[k], rtol=1e-12)
    with pytest.raises(ValueError, match=r"^t: "):
        lasting.predict(state, 15.0)
