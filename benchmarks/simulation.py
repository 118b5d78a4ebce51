"""Time of simulating 20 000 paths against hand-written NumPy of the same array layout.

Run by hand, ``python benchmarks/simulation.py``; writes ``benchmarks/simulation.csv`` beside
itself. Both run in one process with repetitions interleaved; the figure of each is its best.
The column `ratio` is library time over hand-written time in this run.
"""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo

PATHS, ROUNDS = 20_000, 9


def van_der_pol(seed: int) -> np.ndarray:
    """Euler-Maruyama of `zoo.van_der_pol` as one would write it for this model alone."""
    rng = np.random.default_rng(seed)
    h, root, stiffness = 0.01, 0.1, (0.1 * np.pi) ** 2
    x1 = 2 + np.sqrt(0.15) * rng.standard_normal(PATHS)
    x2 = np.sqrt(0.15) * rng.standard_normal(PATHS)
    record = []
    for k in range(7):
        seen = [x1 * x1 + rng.standard_normal(PATHS), x2 + rng.standard_normal(PATHS)]
        record.append([x1, x2, *seen])
        for _ in range(50 if k < 6 else 0):
            normal = rng.standard_normal(PATHS)
            pull = 2 * x2 * (1 - x1 * x1) - stiffness * x1
            x1, x2 = x1 + h * x2, x2 + h * pull + root * x1 * normal
    return np.array(record)


def kicked_duffing(seed: int) -> np.ndarray:
    """Euler steps with thinned jumps of `zoo.kicked_duffing`."""
    rng = np.random.default_rng(seed)
    h, root = 0.01, 0.1
    x1 = 1 + np.sqrt(0.1) * rng.standard_normal(PATHS)
    x2 = np.sqrt(0.1) * rng.standard_normal(PATHS)
    record = []
    for k in range(13):
        seen = x1 * (1 + 0.2 * rng.standard_normal(PATHS)) + rng.standard_normal(PATHS)
        record.append([x1, x2, seen])
        for _ in range(50 if k < 12 else 0):
            pull = x1 - x1 * x1 * x1 - 0.5 * x2
            moved = x2 + h * pull + (0.2 * root) * rng.standard_normal(PATHS)
            risk = -np.expm1(-h * (0.2 + 0.2 * x1 * x1))
            due = np.flatnonzero(rng.random(PATHS) < risk)
            moved[due] += 0.5 + 3 * rng.standard_normal(len(due))
            x1, x2 = x1 + h * x2, moved
    return np.array(record)


def main() -> None:
    rows = []
    for name, hand, count in (
        ("van_der_pol", van_der_pol, 7),
        ("kicked_duffing", kicked_duffing, 13),
    ):
        system, times = getattr(zoo, name)(), 0.5 * np.arange(count)
        runs = {
            "hand-written": lambda seed, hand=hand: hand(seed),
            "seedslib": lambda seed, s=system, t=times: s.simulate(t, PATHS, seed),
            "seedslib, 2 threads": lambda seed, s=system, t=times: s.simulate(
                t, PATHS, seed, workers=2
            ),
        }
        seconds: dict[str, list[float]] = {run: [] for run in runs}
        for seed in range(ROUNDS):
            for run, work in runs.items():
                begin = time.perf_counter()
                work(seed)
                seconds[run].append(time.perf_counter() - begin)
        base = float(min(seconds["hand-written"]))
        for run, values in seconds.items():
            best = float(min(values))
            rows.append([name, run, f"{1e3 * best:.1f}", f"{best / base:.2f}"])
    header = ["model", "code", "milliseconds", "ratio"]
    for row in [header, *rows]:
        print("{:16s}{:22s}{:>14s}{:>8s}".format(*row))
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


if __name__ == "__main__":
    main()
