"""Errors and costs of filters, family by family, on five problems.

Run by hand, ``python benchmarks/which_filter.py``, some minutes on one core; writes
``benchmarks/which_filter.csv`` beside itself. An error is the root of the mean square over times
and runs; `excess` is by how many per cent it lies above that of the best filter on the runs that
both have filtered, with its standard error. The models of the random sine, the bearings and the
re-entry are those of the manual of the EKF/UKF toolbox (Hartikainen, Solin, Särkkä 2011), the
cubic sensor and the switching sensor those of the program MinimaxResearch of horribleheffalump
(MIT); all equations are written anew here.
"""

from __future__ import annotations

import csv
import os
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy as sp

from seedslib.design import BoundedPolynomial, grid_synthesis, minimax_synthesis, synthesize
from seedslib.designed import Memory
from seedslib.filters import CovarianceFilter, GridBayesFilter, ParticleFilter
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap, van_loan

HERE = Path(__file__).parent
PATHS = 8192  # of the filters designed on simulated runs


class Problem(NamedTuple):
    """Runs, what of the state is wanted, and the filters: family, name, run, design, count.

    A run is a function of measurements (K+1, m, N) that gives means (K+1, n, N); `count` is how
    many runs it is given, where not all.
    """

    states: int
    y: np.ndarray
    truth: np.ndarray
    wanted: Callable[[np.ndarray], np.ndarray]
    filters: Iterator[tuple]


def covariance_filters(system, rules, times):
    """Filters that carry a mean and a covariance."""
    for name, rule in rules.items():
        family = "extended" if isinstance(rule, Taylor) else "Gaussian"
        filter = CovarianceFilter(system, rule)
        yield family, name, lambda y, f=filter: f.run(times, y).mean


def particles(system, count, times, runs):
    filter = ParticleFilter(system, count)
    run = partial(filter.run, times, seed=5)
    return "particles", f"{count} particles", lambda y: run(y).mean, "", runs


def designed(family, name, make, times):
    """A filter that is found before the data, with the seconds that this takes."""
    begin = time.process_time()
    filter = make()
    spent = f"{time.process_time() - begin:.1f}"
    return family, name, lambda y: filter.run(times, y).mean, spent


def by_order(system, means, times, orders, known):
    """Filters that remember estimates, designed on simulated runs."""
    for order in orders:
        chosen = {"paths": PATHS, "seed": 3, "measured": known}
        make = partial(synthesize, system, Memory(order), means, times, **chosen)
        yield designed("precomputed", f"order {order}", make, times)


def unseen(y):
    """The same measurements, but for those at k = 0."""
    return np.concatenate([np.full((1, *y.shape[1:]), np.nan), y[1:]])


def scalar(system, alike, grids, corrections, runs=4000) -> Problem:
    """A problem whose distribution can be kept on a grid; `alike` is for Kalman filters."""
    times = np.arange(31.0)
    data = system.simulate(times, runs, 1)
    x, z, y = grids
    rules = {
        "EKF": Taylor(),
        "unscented": Unscented(1.0, 0.0, 2.0),
        "Gauss-Hermite": GaussHermite(10),
    }

    def filters():
        grid = GridBayesFilter(system, x)

        def bayes(y):
            parts = np.split(y, range(250, y.shape[2], 250), axis=2)
            return np.concatenate([grid.run(times, part).mean for part in parts], axis=2)

        yield "Bayes", "Bayes", bayes
        yield from covariance_filters(alike, rules, times)
        yield particles(system, 500, times, 500)
        for name, correction in corrections.items():
            yield designed(
                "minimax", name, lambda c=correction: minimax_synthesis(
                    system, Memory(1), times, paths=50_000, seed=3, correction=c
                ), times,
            )  # fmt: skip
        yield designed(
            "precomputed", "order-1 table",
            lambda: grid_synthesis(system, Memory(1), times, x=x, z=z, y=y), times,
        )  # fmt: skip

    return Problem(1, data.measurements, data.states, lambda x: x[10:, 0], filters())


def cubic() -> Problem:
    """A state that is thrown back to the middle, and a sensor that is steep outside."""
    x, w, v = sp.symbols("x w v", real=True)
    system = DiscreteSystem(
        StochasticMap([x], [x / (1 + x**2) + w], Noise([w])),
        StochasticMap([x], [x**3 + x + v], Noise([v])), [0.1], [[1.16]],
    )  # fmt: skip

    def root(t, forecast, y):
        residual = (y - forecast**3 - forecast) / (1 + 3 * forecast**2)
        return np.concatenate([np.cbrt(y) - forecast, residual])

    corrections = {"residual": None, "cube root": root, "polynomial": BoundedPolynomial(5)}
    grids = (-5.6, 5.6, 225), (-5, 5, 161), (-190, 190, 761)
    return scalar(system, system, grids, corrections)


def switching_sensor() -> Problem:
    """A line that is seen through one of three channels, and which one is not known."""
    gains, noises = np.array([4.0, 1.0, 0.5]), np.array([1.0, 1.0, 3.0])
    probs, cut = np.array([0.25, 0.5, 0.25]), 0.6745
    x, w, v, u = sp.symbols("x w v u", real=True)

    def density(value, mean, variance):
        return np.exp(-0.5 * (value - mean) ** 2 / variance) / np.sqrt(2 * np.pi * variance)

    def measured(t, x, v):
        channel = np.searchsorted((-cut, cut), v[1:], side="right")
        return gains[channel] * x + noises[channel] * v[:1]

    def log_density(t, y, x):
        parts = zip(probs, gains, noises, strict=True)
        return np.log(sum(p * density(y[0], d * x[0], s**2) for p, d, s in parts) + 1e-300)

    def weighed(t, forecast, y):
        """Kalman's correction in each channel, by its probability."""
        above, below, variance = 0.0, 1e-300, 36 + 0.64 * 6.0
        for p, d, s in zip(probs, gains, noises, strict=True):
            spread = d**2 * variance + s**2
            weight = p * density(y, d * forecast, spread)
            above = above + weight * variance * d / spread * (y - d * forecast)
            below = below + weight
        return above / below

    mean, square = probs @ gains, probs @ noises**2
    wander = probs @ gains**2 - mean**2
    sensor = StochasticMap.from_functions(
        1, 1, measured, Noise([v, u]), mean=lambda t, x: mean * x,
        cov=lambda t, x: (wander * x**2 + square)[None], log_density=log_density,
    )  # fmt: skip
    moved = StochasticMap([x], [0.8 * x + 0.2 + 6 * w], Noise([w]))
    formula = mean * x + sp.sqrt(wander * x**2 + square) * v
    alike = DiscreteSystem(moved, StochasticMap([x], [formula], Noise([v])), [0.0], [[1.0]])
    grids = (-64, 66, 417), (-60, 62, 245), (-240, 248, 977)
    corrections = {"residual": None, "weighed": weighed}
    return scalar(DiscreteSystem(moved, sensor, [0.0], [[1.0]]), alike, grids, corrections)


def random_sine(runs=400) -> Problem:
    """A sine whose frequency and amplitude wander; the signal is wanted."""
    variance, dt, times = 0.3, 0.01, np.arange(501.0)
    spread = np.diag([0, 0.2, 0.1])
    matrix, push = van_loan(np.array([[0.0, 1, 0], [0, 0, 0], [0, 0, 0]]), spread, dt)
    state = sp.symbols("theta omega a", real=True)
    *e, r = sp.symbols("e:3 r", real=True)
    step = list(sp.Matrix(matrix) * sp.Matrix(state) + sp.Matrix(e))
    system = DiscreteSystem(
        StochasticMap(state, step, Noise(e, cov=push)),
        StochasticMap(state, [state[2] * sp.sin(state[0]) + r], Noise([r])),
        (0.0, 10.0, 1.0), variance * np.eye(3),
    )  # fmt: skip
    data = system.simulate(times, runs, 11)
    rules = {"EKF": Taylor(), "assumed density": ExactGaussian(), "cubature": Cubature()}
    known = np.broadcast_to(times[:, None] > 0, (501, 1))

    def signal(means):
        three = means.shape[1] == 3
        return (means[:, 2] * np.sin(means[:, 0]) if three else means[:, 0])[1:]

    def filters():
        yield from covariance_filters(system, rules, times)
        blackwell = partial(rao_blackwell, variance=variance, count=300, push=push, dt=dt)
        yield "particles", "300 Rao-Blackwellised", lambda y: blackwell(y[1:, 0])
        yield particles(system, 1000, times, 200)
        yield from by_order(system, ExactGaussian(), times, (1, 4), known)

    return Problem(3, unseen(data.measurements), data.states, signal, filters())


def rao_blackwell(y, variance, count, push, dt):
    """Means of the signal (K+1, 1, runs) by particles of the angle, of y (K, runs).

    Given the angles, their increments measure the frequency and y the amplitude, both linearly.
    """
    rng, shape = np.random.default_rng(5), (count, y.shape[1])
    angle = np.sqrt(variance) * rng.standard_normal(shape)
    frequency, amplitude = np.full(shape, 10.0), np.full(shape, 1.0)
    slow, fade, means = variance, np.full(shape, variance), [np.zeros(y.shape[1])]
    for measured in y:
        move, lean = dt**2 * slow + push[0, 0], dt * slow + push[0, 1]
        jump = np.sqrt(move) * rng.standard_normal(shape)
        angle, frequency = angle + dt * frequency + jump, frequency + lean / move * jump
        slow, fade = slow + push[1, 1] - lean**2 / move, fade + push[2, 2]
        wave = np.sin(angle)
        spread, rest = fade * wave**2 + 1.0, measured - amplitude * wave
        score = -0.5 * (rest**2 / spread + np.log(spread))
        weight = np.exp(score - score.max(axis=0))
        weight /= weight.sum(axis=0)
        gain = fade * wave / spread
        amplitude, fade = amplitude + gain * rest, fade - gain * wave * fade
        means.append((weight * amplitude * wave).sum(axis=0))
        levels = (np.arange(count)[:, None] + rng.random(shape[1])) / count
        pairs = zip(np.cumsum(weight, axis=0).T, levels.T, strict=True)
        chosen = np.stack([np.searchsorted(*pair) for pair in pairs], axis=1).clip(max=count - 1)
        parts = angle, frequency, amplitude, fade
        angle, frequency, amplitude, fade = (np.take_along_axis(p, chosen, 0) for p in parts)
    return np.array(means)[:, None]


def bearings(runs=1000) -> Problem:
    """A target that two sensors see the bearings of; it is no draw of the filters' model."""
    dt, count, sensors, times = 0.01, 500, ((-1, -2), (1, 1)), np.arange(501.0)
    rng = np.random.default_rng(1)
    turn = np.zeros((count, runs))  # angle of a step
    for start in (49, 199, 349):
        turn[start : start + 51] = np.pi / 102 + 1e-4 * rng.standard_normal((51, runs))
    heading = turn / 2 - np.cumsum(turn, axis=0)
    chord = dt * np.sinc(turn / (2 * np.pi))
    place = np.cumsum(chord * np.stack([np.cos(heading), np.sin(heading)]), axis=1)
    apart = place[:, None] - np.array(sensors).T[:, :, None, None]
    angle = np.arctan2(apart[1], apart[0]) + 0.05 * rng.standard_normal((2, count, runs))
    y = np.moveaxis(np.pi - (np.pi - angle) % (2 * np.pi), 0, 1)
    y = np.concatenate([np.full((1, 2, runs), np.nan), y])
    truth = np.concatenate([np.zeros((1, 2, runs)), np.moveaxis(place, 0, 1)])
    matrix, push = van_loan(np.eye(4, k=2), np.diag([0, 0, 0.1, 0.1]), dt)
    state, q = sp.symbols("p_x p_y v_x v_y", real=True), sp.symbols("q:4", real=True)
    e = sp.symbols("e:2", real=True)
    step = list(sp.Matrix(matrix) * sp.Matrix(state) + sp.Matrix(q))
    seen = [sp.atan2(state[1] - b, state[0] - a) + v for (a, b), v in zip(sensors, e, strict=True)]
    turns = dict.fromkeys((0, 1), 2 * np.pi)
    system = DiscreteSystem(
        StochasticMap(state, step, Noise(q, cov=push)),
        StochasticMap(state, seen, Noise(e, cov=0.05**2 * np.eye(2)), period=turns),
        np.zeros(4), np.diag([0.1, 0.1, 10, 10]),
    )  # fmt: skip
    rules = {
        "EKF": Taylor(), "unscented": Unscented(0.5, 2.0, -1.0), "cubature": Cubature(),
        "Gauss-Hermite": GaussHermite(3),
    }  # fmt: skip
    known = np.broadcast_to(times[:, None] > 0, (501, 2))

    def filters():
        yield from covariance_filters(system, rules, times)
        yield particles(system, 1000, times, 100)
        yield from by_order(system, Taylor(), times, (2, 4), known)

    return Problem(4, y, truth, lambda x: x[1:, :2], filters())


def reentry(runs=200) -> Problem:
    """A vehicle that enters the atmosphere and is seen by a radar of great precision."""
    radius, start, drag, dt = 6374.0, [6500.4, 349.14, -1.8093, -6.7967], 0.6932, 0.1
    times = dt * np.arange(2001)
    x, w, v = (sp.symbols(f"{s}1:{n + 1}", real=True) for s, n in (("x", 5), ("w", 3), ("v", 2)))
    distance, speed = sp.sqrt(x[0] ** 2 + x[1] ** 2), sp.sqrt(x[2] ** 2 + x[3] ** 2)
    brake = -0.59783 * sp.exp(x[4] + (radius - distance) / 13.406) * speed
    pull = -3.986e5 / distance**3
    rate = [x[2], x[3], brake * x[2] + pull * x[0], brake * x[3] + pull * x[1], 0]
    step = [a + dt * r for a, r in zip(x, rate, strict=True)]
    step[2:] = [a + noise for a, noise in zip(step[2:], w, strict=True)]
    sight = [sp.sqrt((x[0] - radius) ** 2 + x[1] ** 2) + v[0], sp.atan2(x[1], x[0] - radius) + v[1]]
    radar = StochasticMap(
        x, sight, Noise(v, cov=np.diag([1e-3**2, 0.17e-3**2])), period={1: 2 * np.pi}
    )

    def falling(mean, variance, wander):
        move = StochasticMap(x, step, Noise(w, cov=np.diag([2.4064e-5, 2.4064e-5, wander])))
        return DiscreteSystem(move, radar, [*start, mean], np.diag([1e-6] * 4 + [variance]))

    data = falling(drag, 0.0, 0.0).simulate(times, runs, 1)
    system = falling(0.0, 1.0, 1e-6)
    mean, _, cov = Cubature().moments(system.dynamics)(0.0, system.mean0, system.cov0)
    later = DiscreteSystem(system.dynamics, radar, mean, cov)  # from the first measurement on
    rules = {"EKF": Taylor(), "unscented": Unscented(), "cubature": Cubature()}

    def turned(t, forecast, y):
        """Residuals of range and of place across, along the axes of the plane."""
        along, across = forecast[0] - radius, forecast[1]
        distance = np.hypot(along, across)
        cosine, sine = along / distance, across / distance
        far = y[0] - distance
        side = distance * np.sin(y[1] - np.arctan2(across, along))
        return np.stack([far * cosine, far * sine, -side * sine, side * cosine, far, side])

    def filters():
        yield from covariance_filters(system, rules, times)
        yield particles(system, 100, times, 20)
        nothing = np.zeros((1, 5, runs))
        kinds = {
            "minimax": partial(minimax_synthesis, correction=turned),
            "precomputed": partial(synthesize, linearization=Cubature()),
        }
        for family, make in kinds.items():
            _, name, run, spent = designed(
                family, "turned residual" if family == "minimax" else "order 1",
                lambda f=make: f(later, Memory(1), times=times[1:], paths=1000, seed=1), times[1:],
            )  # fmt: skip
            yield family, name, lambda y, run=run: np.concatenate([nothing, run(y[1:])]), spent

    return Problem(5, unseen(data.measurements), data.states, lambda x: x[1:, :2], filters())


PROBLEMS = {
    "cubic sensor": cubic,
    "switching sensor": switching_sensor,
    "random sine": random_sine,
    "bearings only": bearings,
    "re-entry": reentry,
}


def rows_of(problem: Problem) -> list[tuple]:
    """Family, name, runs, error, excess over the best, its standard error, cost, design."""
    squares, costs = {}, {}
    truth = problem.wanted(problem.truth)
    for family, name, run, *more in problem.filters:
        design, count = [*more, "", None][:2] if more else ("", None)
        y = problem.y[..., : count or truth.shape[-1]]
        begin = time.process_time()
        means = run(y)
        spent = (time.process_time() - begin) / y.shape[2] / len(y)
        square = (problem.wanted(means) - truth[..., : y.shape[2]]) ** 2
        if square.ndim == 3:
            square = square.sum(axis=1)
        squares[family, name] = square.mean(axis=0)
        costs[family, name] = f"{1e6 * spent:.3g}", design
        print(family, name, np.sqrt(squares[family, name].mean()), *costs[family, name], flush=True)
    most = max(map(len, squares.values()))
    best = min((square for square in squares.values() if len(square) == most), key=np.mean)
    rows = []
    for key, square in squares.items():
        n = min(len(square), len(best))
        ratio = np.sqrt(square[:n].mean() / best[:n].mean())
        parts = square[:n] / square[:n].mean() - best[:n] / best[:n].mean()
        numbers = np.sqrt(square.mean()), 100 * (ratio - 1), 50 * ratio * parts.std() / np.sqrt(n)
        rows.append((*key, len(square), *(f"{v:.6g}" for v in numbers), *costs[key]))
    return rows


def main() -> None:
    warnings.simplefilter("ignore")
    with (HERE / "which_filter.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        names = "problem", "states", "family", "filter", "runs", "rmse", "excess", "error"
        table.writerow((*names, "microseconds", "design_seconds"))
        for name, make in PROBLEMS.items():
            problem = make()
            table.writerows((name, problem.states, *row) for row in rows_of(problem))
            file.flush()


if __name__ == "__main__":
    main()
