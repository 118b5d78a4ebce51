"""Examples of switching systems: their probabilities, their noises, and what they refuse."""

import numpy as np
import pytest

from seedslib import zoo

X = np.linspace(-4.0, 4.0, 9)[None]


def probabilities(system):
    """Of the four switches at the points X, (2, 2, 9)."""
    table = [[branch.probability(0.0, X) for branch in row] for row in system.branches]
    return np.broadcast_to(np.array(table), (2, 2, 9))


@pytest.mark.parametrize("rate", [0.25, 1.0, 1.6])
def test_rate_scales_both_switches(rate):
    x = X[0]
    leave = rate * (0.35 - 0.3 * np.exp(-(x**2) / 8))
    back = rate * (1 - 0.9 + 0.5 * np.exp(-(x**2) / 2))
    found = probabilities(zoo.scalar_switching("A1H", rate=rate))
    np.testing.assert_allclose(found, [[1 - leave, leave], [back, 1 - back]], atol=1e-14)


def test_switching_is_certain_at_the_fastest_rate_and_refused_beyond():
    found = probabilities(zoo.scalar_switching(rate=5 / 3))
    assert found[1, 0, 4] == pytest.approx(1.0, abs=1e-12)
    for rate in (0.0, -1.0, 1.7, float("nan")):
        with pytest.raises(ValueError, match=r"rate: wanted a number in \(0, 5/3\]"):
            zoo.scalar_switching(rate=rate)


@pytest.mark.parametrize(("sensor", "default"), [("A1H", 2.0), ("A1L", 0.5), ("A2", 1.0)])
def test_sensor_noise_has_the_deviation_that_was_asked_for(sensor, default):
    for given, wanted in ((None, default), (0.3, 0.3), (1 / 3, 1 / 3)):
        system = zoo.scalar_switching(sensor, deviation=given)
        data = system.simulate(np.arange(3.0), 20_000, 5)
        x = data.states[:, 0]
        shown = 0.5 * x + 0.2 * x**2 if sensor == "A2" else x + 2.0 * data.modes
        noise = data.measurements[:, 0] - shown
        assert noise.std() == pytest.approx(wanted, rel=4 / np.sqrt(2 * noise.size))
        assert abs(noise.mean()) < 4 * wanted / np.sqrt(noise.size)


def test_stationary_law():
    """Share of mode 1, deviation of the state, rate of switches: known from another program."""
    data = zoo.scalar_switching().simulate(np.arange(31.0), 20_000, 7)
    late, modes = data.states[15:, 0], data.modes[15:]
    assert modes.mean() == pytest.approx(0.404, abs=0.004)
    assert late.std() == pytest.approx(2.42, abs=0.02)
    assert (modes[1:] != modes[:-1]).mean() == pytest.approx(0.233, abs=0.003)


@pytest.mark.parametrize("modes", [1, 2])
def test_steady_target_moves_as_it_says(modes):
    system = zoo.steady_target(modes, decay=0.9, noise=0.3, sensor_noise=0.7)
    data = system.simulate(np.arange(6.0), 20_000, 3)
    x, drive = data.states, data.modes[:-1]
    push = x[1:, 1] - 0.9 * x[:-1, 1]
    np.testing.assert_allclose(x[1:, 0], x[:-1, 0] + x[:-1, 1] + push / 2, atol=1e-12)
    for noise, wanted in ((push - drive, 0.3), (data.measurements[:, 0] - x[:, 0], 0.7)):
        assert noise.std() == pytest.approx(wanted, rel=4 / np.sqrt(2 * noise.size))
        assert abs(noise.mean()) < 4 * wanted / np.sqrt(noise.size)
    assert (system.indicators > 0) == (modes == 2)
    if modes == 2:
        np.testing.assert_array_equal(data.indicators, data.modes)


def test_refusals_name_the_argument():
    with pytest.raises(ValueError, match="modes: wanted 1 or 2, got 3"):
        zoo.steady_target(3)
    with pytest.raises(ValueError, match="sensor: wanted one of A1H, A1L, A2, got 'A3'"):
        zoo.scalar_switching("A3")
    for deviation in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(ValueError, match="deviation: wanted a positive number"):
            zoo.scalar_switching(deviation=deviation)
