"""Stationary gains by a spectral factor against the Riccati equation and long recursions."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from seedslib.delay import DelayKalmanFilter, DelaySystem, examples, stationary_gains


def by_riccati(system):
    step = system.augmented()
    predicted = solve_discrete_are(step.transition.T, step.sensor.T, step.noise, step.sensor_cov)
    inner = step.sensor @ predicted @ step.sensor.T + step.sensor_cov
    gain = (predicted @ step.sensor.T / inner).reshape(-1, system.state_size, 1)
    cov = predicted - predicted @ step.sensor.T @ step.sensor @ predicted / inner
    return (
        gain,
        inner,
        predicted[: system.state_size, : system.state_size],
        cov[: system.state_size, : system.state_size],
    )


@pytest.mark.parametrize(
    "build",
    [
        lambda: examples.rotation(0.6, 1),
        lambda: examples.rotation(0.6, 10),
        lambda: examples.rotation(0.7, 3),
        lambda: examples.rotation(0.6, 30),
        examples.precise_sensor,
        examples.two_noises,
        lambda: examples.scalar(0.6, 0.3, 1.0, 0),
        lambda: DelaySystem({0: 0.4, 2: 0.2, 5: -0.3}, 1.0, 1.0, 0.5, 1.0),
        lambda: DelaySystem({0: 0.5, 1: 0.2}, 1.0, 0.0, 1.0, 1.0),
    ],
)
def test_against_the_riccati_equation(build):
    system = build()
    found = stationary_gains(system)
    for one, other in zip(found[:-1], by_riccati(system), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=2e-11 * max(1.0, np.abs(other).max()))


@pytest.mark.parametrize("delay", [3, 100])
def test_against_a_long_fast_recursion(delay):
    system = examples.rotation(0.6, delay)
    found = stationary_gains(system)
    table = DelayKalmanFilter(system, "chandrasekhar").gains(4000)
    assert table.method == "chandrasekhar"
    np.testing.assert_allclose(found.gain, table.gain[-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.cov, table.cov[-1], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (examples.rotation(0.8, 3), "no stationary gains.*outside the unit circle: 2"),
        (examples.scalar(1.2, -1.2, 10.0, 3), "no stationary gains.*outside the unit circle: 2"),
        (examples.scalar(1.2, 0.0, 1.0, 1), "no stationary gains.*outside the unit circle: 1"),
        (DelaySystem({0: 3.0, 1: -2.0}, 1.0, 1.0, 1.0, 1.0), "on the unit circle"),
        (examples.scalar(1.0, 0.0, 1.0, 2), "on the unit circle"),
        (DelaySystem({0: 0.5 * np.ones((4, 1, 1))}, 1.0, 1.0, 1.0, 1.0), "constant"),
        (
            DelaySystem({0: 0.5 * np.eye(2)}, np.eye(2), np.eye(2), np.eye(2), np.eye(2)),
            "one measurement component",
        ),
    ],
)
def test_what_the_route_cannot_do_is_refused(system, message):
    with pytest.raises(ValueError, match=message):
        stationary_gains(system)


def test_number_of_nodes():
    system = examples.rotation(0.6, 3)
    by_choice, given = stationary_gains(system), stationary_gains(system, 8192)
    assert given.nodes == 8192
    np.testing.assert_allclose(given.gain, by_choice.gain, rtol=0, atol=1e-13)
    for near_the_circle, nodes in (
        (examples.rotation(0.7, 3), 32),
        (examples.scalar(0.9999, 0.0), 512),
    ):
        with pytest.raises(ValueError, match="nodes"):
            stationary_gains(near_the_circle, nodes)
    with pytest.raises(TypeError, match="system"):
        stationary_gains("plant")
