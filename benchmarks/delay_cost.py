"""Time of a step of the delay filter's gains against the dense Kalman filter of the stacked state.

Run by hand, ``python benchmarks/delay_cost.py``; writes ``benchmarks/delay_cost.csv`` beside
itself. Both run in one process with one BLAS thread; the figure of each is the median of its runs.
The column `ratio_to_dense` is dense time over own time in this run.
"""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib.delay import DelaySystem, optimal_gains

COMPONENTS = 6
DELAYS = (1, 4, 9, 19, 49, 99, 199, 399, 799)
DENSE_UP_TO = 1200
STEPS = 20


def plant(delay: int) -> DelaySystem:
    rng = np.random.default_rng(0)
    near, far = rng.standard_normal((2, COMPONENTS, COMPONENTS))
    return DelaySystem(
        {0: 0.6 * near / np.linalg.norm(near, 2), delay: 0.3 * far / np.linalg.norm(far, 2)},
        sensor=rng.standard_normal((1, COMPONENTS)),
        noise_cov=np.eye(COMPONENTS),
        sensor_cov=1.0,
        cov0=np.eye(COMPONENTS),
        history_cov=0.5,
    )


def dense(system: DelaySystem, steps: int) -> None:
    """Covariances of the stacked state: F P Fᵀ + Q, and the correction by one measurement."""
    n, size = COMPONENTS, (system.max_delay + 1) * COMPONENTS
    transition, cov = np.eye(size, k=-n), np.eye(size)
    for d, matrix in system.dynamics.items():
        transition[:n, d * n : (d + 1) * n] = matrix
    for _ in range(steps):
        cov = transition @ cov @ transition.T
        cov[:n, :n] += system.state_noise
        cross = cov[:, :n] @ system.sensor.T
        inner = system.sensor @ cross[:n] + system.sensor_cov
        cov -= np.linalg.solve(inner, cross.T).T @ cross.T


def seconds(run, system: DelaySystem, rounds: int) -> float:
    """Median seconds of a step."""
    run(system, 3)
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        run(system, STEPS)
        times.append((time.perf_counter() - start) / STEPS)
    return float(np.median(times))


def main() -> None:
    """Write the table."""
    rows = []
    for delay in DELAYS:
        system, size = plant(delay), (delay + 1) * COMPONENTS
        found = {"structured": seconds(optimal_gains, system, 9)}
        if size <= DENSE_UP_TO:
            found["augmented"] = seconds(dense, system, 1 if size >= 600 else 9)
        for name, value in found.items():
            ratio = f"{found['augmented'] / value:.4g}" if "augmented" in found else ""
            rows.append((name, COMPONENTS, delay, size, f"{1e3 * value:.4g}", ratio))
            print(*rows[-1])
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("method", "n", "N", "D", "ms_per_step", "ratio_to_dense"))
        table.writerows(rows)


if __name__ == "__main__":
    main()
