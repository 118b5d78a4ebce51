"""The filter as printed: equations (5)-(29) literally."""

import numpy as np
import pytest

from oracles.delay import general_system, printed_recursion
from seedslib import zoo
from seedslib.delay import DelaySystem, error_covariance, optimal_gains, printed_gains

SYSTEMS = {
    "three components": lambda: general_system((0, 3)),
    "two components": zoo.precise_sensor,
    "one component": lambda: zoo.delayed_scalar(0.5, -0.6, 4.0, 3),
    "pure delay": lambda: DelaySystem(
        {1: [[0.4, 0.1], [-0.2, 0.3]]}, [[1.3, -0.4]], np.eye(2), [[0.3]], np.eye(2), mean0=[1, -1]
    ),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_gains_and_claimed_matrix_are_the_printed_ones(name):
    system = SYSTEMS[name]()
    printed = printed_gains(system, 15)
    gain, past, claimed = printed_recursion(system, 15)
    np.testing.assert_allclose(printed.gains.gain[1:], gain, atol=1e-12)
    np.testing.assert_allclose(printed.gains.past[1:], past, atol=1e-12)
    np.testing.assert_allclose(printed.claimed[1:], claimed, atol=1e-12)
    np.testing.assert_array_equal(printed.claimed[0], system.cov0)
    np.testing.assert_array_equal(printed_gains(system, 4).claimed, printed.claimed[:5])
    assert not printed.gains.corrected


def test_without_delay_it_is_not_the_kalman_filter():
    """By hand: one component, A = 0.9, no delay, everything else 1, N = 1."""
    gains = printed_gains(zoo.delayed_scalar(0.9, 0.0, 1.0, 1), 2).gains
    first = 1.81 / 2.81
    assert gains.gain[1, 0, 0] == pytest.approx(first, abs=1e-15)
    by_hand = 0.9 * (1.0 - first) * 0.9 * 0.9 / 2.81
    assert gains.past[2, 0, 0, 0] == pytest.approx(by_hand, abs=1e-15)
    assert gains.gain[2, 0, 0] == pytest.approx(0.5939509407, abs=5.01e-11)


def test_the_claimed_matrix_is_not_the_error_covariance_nor_the_optimum():
    """The first instant is optimal; later the claim can lie below the optimum, the truth cannot."""
    system = zoo.delayed_oscillator(0.7, 3)
    printed, best = printed_gains(system, 60), optimal_gains(system, 60).cov
    true = error_covariance(system, printed.gains)
    np.testing.assert_allclose(true[1], best[1], atol=1e-13)
    assert np.trace(printed.claimed[60]) < np.trace(best[60]) < np.trace(true[60])
    pure = zoo.delayed_scalar(0.0, 0.9, 1.0, 4)
    claimed = printed_gains(pure, 30).claimed
    np.testing.assert_allclose(claimed, optimal_gains(pure, 30).cov, atol=1e-14)
