"""Jump-diffusions: closed rates, and steps whose moments are those of the scheme."""

import pickle

import numpy as np
import pytest
import sympy

from oracles.linear import moment_rates
from seedslib.base import Parameter
from seedslib.models import JumpDiffusion, Noise
from systems import COV0, INPUTS, MEAN0, TIMES, U, continuous_numbers, continuous_system

x, y, v, z = sympy.symbols("x y v z", real=True)
t = sympy.Symbol("t")
CERTAIN = 1e6
"""Intensity at which a step of 0.1 has a jump with all but exp(-1e5) probability."""


def scalar(drift=0, diffusion=0, **options):
    settings = {"mean0": [1.0], "cov0": [[0.0]], "step": 0.01} | options
    return JumpDiffusion((x,), [drift], [[diffusion]], [x + v], Noise((v,)), **settings)


def one_step(system, start=0.0, h=0.1, scheme="euler", paths=4, state=1.0):
    rng, states = np.random.default_rng(1), np.full((1, paths), state)
    return system.advance(states, start, start + h, rng, step=h, scheme=scheme)[0]


def euler_moments(model, start, stop, steps, m, second, u):
    """E X and E XX' after Euler steps: a jump comes in a step with chance 1 - exp(-mu h)."""
    h = (stop - start) / steps
    for s in start + h * np.arange(steps):
        G, C = np.eye(2) + model.A(s) * h, model.C(s)
        shift, k = (model.a(s) + model.B(s) * u) * h, model.k(s)
        chance, mark = -np.expm1(-model.mu(s) * h), model.mark_mean
        diffused = model.G(s) @ model.G(s).T * h

        def product(A, a, B, b, m=m, second=second):
            """E (A X + a)(B X + b)'."""
            return A @ second @ B.T + np.outer(A @ m, b) + np.outer(a, B @ m) + np.outer(a, b)

        both = product(G, shift, C, k * mark)
        jumped = product(C, k * mark, C, k * mark) + model.mark_cov * np.outer(k, k)
        second = product(G, shift, G, shift) + diffused + chance * (both + both.T + jumped)
        m = G @ m + shift + chance * (C @ m + k * mark)
    return m, second


@pytest.mark.filterwarnings("ignore:step. about")
def test_coarse_steps_have_the_moments_of_eulers_scheme():
    """Everything depends on time, from a late start, with an input and unequal steps."""
    system, model, paths = continuous_system(step=0.1), continuous_numbers(), 20_000
    inputs = {U: INPUTS[U][:4]}
    data = system.simulate(TIMES[:4], paths, 1, inputs=inputs)
    m, second = MEAN0[:2], COV0[:2, :2] + np.outer(MEAN0[:2], MEAN0[:2])
    H, d, R = model.sensor(TIMES[:4], INPUTS[U][:4])
    for k in range(4):
        if k:
            steps = round((TIMES[k] - TIMES[k - 1]) / 0.1)
            m, second = euler_moments(
                model, TIMES[k - 1], TIMES[k], steps, m, second, INPUTS[U][k - 1]
            )
        states = data.states[k]
        squares = np.einsum("iN,jN->ijN", states, states)
        error = 4.5 / np.sqrt(paths)
        assert (np.abs(states.mean(axis=1) - m) < error * states.std(axis=1)).all()
        assert (np.abs(squares.mean(axis=2) - second) < error * squares.std(axis=2)).all()
        noise = data.measurements[k] - H[k] @ states - d[k][:, None]
        assert (np.abs(noise.mean(axis=1)) < error * np.sqrt(np.diagonal(R[k]))).all()
        np.testing.assert_allclose(np.cov(noise), R[k], atol=0.05)


@pytest.mark.filterwarnings("ignore:step. about")
def test_rates_are_those_of_the_moments():
    system, at = continuous_system(step=0.05), np.random.default_rng(0).normal(size=(2, 5))
    model, lower = continuous_numbers(), np.tril_indices(2)
    for now in (1.5, 2.3):
        velocity, spread = (
            part.value(now, at, np.empty((0, 5)), (0.6,))
            for part in (system.drift_map, system.spread_map)
        )
        np.testing.assert_allclose(system.intensity(now, at, (0.6,)), model.mu(now))
        for k in range(5):
            wanted, square = moment_rates(model, now, at[:, k], np.zeros((2, 2)), 0.6)
            np.testing.assert_allclose(velocity[:, k], wanted, rtol=1e-9)
            np.testing.assert_allclose(spread[:, k], square[lower], rtol=1e-9)


# The scheme of Heun


def test_heun_converges_to_the_integral_of_ito_path_by_path():
    """dX = s dW, dY = c X dW, dZ = Y dt + g X Y dW: Ito's formula gives Y and the mean of Z.

    Y = c (X^2 - s^2 t) / (2 s) on every path and for any step; the martingale part of Z has mean
    zero, which a drift that lacks one of the cross derivatives of the diffusion would move.
    """
    s, c, g, paths = 0.8, 1.5, 0.7, 20_000
    system = JumpDiffusion(
        (x, y, z),
        [0, 0, 0],
        [[s, 0], [c * x, 0], [g * x * y, x]],
        [x + v],
        Noise((v,)),
        [0.0] * 3,
        np.zeros((3, 3)),
        step=0.05,
    )
    states = system.simulate([0.0, 0.5, 1.2], paths, 3, scheme="heun").states
    for k, now in enumerate((0.0, 0.5, 1.2)):
        first, second, third = states[k]
        np.testing.assert_allclose(second, c * (first**2 - s**2 * now) / (2 * s), atol=1e-12)
        assert abs(third.mean()) <= 4 * third.std() / np.sqrt(paths)


def test_heun_takes_the_coefficients_at_both_ends_of_a_step():
    """Drift t x: x (1 + h (t + (t + h)(1 + h t)) / 2); diffusion t^2: the mean of both ends."""
    start, h = 0.7, 0.2
    got = one_step(scalar(t * x), start, h, "heun", state=2.0)
    want = 2.0 * (1 + 0.5 * h * (start + (start + h) * (1 + h * start)))
    np.testing.assert_allclose(got, want, rtol=1e-14)
    kick = one_step(scalar(diffusion=1), start, h, "heun") - 1
    for scheme, factor in (("heun", 0.5 * (start**2 + (start + h) ** 2)), ("euler", start**2)):
        got = one_step(scalar(diffusion=t**2), start, h, scheme) - 1
        np.testing.assert_allclose(got, factor * kick, rtol=1e-13)


# Jumps


@pytest.mark.filterwarnings("ignore:step. about")
@pytest.mark.parametrize("scheme", ["euler", "heun"])
def test_jump_and_intensity_are_those_before_the_step(scheme):
    """Drift 3 and the jump -2 x; intensities that vanish at one end of the step in x or in t."""
    got = one_step(scalar(3, intensity=CERTAIN, jump=[-2 * x]), scheme=scheme, state=1.5)
    np.testing.assert_allclose(got, 1.5 + 0.3 - 3.0, rtol=1e-13)
    for vanishes, jumps in ((1.0, False), (1.3, True)):
        system = scalar(3, intensity=CERTAIN * (x - vanishes) ** 2, jump=[10])
        np.testing.assert_allclose(one_step(system, scheme=scheme), 11.3 if jumps else 1.3)
    for vanishes, jumps in ((0.5, False), (0.6, True)):
        system = scalar(intensity=CERTAIN * (t - vanishes) ** 2, jump=[10 * t])
        got = one_step(system, 0.5, scheme=scheme)
        np.testing.assert_allclose(got, 6.0 if jumps else 1.0, rtol=1e-13)


def test_jumps_of_many_steps_and_a_step_that_is_too_coarse_for_them():
    """Numbers of jumps are sums of independent chances; 400 jumps a unit lose a fifth at 0.001."""
    system, paths = scalar(intensity=6 * t**2, jump=[1], step=0.02), 20_000
    chance = -np.expm1(-6 * (np.arange(50) * 0.02) ** 2 * 0.02)
    count = system.simulate([0.0, 1.0], paths, 3).states[1, 0] - 1
    spread = (chance * (1 - chance)).sum()
    assert count.mean() == pytest.approx(chance.sum(), abs=4 * np.sqrt(spread / paths))
    assert count.var() == pytest.approx(spread, rel=4 * np.sqrt(2.5 / paths))
    system = scalar(intensity=400, jump=[-x], step=0.001, mean0=[5.0])
    with pytest.warns(UserWarning, match=r"0\.2 of the jumps"):
        final = system.simulate([0.0, 0.5], 200, 0).states[1, 0]
    assert (final == 0).all()


@pytest.mark.parametrize("rate", [-1, 1 / (1 - x), sympy.log(x - 2)])
def test_bad_intensities_are_found_when_they_occur(rate):
    system = scalar(intensity=rate, jump=[1])
    with np.errstate(all="ignore"), pytest.raises(ValueError, match="intensity"):
        system.simulate([0.0, 1.0], 2, 0)


# What a system is made of


def test_an_initial_dist_may_be_sampled_and_parameters_may_be_put_in():
    system = scalar(initial=lambda rng, count: rng.uniform(0, 2, (1, count)), cov0=[[1 / 3]])
    start = system.simulate([0.0], 10_000, 0).states[0, 0]
    assert start.min() >= 0
    assert start.mean() == pytest.approx(1, abs=4 / np.sqrt(30_000))
    assert not system.prior.gaussian
    s = sympy.Symbol("s")
    fixed = scalar(drift=s * x, parameters={s: 3})
    assert fixed.drift(0.0, np.array([[2.0, 1.0]])).tolist() == [[6, 3]]
    free = Parameter("q", 0.5)
    system = scalar(diffusion=free * x)
    assert system.parameters == (free,)
    again = pickle.loads(pickle.dumps(system.bind(q=2.0)))
    assert again.diffusion(0.0, np.ones((1, 1))).item() == 2.0
    assert system.diffusion(0.0, np.ones((1, 1))).item() == 0.5
