"""Figures in which exported filters run on new paths."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy import linalg

from bookkit.live.fragment import Figure, Slider, pooled
from seedslib import zoo
from seedslib.design import affine_synthesis, grid_synthesis, stationary, synthesize
from seedslib.designed import SwitchingFilter, large_order
from seedslib.export import to_js
from seedslib.filters import extended_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

NOISES = (0.25, 0.5, 1.0, 2.0)
ORDERS = (1, 2, 4)
RATES = (0.2, 0.5, 1.0, 1.6)
MISSING = tuple(k / 10 for k in range(10))
PATHS = 1000
FLIP = {"x": (-3.5, 3.5, 101), "z": (-2.4, 2.4, 25), "y": (-7.2, 7.2, 37)}


def noisy_van_der_pol(deviation: float) -> JumpDiffusion:
    """`zoo.van_der_pol` with another standard deviation of both sensors."""
    x1, x2, v1, v2 = sympy.symbols("x1 x2 v1 v2")
    return JumpDiffusion(
        state=(x1, x2),
        drift=[x2, -((sympy.pi / 10) ** 2) * x1 + 2 * x2 * (1 - x1**2)],
        diffusion=[[0], [x1]],
        sensor=[x1**2 + v1, x2 + v2],
        noise=Noise((v1, v2), cov=deviation**2 * np.eye(2)),
        mean0=[2, 0],
        cov0=0.15 * np.eye(2),
    )


def van_der_pol_filters(noise: int) -> dict[str, Any]:
    """The filters of one deviation of the sensor noise, by the names of their modules."""
    system, times = noisy_van_der_pol(NOISES[noise]), 0.5 * np.arange(7)
    found: dict[str, Any] = {
        f"{order}@{noise}": synthesize(
            system, large_order(order), ExactGaussian(), times, paths=2000, seed=1, nodes=0
        )
        for order in ORDERS
    }
    return found | {f"ekf@{noise}": extended_kalman(system)}


def linear_filters() -> dict[str, Any]:
    """Filters for ever of the linear oscillator, from exact moments, and the Kalman filter."""
    system, times = zoo.linear_gaussian(), 0.5 * np.arange(24)
    found: dict[str, Any] = {}
    for order in (1, 4):
        made = synthesize(system, large_order(order), Taylor(), times, exact_moments=True, nodes=0)
        found[str(order)] = stationary(made, tolerance=0.1, paths=200, transient=6)
    x1, x2, p, q, v = sympy.symbols("x1 x2 p q v")
    matrix, root = linear_step()
    steps = DiscreteSystem(
        StochasticMap((x1, x2), [*(matrix @ [x1, x2] + root @ [p, q])], Noise((p, q))),
        StochasticMap((x1, x2), [x1 + v], Noise((v,), cov=[[0.25]])),
        [1.0, -0.5],
        np.eye(2),
    )
    return found | {"kf": extended_kalman(steps)}


def flip_filters() -> dict[str, Any]:
    """The optimal function of measurement and one estimate, on a grid, and theorem 2 beside it."""
    system, times = zoo.flip_process(), 0.25 * np.arange(13)
    with warnings.catch_warnings():
        # Almost nothing lies beyond the axis of the memory: 0.0002 of the probability.
        warnings.simplefilter("ignore", UserWarning)
        return {
            "table": grid_synthesis(system, large_order(1), times, **FLIP, nodes=0),
            "line": affine_synthesis(system, large_order(1), ExactGaussian(), times, **FLIP)[0],
        }


def switching_filters(rate: int) -> dict[str, Any]:
    """Designed filter and IMM for one factor of the switching probabilities."""
    system = zoo.scalar_switching(rate=RATES[rate])
    made = synthesize(system, large_order(1), ExactGaussian(), np.arange(16.0), paths=4000, seed=1)
    return {
        f"1@{rate}": stationary(made, tolerance=0.2, paths=500, transient=4),
        f"imm@{rate}": SwitchingFilter(system, Taylor()),
    }


def modules(filters: dict[str, Any]) -> dict[str, str]:
    """The filters as ECMAScript."""
    return {name: to_js(filter) for name, filter in filters.items()}


def linear_step(interval: float = 0.5) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transition matrix of the linear oscillator and the Cholesky factor of its noise."""
    drift, noise = np.array([[0.0, 1.0], [-1.0, -0.4]]), np.diag([0.0, 1.0])
    block = np.block([[-drift, noise], [np.zeros((2, 2)), drift.T]])
    whole = linalg.expm(block * interval)
    matrix = whole[2:, 2:].T
    return matrix, np.linalg.cholesky(matrix @ whole[:2, 2:])


def figures() -> list[Figure]:
    """All figures with filters."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return [_van_der_pol(), _linear(), _flip(), _switching()]


def _van_der_pol() -> Figure:
    made: dict[str, str] = {}
    for k in range(len(NOISES)):
        made |= modules(van_der_pol_filters(k))
    names = [{"key": str(o), "label": f"{o} estimate{'s' * (o > 1)}"} for o in ORDERS]
    return Figure(
        "van_der_pol",
        "filters",
        [Slider("noise", "standard deviation of the sensors", NOISES, 2, modules=True)],
        "Van der Pol oscillator of the jump-diffusion paper, measured seven times as x₁² and x₂ "
        "with noise. 1000 paths are simulated in the page; four filters run on each. Above, errors "
        "of both components together after each measurement; below, x₁ of the first path.",
        {
            "plant": "van_der_pol",
            "times": [0.5 * k for k in range(7)],
            "paths": PATHS,
            "size": 2,
            "parts": [0, 1],
            "options": {},
            "xlabel": "time",
            "state": "x₁",
            "filters": [*names, {"key": "ekf", "label": "extended Kalman"}],
            "timed": [f"ekf@{k}" for k in range(len(NOISES))],
            **pooled(made),
        },
        again=True,
    )


def _linear() -> Figure:
    matrix, root = linear_step()
    names = [{"key": str(o), "label": f"{o} estimate{'s' * (o > 1)}"} for o in (1, 4)]
    return Figure(
        "dropouts",
        "filters",
        [Slider("missing", "share of missing measurements", MISSING, 3)],
        "Linear oscillator, its position measured every half second. The designed filters were "
        "told of no gaps; they put the expected value in the place of what is missing. The Kalman "
        "filter knows what was missing: it is the optimum.",
        {
            "plant": "linear",
            "times": [0.5 * k for k in range(25)],
            "paths": PATHS,
            "size": 2,
            "parts": [0],
            "xlabel": "time",
            "state": "position",
            "shown": 0,
            "timed": ["kf"],
            "options": {
                "matrix": matrix.ravel().tolist(),
                "root": root[[0, 1, 1], [0, 0, 1]].tolist(),
            },
            "filters": [*names, {"key": "kf", "label": "Kalman"}],
            **pooled(modules(linear_filters())),
        },
        again=True,
    )


def _flip() -> Figure:
    kept = {
        name: stationary(made, tolerance=1.0, paths=200, transient=1)
        for name, made in flip_filters().items()
    }
    return Figure(
        "flip",
        "filters",
        [Slider("missing", "share of missing measurements", MISSING, 0)],
        "The process that flips from side to side, measured every quarter of a second. A table of "
        "the optimal function of measurement and last estimate, and the line of theorem 2 with the "
        "same memory.",
        {
            "plant": "flip",
            "times": [0.25 * k for k in range(13)],
            "paths": PATHS,
            "size": 1,
            "parts": [0],
            "xlabel": "time",
            "state": "x",
            "shown": 0,
            "timed": [],
            "options": {},
            "filters": [
                {"key": "table", "label": "optimal function"},
                {"key": "line", "label": "line"},
            ],
            **pooled(modules(kept)),
        },
        again=True,
    )


def _switching() -> Figure:
    made: dict[str, str] = {}
    for k in range(len(RATES)):
        made |= modules(switching_filters(k))
    return Figure(
        "switching",
        "filters",
        [Slider("rate", "factor of the switching probabilities", RATES, 2, modules=True)],
        "Scalar system of two modes whose switching depends on the state. The designed filter "
        "remembers one estimate, the IMM filter a law for each mode; a filter of its own for each "
        "factor.",
        {
            "plant": "switching",
            "times": list(range(21)),
            "paths": PATHS,
            "size": 1,
            "parts": [0],
            "xlabel": "time",
            "state": "x",
            "options": {},
            "filters": [
                {"key": "1", "label": "designed, 1 estimate"},
                {"key": "imm", "label": "IMM, linearised"},
            ],
            "timed": [f"imm@{k}" for k in range(len(RATES))],
            **pooled(made),
        },
        again=True,
    )
