"""Time online of precomputed filters against the library's own extended Kalman filter.

Run by hand, ``python benchmarks/finite_order.py``; writes ``benchmarks/finite_order.csv`` beside
itself. Van der Pol oscillator, seven measurements from 0 to 3, integration step 0.01; estimates at
the measurements only, or forecasts on a grid of 301 times. All filters run in one process, their
repetitions interleaved, with one BLAS thread; the time of each is its shortest.
"""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import Continuous, synthesize
from seedslib.designed import Memory, finite_memory
from seedslib.filters import assumed_density, extended_kalman
from seedslib.linearization import Taylor

TIMES, GRID = np.arange(7) * 0.5, np.linspace(0.0, 3.0, 301)
BATCH = 20_000


def filters() -> dict:
    system = zoo.van_der_pol()
    found = {
        "EKF Euler": extended_kalman(system, integrator="euler"),
        "EKF RK4": extended_kalman(system, integrator="rk4"),
        "FNA RK4": assumed_density(system, integrator="rk4"),
    }
    memories = {f"FBP {l}": (Memory(l), {}) for l in (1, 2, 4)}
    memories |= {"FKP 4": (finite_memory(4), {}), "FMP": (Memory(1), {"predictor": Continuous()})}
    for name, (memory, more) in memories.items():
        made = synthesize(system, memory, Taylor(), TIMES, paths=4096, seed=1, **more)
        found[name] = made.forecasting("piecewise constant")
    return found


def shortest(filters: dict, times, y, rounds: int) -> dict[str, float]:
    """Least seconds of each filter, their repetitions interleaved."""
    best = dict.fromkeys(filters, np.inf)
    for _ in range(rounds + 1):
        for name, filter in filters.items():
            begin = time.perf_counter()
            filter.run(times, y)
            best[name] = min(best[name], time.perf_counter() - begin)
    return best


def main() -> None:
    found, system = filters(), zoo.van_der_pol()
    rows: list[list] = [["filter", "paths", "output", "microseconds_per_path"]]
    for paths, size, rounds in (("single", 1, 60), ("batch", BATCH, 7)):
        y = system.simulate(GRID, size, 5, measured=np.arange(7) * 50).measurements
        y = y[..., 0] if size == 1 else y
        for output, times, part in (("measurements", TIMES, y[::50]), ("grid", GRID, y)):
            for name, seconds in shortest(found, times, part, rounds).items():
                rows.append([name, paths, output, f"{1e6 * seconds / size:.4g}"])
                print(*rows[-1], sep="\t")
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
