"""The filter as printed: equations (5)-(29) literally."""

import numpy as np
import pytest

from oracles.delay import printed_recursion
from seedslib.delay import (
    DelayKalmanFilter,
    DelaySystem,
    PrintedDelayFilter,
    apply_gains,
    error_covariance,
    examples,
)


def varying_plant(steps=15):
    rng = np.random.default_rng(1)
    return DelaySystem(
        {0: 0.4 * rng.standard_normal((steps, 2, 2)), 3: 0.4 * rng.standard_normal((steps, 2, 2))},
        sensor=rng.standard_normal((steps + 1, 2, 2)),
        noise_cov=lambda k: [[1.0 + 0.2 * k]],
        sensor_cov=lambda k: np.array([[1.0, 0.3], [0.3, 0.8]]) * (1 + 0.1 * k),
        mean0=[0.4, -0.9],
        cov0=[[1.0, 0.2], [0.2, 0.6]],
        history_cov=np.array([1.0, 0.5, 0.2])[:, None, None] * np.eye(2),
        noise_input=rng.standard_normal((steps, 2, 1)),
    )


SYSTEMS = {
    "varying": varying_plant,
    "two components": examples.precise_sensor,
    "one component": lambda: examples.scalar(0.5, -0.6, 4.0, 3),
    "pure delay": lambda: DelaySystem(
        {1: [[0.4, 0.1], [-0.2, 0.3]]}, [[1.3, -0.4]], np.eye(2), [[0.3]], np.eye(2), mean0=[1, -1]
    ),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_gains_and_claimed_matrix_are_the_printed_ones(name):
    """And the expanded form (12) equals the claimed (22) for the gains (20), (21)."""
    printed = PrintedDelayFilter(SYSTEMS[name]())
    short, found = printed.gains(4), printed.gains(15)
    gain, past, claimed = printed_recursion(printed.system, 15)
    np.testing.assert_allclose(found.gains.gain[1:], gain, atol=1e-12)
    np.testing.assert_allclose(found.gains.past[1:], past, atol=1e-12)
    np.testing.assert_allclose(found.claimed[1:], claimed, atol=1e-12)
    np.testing.assert_allclose(found.expanded, found.claimed, atol=1e-12)
    np.testing.assert_array_equal(short.claimed, found.claimed[:5])
    assert not found.gains.corrected


@pytest.mark.parametrize("name", SYSTEMS)
def test_run_and_verbs_are_the_estimates_of_the_gains(name):
    system = SYSTEMS[name]()
    y = system.simulate(10, 6, 3).measurements
    printed = PrintedDelayFilter(system)
    run = printed.run(10, y)
    np.testing.assert_array_equal(run.mean, apply_gains(system, printed.gains(10).gains, y))
    np.testing.assert_array_equal(run.cov, printed.gains(10).claimed)
    state = printed.correct(printed.initial((2, 3)), np.full((len(y[0]), 2, 3), np.nan))
    np.testing.assert_array_equal(state.cov, system.cov0[: len(state.cov), : len(state.cov)])
    for k in range(1, 11):
        ahead = printed.predict(state, k)
        step = system.step(k)
        mean = sum(np.tensordot(a, state.mean[d], 1) for d, a in step.dynamics.items())
        np.testing.assert_allclose(ahead.mean[0], mean, atol=1e-12)
        state = printed.correct(ahead, y[k].reshape(-1, 2, 3))
        report = printed.report(state)
        np.testing.assert_allclose(report.mean.reshape(run.mean[k].shape), run.mean[k], atol=1e-12)
        np.testing.assert_allclose(report.cov, run.cov[k], atol=1e-12)


def test_without_delay_it_is_not_the_kalman_filter():
    """By hand: one component, A = 0.9, no delay, everything else 1, N = 1."""
    found = PrintedDelayFilter(examples.scalar(0.9, 0.0, 1.0, 1)).gains(2).gains
    first = 1.81 / 2.81
    assert found.gain[1, 0, 0] == pytest.approx(first, abs=1e-15)
    by_hand = 0.9 * (1.0 - first) * 0.9 * 0.9 / 2.81
    assert found.past[2, 0, 0, 0] == pytest.approx(by_hand, abs=1e-15)
    assert found.gain[2, 0, 0] == pytest.approx(0.5939509407, abs=5.01e-11)


def test_the_claimed_matrix_is_not_the_error_covariance_nor_the_optimum():
    """The first instant is optimal; later the claim can lie below the optimum, the truth cannot."""
    system = examples.rotation(0.7, 3)
    printed, best = PrintedDelayFilter(system).gains(60), DelayKalmanFilter(system).gains(60).cov
    true = error_covariance(system, printed.gains)
    np.testing.assert_allclose(true[1], best[1], atol=1e-13)
    assert np.trace(printed.claimed[60]) < np.trace(best[60]) < np.trace(true[60])
    degenerate = examples.scalar(0.0, 0.9, 1.0, 4)
    claimed = PrintedDelayFilter(degenerate).gains(30).claimed
    np.testing.assert_allclose(claimed, DelayKalmanFilter(degenerate).gains(30).cov, atol=1e-14)
