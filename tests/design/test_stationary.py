"""Designs without an end: settled or refused with numbers, in turn, from files, step by step."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import (
    Polynomial,
    binned_synthesis,
    grid_synthesis,
    stationary,
    synthesize,
)
from seedslib.designed import Memory, large_order, load, save
from seedslib.filters import KalmanFilter, extended_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap

x, v, w = sympy.symbols("x v w", real=True)
t = sympy.Symbol("t")


def walk(factor=0.9, loud=1.0):
    """X' = factor X + W, Y = X + V, where the variance of V may be a function of time."""
    move = StochasticMap([x], [factor * x + w], Noise([w]))
    return DiscreteSystem(
        move, StochasticMap([x], [x + sympy.sqrt(loud) * v], Noise([v])), [0.0], [[4.0]]
    )


def riccati(factor, loud, count):
    """Variances of the Kalman filter after each measurement."""
    cov, found = 4.0, []
    for k in range(count):
        cov = cov if not k else factor**2 * cov + 1.0
        cov -= cov**2 / (cov + loud[k % len(loud)])
        found.append(cov)
    return np.array(found)


def test_a_settled_design_is_the_stationary_kalman_filter():
    """Frozen gains over a record twenty times as long; errors against the Riccati equation."""
    system, times = walk(), np.arange(25.0)
    lasting = stationary(synthesize(system, large_order(1), Taylor(), times, paths=50_000, seed=1))
    long = np.arange(500.0)
    data = system.simulate(long, 400, 5)
    found = lasting.run(long, data.measurements, covariances=True)
    kalman = KalmanFilter(LinearSystem([[0.9]], [[1.0]], [[1.0]], [[1.0]], [0.0], [[4.0]]))
    wanted = kalman.run(long, data.measurements)
    limit = riccati(0.9, [1.0], 500)[-1]
    np.testing.assert_allclose(found.cov[100:, 0, 0], limit, rtol=0.01)
    assert np.abs(found.mean - wanted.mean)[30:].max() < 0.06
    square = ((found.mean - data.states)[100:, 0] ** 2).mean(axis=0)
    assert abs(square.mean() - limit) < 4 * square.std() / 20 + 0.005 * limit


def test_step_by_step_is_the_run_and_forecasts_go_on():
    system, times = zoo.van_der_pol(), 0.25 * np.arange(25)
    made = synthesize(system, large_order(1), ExactGaussian(), times, paths=8000, seed=1, nodes=3)
    lasting = stationary(made, 0.2, paths=500)
    assert lasting.horizon == np.inf
    grid = np.sort(np.concatenate([0.25 * np.arange(41), 0.25 * np.arange(40) + 0.0625]))
    data = system.simulate(grid, 3, 2, measured=np.arange(0, 81, 2))
    run = lasting.run(grid, data.measurements)
    state = lasting.initial((3,))
    for j, at in enumerate(grid):
        if j % 2:
            np.testing.assert_allclose(lasting.forecast(state, at).mean, run.mean[j], rtol=1e-12)
        else:
            state = lasting.correct(lasting.predict(state, at), data.measurements[j])
            np.testing.assert_allclose(state.mean, run.mean[j], rtol=1e-12)
    # by hand: the last fit of the design, and its first node, a quarter into the interval
    u = state.past.vector
    np.testing.assert_allclose(
        lasting.forecast(state, 10.0625).mean, made.node_fits[-1][0].mean(u), rtol=1e-9
    )
    np.testing.assert_allclose(
        lasting.predict(state, 10.25).mean, made.fits[-1].mean(u), rtol=1e-12
    )
    with pytest.raises(ValueError, match=r"next measurement time 10\.25, got 10\.3"):
        lasting.predict(state, 10.3)
    with pytest.raises(
        ValueError,
        match="times: wanted at most 6, where the design ends, got 10",
    ):
        made.run(grid, data.measurements)


def test_steps_in_turn():
    """A sensor that is loud every second time: two gains in turn, and none that serves both."""
    loud = [1.0, 25.0]
    system = walk(loud=13 - 12 * sympy.cos(sympy.pi * t))
    made = synthesize(system, large_order(1), Taylor(), np.arange(25.0), paths=50_000, seed=1)
    with pytest.raises(ValueError, match=r"change by at most 0\.02 .* over the last 6 steps"):
        stationary(made)
    lasting = stationary(made, cycle=2)
    assert "the last 2 steps serve all in turn" in str(lasting)
    long = np.arange(200.0)
    data = system.simulate(long, 500, 5)
    found = lasting.run(long, data.measurements, covariances=True)
    np.testing.assert_allclose(found.cov[50:, 0, 0, 0], riccati(0.9, loud, 200)[50:], rtol=0.02)
    exact = extended_kalman(system).run(long, data.measurements)
    assert np.abs(found.mean - exact.mean)[30:].max() < 0.15


def test_few_steps_are_kept(tmp_path):
    """A short transient, a file of the same numbers, and the error that was predicted."""
    times = np.arange(25.0)
    made = grid_synthesis(
        zoo.scalar_switching("A1H"), large_order(1), times,
        x=(-9, 9, 73), z=(-6, 6, 41), y=(-20, 20, 81),
    )  # fmt: skip
    small = stationary(made, transient=3, paths=4000)
    assert (len(small.steps), small.cycle) == (4, 1)
    assert small.bytes < made.bytes / 6
    np.testing.assert_array_equal(small.predicted.rms[-1], made.predicted.rms[-1])
    np.testing.assert_array_equal(small.times, np.arange(4.0))
    save(small, tmp_path / "small.npz")
    data = zoo.scalar_switching("A1H").simulate(np.arange(300.0), 300, 7)
    again = load(tmp_path / "small.npz")
    a, b = (f.run(data.times, data.measurements) for f in (small, again))
    np.testing.assert_array_equal(a.mean, b.mean)
    square = ((a.mean - data.states)[50:, 0] ** 2).mean(axis=0)
    doubt = square.std() / len(square) ** 0.5
    assert abs(square.mean() - made.predicted.rms[-1, 0] ** 2) < 4 * doubt
    with pytest.raises(ValueError, match="loaded without"):
        stationary(again)


def test_other_kinds_go_on(tmp_path):
    system, times = walk(), np.arange(17.0)
    lasting = stationary(
        synthesize(
            system, large_order(2), Taylor(), times, predictor=Polynomial(2, 0), paths=20_000,
            seed=1,
        ),
        0.05,
    )  # fmt: skip
    save(lasting, tmp_path / "polynomial.npz")
    again = load(tmp_path / "polynomial.npz", system)
    assert again.cycle == 1
    data = system.simulate(np.arange(80.0), 5, 3)
    a, b = (f.run(data.times, data.measurements).mean for f in (lasting, again))
    np.testing.assert_array_equal(a, b)
    cells = stationary(
        binned_synthesis(system, large_order(1), times, paths=100_000, seed=1, bins=20), 0.2
    )
    found = cells.run(data.times, data.measurements).mean
    assert np.sqrt(((found - a) ** 2).mean()) < 0.25


def test_what_does_not_settle_or_runs_away_is_refused():
    young = synthesize(walk(0.99), large_order(1), Taylor(), np.arange(6.0), paths=5000, seed=1)
    with pytest.raises(ValueError, match=r"tolerance: wanted estimates .* got 0\.\d"):
        stationary(young, 0.001)
    # a state that grows for ever: affine forecasts follow it, bounded ones lose it
    wild = synthesize(walk(1.2), large_order(1), Taylor(), np.arange(17.0), paths=20_000, seed=1)
    assert stationary(wild, 0.05).cycle == 1
    bent = synthesize(
        walk(1.2), large_order(1), Taylor(), np.arange(17.0), predictor=Polynomial(3, 0),
        paths=20_000, seed=1,
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"grows by 7\.\d+e\+03 ± \S+ of itself over 16 steps"):
        stationary(bent, 3.0)


def test_bad_arguments():
    made = synthesize(walk(), large_order(1), Taylor(), np.arange(4.0), paths=2000, seed=1)
    with pytest.raises(ValueError, match=r"times: wanted a design of 5 steps or more, .* got 3"):
        stationary(made, cycle=2)
    with pytest.raises(ValueError, match="tolerance: wanted a positive number, got 0"):
        stationary(made, 0)
    with pytest.raises(TypeError, match="filter: wanted a filter with a design"):
        stationary(extended_kalman(walk()))
    with pytest.raises(ValueError, match="cycle: wanted 0 to 3 of the steps, got 4"):
        type(made)(**{f: getattr(made, f) for f in made.__dataclass_fields__} | {"cycle": 4})
    with pytest.raises(ValueError, match="transient"):
        stationary(made, 5.0, transient=7)
    assert Memory(1).depth == 1
