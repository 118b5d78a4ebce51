"""What `export` refuses: the type of the error, and the argument that its message names."""

from functools import cache

import numpy as np
import pytest
import sympy
from sklearn.tree import DecisionTreeRegressor

from export.exported_filters import case, shrinking
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.export import compiled, to_c, to_js
from seedslib.extra import learn
from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    cubature_kalman,
    extended_kalman,
)
from seedslib.linearization import Cubature, Linearization, Taylor
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap
from systems import TIMES, growth

pytestmark = pytest.mark.usefixtures("quick")
x, v, w = sympy.symbols("x v w", real=True)


class Own(Linearization):
    """A rule of one's own, of which nothing is known but its numbers."""

    def moments(self, map, spread=True):
        return Cubature().moments(map, spread)


class Late(Memory):
    """A memory of one's own, which C would renew in its own way."""


def kalman(move=((1, 0), (0, 1)), **options):
    return KalmanFilter(LinearSystem(move, np.eye(2), [[1, 0]], [[1]], [0, 0], **options))


def scalar(shown):
    move = StochasticMap([x], [x + v], Noise([v]))
    return DiscreteSystem(move, StochasticMap([x], [shown + w], Noise([w])), [0], [[1]])


def design(times=range(3), memory=None, system=None, **options):
    """Also in C where inputs are told to a sensor, which is evaluated."""
    options = {"paths": 200, "seed": 1, **options}
    return synthesize(system or growth(), memory or Memory(1), Taylor(), times, **options)


def learned():
    """A filter whose functions are trees."""
    tree = DecisionTreeRegressor(max_depth=2)
    return learn(growth(), Memory(1), range(2), paths=60, seed=1, regressor=tree)


EKF = extended_kalman(growth())
PRINTED = {"normalisation": "printed"}
EXPORTS = [
    (lambda: to_c(growth()), TypeError, "filter"),
    (lambda: to_c(EKF, name="2nd"), ValueError, "name"),
    (lambda: to_c(EKF, "float"), ValueError, "path"),
    (lambda: to_c(EKF, name=3), TypeError, "name"),
    (lambda: to_c(CovarianceFilter(growth(), Own())), TypeError, "linearization"),
    (lambda: to_c(SwitchingFilter(shrinking(), Cubature())), TypeError, "linearization"),
    (lambda: to_c(SwitchingFilter(shrinking(), Taylor(), **PRINTED)), ValueError, "normalisation"),
    (lambda: to_c(kalman(cov0=np.zeros((2, 2)), diffuse=(0, 1))), ValueError, "system"),
    (lambda: to_c(kalman(lambda t: np.eye(2), cov0=np.eye(2))), ValueError, "system"),
    (lambda: to_c(design(times=[0.0])), TypeError, "predictor"),
    (lambda: to_c(design(memory=Late(1))), TypeError, "memory"),
    (lambda: to_c(learned()), TypeError, "filter"),
    (lambda: to_c(design(availability=0.8)), ValueError, "filter"),
    (lambda: to_js(cubature_kalman(scalar(sympy.loggamma(3 + x**2)))), ValueError, "formulas"),
    (lambda: to_c(extended_kalman(scalar(sympy.besselj(0, x)))), ValueError, "formulas"),
]


@cache
def twin(name):
    return compiled(case(name).filter)


def step(name, y=(1.0, 0.0), t=None, k=0, **told):
    """A step of a compiled filter from its state after k measurements."""
    one, state = case(name), twin(name).initial()
    for j in range(k):
        indicator = () if one.indicators is None else (0,)
        state = twin(name).step(state, one.times[j], [0.0, 0.0], *indicator)
    return twin(name).step(state, one.times[k] if t is None else t, y, **told)


STEPS = [
    (lambda: step("extended", [np.inf, 0.0]), ValueError, "y"),
    (lambda: step("extended", np.ones(3)), ValueError, "y"),
    (lambda: step("extended", t="noon"), (TypeError, ValueError), "t"),
    (lambda: step("extended", t=0.0, k=1), ValueError, "t"),
    (lambda: step("extended, continuous", t=1e12, k=1), ValueError, "t"),
    (lambda: step("extended", indicator=0), ValueError, "indicator"),
    (lambda: step("extended, inputs"), ValueError, "bias|force"),
    (lambda: step("IMM, old mode"), ValueError, "indicator"),
    (lambda: step("IMM, old mode", indicator=2), ValueError, "indicator"),
    (lambda: step("modes and log-odds", indicator=-1), ValueError, "y"),
    (lambda: step("affine", t=1.6, k=1), ValueError, "t"),
    (lambda: step("polynomial", t=5.0, k=6), ValueError, "t"),
    (lambda: step("schedule"), ValueError, "y"),
    (lambda: twin("affine").predict(twin("affine").initial(), 1.5), ValueError, "predict"),
    (lambda: twin("IMM, old mode").forecast(None, 2.0), ValueError, "predict"),
    (lambda: twin("extended").correct(twin("extended").initial(), [1, 0]), ValueError, "state"),
    (lambda: twin("extended, inputs").run(TIMES, np.zeros((7, 2))), ValueError, "inputs"),
    (lambda: twin("schedule").run(TIMES, np.zeros((7, 2))), ValueError, "measurements"),
]


@pytest.mark.filterwarnings("ignore:paths:UserWarning", "ignore:held out:UserWarning")
@pytest.mark.parametrize(("call", "error", "argument"), [*EXPORTS, *STEPS])
def test_a_refusal_names_the_argument(call, error, argument):
    with pytest.raises(error, match=rf"^({argument})\b"):
        call()
