"""What `extra` refuses: the type of the error, and the argument that its message names."""

import builtins
from functools import cache

import numpy as np
import pytest
import sympy
from sklearn.linear_model import LinearRegression
from sklearn.tree import DecisionTreeRegressor

from extra.exported_filters import cart, case, driven, shrinking
from seedslib import zoo
from seedslib.base import Parameter
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.evaluation import fit
from seedslib.extra import cluster, compiled, learn, plot_estimates, plot_profile, to_c, to_js
from seedslib.filters import (
    CovarianceFilter,
    Estimates,
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


def matrices(**options):
    move = options.pop("move", np.eye(2))
    return LinearSystem(move, np.eye(2), [[1, 0]], [[1]], [0, 0], **options)


def scalar(shown):
    move = StochasticMap([x], [x + v], Noise([v]))
    return DiscreteSystem(move, StochasticMap([x], [shown + w], Noise([w])), [0], [[1]])


def design(times=range(3), memory=None, model=growth, **options):
    return synthesize(model(), memory or Memory(1), Taylor(), times, paths=200, seed=1, **options)


def learned(regressor, times=range(2), **options):
    options = {"paths": 60, "seed": 1, "nodes": 0, "regressor": regressor, **options}
    return learn(growth(), options.pop("memory", Memory(1)), times, **options)


def biased():
    """A design that is told an input when it evaluates its sensor."""
    inputs = {p: np.zeros(7) for p in cart(inputs=True).mentions}
    return synthesize(
        cart(inputs=True), Memory(1), Taylor(), TIMES, paths=200, seed=1,
        inputs={p: u for p, u in inputs.items() if p.role == "input"},
    )  # fmt: skip


EXPORTS = [
    (lambda: to_c(growth()), TypeError, "filter"),
    (lambda: to_c(extended_kalman(growth()), name="2nd"), ValueError, "name"),
    (lambda: to_c(extended_kalman(growth()), name="a b"), ValueError, "name"),
    (lambda: to_c(extended_kalman(growth()), name=3), TypeError, "name"),
    (lambda: to_c(extended_kalman(growth()), real="half"), ValueError, "real"),
    (lambda: to_c(CovarianceFilter(growth(), Own())), TypeError, "linearization"),
    (lambda: to_c(SwitchingFilter(zoo.scalar_switching(), Cubature())), TypeError, "linearization"),
    (lambda: to_c(SwitchingFilter(shrinking(), Taylor(), normalisation="printed")),
     ValueError, "normalisation"),
    (lambda: to_c(KalmanFilter(matrices(cov0=np.zeros((2, 2)), diffuse=(0, 1)))),
     ValueError, "system"),
    (lambda: to_c(KalmanFilter(matrices(cov0=np.eye(2), move=lambda t: np.eye(2)))),
     ValueError, "system"),
    (lambda: to_c(extended_kalman(zoo.van_der_pol(), integrator="adaptive")),
     ValueError, "integrator"),
    (lambda: to_c(design(model=zoo.van_der_pol).forecasting("linear")), ValueError, "between"),
    (lambda: to_c(design(times=[0.0])), TypeError, "predictor"),
    (lambda: to_c(design(memory=Late(1))), TypeError, "memory"),
    (lambda: to_c(biased()), ValueError, "filter"),
    (lambda: to_c(learned(LinearRegression())), TypeError, "regressor"),
    (lambda: to_c(learned(DecisionTreeRegressor(max_depth=2), range(1))), ValueError, "times"),
    (lambda: to_js(case("extended, inputs").filter), ValueError, "filter"),
    (lambda: to_js(cubature_kalman(scalar(sympy.loggamma(3 + x**2)))), ValueError, "formulas"),
    (lambda: to_c(extended_kalman(scalar(sympy.besselj(0, x)))), ValueError, "formulas"),
]  # fmt: skip


@cache
def quickly(name):
    return compiled(case(name).filter)


def after(name, y, t=None, k=0, **told):
    """A step of a compiled filter from its state after measurement k."""
    one, twin = case(name), quickly(name)
    state = twin.initial()
    for j in range(k):
        indicator = () if one.indicators is None else (0,)
        state = twin.step(state, one.times[j], np.zeros(one.y.shape[1]), *indicator)
    return twin.step(state, one.times[k] if t is None else t, y, **told)


STEPS = [
    (lambda: after("extended", [np.inf, 0.0]), ValueError, "y"),
    (lambda: after("extended", np.ones(3)), ValueError, "y"),
    (lambda: after("extended", ["a", "b"]), (TypeError, ValueError), "y"),
    (lambda: after("extended", [1.0, 0.0], "noon"), (TypeError, ValueError), "t"),
    (lambda: after("extended", [1.0, 0.0], [0.0, 1.0]), (TypeError, ValueError), "t"),
    (lambda: after("extended", [1.0, 0.0], 0.0, k=1), ValueError, "t"),
    (lambda: after("extended, continuous", [1.0, 0.0], 1e12, k=1), ValueError, "t"),
    (lambda: after("extended", [1.0, 0.0], indicator=0), ValueError, "indicator"),
    (lambda: after("extended, inputs", [1.0, 0.0]), ValueError, "bias|force"),
    (lambda: after("IMM, old mode", [1.0, 0.0]), ValueError, "indicator"),
    (lambda: after("IMM, old mode", [1.0, 0.0], indicator=2), ValueError, "indicator"),
    (lambda: after("IMM, old mode", [1.0, 0.0], indicator=0.5), TypeError, "indicator"),
    (lambda: after("IMM, old mode", [1.0, 0.0], 0.0, 1, indicator=0), ValueError, "t"),
    (lambda: after("modes and log-odds", [1.0, 0.0], indicator=-1), ValueError, "y"),
    (lambda: after("affine", [1.0, 0.0], 1.6, k=1), ValueError, "t"),
    (lambda: after("affine", [1.0, 0.0], 1.5, k=1), ValueError, "t"),
    (lambda: after("polynomial", [1.0, 0.0], 5.0, k=6), ValueError, "t"),
    (lambda: after("schedule", [1.0, 0.0]), ValueError, "y"),
    (lambda: quickly("affine").predict(quickly("affine").initial(), 1.5), ValueError, "predict"),
    (lambda: quickly("affine").forecast(quickly("affine").initial(), 9.0), ValueError, "t"),
    (lambda: quickly("IMM, old mode").forecast(None, 2.0), ValueError, "forecast"),
    (lambda: quickly("extended").correct(quickly("extended").initial(), [1.0, 0.0]),
     ValueError, "t"),
    (lambda: quickly("extended, inputs").run(TIMES, np.zeros((7, 2))), ValueError, "inputs"),
    (lambda: quickly("extended").run(TIMES, np.full((7, 2), np.inf)), ValueError, "measurements"),
]  # fmt: skip


def level():
    r = Parameter("r", 3.0, positive=True)
    found = fit(
        KalmanFilter(LinearSystem(1, 0.0, 1, r, 3.0, 0.0)), range(9), [[0.0], [6.0], [3.0]] * 3, [r]
    )
    return plot_profile(found, r, [3.0], level=95)


def drawn(**options):
    found = Estimates(np.zeros((5, 2, 3)), np.zeros((5, 2, 2, 3)))
    return plot_estimates(**{"times": np.arange(5.0), "estimates": found, **options})


OTHERS = [
    (lambda: learned(3), TypeError, "regressor"),
    (lambda: learned(LinearRegression(), draws=0), ValueError, "draws"),
    (lambda: learned(LinearRegression(), sets=1), ValueError, "sets"),
    (lambda: learned(LinearRegression(), components=3), ValueError, "components"),
    (lambda: learned(LinearRegression(), seed=1.5), TypeError, "seed"),
    (lambda: learned(LinearRegression(), memory=Memory(1, indicators=1)), ValueError, "memory"),
    (lambda: learn(driven("old"), large_order(1), range(2), paths=9, seed=1), TypeError, "system"),
    (lambda: cluster(8786).__enter__(), TypeError, "scheduler"),
    (lambda: cluster("nothing://127.0.0.1:9").__enter__(), ValueError, "scheduler"),
    (lambda: synthesize(growth(), Memory(1), Taylor(), range(3), paths=9, seed=1, workers="tcp:"),
     TypeError, "workers"),
    (level, ValueError, "level"),
    (lambda: drawn(times=np.arange(4.0)), ValueError, "times"),
    (lambda: drawn(names=["a"]), ValueError, "names"),
    (lambda: drawn(record=4), ValueError, "record"),
    (lambda: drawn(measurements={2: np.zeros(5)}), ValueError, "measurements"),
    (lambda: drawn(axes=[None]), ValueError, "axes"),
]  # fmt: skip


@pytest.mark.filterwarnings("ignore:paths:UserWarning", "ignore:held out:UserWarning")
@pytest.mark.parametrize(("call", "error", "argument"), [*EXPORTS, *STEPS, *OTHERS])
def test_a_refusal_names_the_argument(call, error, argument):
    with pytest.raises(error, match=rf"^({argument})\b"):
        call()


def test_pictures_without_matplotlib_say_what_is_wanted(monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match="matplotlib"):
        drawn()
