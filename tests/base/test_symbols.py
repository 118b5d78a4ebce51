"""Symbols have one meaning each, and no text is ever run."""

import numpy as np
import pytest
import sympy as sp

from seedslib.base.symbols import require_distinct, require_known, require_number
from seedslib.gaussian import (
    approximate_errors,
    classify,
    expectation,
    expectation_function,
    hermite_expansion,
    mean_square_errors,
    posterior_variance_function,
)
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem
from seedslib.piecewise import PiecewiseLinearSystem
from seedslib.two_step import AugmentedDiffusion, LinearDiffusion, TwoStepEstimator

X, V, W, T, K = sp.symbols("x v w t k")
UNIT = [[1.0]]


def linear():
    return LinearDiffusion(
        drift=-1, noise_intensity=0.5, sensor=1, sensor_intensity=0.1, mean0=0, cov0=4
    )


def diffusion(state=(X,), noise=(V,), sensor=None, **others):
    drift = others.pop("drift", [-s for s in state])
    n = len(state)
    return JumpDiffusion(
        state, drift, np.eye(n).tolist(), sensor or [state[0] + noise[-1]], Noise(noise),
        np.zeros(n), np.eye(n), **others,
    )  # fmt: skip


def switching(state=(X,), noise=(V,), sensor_noise=(W,), indicator=None, **others):
    return SwitchingSystem(
        state, [[state[0] / 2 + noise[0]]], Noise(noise), [[1]], [[state[0] + sensor_noise[0]]],
        Noise(sensor_noise), [(1, np.zeros(len(state)), np.eye(len(state)))], indicator=indicator,
        **others,
    )  # fmt: skip


def piecewise(state=(X,), dynamics=(X / 2,), sensor=(X + V,), noise=V, **others):
    return PiecewiseLinearSystem.from_functions(
        state=state, dynamics=dynamics, sensor=sensor, breakpoints=[-1.0, 0.0, 1.0],
        initial=([0.0], UNIT), noise=noise, **others,
    )  # fmt: skip


TWICE = {
    "jump-diffusion, state and noise": lambda: diffusion((X, V), (V,)),
    "jump-diffusion, states": lambda: diffusion((X, X)),
    "jump-diffusion, parameter and state": lambda: diffusion(parameters={X: 5}),
    "jump-diffusion, parameter and noise": lambda: diffusion(parameters={V: 5}),
    "jump-diffusion, parameter and time": lambda: diffusion(parameters={T: 5}),
    "jump-diffusion, time and state": lambda: diffusion(time=X),
    "jump-diffusion, marks and state": lambda: diffusion(
        intensity=1, jump=[X], marks=Noise((X,))
    ),
    "jump-diffusion, marks and noise": lambda: diffusion(
        intensity=1, jump=[V], marks=Noise((V,))
    ),
    "map, state and noise": lambda: StochasticMap((X, V), [X + V], Noise((V,))),
    "map, states": lambda: StochasticMap((X, X), [X], Noise()),
    "map, time": lambda: StochasticMap((X,), [X], Noise((V,)), time=V),
    "noise": lambda: Noise((V, V)),
    "switching, state and noise": lambda: switching(noise=(X,)),
    "switching, state and sensor noise": lambda: switching(sensor_noise=(X,)),
    "switching, parameter": lambda: switching(parameters={X: 1}),
    "piecewise, state and noise": lambda: piecewise(noise=X, sensor=(X,)),
    "piecewise, time": lambda: piecewise(time=X),
    "piecewise, parameter": lambda: piecewise(parameters={X: 1}),
    "augmented": lambda: AugmentedDiffusion(linear(), X**2, [X], X),
    "mean": lambda: expectation_function(X, [X, X]),
    "discrete": lambda: DiscreteSystem(
        StochasticMap((X, V), [X, V], Noise()),
        StochasticMap((X, K), [X + V], Noise((V,))),
        np.zeros(2), np.eye(2),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TWICE)
def test_one_symbol_has_one_meaning(name):
    with pytest.raises(ValueError, match="wanted distinct symbols"):
        TWICE[name]()


def test_two_maps_may_name_their_noises_alike():
    """Each map has a noise of its own; a symbol says which, inside one map."""
    made = switching(noise=(V,), sensor_noise=(V,))
    assert made.noise == made.sensor_noise


def strings(text):
    """Every public place that takes an expression, a symbol or a value of a parameter."""
    augmented = {"f": text, "variables": [X], "symbol": K}
    return {
        "estimator": lambda: TwoStepEstimator(linear(), text, variables=[X]),
        "estimator, list": lambda: TwoStepEstimator(linear(), [X, text], variables=[X]),
        "augmented f": lambda: AugmentedDiffusion(linear(), **augmented),
        "augmented drift": lambda: AugmentedDiffusion(linear(), X**2, [X], K, drift=text),
        "augmented symbol": lambda: AugmentedDiffusion(linear(), X**2, [X], text),
        "classify": lambda: classify(text, [X]),
        "expectation": lambda: expectation(text, [X], [0], sp.eye(1)),
        "expectation mean": lambda: expectation(X, [X], [text], sp.eye(1)),
        "expectation cov": lambda: expectation(X, [X], [0], [[text]]),
        "expectation variables": lambda: expectation(X, [text], [0], sp.eye(1)),
        "expectation parameters": lambda: expectation(X, [X], [0], sp.eye(1), parameters=[text]),
        "expectation_function": lambda: expectation_function(text, [X]),
        "mean_square_errors": lambda: mean_square_errors(text, [X]),
        "approximate_errors": lambda: approximate_errors(text, [X]),
        "posterior variance": lambda: posterior_variance_function(text, [X]),
        "hermite": lambda: hermite_expansion(text, [X], [0], UNIT, UNIT),
        "drift": lambda: diffusion(drift=[text]),
        "parameter": lambda: diffusion(drift=[-K * X], parameters={K: text}),
        "parameter, np.str_": lambda: diffusion(drift=[-K * X], parameters={K: np.str_(text)}),
        "parameter name": lambda: diffusion(parameters={text: 1}),
        "state": lambda: diffusion(state=(text,), drift=[0], sensor=[V]),
        "time": lambda: diffusion(time=text),
        "map value": lambda: StochasticMap((X,), [text]),
        "map weight": lambda: StochasticMap((X,), [X], weight=text),
        "map state": lambda: StochasticMap((text,), [X]),
        "map time": lambda: StochasticMap((X,), [X], time=text),
        "noise": lambda: Noise((text,)),
        "noise, bare": lambda: Noise(text),
        "noise mean": lambda: Noise((V,)).expectation(text),
        "switching parameter": lambda: switching(parameters={K: text}),
        "switching indicator": lambda: switching(indicator=[[text]]),
        "piecewise dynamics": lambda: piecewise(dynamics=[text]),
        "piecewise sensor": lambda: piecewise(sensor=[text]),
        "piecewise parameter": lambda: piecewise(dynamics=[K * X], parameters={K: text}),
        "piecewise parameter name": lambda: piecewise(parameters={text: 1}),
        "piecewise state": lambda: piecewise(state=(text,)),
        "piecewise time": lambda: piecewise(time=text),
    }


@pytest.mark.parametrize("name", strings(""))
def test_no_string_is_run(name, tmp_path):
    """The text would make a file if anything evaluated it."""
    proof = tmp_path / "run"
    with pytest.raises(TypeError):
        strings(f"__import__('pathlib').Path({str(proof)!r}).touch()")[name]()
    assert not proof.exists()


def test_a_string_in_a_place_of_a_number_is_refused_by_name():
    with pytest.raises(TypeError, match=r"parameters\[k\]: .* got the string '2'"):
        diffusion(drift=[-K * X], parameters={K: "2"})


@pytest.mark.parametrize("assumptions", [{"real": True}, {"positive": True}])
def test_a_name_with_other_assumptions_is_named(assumptions):
    other = sp.Symbol("t", **assumptions)
    with pytest.raises(ValueError, match="got t with assumptions other than those of the known t"):
        diffusion(drift=[-other * X])
    own = sp.Symbol("x", **assumptions)
    with pytest.raises(ValueError, match="got x with assumptions other"):
        expectation_function(own**2, [X])
    with pytest.raises(ValueError, match="got x with assumptions other"):
        StochasticMap((X,), [own])
    assert diffusion(drift=[-other * X], time=other).drift(2.0, np.ones((1, 1))) == -2.0


NO_NUMBER = {
    "an unknown function": (sp.Function("f")(X), r"f\(x\)"),
    "a sum": (sp.Sum(X**K, (K, 0, 3)), r"Sum\(x\*\*k"),
    "an infinity": (X + sp.zoo, "zoo"),
    "NaN": (sp.nan, "nan"),
    "a large number": (sp.Integer(10) ** 400 * X, "range of float64"),
    "a large constant": (X * sp.exp(1000), "range of float64"),
    "an imaginary number": (sp.I * X, r"I\*x"),
    "a derivative": (sp.Derivative(sp.Function("f")(X), X), r"f\(x\)"),
    "an integral": (sp.Integral(sp.exp(-(K**2)), (K, 0, X)), "Integral"),
}


@pytest.mark.parametrize("name", NO_NUMBER)
def test_what_has_no_value_is_refused_where_it_is_given(name):
    expression, found = NO_NUMBER[name]
    with pytest.raises(ValueError, match=found):
        StochasticMap((X,), [expression])
    with pytest.raises(ValueError, match=found):
        diffusion(drift=[expression]).drift(0.0, np.ones((1, 2)))
    with pytest.raises(ValueError, match=found):
        piecewise(dynamics=[expression])


def test_a_sum_that_was_carried_out_is_taken():
    value = StochasticMap((X,), [sp.Sum(X**K, (K, 0, 3)).doit()])
    assert value.value(0.0, np.array([2.0]), np.empty(0)) == 15.0


def test_groups_and_known_symbols():
    require_distinct(state=(X,), noise=None, time=(T,))
    with pytest.raises(ValueError, match="state, noise: wanted distinct symbols, got x in both"):
        require_distinct(state=(X, K), noise=(V, X))
    with pytest.raises(ValueError, match="state: wanted distinct symbols, got x twice"):
        require_distinct(state=(X, X))
    with pytest.raises(TypeError, match="state: wanted SymPy symbols, got 1"):
        require_distinct(state=(1,))
    require_known("f", [X + K], {X, K})
    require_number("f", sp.Rational(10**400, 10**399) * X)
