"""What is abused: constructors, filters, designs and moment functions with good arguments."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
import sympy

from seedslib import zoo
from seedslib.delay import DelayKalmanFilter, DelaySystem
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.filters import (
    Gated,
    GridBayesFilter,
    KalmanFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.linearization import Taylor
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
)
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion, TwoStepEstimator

X, Z, V, W, U = sympy.symbols("x z v w u")
TIMES = np.array([0.0, 1.0, 2.0, 3.0])
Y = np.array([[0.5], [-0.25], [1.5], [1.0]])
PLANE = np.array([[2.0, 0.5], [0.5, 1.0]])


class Target(NamedTuple):
    """A call with good arguments; the kind of each says how it may be spoiled."""

    name: str
    call: Callable[..., object]
    good: dict[str, object]
    kinds: dict[str, str]


def discrete(mean0=0.0, cov0=1.0, noise=1.0):
    mean0, cov0 = ([mean0], [[cov0]]) if np.ndim(mean0) == 0 == np.ndim(cov0) else (mean0, cov0)
    return DiscreteSystem(
        StochasticMap((X,), [X / 2 + V], Noise((V,), cov=[[noise]])),
        StochasticMap((X,), [X + W], Noise((W,))),
        mean0,
        cov0,
    )


def plane(**given):
    return DiscreteSystem(
        StochasticMap((X, Z), [X / 2 + Z, Z / 2 + V], Noise((V,))),
        StochasticMap((X, Z), [X + W], Noise((W,))),
        **given,
    )


def diffusion(**given):
    return JumpDiffusion((X, Z), [Z, -X - Z], [[0], [1]], [X + W], Noise((W,)), **given)


def switching(
    switch=((0.75, 0.25), (0.5, 0.5)), probability=0.5, mean=(0.0,), cov=((1.0,),), **more
):
    return SwitchingSystem(
        (X,),
        [[X / 2 + V], [X / 4 + V]],
        Noise((V,)),
        switch,
        [[X + W], [2 * X + W]],
        Noise((W,)),
        [(probability, mean, cov)] * 2,
        **more,
    )


def linear_diffusion(**given):
    good = {
        "drift": -1.0,
        "noise_intensity": 0.5,
        "sensor": 1.0,
        "sensor_intensity": 0.25,
        "mean0": 0.0,
        "cov0": 4.0,
    }
    return LinearDiffusion(**good | given)


def delayed(**given):
    good = {"sensor": 1.0, "noise_cov": 1.0, "sensor_cov": 1.0, "cov0": 1.0}
    return DelaySystem({0: 0.5, 1: 0.25}, **good | given)


@cache
def designed():
    return synthesize(discrete(), Memory(1), Taylor(), TIMES, paths=400, seed=1, nodes=0)


@cache
def table():
    axes = {"x": (-6, 6, 25), "z": (-6, 6, 9), "y": (-14, 14, 29)}
    return grid_synthesis(zoo.scalar_switching(), Memory(1, log_odds=False), TIMES, **axes)


@cache
def bent():
    system = PiecewiseLinearSystem.from_functions(
        state=(X,),
        dynamics=(X / 2,),
        sensor=(X + W,),
        noise=W,
        breakpoints=[-1.0, 0.0, 1.0],
        initial=([0.0], [[1.0]]),
    )
    return PiecewiseLinearFilter(system)


FILTERS = {
    "extended": lambda: extended_kalman(discrete()),
    "unscented": lambda: unscented_kalman(discrete()),
    "cubature": lambda: cubature_kalman(discrete()),
    "assumed density": lambda: assumed_density(discrete()),
    "extended, continuous": lambda: extended_kalman(
        diffusion(mean0=[0, 0], cov0=np.eye(2), step=0.1)
    ),
    "unscented, continuous": lambda: unscented_kalman(
        diffusion(mean0=[0, 0], cov0=np.eye(2), step=0.1)
    ),
    "Kalman": lambda: KalmanFilter(LinearSystem(0.5, 1.0, 1.0, 2.0, 0.0, 1.0)),
    "gated": lambda: Gated(extended_kalman(discrete())),
    "grid": lambda: GridBayesFilter(discrete(), (-8.0, 8.0, 65)),
    "grid of modes": lambda: GridBayesFilter(switching(), (-8.0, 8.0, 65)),
    "particles": lambda: ParticleFilter(discrete(), 20),
    "particles, modes": lambda: RaoBlackwellFilter(switching(), 10),
    "switching": lambda: SwitchingFilter(switching(), Taylor()),
    "known modes": lambda: KnownModeFilter(switching()),
    "designed": designed,
    "table": table,
    "piecewise": bent,
}


def filtered(make):
    modes = {"modes": np.zeros(4, int)} if make is FILTERS["known modes"] else {}
    return lambda times=TIMES, measurements=Y: make().run(times, measurements, **modes)


def arrays(**good):
    return good, dict.fromkeys(good, "array")


def elementwise(**good):
    return good, dict.fromkeys(good, "elementwise")


def targets():
    """All of them, built anew."""
    for name, make in FILTERS.items():
        yield Target(
            name,
            filtered(make),
            {"times": TIMES, "measurements": Y},
            {"times": "times", "measurements": "missing"},
        )
    law = {"mean0": [0.0, 1.0], "cov0": PLANE}
    kinds = {"mean0": "array", "cov0": "cov"}
    yield Target("DiscreteSystem", plane, law, kinds)
    yield Target("JumpDiffusion", diffusion, law | {"step": 0.5}, kinds | {"step": "positive"})
    yield Target(
        "Noise",
        lambda mean, cov: Noise((V, W), mean, cov),
        {"mean": [0.0, 1.0], "cov": PLANE},
        {"mean": "broadcast", "cov": "cov"},
    )
    yield Target(
        "LinearSystem",
        LinearSystem,
        {"F": PLANE / 4, "Q": PLANE, "H": [[1.0, 0.0]], "R": [[2.0]]} | law,
        {"F": "array", "Q": "cov", "H": "array", "R": "cov"} | kinds,
    )
    yield Target(
        "SwitchingSystem",
        switching,
        {"switch": [[0.75, 0.25], [0.5, 0.5]], "mean": [0.0], "cov": [[1.0]], "probability": 0.5},
        {"switch": "formulas", "mean": "array", "cov": "cov", "probability": "probability"},
    )
    yield Target(
        "indicator",
        lambda indicator: switching(indicator=indicator),
        {"indicator": [[0.75, 0.25], [0.5, 0.5]]},
        {"indicator": "formulas"},
    )
    flat = {
        "drift": [[-1.0, 0.5], [0.0, -2.0]],
        "noise_intensity": PLANE,
        "sensor": [[1.0, 0.0]],
        "sensor_intensity": [[0.5]],
    } | law
    yield Target(
        "LinearDiffusion",
        lambda **a: KalmanBucyFilter(LinearDiffusion(**a)).moments([0.0, 0.5]),
        flat,
        {"drift": "array", "noise_intensity": "cov", "sensor": "array", "sensor_intensity": "cov"}
        | kinds,
    )
    yield Target(
        "KalmanBucyFilter",
        lambda times, increments: KalmanBucyFilter(linear_diffusion()).run(times, increments),
        {"times": TIMES / 32, "increments": Y[1:]},
        {"times": "times", "increments": "missing"},
    )
    yield Target(
        "TwoStepEstimator",
        lambda times, increments: TwoStepEstimator(
            linear_diffusion(), sympy.exp(X), variables=[X]
        ).run(times, increments),
        {"times": TIMES / 32, "increments": Y[1:]},
        {"times": "times", "increments": "missing"},
    )
    yield Target(
        "DelaySystem",
        lambda **a: DelayKalmanFilter(delayed(**a)).run(2, [[np.nan], [1.0], [2.0]]),
        {"noise_cov": [[1.0]], "sensor_cov": [[1.0]], "cov0": [[1.0]], "sensor": [[1.0]]},
        {"noise_cov": "cov", "sensor_cov": "cov", "cov0": "cov", "sensor": "array"},
    )
