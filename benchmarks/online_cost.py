"""Time online of tables, learned functions and polynomial forecasts against their peers.

Run by hand, ``python benchmarks/online_cost.py``; writes ``benchmarks/online_cost.csv`` beside
itself. Microseconds for one measurement of one path, in batches of 4096 paths on one thread; all
filters run in one process, their repetitions interleaved, and the time of each is its shortest.
`ratio` is the time of the assumed-density filter (Runge-Kutta steps of 0.02) over the own time.
"""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.neural_network import MLPRegressor

from seedslib import zoo
from seedslib.design import Polynomial, simulated_synthesis, synthesize
from seedslib.designed import large_order
from seedslib.extra import learn
from seedslib.filters import ParticleFilter, assumed_density, extended_kalman
from seedslib.linearization import ExactGaussian

BATCH = 4096
EXAMPLES = {
    "Van der Pol": (
        zoo.van_der_pol,
        0.5 * np.arange(7),
        {"z": [(-4, 4, 25), (-6, 6, 25)], "y": [(-3, 14, 17), (-8, 8, 17)]},
        4,
    ),
    "Duffing": (
        zoo.kicked_duffing,
        0.5 * np.arange(13),
        {"z": [(-3, 3, 41), (-5, 5, 41)], "y": (-8, 8, 65)},
        2,
    ),
}


def filters(system, times, axes, degree) -> dict:
    """Filters of order one, designed on few paths: their accuracy is not asked for here."""
    one = system, large_order(1)
    rule, design = ExactGaussian(), {"paths": 2000, "seed": 1, "nodes": 0}
    network = MLPRegressor(
        hidden_layer_sizes=(32, 32), early_stopping=True, batch_size=500, learning_rate_init=5e-3
    )
    trees = HistGradientBoostingRegressor(max_iter=60, max_leaf_nodes=16, learning_rate=0.15)
    made = {
        "EKF": extended_kalman(system, step=0.02),
        "FNA": assumed_density(system, step=0.02),
        "affine": synthesize(*one, rule, times, **design),
        "polynomial": synthesize(*one, rule, times, predictor=Polynomial(3, degree), **design),
        "table": simulated_synthesis(*one, times, **design, **axes),
        "network": learn(*one, times, regressor=network, joint=True, **design),
        "trees": learn(*one, times, regressor=trees, **design),
    }
    for count in (20, 200):
        made[f"{count} particles"] = ParticleFilter(system, count, step=0.02)
    return made


def measure(made, times, system, rounds=7) -> dict[str, float]:
    """Least seconds of each filter on one batch."""
    y = system.simulate(times, BATCH, 3).measurements
    best = dict.fromkeys(made, np.inf)
    for turn in range(rounds):
        for name, filter in made.items():
            few = y[..., :256] if "particles" in name else y
            if turn > 2 and "particles" in name:
                continue
            begin = time.perf_counter()
            filter.run(times, few)
            seconds = (time.perf_counter() - begin) * y.shape[2] / few.shape[2]
            best[name] = min(best[name], seconds)
    return best


def main():
    rows = []
    for example, (model, times, axes, degree) in EXAMPLES.items():
        system = model()
        best = measure(filters(system, times, axes, degree), times, system)
        for name, seconds in best.items():
            cost = 1e6 * seconds / (BATCH * len(times))
            rows.append([example, name, f"{cost:.4g}", f"{best['FNA'] / seconds:.3g}"])
            print(f"{example:12s} {name:14s} {cost:9.3f} microseconds   {rows[-1][-1]:>7s}")
    with open(Path(__file__).with_suffix(".csv"), "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["example", "filter", "microseconds", "ratio_to_fna"])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
