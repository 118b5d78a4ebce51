"""Time of one covariance step of the delay filter against the dense augmented Kalman filter.

Run by hand, ``python benchmarks/delay_cost.py``; writes ``benchmarks/delay_cost.csv`` beside
itself. All methods run in one process with one BLAS thread; the figure of each is its median. The
column `ratio_to_dense` is dense time over own time in this run.
"""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib.delay import RECURSIONS, DelaySystem

COMPONENTS = 6
DELAYS = (1, 4, 9, 19, 49, 99, 199, 399, 799)
DENSE_UP_TO = 1200
WANTED = {(600, "structured"): 5.0, (1200, "structured"): 8.0, (1200, "chandrasekhar"): 100.0}


def plant(delay: int) -> DelaySystem:
    rng = np.random.default_rng(0)
    near, far = rng.standard_normal((2, COMPONENTS, COMPONENTS))
    return DelaySystem(
        {0: 0.6 * near / np.linalg.norm(near, 2), delay: 0.3 * far / np.linalg.norm(far, 2)},
        sensor=rng.standard_normal((1, COMPONENTS)),
        noise_cov=np.eye(COMPONENTS),
        sensor_cov=1.0,
        cov0=np.eye(COMPONENTS),
        history_cov=0.5 * np.eye(COMPONENTS),
    )


def times(system: DelaySystem, methods: list[str], rounds: int) -> dict[str, float]:
    """Median seconds per step of each method, after three steps that are not counted."""
    medians = {}
    for name in methods:
        state, seconds = RECURSIONS[name].start(system), []
        for count in range(rounds + 3):
            begin = time.perf_counter()
            state, _ = RECURSIONS[name].advance(system, state)
            if count >= 3:
                seconds.append(time.perf_counter() - begin)
        medians[name] = float(np.median(seconds))
    return medians


def main() -> None:
    rows = []
    for delay in DELAYS:
        size = (delay + 1) * COMPONENTS
        dense = size <= DENSE_UP_TO
        methods = ["structured", "chandrasekhar"] + (["augmented", "array"] if dense else [])
        found = times(plant(delay), methods, 15 if size >= 600 else 40)
        for name, value in found.items():
            ratio = found["augmented"] / value if dense else float("nan")
            rows.append((name, COMPONENTS, delay, size, 1e3 * value, ratio))
            print(f"{name:14s} D = {size:5d}  {1e3 * value:9.3f} ms  ratio {ratio:8.2f}")
    for name in ("augmented", "array", "structured", "chandrasekhar"):
        last = [(size, ms) for label, _, _, size, ms, _ in rows if label == name][-3:]
        slope = np.polyfit(*np.log(np.array(last)).T, 1)[0]
        print(f"{name:14s} time grows as N^{slope:.2f} over D = {last[0][0]}..{last[-1][0]}")
    for (size, name), least in WANTED.items():
        ratio = next(row[5] for row in rows if row[0] == name and row[3] == size)
        print(f"{name} at D = {size}: {ratio:.1f} times (wanted {least:g}): {ratio >= least}")
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(("method", "n", "N", "D", "ms_per_step", "ratio_to_dense"))
        for name, n, delay, size, ms, ratio in rows:
            shown = f"{ratio:.4g}" if np.isfinite(ratio) else ""
            table.writerow((name, n, delay, size, f"{ms:.4g}", shown))


if __name__ == "__main__":
    main()
