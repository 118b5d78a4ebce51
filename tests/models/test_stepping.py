"""One step of a jump-diffusion: at which state and at which time each part of it is taken."""

import numpy as np
import pytest
import sympy

from seedslib.models import JumpDiffusion, Noise

x, v, z = sympy.symbols("x v z", real=True)
t = sympy.Symbol("t")
CERTAIN = 1e6
"""Intensity at which a step of 0.1 has a jump with all but exp(-1e5) probability."""


def scalar(drift=0, diffusion=0, **options):
    settings = {"mean0": [1.0], "cov0": [[0.0]]} | options
    return JumpDiffusion((x,), [drift], [[diffusion]], [x + v], Noise((v,)), **settings)


def one_step(system, start=0.0, h=0.1, scheme="euler", paths=4, state=1.0):
    rng = np.random.default_rng(1)
    states = np.full((1, paths), state)
    return system.advance(states, start, start + h, rng, step=h, scheme=scheme)[0]


# Heun's scheme where the coefficients depend on time


def test_heun_is_of_second_order_for_a_drift_that_depends_on_time():
    """dX = cos(t) dt: Heun's step is the trapezoidal rule, Euler's the rule of left ends."""
    errors = {}
    for scheme in ("euler", "heun"):
        for h in (0.1, 0.05):
            end = scalar(sympy.cos(t)).simulate([0, 1], 1, 0, step=h, scheme=scheme).states[1, 0, 0]
            errors[scheme, h] = abs(end - 1 - np.sin(1.0))
    assert errors["heun", 0.1] / errors["heun", 0.05] == pytest.approx(4, abs=0.05)
    assert errors["heun", 0.05] == pytest.approx(0.05**2 / 12 * np.sin(1.0), rel=0.01)
    assert errors["euler", 0.1] / errors["euler", 0.05] == pytest.approx(2, abs=0.1)


def test_heun_takes_the_diffusion_at_both_ends_of_a_step():
    """dX = B(t) dW: one step is (B(t) + B(t + h)) / 2 times the increment."""
    start, h = 0.5, 0.4
    kick = one_step(scalar(diffusion=1), start, h, "heun", 6) - 1
    got = one_step(scalar(diffusion=t**2), start, h, "heun", 6) - 1
    np.testing.assert_allclose(got, 0.5 * (start**2 + (start + h) ** 2) * kick, rtol=1e-13)
    got = one_step(scalar(diffusion=t**2), start, h, "euler", 6) - 1
    np.testing.assert_allclose(got, start**2 * kick, rtol=1e-13)


def test_heun_of_a_system_that_depends_on_time_and_state():
    """dX = t X dt: one step is x (1 + h (t + (t + h) (1 + h t)) / 2)."""
    start, h = 0.7, 0.2
    got = one_step(scalar(t * x), start, h, "heun", state=2.0)
    want = 2.0 * (1 + 0.5 * h * (start + (start + h) * (1 + h * start)))
    np.testing.assert_allclose(got, want, rtol=1e-14)


# A jump is drawn at the state and at the time before the step


@pytest.mark.filterwarnings("ignore:step. about")
@pytest.mark.parametrize("scheme", ["euler", "heun"])
def test_a_certain_jump_leaves_from_the_state_before_the_step(scheme):
    """Drift c and the jump -2 x: X = x + c h - 2 x, and not -(x + c h)."""
    system = scalar(3, intensity=CERTAIN, jump=[-2 * x])
    got = one_step(system, h=0.1, scheme=scheme, state=1.5)
    np.testing.assert_allclose(got, 1.5 + 0.3 - 3.0, rtol=1e-13)


@pytest.mark.filterwarnings("ignore:step. about")
def test_the_intensity_is_that_of_the_state_before_the_step():
    """It vanishes at x = 1 and at x + c h = 1.3, and not at the other one of the two."""
    for vanishes, jumps in ((1.0, False), (1.3, True)):
        system = scalar(3, intensity=CERTAIN * (x - vanishes) ** 2, jump=[10])
        got = one_step(system, h=0.1)
        np.testing.assert_allclose(got, 11.3 if jumps else 1.3, rtol=1e-13)


@pytest.mark.filterwarnings("ignore:step. about")
def test_intensity_and_jump_are_those_of_the_time_before_the_step():
    for vanishes, jumps in ((0.5, False), (0.6, True)):
        system = scalar(intensity=CERTAIN * (t - vanishes) ** 2, jump=[10 * t])
        np.testing.assert_allclose(one_step(system, 0.5), 6.0 if jumps else 1.0, rtol=1e-13)


@pytest.mark.filterwarnings("ignore:step. about")
def test_marks_have_their_mean_and_their_covariance():
    """A certain jump by its mark alone: mean 3 and variance 0.25 of 40,000 jumps."""
    marks = Noise((z,), mean=3.0, cov=[[0.25]])
    jumps = one_step(scalar(intensity=CERTAIN, jump=[z], marks=marks), paths=40_000) - 1
    assert jumps.mean() == pytest.approx(3.0, abs=4 * 0.5 / 200)
    assert jumps.var() == pytest.approx(0.25, abs=4 * 0.25 * np.sqrt(2) / 200)


def test_jumps_come_as_often_as_their_intensity_says():
    """mu = 6 t²: steps have a jump with the probability 1 - exp(-6 t² h), one by one."""
    system = scalar(intensity=6 * t**2, jump=[1], step=0.02)
    paths, times = 20_000, np.arange(51) * 0.02
    chance = -np.expm1(-6 * times[:-1] ** 2 * 0.02)
    count = system.simulate([0.0, 1.0], paths, 3).states[1, 0] - 1
    spread = (chance * (1 - chance)).sum()
    assert count.mean() == pytest.approx(chance.sum(), abs=4 * np.sqrt(spread / paths))
    assert count.var() == pytest.approx(spread, rel=4 * np.sqrt(2.5 / paths))
