"""The oscillator of the jump-diffusion paper without its noise."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from seedslib import zoo


@pytest.mark.parametrize(
    ("reading", "period", "reach"),
    [("A", 43.29, (2.019, 2.958)), ("I", 2.050, (2.004, 7.342))],
)
def test_limit_cycle(reading, period, reach):
    """A turn takes 43.29, and 2.050 for a frequency of pi."""
    system = zoo.van_der_pol(reading)

    def upward(t, x):
        return x[0]

    upward.direction = 1
    found = solve_ivp(
        lambda t, x: system.drift(t, x[:, None])[:, 0], (0, 5 * period), [2.0, 0.0], rtol=1e-9,
        atol=1e-10, events=upward, max_step=period / 400,
    )  # fmt: skip
    turns = found.t_events[0]
    assert turns[-1] - turns[-2] == pytest.approx(period, rel=5e-4)
    late = found.y[:, found.t > turns[-2]]
    np.testing.assert_allclose(np.abs(late).max(axis=1), reach, rtol=2e-3)


def test_disturbed_motion_turns_at_the_pace_of_the_cycle_and_outside_of_it():
    clock = np.arange(0, 220, 0.25)
    path = zoo.van_der_pol().simulate(clock, 96, 5).states[clock > 43]
    angle = np.unwrap(np.arctan2(path[:, 1], path[:, 0]), axis=0)
    turns = (angle[0] - angle[-1]) / (2 * np.pi) / (clock[-1] - 43) * 43.29
    assert abs(turns.mean() - 0.95) < 4 * turns.std() / np.sqrt(96)
    assert turns.std() / np.sqrt(96) < 0.1
    # two clouds: mostly outside of the undisturbed cycle, rarely between its slow parts
    assert 0.65 < (np.abs(path[:, 0]) > 2.019).mean() < 0.8
    assert (np.abs(path[:, 0]) < 1).mean() < 0.08
