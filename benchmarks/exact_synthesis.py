"""Seconds of the two exact syntheses of the flip process, on one thread.

Run by hand, ``python benchmarks/exact_synthesis.py``; writes ``benchmarks/exact_synthesis.csv``
beside itself. Thirteen measurements; `numbers` is what the design must carry from one measurement
to the next: entries of the joint distribution on the grid, or numbers of all simulated paths.
"""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import grid_synthesis, simulated_synthesis
from seedslib.designed import large_order

TIMES = 0.25 * np.arange(13)
FINE = {"x": (-3.5, 3.5, 281), "z": (-3, 3, 601), "y": (-8, 8, 241)}
COARSE = {"x": (-3.5, 3.5, 141), "z": (-2.5, 2.5, 101), "y": (-8, 8, 97)}
TABLES = {"z": (-2, 2, 81), "y": (-8, 8, 97), "seed": 1}


def main() -> None:
    system = zoo.flip_process()
    works: dict[tuple[str, int, int], Callable[[], object]] = {
        ("densities", 1, 281 * 601): lambda: grid_synthesis(system, large_order(1), TIMES, **FINE),
        ("densities", 1, 141 * 101): lambda: grid_synthesis(
            system, large_order(1), TIMES, **COARSE
        ),
        ("densities", 2, 141 * 101**2): lambda: grid_synthesis(
            system, large_order(2), TIMES, **COARSE
        ),
        ("paths", 1, 2 * 16_000): lambda: simulated_synthesis(
            system, large_order(1), TIMES, paths=16_000, **TABLES
        ),
        ("paths", 2, 3 * 16_000): lambda: simulated_synthesis(
            system, large_order(2), TIMES, paths=16_000, **TABLES
        ),
    }
    rows = []
    for (synthesis, order, numbers), work in works.items():
        begin = time.perf_counter()
        work()
        seconds = f"{time.perf_counter() - begin:.2g}"
        rows.append([synthesis, order, numbers, seconds])
        print(*rows[-1], sep="\t")
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["synthesis", "order", "numbers", "seconds"])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
