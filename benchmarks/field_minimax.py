"""Three models of a public program of the conditionally minimax filter: errors of filters.

Run by hand, ``python benchmarks/field_minimax.py``, a few minutes on one core; writes
``benchmarks/field_minimax.csv`` beside itself. The models are those of the repository
horribleheffalump/MinimaxResearch (MIT); their equations are written anew here, and no number of
its figures is used.

- minimax residual: conditionally minimax, the dynamics as prediction and the residual;
- minimax program: with the functions which that program has for the model, where others;
- minimax chosen: with functions that look at the model, ours; minimax polynomial: bounded ones;
- order 1, 2: tables of the best functions of one or two estimates; least: the distribution on
nodes.
"""

from __future__ import annotations

import csv
import os
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy

from seedslib.base import Nodes
from seedslib.design import BoundedPolynomial, grid_synthesis, minimax_synthesis
from seedslib.designed import Memory
from seedslib.filters import CovarianceFilter, GridBayesFilter, extended_kalman
from seedslib.linearization import GaussHermite, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap

HERE = Path(__file__).parent
TIMES, FROM = np.arange(31.0), 10
RUNS, PATHS = 2000, 50_000
X, W, V, U = sympy.symbols("x w v u", real=True)
EDGES = (3.0, 7.0)
LINES = np.array([[0.3, 1.4, 0.9], [0.4, 3.0, 1.5], [0.7, 3.0, 2.5]])
WEIGHTS = np.array([0.33, 0.37, 0.3])
GAINS, LOUD = np.array([4.0, 1.0, 0.5]), np.array([1.0, 1.0, 3.0])
SHARES, CUT = np.array([0.25, 0.5, 0.25]), 0.6745
BOUND = 5.0


class Problem(NamedTuple):
    """A model, what stands in for it in Kalman filters, nodes, and basic functions."""

    system: DiscreteSystem
    smooth: DiscreteSystem
    x: Any
    z: tuple
    y: tuple
    pair: tuple
    program: tuple = (None, None)
    chosen: tuple = (None, None)


def bell(mean, deviation, x):
    """Normal density."""
    return np.exp(-0.5 * ((x - mean) / deviation) ** 2) / (np.sqrt(2 * np.pi) * deviation)


def noisy(value, spread):
    """Map of array functions with a normal distribution: value(x) and deviation spread(x)."""

    def density(t, y, x):
        return np.log(bell(value(x)[0], spread(x)[0], y[0]))

    return StochasticMap.from_functions(
        1,
        1,
        lambda t, x, v: value(x) + spread(x) * v,
        Noise([W]),
        mean=lambda t, x: value(x),
        cov=lambda t, x: (spread(x) ** 2)[None],
        log_density=density,
    )


# The state is thrown back by one over its cube root


def thrown(x):
    """One over the cube root, kept within the bound."""
    with np.errstate(divide="ignore"):
        return np.clip(1 / np.cbrt(x), -BOUND, BOUND)


def inverse() -> Problem:
    """Inverse proportion, the stable one."""
    u = np.linspace(-np.arcsinh(550.0), np.arcsinh(550.0), 320)
    plain = StochasticMap([X], [X + V], Noise([V]))
    root = X / (X**2 + sympy.Rational(1, 10**12)) ** sympy.Rational(2, 3)  # has a derivative
    return Problem(
        DiscreteSystem(noisy(thrown, np.ones_like), plain, [3.01], [[1.0]]),
        DiscreteSystem(StochasticMap([X], [root + W], Noise([W])), plain, [3.01], [[1.0]]),
        Nodes(0.02 * np.sinh(u), 0.02 * (u[1] - u[0]) * np.cosh(u)),
        (-7, 7, 281),
        (-12, 12, 193),
        ((-6, 6, 61), (-11, 11, 89)),
        chosen=(
            lambda t, z: np.concatenate([thrown(z), np.tanh(z), np.tanh(3 * z), z]),
            lambda t, ahead, y: np.concatenate([y - ahead, np.tanh(y), np.tanh(y - ahead)]),
        ),
    )


# A regression with another line in each of three ranges of the state


def line(x, part):
    """Slope, shift or deviation of the range that x is in."""
    return LINES[np.searchsorted(EDGES, x, side="right"), part]


def averaged(t, x):
    """The prediction of that program: lines in proportion to their own distributions at the
    estimate."""
    slope, shift, spread = LINES.T[:, :, None]
    weight = WEIGHTS[:, None] * bell(shift / (1 - slope), spread / np.sqrt(1 - slope**2), x)
    return ((slope * x + shift) * weight).sum(axis=0, keepdims=True) / weight.sum(axis=0)


def regression() -> Problem:
    """Sampled regression."""
    plain = StochasticMap([X], [X + V], Noise([V]))
    moved = noisy(lambda x: line(x, 0) * x + line(x, 1), lambda x: line(x, 2))
    pieces = [
        sum(p * q for p, q in zip(row, (X, 1, W), strict=True))
        for row in [[sympy.Rational(str(v)) for v in row] for row in LINES]
    ]
    formula = sympy.Piecewise((pieces[0], X < 3), (pieces[1], X < 7), (pieces[2], True))
    return Problem(
        DiscreteSystem(moved, plain, [0.0], [[1.0]]),
        DiscreteSystem(StochasticMap([X], [formula], Noise([W])), plain, [0.0], [[1.0]]),
        (-8.05, 31.95, 401),
        (-6, 29, 281),
        (-11, 35, 185),
        ((-5, 28, 67), (-10, 34, 89)),
        program=(averaged, None),
        chosen=(
            lambda t, z: np.concatenate([averaged(t, z), line(z, 0) * z + line(z, 1), z]),
            lambda t, ahead, y: np.concatenate(
                [y - ahead, np.abs(y - 3), np.abs(y - 7), np.abs(ahead - 3), np.abs(ahead - 7)]
            ),
        ),
    )


# A line seen through one of three channels, and which one is not told


def channel(pick, values):
    """Value of the channel that a standard normal number picks."""
    return values[np.searchsorted((-CUT, CUT), pick, side="right")]


def through(t, x, v):
    """A measurement: the second noise picks the channel of the first."""
    return channel(v[1:], GAINS) * x + channel(v[1:], LOUD) * v[:1]


def mixed(t, y, x):
    """Logarithm of the density of a measurement."""
    parts = (p * bell(d * x[0], s, y[0]) for p, d, s in zip(SHARES, GAINS, LOUD, strict=True))
    with np.errstate(divide="ignore"):
        return np.log(sum(parts))


def weighed(variance):
    """The correction of that program: Kalman's in each channel, by its probability."""

    def correction(t, ahead, y):
        top = below = 0.0
        for p, d, s in zip(SHARES, GAINS, LOUD, strict=True):
            spread = d**2 * variance + s**2
            weight = p * bell(d * ahead, np.sqrt(spread), y)
            top, below = top + weight * variance * d / spread * (y - d * ahead), below + weight
        return top / np.maximum(below, 1e-300)

    return correction


def switching() -> Problem:
    """Switching observations; the picked channel is independent from step to step."""
    first, second = SHARES @ GAINS, SHARES @ GAINS**2
    wander, loud = second - first**2, SHARES @ LOUD**2
    sensor = StochasticMap.from_functions(
        1,
        1,
        through,
        Noise([V, U]),
        mean=lambda t, x: first * x,
        cov=lambda t, x: (wander * x**2 + loud)[None],
        log_density=mixed,
    )
    moved = StochasticMap([X], [0.8 * X + 0.2 + 6 * W], Noise([W]))
    alike = StochasticMap([X], [first * X + sympy.sqrt(wander * X**2 + loud) * V], Noise([V]))
    variance = 36 + 0.64 * 6.0
    return Problem(
        DiscreteSystem(moved, sensor, [0.0], [[1.0]]),
        DiscreteSystem(moved, alike, [0.0], [[1.0]]),
        (-64, 66, 417),
        (-60, 62, 245),
        (-240, 248, 977),
        ((-58, 60, 60), (-240, 248, 245)),
        program=(None, weighed(variance)),
        chosen=(
            None,
            lambda t, ahead, y: np.concatenate(
                [weighed(variance)(t, ahead, y), y - first * ahead, ahead]
            ),
        ),
    )


PROBLEMS = {
    "inverse proportion": inverse,
    "sampled regression": regression,
    "switching observations": switching,
}


def kalman_filters(problem: Problem) -> dict:
    """Filters that need no design, by name."""
    system = problem.smooth
    return {
        "extended Kalman": extended_kalman(system),
        "unscented, alpha 1, beta 0, kappa 2": CovarianceFilter(system, Unscented(1.0, 0.0, 2.0)),
        "Gauss-Hermite 10": CovarianceFilter(system, GaussHermite(10)),
    }


def minimax_filters(problem: Problem, paths: int = PATHS, times=TIMES) -> dict:
    """Conditionally minimax filters by name, and the seconds of their design."""
    choices = {
        "residual": (None, None),
        "program": problem.program,
        "chosen": problem.chosen,
        "polynomial": (None, BoundedPolynomial(5)),
    }
    found = {}
    for name, (prediction, correction) in choices.items():
        if name == "program" and problem.program == (None, None):
            continue
        begin = time.process_time()
        filter = minimax_synthesis(
            problem.system,
            Memory(1),
            times,
            paths=paths,
            seed=3,
            prediction=prediction,
            correction=correction,
        )
        found[f"minimax {name}"] = filter, time.process_time() - begin
    return found


def table(problem: Problem, order: int, times=TIMES):
    """The table of the best functions, and the seconds of its design."""
    begin = time.process_time()
    z, y = (problem.z, problem.y) if order == 1 else problem.pair
    filter = grid_synthesis(problem.system, Memory(order), times, x=problem.x, z=z, y=y)
    return filter, time.process_time() - begin


def rows_of(name: str):
    """Rows of the table for a problem, as they are found."""
    problem = PROBLEMS[name]()
    data = problem.system.simulate(TIMES, RUNS, 1)
    states, y = data.states[FROM:, 0], data.measurements
    begin = time.process_time()
    filter = GridBayesFilter(problem.system, problem.x)
    parts = [filter.run(TIMES, y[..., a : a + 250]).mean for a in range(0, RUNS, 250)]
    best = np.concatenate(parts, axis=2)[FROM:, 0]
    spent = time.process_time() - begin

    def told(row, mean, spent, design=None, predicted=None):
        square = [
            (mean - states) ** 2,
            (mean - states) ** 2 - (best - states) ** 2,
            (mean - best) ** 2,
        ]
        square = [part.mean(axis=0) for part in square]
        values = [v for part in square for v in (part.mean(), part.std() / RUNS**0.5)]
        cost = 1e6 * spent / RUNS / len(TIMES)
        more = ["" if v is None else f"{v:.4f}" for v in (design, predicted)]
        return name, row, RUNS, *(f"{v:.6f}" for v in values), f"{cost:.3f}", *more

    yield told("least", best, spent)
    for row, filter in kalman_filters(problem).items():
        begin = time.process_time()
        mean = filter.run(TIMES, y).mean[FROM:, 0]
        yield told(row, mean, time.process_time() - begin)
    designed = minimax_filters(problem)
    designed |= {f"order {order}": table(problem, order) for order in (1, 2)}
    for row, (filter, design) in designed.items():
        begin = time.process_time()
        mean = filter.run(TIMES, y).mean[FROM:, 0]
        spent = time.process_time() - begin
        predicted = float((filter.predicted.rms[FROM:, 0] ** 2).mean())
        yield told(row, mean, spent, design, predicted)


def main() -> None:
    warnings.simplefilter("ignore")
    with (HERE / "field_minimax.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        names = "problem", "row", "runs", "mse", "error", "above", "above_error", "far"
        rows.writerow((*names, "far_error", "microseconds", "design_seconds", "predicted"))
        for name in PROBLEMS:
            for row in rows_of(name):
                rows.writerow(row)
                file.flush()
                print(*row, flush=True)


if __name__ == "__main__":
    main()
