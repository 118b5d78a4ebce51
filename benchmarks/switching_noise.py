"""What filters of the scalar switching system lose over the noise of the sensor and the switching.

Run by hand, ``python benchmarks/switching_noise.py``, some minutes on one core; writes
``benchmarks/switching_noise.csv`` beside itself. A row has a deviation of the sensor noise and a
factor of both switching probabilities. For each filter it has the share of wrong modes and the RMS
error over the measurements from the tenth on, and what that is above the Bayes filter, in per cent.
"""

from __future__ import annotations

import csv
import math
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import SwitchingFilter, large_order
from seedslib.evaluation import compare
from seedslib.filters import GridBayesFilter
from seedslib.linearization import ExactGaussian, Taylor

DEVIATIONS, RATES = (0.25, 0.5, 1.0, 2.0, 4.0), (0.2, 0.5, 1.0, 1.6)
DESIGN, TEST, SEED, TIMES = 10_000, 4_000, 1, np.arange(31.0)


def point(deviation: float, rate: float) -> dict[str, float]:
    """One row of the table."""
    system = zoo.scalar_switching("A1H", deviation=deviation, rate=rate)
    gaussian, order = ExactGaussian(), large_order(1)
    low, high = -8 - 4 * deviation, 10 + 4 * deviation
    y = (low, high, math.ceil(6 * (high - low) / min(deviation, 1.5)) + 1)
    filters = {
        "bayes": GridBayesFilter(system, (-12, 12, 241)),
        "aof_g": SwitchingFilter(system, gaussian),
        "imm_ekf": SwitchingFilter(system, Taylor()),
        "fbp_g": synthesize(system, order, gaussian, TIMES, paths=DESIGN, seed=SEED),
        "exact": grid_synthesis(system, order, TIMES, x=(-8, 8, 161), z=(-6, 6, 121), y=y),
    }
    table = compare(filters, system, TIMES, TEST, SEED + 1, window=(10, 30))
    row, best = {"deviation": deviation, "rate": rate}, table["bayes"].average[0] / 100
    for name, one in table.items():
        row |= {f"wrong_{name}": one.average_mode_error, f"rms_{name}": one.average[0]}
        if name != "bayes":
            apart = table.difference(name, "bayes")
            row[f"more_{name}"] = apart.average[0] / best
            row[f"more_error_{name}"] = apart.average_error[0] / best
    return row


def main() -> None:
    """Write the table."""
    rows = [point(deviation, rate) for deviation in DEVIATIONS for rate in RATES]
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({name: f"{value:.8g}" for name, value in row.items()} for row in rows)


if __name__ == "__main__":
    main()
