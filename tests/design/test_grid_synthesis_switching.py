"""Exact designs of switching systems on grids: against loops over all events, limits, paths."""

from itertools import product

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from seedslib import zoo
from seedslib.base import Axis
from seedslib.design import grid_risk, grid_synthesis, optimal_risk, synthesize
from seedslib.designed import Memory, finite_memory, large_order
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

x, v, w, t = sympy.symbols("x v w t")
FIRST = [(0.6, 0.3, 1.2), (0.4, -0.5, 0.7)]
MOVES = [(0.4, 0.9, 0.6), (-0.7, 0.5, 0.8)]
SHOWS = [(0.0, 1.0, 0.7), (1.0, 0.7, 1.1)]
INDICATOR = np.array([[0.8, 0.2], [0.3, 0.7]])


def leave(state, m=np):
    """Probability of leaving mode 0; mode 1 is left with probability 0.3."""
    return 0.35 - 0.3 * m.exp(-((state - 1) ** 2) / 8)


def reference():
    """Two unlike modes, a switch that depends on the state, time, and an indicator."""
    return SwitchingSystem(
        (x,),
        [[a + c * x + s * v * (1 + t / 9)] for a, c, s in MOVES],
        Noise((v,)),
        [[1 - leave(x, sympy), leave(x, sympy)], [0.3, 0.7]],
        [[b + d * x + s * w * (1 + t / 7)] for b, d, s in SHOWS],
        Noise((w,)),
        [(chance, [mean], [[var]]) for chance, mean, var in FIRST],
        indicator=INDICATOR,
    )


def transition(time, mode, state):
    """Probabilities of moves on the nodes, [next, now]."""
    found = np.empty((len(state), len(state)))
    for column, (i, r) in enumerate(zip(mode, state, strict=True)):
        a, c, s = MOVES[i]
        go = leave(r) if i == 0 else 0.7
        moved = norm.pdf(state, a + c * r, s * (1 + time / 9))
        found[:, column] = moved * np.where(mode == 1, go, 1 - go)
    return found / found.sum(axis=0)


def likelihood(time, mode, state, y):
    """Masses of indicator and measurement, by (j, number of y)."""
    b, d, s = np.array(SHOWS)[mode].T
    seen = np.array([norm.pdf(value, b + d * state, s * (1 + time / 7)) for value in y])
    seen[[0, -1]] /= 2  # the trapezium rule
    seen /= seen.sum(axis=0)
    return {(j, k): row * INDICATOR[mode, j] for j in (0, 1) for k, row in enumerate(seen)}


def by_loops(memory, nodes, y, z, times):
    """(4.6) to (4.8) one event at a time; the memory is a tuple of blocks, newest first.

    Returns for each step the estimates and modes by (j, y, memory), and the risk. Indicator -1
    stands for a missing one.
    """
    mode, state = np.repeat([0, 1], len(nodes)), np.tile(nodes, 2)
    start = np.concatenate([norm.pdf(nodes, mean, var**0.5) for _, mean, var in FIRST])
    for i, (chance, *_) in enumerate(FIRST):
        start[mode == i] *= chance / start[mode == i].sum()
    joint, found = {(): start}, []
    for time in times:
        beta = likelihood(time, mode, state, y)
        new, best, mse, right = {}, {}, 0.0, 0.0
        for (u, dist), (j, b) in product(joint.items(), beta):
            mass = dist * beta[j, b]
            for seen, same in ((j, mass), (-1, dist * (beta[0, b] + beta[1, b]))):
                if (total := same.sum()) > 1e-13:
                    prob = same[mode == 1].sum() / total
                    best[seen, b, u] = same @ state / total, int(prob > 0.5), prob, total
            if (j, b, u) not in best:
                continue
            mean, decided, *_ = best[j, b, u]
            mse += mass @ (state - mean) ** 2
            right += mass[mode == decided].sum()
            told = (j,) * memory.indicators
            blocks = [((*told, b), 1.0)]
            if memory.estimates:
                place = np.clip((mean - z[0]) / (z[1] - z[0]), 0, len(z) - 1)
                low = min(int(place), len(z) - 2)
                shares = (low, 1 + low - place), (low + 1, place - low)
                blocks = [((decided, *told, node), share) for node, share in shares]
            for block, share in blocks:
                cell = (block, *u)[: memory.depth]
                new[cell] = new.get(cell, 0.0) + share * mass
        found.append((best, mse, 1 - right))
        joint = {u: transition(time, mode, state) @ dist for u, dist in new.items()}
    return found


@pytest.mark.filterwarnings("ignore:[xyz]. :UserWarning")  # the axes are short and coarse
@pytest.mark.parametrize(
    ("memory", "steps"),
    [
        (large_order(1), 4),
        (large_order(2), 3),
        (finite_memory(2), 3),
        (Memory(1, 0, 1), 3),
        (Memory(0, 1, 1), 3),
    ],
)
def test_recursion_equals_loops_over_all_events(memory, steps):
    axes = {"x": Axis(-3.0, 3.0, 13), "z": Axis(-2.0, 2.0, 4), "y": Axis(-5.0, 6.0, 6)}
    times = np.arange(2.0, 2.0 + steps)
    filter = grid_synthesis(reference(), memory, times, **axes)
    again = grid_risk(filter, **axes)
    found = by_loops(memory, *(axes[name].nodes for name in "xyz"), times)
    wanted = np.array([[mse, wrong] for _, mse, wrong in found])
    ours = np.stack([filter.predicted.rms[:, 0] ** 2, filter.predicted.mode_rate], axis=1)
    np.testing.assert_allclose(ours, wanted, atol=1e-9)
    np.testing.assert_allclose(np.stack([again.mse, again.mode_error], axis=1), wanted, atol=1e-9)
    compared = 0
    for (best, _, _), step in zip(found, filter.steps, strict=True):
        shown = step.update
        assert shown.mode.shape == tuple(axis.count for axis in shown.axes)
        for (j, b, u), (mean, mode, prob, mass) in best.items():
            if mass < 1e-6:
                continue  # events of probability 1e-15 are left out: digits of rare ones are lost
            place = (j if j >= 0 else 2, b, *(part for block in u for part in block))
            assert shown.estimate[(0, *place)] == pytest.approx(mean, abs=1e-8)
            if abs(prob - 0.5) > 1e-6:
                assert shown.mode[place] == mode
            compared += 1
    assert compared > 100


def linear(modes):
    """Parts of a system whose modes are all one linear system."""
    return {
        "state": (x,),
        "dynamics": [[0.9 * x + 0.4 * v]] * modes,
        "noise": Noise((v,)),
        "sensor": [[x + 0.7 * w]] * modes,
        "sensor_noise": Noise((w,)),
    }


@pytest.mark.parametrize("memory", [large_order(1), large_order(2), finite_memory(1)])
def test_equal_modes_are_one_mode_and_one_mode_is_an_ordinary_system(memory):
    axes = {"x": (-5, 5, 41), "z": (-4, 4, 33), "y": (-8, 8, 41)}
    one = SwitchingSystem(**linear(1), switching=[[1]], initial=[(1.0, [0.3], [[0.8]])])
    three = SwitchingSystem(
        **linear(3),
        switching=[[0.2, 0.3, 0.5]] * 3,
        initial=[(p, [0.3], [[0.8]]) for p in (0.2, 0.3, 0.5)],
    )
    ordinary = DiscreteSystem(
        StochasticMap((x,), [0.9 * x + 0.4 * v], Noise((v,))),
        StochasticMap((x,), [x + 0.7 * w], Noise((w,))),
        [0.3],
        [[0.8]],
    )
    found = [optimal_risk(system, memory, range(4), **axes) for system in (one, ordinary)]
    np.testing.assert_allclose(found[1].mse, found[0].mse, rtol=1e-5)
    assert found[0].mode_error.max() < 1e-14
    assert found[1].mode_error is None
    if memory == large_order(1):
        found.append(optimal_risk(three, memory, range(4), **axes))
        np.testing.assert_allclose(found[2].mse, found[0].mse, rtol=1e-10)
        np.testing.assert_allclose(found[2].mode_error, 0.5, atol=1e-12)


def test_an_indicator_that_shows_the_mode_decides_it():
    """Impossible readings, a mode that never starts and noise finer than the grid do no harm."""
    system = SwitchingSystem(
        state=(x,),
        dynamics=[[0.9 * x], [0.5 * x + 0.01 * v]],
        noise=Noise((v,)),
        switching=[[0.8, 0.2], [0.3, 0.7]],
        sensor=[[x + w], [x + 2 * w]],
        sensor_noise=Noise((w,)),
        indicator=[[1, 0], [0, 1]],
        initial=[(1.0, [0], [[1]]), (0.0, [0], [[1]])],
    )
    axes = {"x": (-5, 5, 101), "z": (-4, 4, 81), "y": (-16, 16, 129)}
    filter = grid_synthesis(system, large_order(1), range(5), **axes)
    assert filter.predicted.mode_rate.max() < 1e-12
    data = system.simulate(range(5), 4000, 3)
    found = filter.run(data.times, data.measurements, indicators=data.indicators)
    assert np.array_equal(found.modes, data.modes)
    square = (found.mean - data.states)[:, 0] ** 2
    apart = square.mean(axis=1) - filter.predicted.rms[:, 0] ** 2
    assert (np.abs(apart) < 4 * square.std(axis=1) / 4000**0.5 + 3e-3).all()
    # a missing indicator leaves the modes open
    found = filter.run(data.times, data.measurements, indicators=np.full((5, 4000), -1))
    assert 0.05 < np.mean(found.modes != data.modes) < 0.4


@pytest.mark.parametrize(
    "memory", [large_order(1), finite_memory(1), Memory(1, 0, 1), Memory(0, 1, 1)]
)
def test_risk_is_the_error_on_simulated_paths(memory):
    """Of a benchmark without an indicator, and of one with dependent noises."""
    system, axes = (
        zoo.scalar_switching(),
        {"x": (-8, 8, 81), "z": (-6, 6, 121), "y": (-16, 18, 137)},
    )
    if memory.indicators:
        system = zoo.dependent_switching()
        axes = {"x": (-6, 6, 91), "z": (-4, 4, 61), "y": (-7, 11, 91)}
    filter = grid_synthesis(system, memory, range(5), **axes)
    data = system.simulate(range(5), 20_000, 7)
    found = filter.run(data.times, data.measurements, indicators=data.indicators)
    square = (found.mean - data.states)[:, 0] ** 2
    apart = square.mean(axis=1) - filter.predicted.rms[:, 0] ** 2
    assert (np.abs(apart) < 4 * square.std(axis=1) / 20_000**0.5).all()
    wrong = (found.modes != data.modes).mean(axis=1)
    error = np.sqrt(wrong * (1 - wrong) / 20_000)
    assert (np.abs(wrong - filter.predicted.mode_rate) < 4 * error).all()
    # tables of one kind come closer to each other, decisions too
    assert np.isnan(filter.changes[:, :2]).all()
    estimates, modes = filter.changes[:, 2:]
    assert (np.diff(estimates) < 0).all()
    assert (modes[1:] < modes[0]).all()
    assert 0 < modes[0] < 0.2
    if memory == large_order(1):
        assert np.sqrt(square[1].mean()) == pytest.approx(1.2662, abs=0.02)


def test_risk_of_a_simulated_design_with_modes_is_its_held_out_error():
    filter = synthesize(reference(), Memory(1), Taylor(), range(3), paths=12_000, seed=1)
    risk = grid_risk(filter, x=(-8, 8, 65), z=(-7, 7, 49), y=(-12, 12, 65))
    held = filter.held_out
    assert (np.abs(np.sqrt(risk.mse) - held.rms[:, 0]) < 4 * held.error[:, 0]).all()
    assert (np.abs(risk.mode_error - held.mode_rate) < 4 * held.mode_error).all()
