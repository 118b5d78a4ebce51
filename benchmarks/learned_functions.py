"""Learned functions of one remembered estimate, and particle filters, on two oscillators.

Run by hand, ``python benchmarks/learned_functions.py``; writes ``benchmarks/learned_functions.csv``
beside itself: RMS errors of x1 after each measurement and on the average over them, those of a
filter alone (`other` is empty) or less those of another on the same paths, with standard errors.
Networks have two hidden layers of 32 and stop when held-out paths say so; trees are boosted.
Particle filters are slow and run on fewer paths (`run` is then "particles"), but for the table and
200 particles, which are near each other and meet on more (`run` is then "sharp").
"""

from __future__ import annotations

import csv
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.neural_network import MLPRegressor
from threadpoolctl import threadpool_limits

from seedslib import zoo
from seedslib.design import simulated_synthesis
from seedslib.designed import large_order
from seedslib.evaluation import compare
from seedslib.extra import learn
from seedslib.filters import Filter, ParticleFilter, assumed_density

DESIGN, TEST, PARTICLE_PATHS, SHARP, SEED = 10_000, 12_288, 1024, 24_576, 1
EXAMPLES = {
    "Van der Pol": (
        zoo.van_der_pol(),
        0.5 * np.arange(7),
        1,
        {"z": [(-4, 4, 25), (-6, 6, 25)], "y": [(-3, 14, 17), (-8, 8, 17)]},
    ),
    "Duffing": (
        zoo.kicked_duffing(),
        0.5 * np.arange(13),
        4,
        {"z": [(-3, 3, 41), (-5, 5, 41)], "y": (-8, 8, 65)},
    ),
}


def network() -> MLPRegressor:
    return MLPRegressor(
        hidden_layer_sizes=(32, 32),
        early_stopping=True,
        n_iter_no_change=3,
        learning_rate_init=1e-2,
        max_iter=200,
    ).set_params(batch_size=1000)


def rows_of(example: str, run: str, found, times, others: list[str]) -> list[list]:
    """Rows of the table: each filter alone, and less each of some others."""
    rows = []
    for name, own in found.items():
        parts = [("", own.rms[:, 0], own.rms_error[:, 0], own.average[0], own.average_error[0])]
        for other in others:
            if other in found and other != name:
                gap = found.difference(name, other)
                whole = gap.average[0], gap.average_error[0]
                parts.append((other, gap.rms[:, 0], gap.error[:, 0], *whole))
        for other, rms, error, average, average_error in parts:
            at = [example, run, name, other]
            rows.append([*at, "average", f"{average:.8f}", f"{average_error:.8f}"])
            for k, t in enumerate(times):
                rows.append([*at, f"{t:g}", f"{rms[k]:.8f}", f"{error[k]:.8f}"])
    return rows


def main() -> None:
    threadpool_limits(1)
    one, rows = large_order(1), []
    for example, (system, times, part, axes) in EXAMPLES.items():
        own = {"paths": DESIGN if part == 1 else DESIGN // 2, "seed": SEED}
        filters: dict[str, Filter] = {
            "assumed density": assumed_density(system, step=0.02),
            "table": simulated_synthesis(system, one, times, **own, **axes),
            "network": learn(system, one, times, regressor=network(), joint=True, sets=2, **own),
        }
        if example == "Van der Pol":
            trees = HistGradientBoostingRegressor(
                max_iter=60, max_leaf_nodes=16, learning_rate=0.15
            )
            filters["trees"] = learn(
                system, one, times, regressor=trees, joint=False, sets=2, **own
            )
        found = compare(filters, system, times, TEST // part, SEED + 1, components=1, bound=20)
        rows += rows_of(example, "all", found, times, ["assumed density", "table"])
        rivals: dict[str, Filter] = {
            f"{count} particles": ParticleFilter(system, count, step=0.02) for count in (20, 200)
        }
        rivals |= {name: filters[name] for name in ("table", "network")}
        found = compare(rivals, system, times, PARTICLE_PATHS // part, SEED + 2, components=1)
        others = ["table", "20 particles", "200 particles"]
        rows += rows_of(example, "particles", found, times, others)
        pair = {name: rivals[name] for name in ("table", "200 particles")}
        found = compare(pair, system, times, SHARP, SEED + 5, components=1, bound=20)
        rows += rows_of(example, "sharp", found, times, ["200 particles"])
    for row in rows:
        if row[4] == "average":
            print(*row)
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["example", "run", "filter", "other", "time", "rms", "error"])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
