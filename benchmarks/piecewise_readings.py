"""The falling body under every reading of its illegible entries; some minutes.

Run by hand, ``python benchmarks/piecewise_readings.py``; writes a ``.csv`` of its name beside
itself. A reading is a sensor noise H, a standard deviation of the range in the prior, a
speed at t = 0 (for the time index of the coefficient K) and a mean of the range, other than
27.5 km for bodies from rest and H = 1e-3 only. A line is a quantity at t = 1 to 10, for bodies at
5 km, at 50 km and, with the mean 27.5, drawn from the prior between the two:

* ``r``, ``tau``, ``ekf_r``, ``ekf_tau``: relative error and mean squared error over reported
  variance of the piecewise-linear and of the extended Kalman filter; ``ekf_median`` the median
  of what ``ekf_tau`` averages, ``ekf_axis`` the share of averages over 20 runs between 10 and 25;
* ``relative x``, ``absolute x``: how many weights reach x times the largest one, or x;
* ``cumulative x``: how many of the largest weights together leave less than x.
"""

from __future__ import annotations

import csv
import dataclasses
import itertools
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib.filters import extended_kalman
from seedslib.piecewise import PiecewiseLinearFilter
from seedslib.zoo import falling_body

NOISES = (1e-3, 1e-4, 1e-5)
DEVIATIONS = (8.6, 11.25, 13.0, 22.5)
SPEEDS = (0.0, -1.0, 1.0)
MEANS = (5.0, 10.0, 15.0, 20.0, 40.0)
READINGS = [(*r, 27.5) for r in itertools.product(NOISES, DEVIATIONS, SPEEDS)]
READINGS += [(1e-3, deviation, 0.0, mean) for deviation in DEVIATIONS for mean in MEANS]
BODIES = ("5", "50", "drawn")
LEVELS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.001)
RUNS, SEED = 2000, 20


def starts(
    body: str, mean: float, deviation: float, runs: int, rng: np.random.Generator
) -> np.ndarray:
    """Ranges of the bodies, (runs,)."""
    if body != "drawn":
        return np.full(runs, float(body))
    found = np.zeros(0)
    while found.size < runs:
        more = mean + deviation * rng.standard_normal(runs)
        found = np.append(found, more[(more > 5.0) & (more < 50.0)])
    return found[:runs]


def counts(weights: np.ndarray) -> dict[str, np.ndarray]:
    """Noticeable terms of weights (windows, runs) under every criterion, (runs,)."""
    largest = -np.sort(-weights, axis=0)
    left = 1.0 - np.cumsum(largest, axis=0)
    found = {}
    for level in LEVELS:
        found[f"relative {level:g}"] = (largest >= level * largest[0]).sum(axis=0)
        found[f"absolute {level:g}"] = (largest >= level).sum(axis=0)
        found[f"cumulative {level:g}"] = 1 + (left >= level).sum(axis=0)
    return found


def study(
    noise: float, deviation: float, speed: float, mean: float, body: str, runs: int, seed: int
) -> dict[str, np.ndarray]:
    """Squared errors, their ratios to the claimed variance, and counts, each (10, runs)."""
    rng, times = np.random.default_rng(seed), np.arange(11.0)
    x = starts(body, mean, deviation, runs, rng)
    fallen = 0.005 * times[1:, None] ** 2 + 0.01 * speed * times[1:, None]
    y = 0.1 - fallen / x + noise * rng.standard_normal((runs, 10)).T
    y = np.concatenate([np.full((1, 1, runs), np.nan), y[:, None]])
    system = falling_body(sensor_noise=noise, deviation=deviation, speed=speed)
    system = dataclasses.replace(system, mean0=[mean, 0.1])
    parts: dict[str, list[np.ndarray]] = {"square": [], "ratio": []}
    for state in itertools.islice(PiecewiseLinearFilter(system).states(10, y), 1, None):
        parts["square"].append((state.mean[0] / x - 1.0) ** 2)
        parts["ratio"].append((state.mean[0] - x) ** 2 / state.cov[0, 0])
        for name, count in counts(state.weights).items():
            parts.setdefault(name, []).append(count)
    ekf = extended_kalman(system.discrete()).run(times, y)
    error = ekf.mean[1:, 0] - x
    ekf_parts = {"ekf_square": (error / x) ** 2, "ekf_ratio": error**2 / ekf.cov[1:, 0, 0]}
    return {name: np.array(part) for name, part in parts.items()} | ekf_parts


def summary(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The lines of the table, (10,) each."""
    twenty = found["ekf_ratio"].reshape(10, -1, 20).mean(axis=2)
    lines = {
        "r": np.sqrt(found["square"].mean(axis=1)),
        "tau": found["ratio"].mean(axis=1),
        "ekf_r": np.sqrt(found["ekf_square"].mean(axis=1)),
        "ekf_tau": found["ekf_ratio"].mean(axis=1),
        "ekf_median": np.median(found["ekf_ratio"], axis=1),
        "ekf_axis": ((twenty > 10.0) & (twenty < 25.0)).mean(axis=1),
    }
    criteria = [name for name in found if " " in name]
    return lines | {name: found[name].mean(axis=1) for name in criteria}


def main() -> None:
    rows = []
    for reading in READINGS:
        for body in BODIES if reading[-1] == 27.5 else BODIES[:2]:
            found = summary(study(*reading, body, RUNS, SEED))
            for quantity, values in found.items():
                rows.append([*reading, body, quantity, *map("{:.4g}".format, values)])
        print(*reading, flush=True)
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["noise", "deviation", "speed", "mean", "body", "quantity", *range(1, 11)])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
