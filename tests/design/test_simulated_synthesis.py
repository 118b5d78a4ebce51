"""Optimal functions as tables by regression on paths: against grids, sums by hand, and paths."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import grid_risk, grid_synthesis, optimal_risk, simulated_synthesis
from seedslib.designed import Memory, large_order
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

x, q, v, w, r, s, t = sympy.symbols("x q v w r s t")
TIMES = 0.25 * np.arange(5)
GRID = {"x": (-3.5, 3.5, 141), "z": (-3.0, 3.0, 161), "y": (-8.0, 8.0, 97)}
TABLES = {"z": (-2.0, 2.0, 81), "y": (-8.0, 8.0, 97)}


@pytest.fixture(scope="module")
def flip():
    return zoo.flip_process()


@pytest.mark.parametrize(("method", "most"), [("likelihood", 1.006), ("histogram", 1.025)])
def test_risk_comes_close_to_that_of_the_exact_design(flip, method, most):
    """True risks, without random numbers; the histogram needs more paths for less."""
    exact = optimal_risk(flip, large_order(1), TIMES, **GRID).mse
    made = simulated_synthesis(
        flip, large_order(1), TIMES, paths=10_000, seed=1, method=method, **TABLES
    )
    risk = grid_risk(made, **GRID).mse
    assert 1.0 <= risk[1:].mean() / exact[1:].mean() < most
    if method == "histogram":
        assert risk[1:].mean() / exact[1:].mean() > 1.006
    # what the design says of itself, on paths that it has not seen, is true within its error
    for says in (made.predicted, made.held_out):
        apart = np.abs(says.rms[:, 0] - np.sqrt(risk))
        assert (apart < 4 * says.error[:, 0]).all()
    assert not made.predicted.in_sample
    assert (made.design.paths, made.held_out.paths) == (20_000, 1250)


def test_more_paths_bring_estimates_of_a_switching_system_nearer_to_the_exact_ones():
    system, axes = zoo.scalar_switching("A1H"), {"z": (-6, 6, 61), "y": (-16, 18, 69)}
    exact = grid_synthesis(
        system, large_order(1), range(4), x=(-8, 8, 81), z=(-6, 6, 121), y=(-16, 18, 137)
    )
    data = system.simulate(range(4), 4000, 12)
    wanted, apart = exact.run(data.times, data.measurements), []
    for paths in (1000, 16_000):
        made = simulated_synthesis(system, large_order(1), range(4), paths=paths, seed=1, **axes)
        found = made.run(data.times, data.measurements)
        apart.append(((found.mean - wanted.mean)[3] ** 2).mean())
    assert apart[1] < 0.4 * apart[0]
    assert apart[1] < 0.02
    assert (found.modes != wanted.modes).mean() < 0.05
    rate = made.predicted.mode_rate - exact.predicted.mode_rate
    assert (np.abs(rate) < 4 * made.predicted.mode_error + 0.005).all()
    rate = made.held_out.mode_rate - made.predicted.mode_rate
    assert (np.abs(rate) < 4.5 * made.held_out.mode_error).all()


@pytest.mark.parametrize("method", ["likelihood", "histogram"])
@pytest.mark.parametrize("memory", [large_order(1), Memory(1, 0, 1), Memory(0, 1, 1)])
def test_indicators_bring_designs_near_the_optimum_of_their_memory(memory, method):
    system, times = zoo.dependent_switching(), np.arange(3)
    axes = {"z": (-4, 4, 33), "y": (-7, 11, 49)}
    best = optimal_risk(system, memory, times, x=(-6, 6, 49), **axes)
    made = simulated_synthesis(system, memory, times, paths=6000, seed=3, method=method, **axes)
    data = system.simulate(times, 10_000, 4)
    found = made.run(times, data.measurements, indicators=data.indicators)
    square = (found.mean - data.states)[:, 0] ** 2
    error = 4 * square.std(axis=1) / 100
    loose = 1.03 if method == "likelihood" else 1.08
    assert (square.mean(axis=1) < loose * best.mse + error).all()
    assert (square.mean(axis=1) > best.mse - error).all()
    wrong = (found.modes != data.modes).mean(axis=1)
    assert (np.abs(wrong - best.mode_error) < 0.012 + 4 * np.sqrt(wrong / 10_000)).all()
    if not memory.indicators:
        # a missing indicator: worse than seen, better than nothing known
        unseen = np.full((1, 10_000), -1)
        blind = made.run(times[:1], data.measurements[:1], indicators=unseen)
        assert wrong[0] + 0.03 < (blind.modes != data.modes[:1]).mean() < 0.4
        assert ((blind.mean - data.states[:1]) ** 2).mean() < 0.5 * data.states[0].var()


@pytest.mark.parametrize("method", ["likelihood", "histogram"])
def test_functions_are_fitted_and_tried_on_sets_of_paths_in_turn(flip, method):
    """What is predicted is the error on the set after the one that a function was fitted to."""
    made = simulated_synthesis(
        flip,
        Memory(1),
        TIMES[:4],
        paths=300,
        seed=3,
        method=method,
        **TABLES,
    )
    streams = np.random.SeedSequence(3).spawn(3)[:2]
    paths = [flip.simulate(TIMES[:4], 300, s) for s in streams]
    for j in range(4):
        data = paths[(j + 1) % 2]
        found = made.run(TIMES[: j + 1], data.measurements[: j + 1]).mean[j]
        square = (found - data.states[j])[0] ** 2
        np.testing.assert_allclose(made.predicted.rms[j], np.sqrt(square.mean()), rtol=1e-9)
        error = square.std() / np.sqrt(300) / (2 * made.predicted.rms[j])
        np.testing.assert_allclose(made.predicted.error[j], error, rtol=1e-9)
    rms = made.predicted.rms[:, 0]
    np.testing.assert_allclose(made.covariances[:, 0, 0], rms**2, rtol=1e-12)


def test_two_components_and_two_measurements():
    """Unlike components, time, a late start: two steps are a regression on both measurements."""
    times = [3.0, 4.0]
    moves = StochasticMap([x, q], [x + q / 2 + v, q - x / 3 + w], Noise((v, w)))
    sensor = StochasticMap([x, q], [x + r * (t - 2.5), 5 * q + s], Noise((r, s)))
    system = DiscreteSystem(moves, sensor, [1.0, -2.0], [[1.0, 0.2], [0.2, 2.0]])
    z, y = [(-7, 8, 11), (-9, 6, 11)], [(-7, 9, 21), (-45, 30, 61)]
    made = simulated_synthesis(system, Memory(1), times, paths=2000, seed=3, z=z, y=y)
    fresh = system.simulate(times, 4000, 9)
    known = np.concatenate([*fresh.measurements, np.ones((1, 4000))])
    weights = np.linalg.lstsq(known.T, fresh.states[1].T, rcond=None)[0]
    least = np.sqrt(((fresh.states[1] - weights.T @ known) ** 2).mean(axis=1))
    error = made.run(times, fresh.measurements).mean[1] - fresh.states[1]
    assert (np.sqrt((error**2).mean(axis=1)) < 1.12 * least).all()


@pytest.mark.filterwarnings("ignore:held out:UserWarning")
def test_diverged_paths_are_left_out_and_counted():
    system = JumpDiffusion((x,), [x**9 - x], [[1]], [x + v], Noise((v,)), [0], [[0.3]], step=0.05)
    with pytest.warns(UserWarning, match="paths"):
        made = simulated_synthesis(
            system,
            large_order(1),
            [0.0, 0.5],
            paths=2000,
            seed=1,
            y=(-6, 6, 41),
            z=(-3, 3, 41),
        )
    assert 0 < made.design.diverged < 2000
    assert made.design.paths == 4000
    assert np.isfinite(made.steps[1].update.estimate).all()
