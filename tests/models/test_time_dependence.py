"""A jump-diffusion of which everything depends on time: simulated moments and the maps of rates."""

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from seedslib.models import JumpDiffusion, Noise, StochasticMap

x, v, z = sympy.symbols("x v z", real=True)
t = sympy.Symbol("t")
MARK, SPREAD = 0.6, 0.5

SYSTEM = JumpDiffusion(
    (x,), [-(1 + t) * x + sympy.cos(3 * t)], [[1 + t]],
    [(1 + t) * x + t * v], Noise((v,), mean=0.8, cov=[[0.3]]), [1.0], [[0.4]],
    intensity=2 * t, jump=[-t * x / 2 + (1 + t) * z], marks=Noise((z,), mean=MARK, cov=[[SPREAD]]),
)  # fmt: skip


def coefficients(t):
    """a, b, B, mu, c, d of dX = (a X + b) dt + B dW and jumps c X + d z with intensity mu."""
    return -(1 + t), np.cos(3 * t), 1 + t, 2 * t, -t / 2, 1 + t


def moment_equations(t, moments):
    """Rates of E X and E X² by Itô's formula."""
    a, b, B, mu, c, d = coefficients(t)
    m, q = moments
    square = c**2 * q + 2 * c * d * MARK * m + d**2 * (SPREAD + MARK**2)
    rate = 2 * (a * q + b * m) + B**2 + mu * (2 * (c * q + d * MARK * m) + square)
    return [a * m + b + mu * (c * m + d * MARK), rate]


def euler_moments(start, stop, h):
    """E X and E X² of the scheme itself: a jump comes in a step with chance 1 - exp(-mu h)."""
    m, q = 1.0, 1.4
    for k in range(round((stop - start) / h)):
        a, b, B, mu, c, d = coefficients(start + k * h)
        chance, g, s = -np.expm1(-mu * h), 1 + a * h, b * h
        both = g * c * q + (g * d * MARK + s * c) * m + s * d * MARK
        square = c**2 * q + 2 * c * d * MARK * m + d**2 * (SPREAD + MARK**2)
        q = g**2 * q + 2 * g * s * m + s**2 + B**2 * h + chance * (2 * both + square)
        m = g * m + s + chance * (c * m + d * MARK)
    return m, q


def agrees(drawn, mean, square):
    """Sampled mean and mean square within four standard errors."""
    root = np.sqrt(drawn.size)
    assert abs(drawn.mean() - mean) < 4 * drawn.std() / root
    assert abs((drawn**2).mean() - square) < 4 * (drawn**2).std() / root


@pytest.mark.filterwarnings("ignore:step. about")
@pytest.mark.parametrize("start", [0.0, 0.5])
def test_coarse_steps_have_the_moments_of_the_scheme(start):
    """Steps of 0.1, so that one step early or late shows."""
    states = SYSTEM.simulate([start, start + 1.0], 20_000, 1, step=0.1).states
    agrees(states[1, 0], *euler_moments(start, start + 1.0, 0.1))


def test_fine_steps_have_the_moments_of_the_equation():
    states = SYSTEM.simulate([0.0, 0.4, 1.0], 10_000, 2, step=0.004).states
    exact = solve_ivp(moment_equations, (0, 1), [1.0, 1.4], t_eval=[0.4, 1.0], rtol=1e-9).y
    for k in (0, 1):
        agrees(states[k + 1, 0], *exact[:, k])


def test_array_functions_are_asked_for_the_same_times():
    """The system as array functions: the same paths."""
    numeric = JumpDiffusion.from_functions(
        lambda t, x: -(1 + t) * x + np.cos(3 * t),
        lambda t, x: np.full((1, 1, *x.shape[1:]), 1 + t),
        StochasticMap.from_functions(
            1, 1, lambda t, x, v: (1 + t) * x + t * v, Noise(1, 0.8, [[0.3]])
        ),
        [1.0], [[0.4]],
        intensity=lambda t, x: np.full(x.shape[1:], 2 * t),
        jump=StochasticMap.from_functions(
            1, 1, lambda t, x, z: -t * x / 2 + (1 + t) * z, Noise(1, MARK, [[SPREAD]])
        ),
    )  # fmt: skip
    a, b = (s.simulate([0.0, 0.3, 1.0], 200, 4, step=0.02) for s in (SYSTEM, numeric))
    np.testing.assert_allclose(a.states, b.states, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(a.measurements, b.measurements, rtol=1e-10, atol=1e-12)
    states, none = np.array([[0.3, -1.2]]), np.empty((0, 2))
    for name in ("drift_map", "spread_map"):
        one, two = (getattr(s, name).value(0.7, states, none) for s in (SYSTEM, numeric))
        np.testing.assert_allclose(one, two, rtol=1e-9)


def test_measurements_are_made_at_their_own_times():
    """Y = (1 + t) X + t V: given the states its mean and variance are known."""
    data = SYSTEM.simulate([0.0, 0.5, 1.5], 20_000, 5)
    for k, now in enumerate(data.times):
        noise = data.measurements[k, 0] - (1 + now) * data.states[k, 0]
        assert abs(noise.mean() - 0.8 * now) <= 4 * now * np.sqrt(0.3 / 20_000) + 1e-12
        assert noise.var() == pytest.approx(0.3 * now**2, rel=4 * np.sqrt(2 / 20_000), abs=1e-12)


def test_rates_of_mean_and_covariance():
    """b = a x + b + mu E s and Sigma = B² + mu E s² at several times."""
    states, none = np.array([[0.3, -1.2]]), np.empty((0, 2))
    for now in (0.0, 0.4, 1.3):
        a, b, B, mu, c, d = coefficients(now)
        mean = (a * states + b) + mu * (c * states + d * MARK)
        square = B**2 + mu * ((c * states + d * MARK) ** 2 + d**2 * SPREAD)
        np.testing.assert_allclose(SYSTEM.drift_map.value(now, states, none), mean, rtol=1e-12)
        np.testing.assert_allclose(SYSTEM.spread_map.value(now, states, none), square, rtol=1e-12)
