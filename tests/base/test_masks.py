"""A mask means a missing measurement; anywhere else there is nothing that may be missing."""

import numpy as np
import pytest
import sympy as sp

from seedslib import zoo
from seedslib.base import correct
from seedslib.base.checks import as_covariance, as_real, as_times, unmasked
from seedslib.delay import DelayKalmanFilter, DelaySystem
from seedslib.design import synthesize
from seedslib.designed import SwitchingFilter, large_order
from seedslib.filters import (
    GridBayesFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    cubature_kalman,
    extended_kalman,
)
from seedslib.gaussian import expectation_function, interval
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion, TwoStepEstimator

X, V, W = sp.symbols("x v w")
TIMES = np.arange(4.0)
Y = np.array([[1.0], [-9999.0], [1.0], [0.5]])
MASKED = np.ma.masked_equal(Y, -9999.0)
GAPS = np.where(Y == -9999.0, np.nan, Y)
WHOLE = np.ma.masked_equal(np.array([[1], [-9999], [1], [2]]), -9999)
"""Integers, whose masked entries have to become floats."""


def discrete():
    return DiscreteSystem(
        StochasticMap((X,), [X / 2 + V], Noise((V,))),
        StochasticMap((X,), [X + W], Noise((W,))), [0.0], [[1.0]],
    )  # fmt: skip


def switching():
    half = sp.Rational(1, 2)
    return SwitchingSystem(
        (X,), [[X / 2 + V], [X / 3 + V]], Noise((V,)), [[half, half], [half, half]],
        [[X + W], [2 * X + W]], Noise((W,)), [(0.5, [0.0], [[1.0]])] * 2,
        indicator=[[0.8, 0.2], [0.2, 0.8]],
    )  # fmt: skip


def linear():
    return LinearDiffusion(
        drift=-1, noise_intensity=0.5, sensor=1, sensor_intensity=0.1, mean0=0, cov0=4
    )


def grid(y):
    return GridBayesFilter(switching()).run(TIMES, y, indicators=shown(y)).mean


def shown(y):
    """Indicators with the third missing, masked where the measurements are."""
    if isinstance(y, np.ma.MaskedArray):
        return np.ma.masked_equal(np.array([0, 1, 7, 0]), 7)
    return np.array([0, 1, -1, 0])


def piecewise(y):
    system = PiecewiseLinearSystem.from_functions(
        state=(X,), dynamics=(X / 2,), sensor=(X + W,), noise=W, breakpoints=[-1.0, 0.0, 1.0],
        initial=([0.0], [[1.0]]),
    )  # fmt: skip
    return PiecewiseLinearFilter(system).run(TIMES, y).mean


def delayed(y):
    system = DelaySystem({0: 0.5, 1: 0.2}, 1.0, 1.0, 1.0, 1.0)
    start = np.ma.masked_all((1, 1)) if isinstance(y, np.ma.MaskedArray) else [[np.nan]]
    return DelayKalmanFilter(system).run(len(y), np.ma.concatenate([start, y])).mean


def designed(y):
    made = synthesize(discrete(), large_order(1), Taylor(), TIMES, paths=500, seed=1, nodes=0)
    return made.run(TIMES, y).mean


RUNS = {
    "extended": lambda y: extended_kalman(discrete()).run(TIMES, y).mean,
    "cubature": lambda y: cubature_kalman(discrete()).run(TIMES, y).mean,
    "continuous": lambda y: extended_kalman(zoo.linear_gaussian()).run(TIMES, y).mean,
    "particles": lambda y: ParticleFilter(discrete(), 50).run(TIMES, y, seed=1).mean,
    "grid": grid,
    "switching": lambda y: (
        SwitchingFilter(switching(), Taylor()).run(TIMES, y, indicators=shown(y)).mean
    ),
    "Rao-Blackwell": lambda y: (
        RaoBlackwellFilter(switching(), 20).run(TIMES, y, indicators=shown(y), seed=1).mean
    ),
    "designed": designed,
    "piecewise": piecewise,
    "delay": delayed,
    "Kalman-Bucy": lambda y: KalmanBucyFilter(linear()).run(np.arange(5.0) / 50, y).mean,
    "two-step": lambda y: (
        TwoStepEstimator(linear(), X**2, variables=[X]).run(np.arange(5.0) / 50, y).mean
    ),
}


@pytest.mark.parametrize("name", RUNS)
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_a_masked_measurement_is_a_missing_one(name):
    found = RUNS[name](MASKED)
    np.testing.assert_array_equal(found, RUNS[name](GAPS))
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(RUNS[name](WHOLE), RUNS[name](WHOLE.astype(float).filled(np.nan)))


def test_one_step_takes_a_masked_measurement():
    law = [0.0, 0.0], np.eye(2)
    moments = [0.0, 0.0], np.eye(2), 2 * np.eye(2)
    y = np.ma.array([1.0, 9e9], mask=[False, True])
    for got, wanted in zip(
        correct(*law, y, moments), correct(*law, [1.0, np.nan], moments), strict=True
    ):
        np.testing.assert_array_equal(got, wanted)
    for filter in (ParticleFilter(discrete(), 50), extended_kalman(discrete())):
        states = []
        for measured in (np.ma.masked_all(1), [np.nan]):
            start = (
                filter.initial((), np.random.SeedSequence(1))
                if hasattr(filter, "particles")
                else filter.initial()
            )
            states.append(filter.step(start, 0.0, measured))
        np.testing.assert_array_equal(states[0].mean, states[1].mean)


def test_a_masked_indicator_is_a_missing_one_in_one_step():
    filter = SwitchingFilter(switching(), Taylor())
    masked = np.ma.array(1, mask=True)
    got = filter.step(filter.initial(), 0.0, [1.0], masked)
    np.testing.assert_array_equal(
        got.law.prob, filter.step(filter.initial(), 0.0, [1.0], -1).law.prob
    )


HIDDEN = np.ma.array([1.0, 2.0], mask=[False, True])
ELSEWHERE = {
    "a number": lambda: as_real("x", HIDDEN),
    "times": lambda: as_times("times", HIDDEN),
    "a covariance": lambda: as_covariance("cov", np.ma.array(np.eye(2), mask=np.eye(2))),
    "a list of masked arrays": lambda: as_real("x", [HIDDEN, HIDDEN]),
    "a mean of a correction": lambda: correct(
        HIDDEN, np.eye(2), [1.0], ([0.0], np.ones((2, 1)), [[1.0]])
    ),
    "a mean of a function": lambda: expectation_function(X * V, [X, V])(HIDDEN, np.eye(2)),
    "a bound": lambda: interval(HIDDEN, 1.0, 0.0, 1.0),
    "a noise": lambda: Noise((V, W), HIDDEN),
    "a coefficient": lambda: LinearDiffusion(
        lambda t: np.ma.masked_all((1, 1)), 1, 1, 1, mean0=0, cov0=1
    ),
    "measured": lambda: discrete().simulate(
        TIMES, 2, 1, measured=np.ma.array([True] * 4, mask=[False] * 3 + [True])
    ),
    "regions": lambda: PiecewiseLinearSystem.from_functions(
        state=(X,), dynamics=(X,), sensor=(X + W,), noise=W, initial=([0.0], [[1.0]]),
        breakpoints=np.ma.array([-1.0, 0.0, 1.0], mask=[0, 1, 0]),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ELSEWHERE)
def test_a_mask_is_refused_where_nothing_may_be_missing(name):
    with pytest.raises(TypeError, match="masked"):
        ELSEWHERE[name]()


def test_an_empty_mask_hides_nothing():
    full = np.ma.array([1, 2], mask=False)
    np.testing.assert_array_equal(as_real("x", full), [1.0, 2.0])
    same = np.arange(3.0)
    assert unmasked("x", same) is same
    np.testing.assert_array_equal(as_real("x", [HIDDEN, HIDDEN], nan=True), [[1, np.nan]] * 2)
