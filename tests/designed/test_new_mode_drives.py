"""The new mode drives the step: grids, particles, pairs of modes, and filters that are designed."""

import numpy as np
import pytest
import sympy

from oracles.wave import wave
from seedslib.design import grid_risk, grid_synthesis, simulated_synthesis, synthesize
from seedslib.designed import large_order
from seedslib.evaluation import evaluate
from seedslib.filters import GridBayesFilter, ParticleFilter
from seedslib.linearization import GaussHermite
from seedslib.models import Noise, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)
AXIS = (-10.0, 10.0, 161)


def test_grid_and_particles_agree_and_the_other_timing_does_not():
    system, times = wave(), np.arange(12.0)
    data = system.simulate(times, 30, 5)
    exact = GridBayesFilter(system, AXIS).run(times, data.measurements)
    drawn = ParticleFilter(system, 4000).run(times, data.measurements, seed=2)
    other = GridBayesFilter(wave("old"), AXIS).run(times, data.measurements)
    apart = [np.sqrt(((f.mean - exact.mean) ** 2).mean()) for f in (drawn, other)]
    assert apart[0] < 0.03 < 0.3 < apart[1]
    assert np.abs(drawn.mode_prob - exact.mode_prob).mean() < 0.02
    scores = [f.loglik.sum(axis=0).mean() for f in (exact, drawn, other)]
    assert abs(scores[1] - scores[0]) < 0.03
    assert scores[2] < scores[0] - 0.3


def test_pairs_of_modes_make_the_one_timing_of_the_other():
    """Constant probabilities: (old, new) with the old one driving is new with the new driving."""
    chain, start = np.array([[0.9, 0.1], [0.2, 0.8]]), np.array([0.6, 0.4])
    moves = [[x + 1.8 * sympy.sin(x) + v / 2], [0.6 * x + v / 2]]
    law = [(p, [0.0], [[1.0]]) for p in start]
    single = SwitchingSystem(
        (x,), moves, Noise((v,)), chain.tolist(), [[x + w]] * 2, Noise((w,)), law, drives="new"
    )
    ahead = [np.kron(np.eye(2)[l], chain[l]).tolist() for _ in (0, 1) for l in (0, 1)]
    both = SwitchingSystem(
        (x,), [moves[l] for _ in (0, 1) for l in (0, 1)], Noise((v,)), ahead, [[x + w]] * 4,
        Noise((w,)), [(p, [0.0], [[1.0]]) for p in (start[:, None] * chain).ravel()],
    )  # fmt: skip
    times = np.arange(9.0)
    y = single.simulate(times, 20, 5).measurements
    one, two = (GridBayesFilter(each, AXIS).run(times, y) for each in (single, both))
    np.testing.assert_allclose(one.mean, two.mean, atol=1e-10)
    np.testing.assert_allclose(one.loglik, two.loglik, atol=1e-10)


@pytest.fixture(scope="module")
def designs():
    """One decision remembered, from simulated paths; and what the same memory allows at best."""
    times = np.arange(7.0)
    made = synthesize(wave(), large_order(1), GaussHermite(5), times, paths=20_000, seed=1)
    best = grid_synthesis(wave(), large_order(1), times, x=AXIS, z=(-10, 10, 81))
    return made, best, times


def test_a_designed_filter_is_consistent_with_the_grid(designs):
    """What it does, on the law itself and on paths, what it predicts, and the bounds."""
    made, best, times = designs
    risk = grid_risk(made, x=AXIS, z=(-10, 10, 161))
    seen = evaluate(made, wave(), times, 20_000, 9)
    bayes = evaluate(GridBayesFilter(wave(), AXIS), wave(), times, 2000, 9)
    for k in range(1, 7):
        paths = seen.rms[k, 0] ** 2
        error = 2 * seen.rms[k, 0] * seen.rms_error[k, 0]
        assert abs(risk.mse[k] - paths) < 4 * error + 0.004
        assert abs(made.predicted.rms[k, 0] ** 2 - paths) < 6 * error
        assert best.predicted.rms[k, 0] ** 2 < risk.mse[k] + 1e-9
        assert bayes.rms[k, 0] < best.predicted.rms[k, 0] + 4 * bayes.rms_error[k, 0]


def test_tables_from_paths_are_consistent_with_those_of_the_grid(designs):
    """Optimal functions of the same memory: nearest neighbours on paths and the exact law."""
    _, best, times = designs
    made = simulated_synthesis(wave(), large_order(1), times[:4], paths=8000, seed=4)
    found = evaluate(made, wave(), times[:4], 8000, 9)
    exact = evaluate(best, wave(), times, 8000, 9)
    for k in range(4):
        assert abs(found.rms[k, 0] / exact.rms[k, 0] - 1) < 0.03


def test_the_other_timing_makes_a_worse_design(designs):
    made, _, times = designs
    wrong = synthesize(wave("old"), large_order(1), GaussHermite(5), times, paths=20_000, seed=1)
    found = evaluate(wrong, wave(), times, 20_000, 9), evaluate(made, wave(), times, 20_000, 9)
    assert found[0].rms[-1, 0] > found[1].rms[-1, 0] + 0.02
