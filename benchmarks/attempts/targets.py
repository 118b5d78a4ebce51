"""What is abused: constructors, filters, designs and moment functions with good arguments."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
import sympy

from seedslib import zoo
from seedslib.base import Axis, correct, interpolate
from seedslib.delay import DelayKalmanFilter, DelaySystem
from seedslib.design import affine_synthesis, grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.evaluation import evaluate
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
    smooth,
    unscented_kalman,
)
from seedslib.gaussian import (
    abs_errors,
    abs_moments,
    bivariate_normal_cdf,
    cubature,
    elevation_moments,
    expectation_function,
    fifth_degree,
    gauss_hermite,
    interval,
    max_errors,
    max_moments,
    mean_of,
    mean_square_errors,
    norm_errors,
    norm_mean,
    polygon,
    posterior_variance_function,
    sine_errors,
    sine_moments,
    unscented,
)
from seedslib.linearization import Moments, Taylor
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
    van_loan,
)
from seedslib.pareto import bisect, choose, compromise
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem
from seedslib.riemann import solve_riemann, wiener_gain
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
    yield from functions()
    yield from designs()


def functions():
    one = {"mean": 0.5, "var": 2.0}
    kinds = {"mean": "elementwise", "var": "variance"}
    yield Target("abs_moments", abs_moments, one, kinds)
    yield Target("sine_moments", sine_moments, one, kinds)
    for function in (abs_errors, sine_errors):
        yield Target(
            function.__name__, function, one | {"error_var": 0.5}, kinds | {"error_var": "variance"}
        )
    law, matrix = {"mean": [0.5, 1.0], "cov": PLANE}, {"mean": "array", "cov": "cov"}
    yield Target("max_moments", max_moments, law, matrix)
    yield Target(
        "max_errors", max_errors, law | {"error_cov": PLANE / 2}, matrix | {"error_cov": "cov"}
    )
    yield Target("norm_errors", norm_errors, {"cov": PLANE}, {"cov": "cov"})
    yield Target("norm_mean", norm_mean, law, matrix)
    yield Target(
        "elevation_moments",
        elevation_moments,
        {"mean": [1.0, 0.5, 0.75], "cov": np.diag([1.0, 2.0, 0.5])},
        matrix,
    )
    yield Target(
        "interval",
        interval,
        one | {"lower": -1.0, "upper": 1.5},
        kinds | {"lower": "bound", "upper": "bound"},
    )
    triangle = [[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]]
    yield Target(
        "polygon",
        polygon,
        law | {"vertices": triangle, "tolerance": 1e-12},
        matrix | {"vertices": "vertices", "tolerance": "nonnegative or inf"},
    )
    yield Target(
        "bivariate_normal_cdf",
        bivariate_normal_cdf,
        {"h": 0.5, "k": -0.25, "rho": 0.5},
        {"h": "bound", "k": "bound", "rho": "correlation"},
    )
    for f in (X**2 * Z, sympy.exp(X / 4) * sympy.sin(Z), sympy.Abs(X - Z), sympy.sqrt(X**2 + Z**2)):
        yield Target(
            f"expectation of {f}",
            lambda mean, cov, f=f: expectation_function(f, [X, Z])(mean, cov),
            law,
            matrix,
        )
    for f in (X**2 * Z, sympy.exp(X / 4)):
        yield Target(
            f"posterior variance of {f}",
            lambda mean, cov, f=f: posterior_variance_function(f, [X, Z])(mean, cov),
            law,
            matrix,
        )
        yield Target(
            f"errors of {f}",
            lambda mean, cov, error_cov, f=f: mean_square_errors(f, [X, Z])(mean, cov, error_cov),
            law | {"error_cov": PLANE / 2},
            matrix | {"error_cov": "cov"},
        )
    yield Target(
        "mean_of",
        lambda mean, cov: mean_of(lambda x: x[0] * x[1], mean, cov, cubature(2)),
        law,
        matrix,
    )
    for rule in (cubature, fifth_degree):
        yield Target(rule.__name__, rule, {"n": 2}, {"n": "count 1"})
    yield Target(
        "gauss_hermite", gauss_hermite, {"n": 2, "order": 3}, {"n": "count 1", "order": "count 1"}
    )
    yield Target(
        "unscented", unscented, {"n": 2, "kappa": 1.0}, {"n": "count 1", "kappa": "number"}
    )
    yield Target(
        "van_loan",
        van_loan,
        {"drift": -PLANE, "diffusion": PLANE, "step": 0.5},
        {"drift": "array", "diffusion": "cov", "step": "nonnegative"},
    )
    yield Target(
        "Axis",
        Axis,
        {"low": -1.0, "high": 1.0, "count": 5},
        {"low": "number", "high": "number", "count": "count 2"},
    )
    yield Target(
        "interpolate",
        lambda table, points: interpolate(table, [Axis(-1.0, 1.0, 3)], [points]),
        {"table": [[0.0, 1.0, 4.0]], "points": 0.5},
        {"table": "cells inf", "points": "elementwise"},
    )
    gains = Moments(np.array([0.5]), np.array([[1.0], [0.5]]), np.array([[3.0]]))
    yield Target(
        "correct",
        lambda mean, cov, y: correct(mean, cov, y, gains),
        law | {"y": [1.0]},
        {"mean": "primitive", "cov": "primitive", "y": "missing array"},
    )
    yield Target(
        "choose", choose, {"criteria": [[1.0, 2.0, 4.0], [4.0, 2.5, 1.0]]}, {"criteria": "rows"}
    )
    pair = [lambda x: float((x + 1) ** 2), lambda x: float((x - 1) ** 2)]
    for function, names in ((bisect, ("start", "end")), (compromise, ("lower", "upper"))):
        yield Target(
            function.__name__,
            lambda *, f=function, n=names, **a: f(pair, *(a[k] for k in n)),
            dict(zip(names, (-1.0, 1.0), strict=True)),
            dict.fromkeys(names, "number"),
        )
    yield Target(
        "solve_riemann",
        lambda right: solve_riemann(np.ones(8), right),
        {"right": np.arange(8.0)},
        {"right": "complex"},
    )
    yield Target(
        "wiener_gain",
        wiener_gain,
        {
            "transition": PLANE / 4,
            "sensor": [[1.0, 0.0]],
            "state_noise": PLANE,
            "sensor_noise": [[1.0]],
        },
        {"transition": "array", "sensor": "array", "state_noise": "cov", "sensor_noise": "lone"},
    )


def designs():
    def simulated(times, paths, seed, nodes, workers):
        made = synthesize(
            discrete(),
            Memory(1),
            Taylor(),
            times,
            paths=paths,
            seed=seed,
            nodes=nodes,
            workers=workers,
        )
        return made.fits

    yield Target(
        "synthesize",
        simulated,
        {"times": TIMES, "paths": 200, "seed": 1, "nodes": 0, "workers": 1},
        {
            "times": "times",
            "paths": "count 1",
            "seed": "seed",
            "nodes": "count 0",
            "workers": "count 1",
        },
    )
    yield Target(
        "affine_synthesis",
        lambda times: (
            affine_synthesis(discrete(), Memory(1), Taylor(), times, x=(-8, 8, 65))[0].fits
        ),
        {"times": TIMES},
        {"times": "times"},
    )
    yield Target(
        "grid_synthesis",
        lambda times, low, high, count: (
            grid_synthesis(
                discrete(), Memory(1), times, x=(low, high, count), z=(-4, 4, 9), y=(-6, 6, 13)
            ).predicted
        ),
        {"times": TIMES, "low": -8.0, "high": 8.0, "count": 33},
        {"times": "times", "low": "number", "high": "number", "count": "count 2"},
    )
    yield Target(
        "simulate",
        lambda times, paths, seed: discrete().simulate(times, paths, seed),
        {"times": TIMES, "paths": 3, "seed": 1},
        {"times": "times", "paths": "count 1", "seed": "seed"},
    )
    yield Target(
        "simulate a diffusion",
        lambda times, paths, seed, step: diffusion(mean0=[0, 0], cov0=PLANE).simulate(
            times, paths, seed, step=step
        ),
        {"times": TIMES, "paths": 3, "seed": 1, "step": 0.5},
        {"times": "times", "paths": "count 1", "seed": "seed", "step": "positive or inf"},
    )
    yield Target(
        "simulate modes",
        lambda times, paths, seed: switching().simulate(times, paths, seed),
        {"times": TIMES, "paths": 3, "seed": 1},
        {"times": "times", "paths": "count 1", "seed": "seed"},
    )
    yield Target(
        "evaluate",
        lambda times, paths, seed: (
            evaluate(extended_kalman(discrete()), discrete(), times, paths, seed).rms
        ),
        {"times": TIMES, "paths": 20, "seed": 1},
        {"times": "times", "paths": "count 1", "seed": "seed"},
    )
    yield Target(
        "smooth",
        lambda times, measurements, lag: smooth(
            extended_kalman(discrete()), times, measurements, lag=lag
        ),
        {"times": TIMES, "measurements": Y, "lag": 2},
        {"times": "times", "measurements": "missing", "lag": "count 0"},
    )
    yield Target(
        "Memory",
        lambda estimates, measurements: Memory(estimates, measurements),
        {"estimates": 1, "measurements": 1},
        {"estimates": "count 0", "measurements": "count 0"},
    )
    yield Target(
        "ParticleFilter",
        lambda particles: ParticleFilter(discrete(), particles).run(TIMES, Y),
        {"particles": 10},
        {"particles": "count 1"},
    )
    yield Target(
        "step of a filter",
        lambda step, rtol: extended_kalman(
            diffusion(mean0=[0, 0], cov0=PLANE), step=step, rtol=rtol
        ).run(TIMES, Y),
        {"step": 0.5, "rtol": 1e-6},
        {"step": "positive or inf", "rtol": "nonnegative"},
    )
