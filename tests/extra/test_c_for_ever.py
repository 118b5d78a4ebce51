"""Designs without an end in C, against the same filters in Python, long after their last time."""

from functools import lru_cache

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Continuous, Polynomial, grid_synthesis, stationary, synthesize
from seedslib.designed import Memory, finite_memory, large_order
from seedslib.extra import to_c
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import JumpDiffusion, Noise

x, v, t = sympy.symbols("x v t", real=True)
LENGTH = 400


def tide():
    """A number driven with the period 2, seen by a sensor whose gain has the same period."""
    return JumpDiffusion(
        (x,), [-x + sympy.cos(sympy.pi * t)], [[0.5]], [(2 + sympy.sin(sympy.pi * t)) * x + v],
        Noise((v,), cov=[[0.1]]), [0.0], [[1.0]], time=t, step=0.05,
    )  # fmt: skip


DESIGNS = {
    "one step": (Memory(1), Taylor(), {}, {}),
    "two estimates, four steps in turn": (Memory(2), Taylor(), {}, {"cycle": 4}),
    "measurements, a short transient": (
        finite_memory(2), Taylor(), {}, {"cycle": 4, "transient": 3},
    ),
    "polynomial": (Memory(1), ExactGaussian(), {"predictor": Polynomial(3, 2)}, {"cycle": 4}),
    "continuous": (
        Memory(1), Taylor(), {"predictor": Continuous(), "step": 0.1}, {"cycle": 4},
    ),
}  # fmt: skip


@lru_cache
def lasting(name):
    memory, rule, options, turn = DESIGNS[name]
    times = 0.5 * np.arange(21.0)
    if not turn:  # a period of its own
        times = 2.0 * np.arange(16.0)
    made = synthesize(tide(), memory, rule, times, paths=1000, seed=1, **options)
    return stationary(made, tolerance=0.5, paths=200, **turn)


def close(found, wanted, part=1e-11):
    lost = np.isnan(wanted)
    assert np.array_equal(lost, np.isnan(found))
    np.testing.assert_allclose(found[~lost], wanted[~lost], rtol=part, atol=part)


@pytest.mark.parametrize("name", DESIGNS)
def test_many_laps(name, compiled):
    filter = lasting(name)
    times = np.array([filter.clock.moment(k, filter.cycle) for k in range(LENGTH)])
    y = filter.system.simulate(times, 3, 5).measurements
    made = compiled(filter)
    mean, cov, loglik, _ = made.run(times, y)
    wanted = filter.run(times, y, covariances=True)
    close(mean, wanted.mean)
    close(cov, wanted.cov)
    close(loglik, wanted.loglik)


@pytest.mark.parametrize("name", DESIGNS)
def test_forecasts_after_many_laps(name, compiled):
    filter, steps = lasting(name), 103
    times = np.array([filter.clock.moment(k, filter.cycle) for k in range(steps + 1)])
    y = filter.system.simulate(times, 1, 6).measurements[..., 0]
    made, state = compiled(filter), filter.initial()
    for k in range(steps):
        state = filter.step(state, times[k], y[k])
    for moment in np.linspace(times[-2], times[-1], 7):
        wanted = filter.forecast(state, moment).mean
        np.testing.assert_allclose(made.forecast(y[:steps], float(moment)), wanted, rtol=1e-10)
    assert made.forecast(y[:steps], float(times[-1] + 0.01)) == 4
    assert made.forecast(y[:steps], float(times[-2] - 0.01)) == 4
    assert "FILTER_CYCLE" in to_c(filter)


@pytest.mark.parametrize("memory", [large_order(1), large_order(2)])
def test_tables_go_on(memory, compiled):
    made = grid_synthesis(
        zoo.flip_process(), memory, 0.25 * np.arange(14.0), x=(-3.5, 3.5, 61), z=(-2.5, 2.5, 9),
        y=(-8, 8, 25), nodes=1,
    )  # fmt: skip
    filter = stationary(made, tolerance=0.5, paths=200)
    times = 0.25 * np.arange(float(LENGTH))
    y = filter.system.simulate(times, 2, 2).measurements
    library = compiled(filter)
    mean, cov, _, _ = library.run(times, y)
    wanted = filter.run(times, y, covariances=True)
    close(mean, wanted.mean, 1e-13)
    close(cov, np.broadcast_to(wanted.cov[..., None], cov.shape), 1e-13)
    state, steps = filter.initial(), 31
    for k in range(steps):
        state = filter.step(state, times[k], y[k, :, 0])
    for moment in np.linspace(times[steps - 1], times[steps], 5):
        wanted = filter.forecast(state, moment).mean
        np.testing.assert_allclose(library.forecast(y[:steps, :, 0], moment), wanted, rtol=1e-11)
