"""Time and error of the piecewise-linear filter against an extended Kalman and particle filters.

Run by hand, ``python benchmarks/piecewise_filter.py``; writes ``benchmarks/piecewise_filter.csv``
beside itself. The falling body, 10 steps, 100 windows, 1000 records from 5 km and 1000 from 50 km
in one batch each; particle filters get fewer records, since each costs as much as all others. All
run in one process with repetitions interleaved; the figure of each is its median. `error` is the
root mean square distance from the exact posterior mean at the last step, in posterior standard
deviations; `ratio` is the time per record over that of the extended Kalman filter.

Two further lines: the Lozi map (windows in a plane, 6 steps) exact and pruned, and moment
matching with process noise (24 windows, 15 steps).
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

from seedslib.filters import ParticleFilter, extended_kalman
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem, examples, line_cells

RECORDS, ROUNDS = 1000, 5
PARTICLES = {1000: 100, 10_000: 20, 100_000: 4, 1_000_000: 1}
STARTS = (5.0, 50.0)


def angles(start: float) -> np.ndarray:
    """Measured angles of bodies that fall from one range, (11, 1, RECORDS)."""
    noise = np.random.default_rng(0).standard_normal((RECORDS, 10))
    angle = 0.1 - 0.005 * np.arange(1.0, 11.0)[:, None] ** 2 / start + 1e-3 * noise.T
    return np.concatenate([np.full((1, 1, RECORDS), np.nan), angle[:, None]])


def exact(y: np.ndarray, block: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean and deviation of the range at the end, on a grid."""
    x, parts = np.geomspace(1.0, 125.0, 8001)[:, None], []
    for first in range(0, y.shape[2], block):
        part = y[..., first : first + block]
        log_weight = np.log(x) - 0.5 * ((x - 27.5) / 11.25) ** 2 + np.zeros((1, part.shape[2]))
        angle, var = np.full(log_weight.shape, 0.1), 1e-12
        for t in range(1, 11):
            angle = angle - 0.01 * (t - 0.5) / x
            error, spread = part[t] - angle, var + 1e-6
            log_weight = log_weight - 0.5 * error**2 / spread
            angle, var = angle + var / spread * error, var * 1e-6 / spread
        weight = np.exp(log_weight - log_weight.max(axis=0))
        weight /= weight.sum(axis=0)
        mean = (weight * x).sum(axis=0)
        parts.append((mean, np.sqrt((weight * (x - mean) ** 2).sum(axis=0))))
    mean, deviation = np.concatenate(parts, axis=1)
    return mean, deviation


def falling_body(rows: list[dict]) -> None:
    """Every filter on the same records."""
    data = {start: angles(start) for start in STARTS}
    truth = {start: exact(y) for start, y in data.items()}
    paper = examples.falling_body(100)
    even = examples.falling_body(100, partition="curvature", span=(2.5, 100.0))
    times, ekf = np.arange(11.0), extended_kalman(paper.discrete())
    runs: dict[str, tuple[int, Callable]] = {
        "extended Kalman": (RECORDS, lambda y: ekf.run(times, y)),
        "piecewise, 100 windows of the paper": (
            RECORDS, lambda y: PiecewiseLinearFilter(paper).run(10, y)
        ),
        "piecewise, 100 even windows": (RECORDS, lambda y: PiecewiseLinearFilter(even).run(10, y)),
        "piecewise, 100 even windows, pruned 1e-6": (
            RECORDS, lambda y: PiecewiseLinearFilter(even, prune=1e-6).run(10, y)
        ),
    }  # fmt: skip
    for count, records in PARTICLES.items():
        swarm = ParticleFilter(paper.discrete(), count)
        runs[f"particles, {count}"] = (records, lambda y, s=swarm: s.run(times, y, seed=1))
    taken: dict[str, list[float]] = {name: [] for name in runs}
    errors: dict[str, list[float]] = {name: [] for name in runs}
    for round_ in range(ROUNDS):
        for name, (records, run) in runs.items():
            if name.startswith("particles") and round_ >= 2:
                continue
            began = time.perf_counter()
            found = [run(data[start][..., :records]).mean[-1, 0] for start in STARTS]
            taken[name].append((time.perf_counter() - began) / (2 * records))
            if round_ == 0:
                for start, mean in zip(STARTS, found, strict=True):
                    gap = (mean - truth[start][0][:records]) / truth[start][1][:records]
                    errors[name].append(float(np.sqrt((gap**2).mean())))
    base = np.median(taken["extended Kalman"])
    for name, (records, _) in runs.items():
        seconds = float(np.median(taken[name]))
        rows.append(row("falling body", name, records, seconds, seconds / base, errors[name]))


def other_cases(rows: list[dict]) -> None:
    """Windows in a plane, and process noise."""
    lozi = PiecewiseLinearSystem(
        regions=line_cells([[1.0], [0.0]], [0.0]),
        dynamics=([1.0, 0.0], [[[1.7, -1.7], [1.0, 1.0]], [[0.5, 0.5], [0.0, 0.0]]]),
        sensor=([0.0], [[1.0, 0.0]]),
        sensor_noise=[[0.3]],
        mean0=[0.1, 0.1],
        cov0=[[0.3, 0.05], [0.05, 0.2]],
    )
    x, v, w = sympy.symbols("x v w")
    wave = PiecewiseLinearSystem.from_functions(
        state=(x,),
        dynamics=[2 * sympy.sin(x) + w / 2],
        sensor=[x**2 / 5 + 3 * v / 10],
        noise=(v, w),
        breakpoints=np.linspace(-4.0, 4.0, 25),
        initial=([1.0], [[0.5]]),
    )
    cases = (
        ("Lozi map", "exact", PiecewiseLinearFilter(lozi), 6, 20),
        ("Lozi map", "pruned 1e-3", PiecewiseLinearFilter(lozi, prune=1e-3), 6, 20),
        ("process noise", "moment matching, 24 windows", PiecewiseLinearFilter(wave), 15, 100),
    )
    for case, name, filter_, steps, records in cases:
        y = filter_.system.simulate(steps, records, 3).measurements
        taken = []
        for _ in range(3):
            began = time.perf_counter()
            filter_.run(steps, y)
            taken.append((time.perf_counter() - began) / records)
        rows.append(row(case, name, records, float(np.median(taken)), None, []))


def row(case, name, records, seconds, ratio, errors) -> dict:
    """One line of the table."""
    near, far = [*map("{:.4g}".format, errors), "", ""][:2]
    return {
        "case": case, "filter": name, "records": records,
        "microseconds_per_record": f"{1e6 * seconds:.4g}",
        "ratio": "" if ratio is None else f"{ratio:.3g}",
        "error_5_km": near, "error_50_km": far,
    }  # fmt: skip


def main() -> None:
    rows: list[dict] = []
    falling_body(rows)
    other_cases(rows)
    target = Path(__file__).with_suffix(".csv")
    with target.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    print(target.read_text(), end="")


if __name__ == "__main__":
    main()
