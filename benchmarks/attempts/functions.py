"""More of what is abused: moment functions and designs with good arguments."""

from __future__ import annotations

import numpy as np
import sympy

from attempts.targets import PLANE, TIMES, Target, X, Y, Z, diffusion, discrete, switching
from seedslib.base import Axis, correct, interpolate
from seedslib.design import affine_synthesis, grid_synthesis, synthesize
from seedslib.designed import Memory
from seedslib.evaluation import evaluate
from seedslib.filters import (
    ParticleFilter,
    extended_kalman,
    smooth,
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
    van_loan,
)
from seedslib.pareto import bisect, choose, compromise
from seedslib.riemann import solve_riemann, wiener_gain


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
