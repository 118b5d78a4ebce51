"""Errors of the four filters of figure 2 under fourteen readings of the Van der Pol oscillator.

Run by hand, ``python benchmarks/van_der_pol_readings.py``; writes
``benchmarks/van_der_pol_readings.csv`` beside itself: RMS errors of x1 at t = 3 with their standard
errors, and how much smaller each is than that of the four-measurement filter on the same paths.
4096 paths of a design, 5120 other paths for the errors.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import Affine, Continuous, synthesize
from seedslib.designed import Memory, finite_memory
from seedslib.evaluation import compare
from seedslib.filters import Filter, extended_kalman
from seedslib.linearization import Taylor

TACTS = np.arange(7) * 0.5
DESIGN, TEST, SEED = 4096, 5120, 1
RECIPES = {
    "one estimate, continuous": (Memory(1), Continuous()),
    "one estimate": (Memory(1), Affine()),
    "four estimates": (Memory(4), Affine()),
    "four measurements": (finite_memory(4), Affine()),
}


def main() -> None:
    rows = []
    for reading in "ABCDEFGHIJKLMN":
        system = zoo.van_der_pol(reading)
        filters: dict[str, Filter] = {
            "extended": extended_kalman(system, integrator="euler", bound=50)
        }
        for name, (memory, predictor) in RECIPES.items():
            filters[name] = synthesize(
                system,
                memory,
                Taylor(),
                TACTS,
                predictor=predictor,
                nodes=0,
                paths=DESIGN,
                seed=SEED,
            )
        table = compare(filters, system, TACTS, TEST, SEED + 1, components=1)
        for name in filters:
            one = [table[name].rms[-1, 0], table[name].rms_error[-1, 0]]
            for other in ("extended", "four measurements"):
                gap = table.difference(name, other)
                one += [gap.rms[-1, 0], gap.error[-1, 0]]
            rows.append([reading, name, *(f"{value:.8f}" for value in one)])
            print(*rows[-1])
    head = ["reading", "filter", "rms", "error", "to_extended", "to_extended_error"]
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*head, "to_measurements", "to_measurements_error"])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
