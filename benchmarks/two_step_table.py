"""Time of one step of the two-step estimator, with everything stored and without.

Run by hand, ``python benchmarks/two_step_table.py``; writes ``benchmarks/two_step_table.csv``
beside itself. A row for each power of the energy of a damped oscillator: the number of stored
coefficients of a time, the milliseconds beforehand for a step, and the microseconds of one path's
step online: the Kalman estimate with the stored gain, and then the estimate of the function and
its variance from the stored coefficients (`stored`) or from the formulas of the function at the
stored covariance (`formulas`). Shortest of three runs, one thread.
"""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy

from seedslib.two_step import LinearDiffusion, TwoStepEstimator

STEPS = 200
TIMES = np.linspace(0, 1, STEPS + 1)
OSCILLATOR = LinearDiffusion(
    [[0, 1], [-4, -0.5]], np.diag([0.0, 1.0]), [[1, 0]], 0.1, [1, 1], np.eye(2)
)


def shortest(action: Callable[[], object]) -> float:
    """Seconds of the fastest of three calls."""
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def measured(power: int) -> list:
    """One row."""
    x = sympy.symbols("x:2", real=True)
    estimator = TwoStepEstimator(OSCILLATOR, (4 * x[0] ** 2 + x[1] ** 2) ** power, variables=x)
    table = estimator.table(TIMES)
    increments = OSCILLATOR.simulate(TIMES, 1, 0).increments[:, :, 0]

    def stored() -> None:
        mean = table.start
        for k in range(STEPS):
            mean = table.update(k, mean, increments[k])
            table.estimate(k + 1, mean)

    def formulas() -> None:
        mean = table.start
        for k in range(STEPS):
            mean = table.update(k, mean, increments[k])
            estimator.estimate(mean, table.cov[k + 1])
            estimator.variance(mean, table.cov[k + 1])

    beforehand = 1e3 * shortest(lambda: estimator.table(TIMES)) / STEPS
    online = [1e6 * shortest(action) / STEPS for action in (stored, formulas)]
    size = table.mean_coefficients[0].size + table.variance_coefficients[0].size
    return [2 * power, size, *(f"{value:.3g}" for value in (beforehand, *online))]


def main() -> None:
    """Write the table."""
    rows = [measured(power) for power in (1, 2, 3)]
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["degree", "coefficients", "beforehand_ms", "stored_us", "formulas_us"])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
