"""Online time and accuracy of filters of the scalar switching systems, side by side.

Run by hand, ``python benchmarks/switching_cost.py``; writes ``benchmarks/switching_cost.csv``
beside itself. All filters see the same paths. Times are processor times of this process with one
BLAS thread, per path and step in runs over many paths at once; repetitions are interleaved and
the figure of each filter is its best. The column `ratio` is own time over that of the exact table
with 61 nodes, `difference` the time-averaged mean-square error less that of the fine table on
the same paths. Averages are over k = 10..30.
"""

from __future__ import annotations

import csv
import os
import time
import warnings
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import grid_synthesis, simulated_synthesis, synthesize
from seedslib.designed import SwitchingFilter, large_order
from seedslib.evaluation import compare
from seedslib.filters import GridBayesFilter, ParticleFilter
from seedslib.linearization import ExactGaussian, Taylor

TIMES = np.arange(31.0)
WINDOW = (10, 30)
PATHS = 4000
DESIGN_PATHS = 20_000
TIMED = 4000
SLOW = {"particles, 1000": 200, "particles, 100": 1000, "grid Bayes": 1000}
"""Paths on which slow filters are timed."""

ROUNDS = 7
TABLE = "exact table, 61 nodes"
FINE = "exact table, 241 nodes"
WANTED = {"IMM of extended Kalman filters": 5.0, "particles, 1000": 500.0}
SHOWN = {"A1H": (-16, 18, 137), "A1L": (-11, 13, 241), "A2": (-8, 26, 545)}
NAMES = (
    "sensor",
    "filter",
    "microseconds",
    "ratio",
    "mode_error",
    "mode_error_error",
    "rmse",
    "rmse_error",
    "difference",
    "difference_error",
    "mode_difference",
    "mode_difference_error",
)


def filters(sensor: str) -> dict:
    """Filters by name, designed where they have a design."""
    system = zoo.scalar_switching(sensor)
    axes, order = {"x": (-8, 8, 81), "y": SHOWN[sensor]}, large_order(1)
    drawn = {"paths": DESIGN_PATHS, "seed": 101}
    fine = {"y": (*SHOWN[sensor][:2], 121), "z": (-6, 6, 121)}
    found = {
        FINE: grid_synthesis(system, order, TIMES, z=(-6, 6, 241), **axes),
        TABLE: grid_synthesis(system, order, TIMES, z=(-6, 6, 61), **axes),
    }
    for name, method in (("histogram", "histogram"), ("weighted histogram", "likelihood")):
        found[name] = simulated_synthesis(system, order, TIMES, method=method, **drawn, **fine)
    found["IMM of extended Kalman filters"] = SwitchingFilter(system, Taylor())
    found["AOF-G"] = SwitchingFilter(system, ExactGaussian())
    found["FBP-L 1"] = synthesize(system, order, Taylor(), TIMES, **drawn)
    found["FBP-G 1"] = synthesize(system, order, ExactGaussian(), TIMES, **drawn)
    found["grid Bayes"] = GridBayesFilter(system, (-8, 8, 161))
    found["particles, 100"] = ParticleFilter(system, 100)
    found["particles, 1000"] = ParticleFilter(system, 1000)
    return found


def timings(found: dict, system) -> dict:
    """Best processor time per path and step, in microseconds."""
    data = system.simulate(TIMES, TIMED, 7)
    best = dict.fromkeys(found, np.inf)
    for count in range(ROUNDS):
        for name, filter in found.items():
            paths = SLOW.get(name, TIMED)
            if name in SLOW and count >= 3:
                continue
            begin = time.process_time()
            filter.run(TIMES, data.measurements[..., :paths])
            each = (time.process_time() - begin) / (paths * len(TIMES))
            best[name] = min(best[name], 1e6 * each)
    return best


def main() -> None:
    rows = []
    for sensor in SHOWN:
        system, found = zoo.scalar_switching(sensor), filters(sensor)
        best = timings(found, system)
        scores = compare(found, system, TIMES, PATHS, 202, window=WINDOW)
        for name, score in scores.items():
            apart = scores.difference(name, FINE)
            rows.append(
                (
                    sensor,
                    name,
                    best[name],
                    best[name] / best[TABLE],
                    score.average_mode_error,
                    score.average_mode_error_error,
                    score.average[0],
                    score.average_error[0],
                    apart.average_square,
                    apart.average_square_error,
                    apart.average_mode,
                    apart.average_mode_error,
                )
            )
            print(sensor, f"{name:32s}", *(f"{value:9.4f}" for value in rows[-1][2:]), flush=True)
        for name, least in WANTED.items():
            ratio = best[name] / best[TABLE]
            print(f"{name}: {ratio:.1f} times the table (wanted {least:g}): {ratio >= least}")
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(NAMES)
        for sensor, name, *values in rows:
            table.writerow((sensor, name, *(f"{value:.5g}" for value in values)))


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
