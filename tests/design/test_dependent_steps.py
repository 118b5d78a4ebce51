"""Noises of sensor and dynamics that depend on each other: the exact recursion of remark 1."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import dependent_steps, optimal_risk
from seedslib.designed import finite_memory, large_order

DECAY, PUSH, LOUD = 0.9, 0.5, 1.0


def normal(x, mean, deviation):
    return np.exp(-0.5 * ((x - mean) / deviation) ** 2) / deviation


def kernel(x, y, moves, sensors, push, loud, tied, leave):
    """gamma(x', y | x) on nodes: the next state is normal given the noise of the sensor."""
    modes, count = len(moves), len(x)
    found = np.zeros((len(y), modes, count, modes, count))
    for i in range(modes):
        seen = normal(y[:, None], sensors[i](x), loud)
        seen /= seen.sum(axis=0)
        mean = moves[i](x) + push * tied * (y[:, None] - sensors[i](x)) / loud
        there = normal(x[:, None], mean[:, None, :], push * np.sqrt(1 - tied**2))
        there /= there.sum(axis=1, keepdims=True)
        for l in range(modes):
            found[:, l, :, i] = seen[:, None] * there * leave[i][l](x)
    return found.reshape(len(y), modes * count, modes * count)


def kalman(tied, steps):
    """Error variances of the Kalman filter whose forecast uses the correlation."""
    forecast, found, both = 1.0, [], PUSH * LOUD * tied
    for _ in range(steps):
        total = forecast + LOUD**2
        found.append(forecast - forecast**2 / total)
        forecast = DECAY**2 * forecast + PUSH**2 - (DECAY * forecast + both) ** 2 / total
    return np.array(found)


@pytest.mark.parametrize("tied", [0.7, -0.7])
def test_linear_system_with_tied_noises_and_a_remembered_measurement_is_the_kalman_filter(tied):
    x, y = np.linspace(-5, 5, 61), np.linspace(-8, 8, 49)
    made = kernel(
        x, y, [lambda x: DECAY * x], [lambda x: x], PUSH, LOUD, tied, [[lambda x: 1 + 0 * x]]
    )
    start = normal(x, 0, 1)
    wanted, errors = kalman(tied, 4), []
    for count in (21, 41):
        axes = {"z": (-4, 4, count), "measurements": True}
        steps = dependent_steps(start / start.sum(), [made] * 4, x, 1, **axes)
        errors.append(np.array([step.mse for step in steps]))
    assert (errors[1] > wanted - 2e-4).all()
    np.testing.assert_allclose(errors[1] + (errors[1] - errors[0]) / 3, wanted, rtol=1e-2)


def scalar(tied):
    """The scalar benchmark with its noises tied, on nodes."""
    x, y = np.linspace(-8, 8, 41), np.linspace(-16, 18, 69)

    def leave(x):
        return 0.35 - 0.3 * np.exp(-(x**2) / 8)

    def back(x):
        return 0.1 + 0.5 * np.exp(-(x**2) / 2)

    made = kernel(
        x,
        y,
        [lambda x: x + 1.8 * np.sin(x), lambda x: 0.6 * x],
        [lambda x: x, lambda x: 2 + x],
        0.5,
        2.0,
        tied,
        [[lambda x: 1 - leave(x), leave], [back, lambda x: 1 - back(x)]],
    )
    start = np.tile(normal(x, 0, 1), 2)
    return start / start.sum(), made, np.tile(x, 2)


def test_independent_noises_are_the_recursion_of_theorem_2():
    start, made, x = scalar(0.0)
    steps = list(dependent_steps(start, [made] * 4, x, 2, z=(-6, 6, 41)))
    axes = {"x": (-8, 8, 41), "y": (-16, 18, 69)}
    system = zoo.scalar_switching()
    risk = optimal_risk(system, large_order(1), range(4), z=(-6, 6, 41), **axes)
    np.testing.assert_allclose([s.mse for s in steps], risk.mse, rtol=1e-6)
    np.testing.assert_allclose([s.mode_error for s in steps], risk.mode_error, rtol=1e-6)
    more = list(dependent_steps(start, [made] * 3, x, 2, z=(-6, 6, 41), measurements=True))
    past = optimal_risk(system, finite_memory(1), range(3), **axes)
    for other in (risk.mse, past.mse):
        assert all(s.mse < m + 1e-9 for s, m in zip(more, other, strict=False))
