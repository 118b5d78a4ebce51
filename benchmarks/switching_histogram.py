"""Filters of the scalar switching systems by plain histograms, as section 5 of the paper says it.

Run by hand, ``python benchmarks/switching_histogram.py``; writes
``benchmarks/switching_histogram.csv`` beside itself. Each row is one design (cells of each
argument, paths, seed) with its averages over k = 10..30: on paths of their own, which the design
has not seen, with standard errors, and on the paths of the design.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from seedslib import zoo
from seedslib.design import binned_synthesis
from seedslib.designed import large_order

TIMES = np.arange(31.0)
FIRST = 10
TEST_PATHS, TEST_SEED = 20_000, 202
CASES = (
    ("A1H", 20, 30_000),
    ("A1H", 40, 30_000),
    ("A1H", 20, 300_000),
    ("A1H", 40, 300_000),
    ("A1L", 40, 300_000),
    ("A2", 40, 300_000),
)
NAMES = (
    "sensor",
    "bins",
    "paths",
    "seed",
    "mode_error",
    "mode_error_error",
    "rmse",
    "rmse_error",
    "own_mode_error",
    "own_rmse",
)


def accuracy(filter, data) -> list[float]:
    """Part of wrong modes and root-mean-square error on paths, each with its standard error."""
    found = filter.run(TIMES, data.measurements)
    square = ((found.mean - data.states)[FIRST:, 0] ** 2).mean(axis=0)
    wrong = (found.modes != data.modes)[FIRST:].mean(axis=0)
    root, rmse = np.sqrt(len(square)), np.sqrt(square.mean())
    return [wrong.mean(), wrong.std() / root, rmse, square.std() / root / 2 / rmse]


def main() -> None:
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(NAMES)
        for sensor, bins, paths in CASES:
            system = zoo.scalar_switching(sensor)
            data = system.simulate(TIMES, TEST_PATHS, TEST_SEED)
            seed = 303
            filter = binned_synthesis(
                system, large_order(1), TIMES, paths=paths, seed=seed, bins=bins
            )
            own = filter.predicted
            figures = [
                *accuracy(filter, data),
                own.mode_rate[FIRST:].mean(),
                np.sqrt((own.rms[FIRST:] ** 2).mean()),
            ]
            table.writerow((sensor, bins, paths, seed, *(f"{value:.5g}" for value in figures)))
            file.flush()


if __name__ == "__main__":
    main()
