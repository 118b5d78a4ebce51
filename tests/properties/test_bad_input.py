"""Bad input is refused by the argument's name; the same numbers in another form change nothing."""

import datetime
from functools import partial

import numpy as np
import pytest
import sympy as sp

from seedslib.base import Axis, interpolate
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.filters import KalmanFilter, assumed_density, extended_kalman
from seedslib.gaussian import cubature, gauss_hermite, norm_mean
from seedslib.linearization import Taylor
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    van_loan,
)
from seedslib.two_step import LinearDiffusion

X, V, W = sp.symbols("x v w")
TIMES, Y = np.array([0.0, 1.0, 2.0]), np.array([[0.5], [1.0], [0.25]])
PLANE = np.array([[2.0, 0.5], [0.5, 1.0]])


def discrete(drift=X / 2, state=X):
    move, sensor = StochasticMap((state,), [drift + V], Noise((V,))), [state + W]
    return DiscreteSystem(move, StochasticMap((state,), sensor, Noise((W,))), [0.0], [[1.0]])


def diffusion(drift=-X, **given):
    return JumpDiffusion((X,), [drift], [[1]], [X + W], Noise((W,)), [0.0], [[1.0]], **given)


def designed(**given):
    good = {"paths": 200, "seed": 1, "nodes": 0}
    return synthesize(discrete(), Memory(1), Taylor(), TIMES, **(good | given))


def bucy(**given):
    return tuple(LinearDiffusion(**given).moments([0.0, 0.5]))


LINEAR = {"F": PLANE / 4, "Q": PLANE, "H": [[1.0, 0.0]], "R": [[2.0]]}
LINEAR |= {"mean0": [0.0, 1.0], "cov0": PLANE}
FLOW = {"drift": [[-1.0]], "noise_intensity": [[0.5]], "sensor": [[1.0]], "cov0": [[4.0]]}
FLOW |= {"sensor_intensity": [[0.25]], "mean0": [0.0]}
CALLS = {
    "LinearSystem": (lambda **a: KalmanFilter(LinearSystem(**a)).run(TIMES, Y).mean, LINEAR),
    "Noise": (lambda **a: Noise((V, W), **a).cov, {"mean": [0.0, 1.0], "cov": PLANE}),
    "van_loan": (partial(van_loan, step=0.5), {"drift": PLANE, "diffusion": PLANE}),
    "norm_mean": (lambda **a: [norm_mean(**a)], {"mean": [0.5, 1.0], "cov": PLANE}),
    "LinearDiffusion": (bucy, FLOW),
    "run": (lambda times: extended_kalman(discrete()).run(times, Y).mean, {"times": TIMES}),
}
ARGUMENTS = [(name, argument) for name, (_, good) in CALLS.items() for argument in good]
BAD = ["x", b"1", {}, object(), 1j, datetime.date(2026, 1, 2), [[1.0], [1.0, 2.0]]]
FORMS = (np.ndarray.tolist, *(lambda a, t=t: a.astype(t) for t in (">f8", "f4", np.longdouble)))
NUMBERS = {
    "paths": lambda v: designed(paths=v),
    "seed": lambda v: discrete().simulate(TIMES, 2, v),
    "nodes": lambda v: designed(nodes=v),
    "n": cubature,
    "order": lambda v: (gauss_hermite(2, 3), gauss_hermite(2, v)),  # 3.0 is not the cached 3
    "step": lambda v: diffusion(step=v),
    "low": lambda v: Axis(v, 2.0, 3),
    "points": lambda v: interpolate([[0.0, 1.0, 2.0]], [Axis(0, 1, 3)], [v]),
}


@pytest.mark.parametrize(("name", "argument"), ARGUMENTS)
def test_an_array_that_is_none_is_refused_by_its_name(name, argument):
    call, good = CALLS[name]
    for bad in [*BAD, np.array(good[argument]) * np.nan]:
        with pytest.raises((TypeError, ValueError), match=rf"^{argument}\b"):
            call(**good | {argument: bad})


@pytest.mark.parametrize("argument", NUMBERS)
def test_a_number_that_is_none_is_refused_by_its_name(argument):
    for bad in [*BAD, np.nan, "0.5", *[-1, 1.5, 3.0, True] * (argument in list(NUMBERS)[:5])]:
        with pytest.raises((TypeError, ValueError), match=rf"^{argument}\b"):
            NUMBERS[argument](bad)


@pytest.mark.parametrize(("name", "argument"), ARGUMENTS)
def test_the_same_numbers_in_another_form_give_the_same_result(name, argument):
    call, good = CALLS[name]
    wanted = call(**good)
    for form in FORMS:
        found = call(**good | {argument: form(np.asarray(good[argument], dtype=float))})
        for one, two in zip(found, wanted, strict=True):
            np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("name", ["sin", "numpy", "exp", "lambda", "x 1"])
def test_a_symbol_may_have_any_name(name):
    runs = [
        extended_kalman(discrete(sp.sin(s) + sp.pi * sp.exp(-s), s)).run(TIMES, Y)
        for s in (sp.Symbol(name), X)
    ]
    np.testing.assert_array_equal(runs[0].mean, runs[1].mean)


@pytest.mark.parametrize("drift", [X**100, sp.exp(X**2)])
def test_a_single_record_that_overflows_is_marked_as_those_of_a_batch(drift):
    filter = assumed_density(diffusion(drift, step=0.25))
    assert filter.run(TIMES, Y).diverged.any()
    assert filter.run(TIMES, np.stack([Y, Y], axis=-1)).diverged.all()
