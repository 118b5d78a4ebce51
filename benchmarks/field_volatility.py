"""Distances of filters of a stochastic volatility from the exact mean, for the table of filters.

Run by hand, ``OPENBLAS_NUM_THREADS=1 python benchmarks/field_volatility.py``, about
2 minutes on one core; writes ``benchmarks/field_volatility.csv``: e_x is the mean square of the
distance from the exact mean. The model is that of the package PyDPF.
"""

import csv
import time
import warnings
from pathlib import Path

import numpy as np
import sympy

from seedslib.design import grid_synthesis, stationary
from seedslib.designed import Memory
from seedslib.filters import GridBayesFilter, ParticleFilter
from seedslib.models import DiscreteSystem, Noise, StochasticMap

PATHS, TIMES = 500, np.arange(1000.0)
TABLES = {
    1: {"x": (-13, 13, 105), "z": (-10, 10, 161), "y": (-32, 20, 209)},
    2: {"x": (-12, 12, 73), "z": (-9, 9, 91), "y": (-26, 18, 177)},
}


def volatility():
    """X' = .91 X + W, and the logarithm of the squared return: X + log .25 + log V²."""
    x, w, v = sympy.symbols("x w v", real=True)
    noise = Noise(
        [v],
        -np.euler_gamma - np.log(2),
        [[np.pi**2 / 2]],
        lambda rng, count: np.log(rng.standard_normal((1, count)) ** 2),
        lambda v: 0.5 * (v[0] - np.exp(v[0]) - np.log(2 * np.pi)),
    )
    moves = StochasticMap([x], [0.91 * x + w], Noise([w]))
    shows = StochasticMap([x], [x + 2 * sympy.log(0.5) + v], noise)
    return DiscreteSystem(moves, shows, 0, 1 / (1 - 0.91**2))


def main() -> None:
    warnings.simplefilter("ignore")
    system = volatility()
    y = system.simulate(TIMES, PATHS, 2).measurements
    best = GridBayesFilter(system, (-14, 14, 113))
    exact = best.run(TIMES, y).mean
    runs = {"Bayes": (PATHS, lambda y: best.run(TIMES, y))}
    for count, paths in ((100, PATHS), (400, 200), (1600, 50)):
        cloud = ParticleFilter(system, count)
        runs[f"bootstrap {count}"] = paths, lambda y, f=cloud: f.run(TIMES, y, seed=3)
    for order, axes in TABLES.items():
        made = grid_synthesis(system, Memory(order), TIMES[:20], **axes)
        table = stationary(made, transient=order)
        runs[f"order {order}"] = PATHS, lambda y, f=table: f.run(TIMES, y)
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("row", "paths", "e_x", "error", "microseconds"))
        for name, (paths, run) in runs.items():
            begin = time.process_time()
            means = run(y[..., :paths]).mean
            spent = 1e6 * (time.process_time() - begin) / paths / len(TIMES)
            each = ((means - exact[..., :paths]) ** 2).mean(axis=(0, 1))
            error = each.std() / paths**0.5
            writer.writerow((name, paths, f"{each.mean():.7f}", f"{error:.7f}", f"{spent:.3f}"))


if __name__ == "__main__":
    main()
