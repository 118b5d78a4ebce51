import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base import Axis
from seedslib.models import FellerChain, JumpDiffusion, Noise, StochasticMap
from seedslib.models.chains.feller import generator

X, V, Z, T = sympy.symbols("x v z t")


def scalar(drift, diffusion, mean0=0.0, var0=0.25, **options):
    return JumpDiffusion(
        (X,), [drift], [[diffusion]], [X + V], Noise((V,)), [mean0], [[var0]], **options
    )


def test_chain_of_the_flip_process_at_time_one():
    axis = Axis(-3.5, 3.5, 281)
    law, x = FellerChain(zoo.flip_process(), axis).law(1.0), axis.nodes
    found = [law @ x, law @ x**2, law @ x**4]
    assert found == pytest.approx([0.30208, 0.86930, 1.03817], abs=5e-6)
    below = law[x < -1e-9].sum() + 0.5 * law[np.abs(x) < 1e-9].sum()
    assert below == pytest.approx(0.33358, abs=5e-6)


def test_chain_against_simulated_paths():
    system, axis = zoo.flip_process(), Axis(-3.5, 3.5, 281)
    law = FellerChain(system, axis).law(1.0)
    made = system.simulate([0.0, 1.0], 40_000, 7).states[1, 0]
    for power in (1, 2, 4):
        sample = made**power
        error = sample.std() / np.sqrt(len(sample))
        # half a step of Euler's method shifts moments by about step times intensity
        assert abs(law @ axis.nodes**power - sample.mean()) < 4 * error + 2e-3


def test_rates_conserve_mass_and_have_the_right_signs():
    rates = generator(zoo.flip_process(), Axis(-3.5, 3.5, 141))
    assert np.abs(rates.sum(axis=0)).max() < 1e-11 * np.abs(rates).max()
    off = rates - np.diag(np.diagonal(rates))
    assert (off >= 0).all()
    assert (np.diagonal(rates) < 0).all()


@pytest.mark.parametrize("count", [15, 57, 281])
def test_transition_is_a_stochastic_matrix_on_any_grid(count):
    moved = FellerChain(zoo.flip_process(), Axis(-3.5, 3.5, count)).transition(0.0, 0.25)
    assert (moved >= 0).all()
    assert np.abs(moved.sum(axis=0) - 1.0).max() < 1e-14


def test_first_moments_of_the_rates_are_drift_and_diffusion():
    """In the middle of a fine grid sum_i Q_ij (x_i - x_j)^p is a + mu s, then B² + mu s²."""
    jumps = {"intensity": 0.5 + X**2, "jump": [-X + 0.4 * Z], "marks": Noise((Z,))}
    system = scalar(1 - X, sympy.sqrt(1 + X**2 / 4), **jumps)
    axis = Axis(-6.0, 6.0, 1201)
    rates, x = generator(system, axis), axis.nodes
    inside = np.abs(x) < 1.5
    apart = x[:, None] - x
    speed = (rates * apart).sum(axis=0)[inside]
    spread = (rates * apart**2).sum(axis=0)[inside]
    x = x[inside]
    intensity = 0.5 + x**2
    assert np.abs(speed - (1 - x - intensity * x)).max() < 1e-4
    assert np.abs(spread - (1 + x**2 / 4 + intensity * (x**2 + 0.16))).max() < 2e-3


def test_ornstein_uhlenbeck_moments_converge_with_the_square_of_the_step():
    system, errors = scalar(-X, 1, 0.7, 0.2), []
    mean, variance = 0.7 * np.exp(-0.8), 0.2 * np.exp(-1.6) + 0.5 * (1 - np.exp(-1.6))
    for count in (61, 121, 241):
        axis = Axis(-6.0, 6.0, count)
        law = FellerChain(system, axis).law(0.8)
        found = law @ axis.nodes
        errors.append([found - mean, law @ (axis.nodes - found) ** 2 - variance])
    coarse, middle, fine = np.array(errors)
    assert coarse / middle == pytest.approx([4.0, 4.0], rel=0.06)
    assert middle / fine == pytest.approx([4.0, 4.0], rel=0.03)
    assert np.abs(fine).max() < 5e-4


def test_rates_that_depend_on_time():
    """dX = cos(5 t) dt + dW has the mean sin(5 t) / 5, the midpoint rule an error of 8e-5."""
    axis = Axis(-6.0, 6.0, 121)
    chain = FellerChain(scalar(sympy.cos(5 * T), 1, step=0.02), axis)
    for t in (0.4, 1.0):
        assert chain.law(t) @ axis.nodes == pytest.approx(
            np.sin(5 * t) / 5 * (1 + (5 * 0.02) ** 2 / 24), abs=2e-6
        )


def test_array_functions_whose_rates_change_late():
    """dX = dW until time 1, then dX = dt + dW: the change is seen though it comes late."""
    system = JumpDiffusion.from_functions(
        lambda t, x: np.full(x.shape, float(t >= 1.0)),
        lambda t, x: np.ones((1, 1, *x.shape[1:])),
        scalar(0, 1).sensor,
        [0.0],
        [[0.25]],
        step=0.05,
    )
    chain = FellerChain(system, Axis(-7.0, 9.0, 161))
    early = chain.transition(0.0, 1.0) @ chain.start()
    late = chain.transition(1.0, 2.0) @ early
    assert early @ chain.axis.nodes == pytest.approx(0.0, abs=1e-9)
    assert late @ chain.axis.nodes == pytest.approx(1.0, abs=1e-6)
    assert chain.transition(0.0, 0.5) is chain.transition(0.2, 0.7)


def test_no_diffusion_moves_mass_upwind():
    axis = Axis(0.0, 4.0, 401)
    law = FellerChain(scalar(1, 0, 1.0, 0.01), axis).law(1.0)
    assert (law >= 0).all()
    assert law @ axis.nodes == pytest.approx(2.0, abs=1e-9)


def test_jumps_without_spread_and_a_known_start():
    """No jump in [0, t] has probability exp(-2 t); each jump adds one."""
    system = scalar(0, 0, 0.0, 0.0, intensity=2, jump=[1])
    law = FellerChain(system, Axis(0.0, 20.0, 81)).law(0.6)
    counts = law[::4]
    expected = [np.exp(-1.2) * 1.2**k / np.prod(np.arange(1.0, k + 1)) for k in range(8)]
    assert counts[:8] == pytest.approx(expected, abs=1e-12)
    assert law.sum() == pytest.approx(1.0, abs=1e-14)


def test_jump_that_is_not_affine_in_its_mark():
    """s = z² - 1 has mean 0 and second moment 2."""
    system = scalar(0, sympy.Rational(1, 2), intensity=3, jump=[Z**2 - 1], marks=Noise((Z,)))
    axis = Axis(-20.0, 40.0, 601)
    law, x = FellerChain(system, axis).law(0.5), axis.nodes
    assert law @ x == pytest.approx(0.0, abs=1e-6)
    assert law @ x**2 == pytest.approx(0.25 + 0.125 + 3.0, abs=0.01)


def test_probability_without_jump_for_a_frozen_state():
    """X ~ N(0, 1) frozen, intensity x²: (1 + 2 t)^(-1/2). A jump leads far away."""
    system = scalar(0, 0, 0.0, 1.0, intensity=X**2, jump=[40 - X])
    axis = Axis(-6.0, 40.0, 921)
    law = FellerChain(system, axis).law(0.5)
    assert law[axis.nodes < 20].sum() == pytest.approx(2.0**-0.5, abs=1e-4)


def test_bad_systems():
    axis = Axis(-3.0, 3.0, 31)
    with pytest.raises(ValueError, match="one state component for a grid, got 2"):
        FellerChain(zoo.van_der_pol(), axis)
    with pytest.raises(ValueError, match="intensity: wanted finite nonnegative numbers"):
        generator(scalar(0, 1, intensity=X, jump=[1]), axis)
    marks = Noise((Z,), sample=lambda rng, count: rng.uniform(-1, 1, (1, count)), cov=[[1 / 3]])
    with pytest.raises(ValueError, match="jump: wanted Gaussian marks"):
        generator(scalar(0, 1, intensity=1, jump=[Z], marks=marks), axis)
    with pytest.raises(ValueError, match="wanted a Gaussian initial law"):
        FellerChain(
            scalar(0, 1, initial=lambda rng, count: rng.uniform(-1, 1, (1, count))), axis
        ).start()
    blind = JumpDiffusion.from_functions(
        lambda t, x: -x,
        lambda t, x: np.ones((1, 1, *x.shape[1:])),
        StochasticMap.from_functions(1, 1, lambda t, x, v: x + v**3, Noise(1)),
        [0.0],
        [[1.0]],
    )
    with pytest.raises(ValueError, match="whose likelihood has no closed form"):
        FellerChain(blind, axis)
    with pytest.raises(ValueError, match="stop: wanted a time after 1"):
        FellerChain(scalar(0, 1), axis).transition(1.0, 1.0)


def test_a_short_axis_is_reported():
    chain = FellerChain(scalar(0, 1, 0.0, 4.0), Axis(-1.0, 1.0, 21))
    with pytest.warns(UserWarning, match="in an outermost cell; the axis is too short"):
        chain.look_at_ends(chain.start())
