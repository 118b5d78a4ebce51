"""Time of three whole tasks of a user against statsmodels and plain NumPy, in one run.

Run by hand, ``python benchmarks/tasks_speed.py``; writes ``benchmarks/tasks_speed.csv`` beside
itself: seconds of the processor (the best of a few) of ours and of the other program, and how many
times ours takes. Monthly CO2 with its gaps, a trend and a season, from a diffuse start; stochastic
volatility on a grid of 161 nodes, 1866 simulated returns; the same with 1000 particles. Both sides
give the same numbers, to the tolerance in `CHECKS`.
"""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy
from scipy.optimize import minimize
from statsmodels.api import datasets, tsa

from seedslib.base import Parameter
from seedslib.evaluation import fit
from seedslib.filters import GridBayesFilter, KalmanFilter, ParticleFilter, smooth
from seedslib.models import DiscreteSystem, Noise, StochasticMap, season, trend

CO2 = datasets.co2.load_pandas().data["co2"].resample("MS").mean().to_numpy()
MONTHS = np.arange(len(CO2))
RETURNS, PARTICLES, GRID = 1866, 1000, (-4.0, 4.0, 161)
FOUR = [Parameter(name, 0.1, positive=True) for name in ("noise", "level", "slope", "season")]
A, S, B = Parameter("a", 0.95), Parameter("s", 0.2, positive=True), Parameter("b", 0.7)
CHECKS = {"filter": 1e-9, "smoother": 1e-9, "fit": 1e-4, "grid": 1e-6, "grid fit": 1e-3}


def structural():
    noise, moved, slope, pattern = FOUR
    return KalmanFilter(trend(moved, slope, noise=noise) + season(12, pattern))


def theirs():
    return tsa.UnobservedComponents(CO2, "lltrend", seasonal=12, use_exact_diffuse=True)


def volatility():
    """A filter for each set of numbers, of formulas that are compiled once."""
    x, v, w = sympy.symbols("x v w", real=True)
    moved = StochasticMap([x], [A * x + S * v], Noise([v]))
    shown = StochasticMap([x], [B * sympy.exp(x / 2) * w], Noise([w]))
    system = DiscreteSystem(moved, shown, 0, S**2 / (1 - A**2))
    return lambda numbers: GridBayesFilter(system.bind(numbers), x=GRID)


def returns():
    rng, h, rows = np.random.default_rng(0), 0.0, []
    for _ in range(RETURNS):
        h = 0.96 * h + 0.19 * rng.normal()
        rows.append(0.68 * np.exp(h / 2) * rng.normal())
    return np.array(rows)


def grid_by_hand(y, a, s, b):
    """Log-likelihood by the recursion of Kitagawa, in NumPy."""
    nodes = np.linspace(*GRID)
    step = np.exp(-((nodes[:, None] - a * nodes) ** 2) / (2 * s * s))
    step *= (nodes[1] - nodes[0]) / (s * np.sqrt(2 * np.pi))
    prob = np.exp(-nodes * nodes * (1 - a * a) / (2 * s * s))
    prob, deviation, total = prob / prob.sum(), b * np.exp(nodes / 2), 0.0
    for k, row in enumerate(y):
        prob = step @ prob if k else prob
        prob = prob * np.exp(-0.5 * (row / deviation) ** 2) / deviation / np.sqrt(2 * np.pi)
        total += np.log(prob.sum())
        prob /= prob.sum()
    return total


def grid_fit_by_hand(y):
    start = [A.value, np.log(S.value), B.value]

    def less(u):
        return -grid_by_hand(y, u[0], np.exp(u[1]), u[2]) if abs(u[0]) < 1 else np.inf

    return -minimize(less, start, method="Nelder-Mead").fun


def particles_by_hand(y):
    rng, a, s, b = np.random.default_rng(1), A.value, S.value, B.value
    x = s / np.sqrt(1 - a * a) * rng.normal(size=PARTICLES)
    means = []
    for k, row in enumerate(y):
        x = a * x + s * rng.normal(size=PARTICLES) if k else x
        weight = np.exp(-0.5 * (row / b) ** 2 * np.exp(-x) - x / 2)
        weight /= weight.sum()
        means.append(weight @ x)
        at = (np.arange(PARTICLES) + rng.uniform()) / PARTICLES
        x = x[np.searchsorted(np.cumsum(weight), at).clip(max=PARTICLES - 1)]
    return np.array(means)


def seconds(call, rounds):
    """The best time, and the result."""
    times = []
    for _ in range(rounds):
        begin = time.process_time()
        found = call()
        times.append(time.process_time() - begin)
    return min(times), found


def main() -> None:
    ours, other, y = structural(), theirs(), returns()
    values, column, made = [p.value for p in FOUR], CO2[:, None], volatility()
    start, times = {A: A.value, S: S.value, B: B.value}, np.arange(RETURNS)
    particles = ParticleFilter(made(start).system, PARTICLES)
    rows = {
        "filter": (
            lambda: ours.run(MONTHS, column).loglik.sum(),
            lambda: other.filter(values).llf,
            3,
        ),
        "smoother": (
            lambda: smooth(ours, MONTHS, column).mean[0, 0],
            lambda: other.smooth(values).smoothed_state[0, 0],
            3,
        ),
        "fit": (
            lambda: fit(ours, MONTHS, column, FOUR).loglik,
            lambda: other.fit(disp=0, maxiter=200).llf,
            1,
        ),
        "grid": (
            lambda: made(start).run(times, y[:, None]).loglik.sum(),
            lambda: grid_by_hand(y, *start.values()),
            3,
        ),
        "grid fit": (
            lambda: fit(made, times, y[:, None], [A, S, B]).loglik,
            lambda: grid_fit_by_hand(y),
            1,
        ),
        "particles": (
            lambda: particles.run(times, y[:, None]).mean[:, 0],
            lambda: particles_by_hand(y),
            3,
        ),
    }
    with open(Path(__file__).with_suffix(".csv"), "w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["task", "program", "ours", "other", "times"])
        for task, (left, right, rounds) in rows.items():
            (mine, a), (peer, b) = seconds(left, rounds), seconds(right, rounds)
            if task in CHECKS:
                assert abs(a - b) <= CHECKS[task] * abs(b), (task, a, b)
            program = "statsmodels" if task in ("filter", "smoother", "fit") else "NumPy"
            row = [task, program, f"{mine:.2g}", f"{peer:.2g}", f"{mine / peer:.2g}"]
            print(*row)
            out.writerow(row)


if __name__ == "__main__":
    main()
