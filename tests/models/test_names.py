"""Names of symbols carry no meaning, noises are values, and steps have no derivative."""

import numpy as np
import pytest
import sympy as sp

from seedslib.filters import extended_kalman, unscented_kalman
from seedslib.gaussian import expectation, expectation_function
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem
from seedslib.models.codegen import compile_array

X, V, W = sp.symbols("x v w")
TIMES = np.arange(4.0)


@pytest.mark.parametrize("name", ["u0_", "u1_", "u2_", "u3_", "u4_", "u5_"])
def test_a_state_may_have_any_name(name):
    """Simulation compiles with dummies, whose stand-ins once took such names."""

    def simulated(state):
        system = JumpDiffusion(
            (state,), [-state], [[1]], [state + W], Noise((W,)), [0.0], [[1.0]], step=0.1
        )
        return system.simulate([0.0, 1.0], 50, 1, scheme="heun").states

    np.testing.assert_array_equal(simulated(sp.Symbol(name)), simulated(sp.Symbol("q")))


def test_stand_ins_of_dummies_take_free_names_only():
    taken = sp.symbols("u0_ u1_ u2_")
    dummy, other = sp.Dummy(), sp.Dummy()
    value = compile_array((taken, dummy, (other,)), [taken[0] + 10 * dummy + 100 * other])
    assert value((1.0, 5.0, 7.0), 2.0, (3.0,)) == 321.0


def test_noises_are_compared_by_what_they_are():
    def draw(rng, count):
        return rng.standard_t(5, (2, count))

    noise = Noise((V, W), cov=[[2.0, 1.0], [1.0, 3.0]])
    same = Noise([V, W], [0.0, -0.0], [[2.0, 1.0], [1.0, 3.0]])
    assert noise == same
    assert hash(noise) == hash(same)
    others = (
        Noise((W, V), cov=noise.cov), Noise((V, W)), Noise((V, W), [0.0, 1.0], noise.cov),
        Noise(2, cov=noise.cov), Noise((V,)), Noise((V, W), cov=noise.cov, sample=draw), "noise",
    )  # fmt: skip
    assert not any(noise == other for other in others)
    assert len({noise, *others}) == 8


STEPS = (sp.sign(X), sp.Heaviside(X), sp.floor(X), sp.Mod(X, 2))


@pytest.mark.parametrize("step", STEPS, ids=str)
def test_a_step_is_refused_by_taylor_in_a_sentence_and_works_elsewhere(step):
    system = DiscreteSystem(
        StochasticMap((X,), [X / 2 + V], Noise((V,))),
        StochasticMap((X,), [X + step + W], Noise((W,))),
        [0.0], [[1.0]],
    )  # fmt: skip
    data = system.simulate(TIMES, 20, 1)
    y = data.measurements
    with pytest.raises(ValueError, match=r"wanted functions with NumPy code, got .*Unscented"):
        extended_kalman(system).run(TIMES, y)
    assert np.isfinite(unscented_kalman(system).run(TIMES, y).mean).all()


def test_a_switching_function_whose_variables_cancel_is_a_constant():
    """Ended in StopIteration; the mean of 1{3 > 0} is 1."""
    flat = (X + 1) ** 2 - X**2 - 2 * X + 2
    mean = expectation_function(sp.Heaviside(flat) * X**2, [X])
    assert mean([2.0], [[1.0]]) == 5.0
    assert expectation_function(sp.erf(flat), [X])([2.0], [[1.0]]) == pytest.approx(
        float(sp.erf(3)), rel=1e-15
    )
    assert expectation(sp.sign(-flat), [X], [0], sp.eye(1)) == -1


def test_an_indicator_of_the_wrong_kind_is_refused_by_name():
    def system(indicator):
        return SwitchingSystem(
            (X,), [[X / 2 + V]], Noise((V,)), [[1]], [[X + W]], Noise((W,)), [(1, [0.0], [[1.0]])],
            indicator=indicator,
        )  # fmt: skip

    for wrong in ({0: [1]}, "1", [["1"]], [[X > 0]], [[None]], object(), iter([[1]])):
        with pytest.raises(TypeError, match="indicator: wanted SymPy expressions"):
            system(wrong)
    made = system(None)
    move, reading = StochasticMap((X,), [X / 2 + V], made.noise), made.readings[0][0].map
    for table in (None, [], [[]], [move], [[None]], 3):
        with pytest.raises(TypeError, match="moves: wanted rows of StochasticMap"):
            SwitchingSystem.from_maps(table, [[reading]], made.initial)
        with pytest.raises(TypeError, match="readings: wanted rows of StochasticMap"):
            SwitchingSystem.from_maps([[move]], table, made.initial)
    for wrong in (None, "seen", np.ones(2), [1]):
        with pytest.raises(TypeError, match="indicator: wanted True"):
            SwitchingSystem.from_maps([[move]], [[reading]], made.initial, indicator=wrong)
    assert SwitchingSystem.from_maps(iter([[move]]), [[reading]], made.initial).modes == 1
