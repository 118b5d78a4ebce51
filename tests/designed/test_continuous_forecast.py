"""The continuous forecast's Euler steps: at which time and where each velocity is taken."""

import numpy as np
import pytest
import sympy

from seedslib.design import Continuous, synthesize
from seedslib.designed import Memory
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import JumpDiffusion, Noise

x, y, v, z = sympy.symbols("x y v z", real=True)
t = sympy.Symbol("t")
TIMES, STEP = [0.2, 0.7, 1.2], 0.1


def design(drift, **options):
    system = JumpDiffusion(
        (x,), [drift], [[0.3]], [x + v], Noise((v,)), [1.0], [[0.4]], step=STEP, **options
    )
    return synthesize(
        system, Memory(1), ExactGaussian(), TIMES, predictor=Continuous(), paths=300, seed=1,
        step=STEP,
    )  # fmt: skip


def states(filter):
    """After the measurements at the first and at the second time: alone, and in a batch of two."""
    for batch in ((), (2,)):
        state = filter.initial(batch)
        for k in range(2):
            state = filter.step(state, TIMES[k], np.full((1, *batch), 0.8 - k))
            yield TIMES[k], state


def test_velocities_are_those_of_the_beginning_of_a_step():
    """dX = f(t) dt + ...: whatever is fitted, Z moves by the sum of f(t_j) h over its steps."""
    filter = design(t**2)
    for start, state in states(filter):
        for steps in (1, 3, 5):
            moved = sum((start + j * STEP) ** 2 * STEP for j in range(steps))
            got = filter.forecast(state, start + steps * STEP).mean
            np.testing.assert_allclose(got, state.mean + moved, rtol=1e-12)


def test_velocities_of_jumps_are_those_of_the_beginning_of_a_step():
    """Jumps of mean 2 t that come with intensity t / 2 move the forecast by t²."""
    marks = Noise((z,), mean=2.0)
    filter = design(0, intensity=t / 2, jump=[t * z], marks=marks)
    for start, state in states(filter):
        moved = sum((start + j * STEP) ** 2 * STEP for j in range(5))
        got = filter.forecast(state, start + 5 * STEP).mean
        np.testing.assert_allclose(got, state.mean + moved, rtol=1e-12)


def test_velocities_are_those_of_the_fitted_law():
    """dX = -t X dt: each step adds -h t (Gamma Z + kappa), with the fit of its own beginning."""
    filter = design(-t * x)
    for start, state in states(filter):
        moved = state.mean
        for j, fit in enumerate(filter.node_fits[TIMES.index(start)][:4]):
            now = start + j * STEP
            law = fit.gain @ moved.reshape(1, -1) + fit.offset[:, None]
            moved = moved - STEP * now * law.reshape(moved.shape)
            got = filter.forecast(state, now + STEP).mean
            np.testing.assert_allclose(got, moved, rtol=1e-11)


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian()])
def test_forecasts_of_a_run_are_those_of_its_steps(rule):
    """Two components, a velocity that depends on time and on both of them."""
    system = JumpDiffusion(
        (x, y), [y + t, -x - t * y**2], [[0], [0.3]], [x + v], Noise((v,), mean=0.3), [1.0, 0.0],
        0.2 * np.eye(2), step=STEP,
    )  # fmt: skip
    filter = synthesize(
        system, Memory(1), rule, TIMES, predictor=Continuous(), paths=300, seed=1, step=STEP
    )
    grid = np.linspace(0.2, 1.2, 11)
    data = system.simulate(grid, 3, 2, measured=[0, 5, 10])
    found = filter.run(grid, data.measurements)
    state = filter.initial()
    for j, now in enumerate(grid):
        if j % 5 == 0:
            state = filter.step(state, now, data.measurements[j, :, 1])
        mean = state.mean if j % 5 == 0 else filter.forecast(state, now).mean
        np.testing.assert_allclose(mean, found.mean[j, :, 1], rtol=1e-9)
