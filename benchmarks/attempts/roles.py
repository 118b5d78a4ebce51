"""Places of a model that take formulas and symbols: strings there, and one symbol in two roles."""

from __future__ import annotations

import numpy as np
import sympy

from attempts.targets import linear_diffusion
from seedslib.base import Parameter
from seedslib.gaussian import (
    approximate_errors,
    classify,
    expectation,
    expectation_function,
    mean_square_errors,
)
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem
from seedslib.two_step import AugmentedDiffusion, TwoStepEstimator

X, V, W, T = sympy.symbols("x v w t")


ALONE = (sympy.Lambda, sympy.MatrixExpr)
"""Nothing can be added to these."""


def moves(f):
    f = f + V if isinstance(f, sympy.Expr) and not isinstance(f, ALONE) else f
    return DiscreteSystem(
        StochasticMap((X,), [f], Noise((V,))),
        StochasticMap((X,), [X + W], Noise((W,))),
        [0.0],
        [[1.0]],
    )


def shows(f):
    f = f + W if isinstance(f, sympy.Expr) and not isinstance(f, ALONE) else f
    return DiscreteSystem(
        StochasticMap((X,), [X / 2 + V], Noise((V,))),
        StochasticMap((X,), [f], Noise((W,))),
        [0.0],
        [[1.0]],
    )


def drifts(f):
    return JumpDiffusion((X,), [f], [[1]], [X + W], Noise((W,)), [0.0], [[1.0]], step=0.25)


PLACES = {"dynamics": moves, "sensor": shows, "drift": drifts}


def _two_modes(**given):
    good = {
        "dynamics": [[X + V], [X / 2 + V]],
        "switching": [[0.5, 0.5]] * 2,
        "sensor": [[X + W]] * 2,
        "indicator": None,
    }
    good |= given
    return SwitchingSystem(
        (X,),
        good["dynamics"],
        Noise((V,)),
        good["switching"],
        good["sensor"],
        Noise((W,)),
        [(0.5, [0], [[1]])] * 2,
        indicator=good["indicator"],
    )


STRINGS = {
    "drift": drifts,
    "dynamics": moves,
    "sensor": shows,
    "diffusion": lambda s: JumpDiffusion((X,), [-X], [[s]], [X + W], Noise((W,)), [0], [[1]]),
    "intensity": lambda s: JumpDiffusion(
        (X,), [-X], [[1]], [X + W], Noise((W,)), [0], [[1]], intensity=s, jump=[1]
    ),
    "jump": lambda s: JumpDiffusion(
        (X,), [-X], [[1]], [X + W], Noise((W,)), [0], [[1]], intensity=1, jump=[s]
    ),
    "parameter": lambda s: JumpDiffusion(
        (X,), [-X * V], [[1]], [X + W], Noise((W,)), [0], [[1]], parameters={V: s}
    ),
    "name of a parameter": lambda s: JumpDiffusion(
        (X,), [-X], [[1]], [X + W], Noise((W,)), [0], [[1]], parameters={s: 1}
    ),
    "state": lambda s: StochasticMap((s,), [X], Noise()),
    "noise": lambda s: Noise((s,)),
    "states": lambda s: StochasticMap(s, [X], Noise()),
    "time": lambda s: StochasticMap((X,), [X], Noise(), time=s),
    "weight": lambda s: StochasticMap((X,), [X + V], Noise((V,)), weight=s),
    "switching": lambda s: _two_modes(switching=[[s, 0.5], [0.5, 0.5]]),
    "indicator": lambda s: _two_modes(indicator=[[s, 0.5], [0.5, 0.5]]),
    "dynamics of a mode": lambda s: _two_modes(dynamics=[[s], [X + V]]),
    "sensor of a mode": lambda s: _two_modes(sensor=[[s], [X + W]]),
    "expectation": lambda s: expectation(s, [X], [0], [[1]]),
    "expectation_function": lambda s: expectation_function(s, [X]),
    "variables": lambda s: expectation_function(X, [s]),
    "classify": lambda s: classify(s, [X]),
    "errors": lambda s: mean_square_errors(s, [X]),
    "mean": lambda s: expectation(X, [X], [s], [[1]]),
    "covariance": lambda s: expectation(X**2, [X], [0], [[s]]),
    "approximate errors": lambda s: approximate_errors(s, [X]),
    "Noise.expectation": lambda s: Noise((V,)).expectation([s]),
    "TwoStepEstimator": lambda s: TwoStepEstimator(linear_diffusion(), s, variables=[X]),
    "AugmentedDiffusion": lambda s: AugmentedDiffusion(linear_diffusion(), s, [X], V),
    "bad value": lambda s: Parameter("p", s),
}


def twice() -> dict[str, object]:
    """One symbol in two roles."""
    noise = Noise((W,))
    return {
        "state and noise": lambda: JumpDiffusion(
            (X, V), [V, -X], [[0], [1]], [X + V], Noise((V,)), [0, 0], np.eye(2)
        ),
        "state and state": lambda: JumpDiffusion(
            (X, X), [X, -X], [[0], [1]], [X + W], noise, [0, 0], np.eye(2)
        ),
        "noise and noise": lambda: Noise((V, V)),
        "state and parameter": lambda: JumpDiffusion(
            (X,), [-X], [[1]], [X + W], noise, [0], [[1]], parameters={X: 5}
        ),
        "noise and parameter": lambda: JumpDiffusion(
            (X,), [-X], [[1]], [X + W], noise, [0], [[1]], parameters={W: 5}
        ),
        "state and time": lambda: JumpDiffusion(
            (X,), [-X], [[1]], [X + W], noise, [0], [[1]], time=X
        ),
        "noise and time": lambda: JumpDiffusion(
            (X,), [-X], [[1]], [X + W], noise, [0], [[1]], time=W
        ),
        "state and mark": lambda: JumpDiffusion(
            (X,), [-X], [[1]], [X + W], noise, [0], [[1]], intensity=1, jump=[X], marks=Noise((X,))
        ),
        "variables": lambda: expectation_function(X, [X, X]),
        "variable and parameter": lambda: expectation_function(X, [X], parameters=[X]),
        "state and noise of a map": lambda: StochasticMap((X,), [X], Noise((X,))),
        "modes": lambda: SwitchingSystem(
            (X,),
            [[X]] * 2,
            Noise((X,)),
            [[1, 0], [0, 1]],
            [[X + W]] * 2,
            noise,
            [(0.5, [0], [[1]])] * 2,
        ),
    }
