"""Arguments that do not fit are refused by the type of the error and the argument's name."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import (
    BoundedPolynomial,
    Continuous,
    Polynomial,
    affine_synthesis,
    binned_synthesis,
    grid_risk,
    grid_synthesis,
    minimax_synthesis,
    simulated_synthesis,
    stationary,
    synthesize,
)
from seedslib.designed import Memory, large_order
from seedslib.filters import extended_kalman
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

x, v, w = sympy.symbols("x v w")
TIMES = np.array([0.0, 0.25, 0.5])


def linear(drift=-x, diffusion=1, sensor=x + v, mean=0):
    noise = Noise((v,))
    return JumpDiffusion((x,), [drift], [[diffusion]], [sensor], noise, [mean], [[1]], step=0.1)


def walk(sensors=1):
    names = sympy.symbols(f"r1:{sensors + 1}", real=True)
    return DiscreteSystem(
        StochasticMap([x], [x + w], Noise([w])),
        StochasticMap([x], [x + r for r in names], Noise(names)),
        [0.0],
        [[1.0]],
    )


FLIP, SCALAR, LINEAR, WALK = zoo.flip_process(), zoo.scalar_switching("A1H"), linear(), walk()
TARGET = zoo.manoeuvring_target("noisy")
SQUARED = linear(sensor=x * v**2)


def made(system=LINEAR, memory=None, linearization=None, times=TIMES, **options):
    rule = Taylor() if linearization is None else linearization
    options = {"paths": 200, "seed": 1} | options
    return synthesize(system, memory or Memory(1), rule, times, **options)


def exact(**parts):
    return synthesize(linear(**parts), Memory(1), Taylor(), TIMES, exact_moments=True)


def grid(system=FLIP, memory=None, times=TIMES, **axes):
    axes = {"x": (-3.5, 3.5, 31)} | axes
    return grid_synthesis(system, memory or Memory(1), times, **axes)


def tables(system=FLIP, memory=None, times=TIMES, **options):
    options = {"paths": 60, "seed": 1, "y": (-8, 8, 9), "z": (-2, 2, 9)} | options
    return simulated_synthesis(system, memory or Memory(1), times, **options)


def minimax(system=WALK, **options):
    return minimax_synthesis(system, Memory(1), range(3), paths=200, seed=1, **options)


ODD = Memory(1, indicators=1)
REFUSALS = [
    # synthesize
    (lambda: made(system=3), TypeError, "system"),
    (lambda: made(memory=2), TypeError, "memory"),
    (lambda: made(SCALAR, memory=ODD, times=range(3)), ValueError, "memory"),
    (lambda: made(linearization="taylor"), TypeError, "linearization"),
    (lambda: made(predictor="affine"), TypeError, "predictor"),
    (lambda: made(predictor=Continuous(), memory=Memory(2)), ValueError, "predictor"),
    (lambda: made(predictor=Polynomial(), exact_moments=True), ValueError, "exact_moments"),
    (lambda: made(components=2), ValueError, "components"),
    (lambda: made(times=[0, 1, 1]), ValueError, "times"),
    (lambda: made(nodes=-1), ValueError, "nodes"),
    (lambda: made(paths=4, memory=Memory(3)), ValueError, "paths"),
    (lambda: made(paths=None), TypeError, "paths"),
    (lambda: made(seed=None), TypeError, "seed"),
    (lambda: made(workers=0), ValueError, "workers"),
    (lambda: made(step=0.0), ValueError, "step"),
    (lambda: made(scheme="milstein"), ValueError, "scheme"),
    (lambda: made(SCALAR, times=range(3), step=0.1), ValueError, "step"),
    (lambda: made(TARGET, times=range(3), availability=0.5), ValueError, "availability"),
    (lambda: made(TARGET, times=range(3), measured=[0, 1]), ValueError, "measured"),
    (lambda: made(normalisation="printed"), ValueError, "normalisation"),
    (lambda: made(predictor=Continuous(), availability=0.5), ValueError, "availability"),
    (lambda: made(measured=[True]), ValueError, "measured"),
    (lambda: made(availability=1.5), ValueError, "availability"),
    (lambda: made(walk(5), times=range(3), availability=0.5), ValueError, "availability"),
    # exact moments
    (lambda: exact(sensor=x**2 + v), ValueError, "exact_moments"),
    (lambda: exact(sensor=x + x * v), ValueError, "exact_moments"),
    # grids
    (lambda: grid(memory=Memory(1, 1)), ValueError, "memory"),
    (lambda: grid(SCALAR, memory=Memory(1, log_odds=True), times=range(3)), ValueError, "memory"),
    (lambda: grid(memory=large_order(6)), ValueError, "memory"),
    (lambda: grid(system=zoo.van_der_pol()), ValueError, "component"),
    (lambda: grid(x=3.5), TypeError, "x"),
    (lambda: grid(y=[(-8, 8, 9)] * 2), ValueError, "y"),
    (lambda: grid(times=[0.0, 0.0]), ValueError, "times"),
    (
        lambda: affine_synthesis(FLIP, Memory(1), None, TIMES, x=(-3.5, 3.5, 31)),
        TypeError,
        "linearization",
    ),
    (lambda: grid_risk(made(measured=[0, 2]), x=(-3.5, 3.5, 31)), ValueError, "filter"),
    # tables on paths
    (lambda: tables(method="neural"), ValueError, "method"),
    (lambda: tables(SQUARED), ValueError, "method"),
    (lambda: tables(seed=None), TypeError, "seed"),
    (lambda: tables(memory=Memory(1, log_odds=True)), ValueError, "memory"),
    (lambda: tables(memory=large_order(4), z=(-2, 2, 99)), ValueError, "memory"),
    (lambda: tables(y=(-8, 8)), TypeError, "y"),
    (
        lambda: binned_synthesis(zoo.van_der_pol(), Memory(1), [0, 1], paths=10, seed=1),
        ValueError,
        "system",
    ),
    (
        lambda: binned_synthesis(FLIP, Memory(1), [0, 1], paths=10, seed=1, bins=1),
        ValueError,
        "bins",
    ),
    # minimax
    (lambda: minimax(correction=3), TypeError, "correction"),
    (lambda: minimax(prediction="mean"), TypeError, "prediction"),
    (lambda: minimax(correction=lambda t, forecast, y: y[0]), ValueError, "correction"),
    (lambda: minimax(system=FLIP), TypeError, "system"),
    (lambda: BoundedPolynomial(0), ValueError, "degree"),
    # designs without an end
    (lambda: stationary(extended_kalman(WALK)), TypeError, "filter"),
    (lambda: stationary(made(times=TIMES[:2])), ValueError, "times"),
    (lambda: stationary(made(WALK, times=range(4), availability=0.8)), ValueError, "availability"),
    (lambda: stationary(made(WALK, times=range(4)), 0), ValueError, "tolerance"),
    (lambda: stationary(made(WALK, times=range(4)), 5.0, transient=7), ValueError, "transient"),
]


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_refusal_names_the_argument(call, error, name):
    with pytest.raises(error, match=rf"\b{name}\b"):
        call()
