"""Accuracy of filters of the scalar switching system, with standard errors.

Run by hand, ``python benchmarks/switching_scalar.py`` (minutes); writes
``benchmarks/switching_scalar.csv`` beside itself. Three sensors, measurements at 0, 1, ..., 30.
Filters are designed on 20 000 paths and scored on 20 000 others, the same for all of them;
the last part designs Gaussian filters on fewer and more paths. Every figure depends on nothing
but the seeds, so a second run writes the same table.

Columns: `part` is "average" (over the times 10 to 30), "time" (at one time), "training size", or
"risk" (the averages that an exact filter predicts, without random numbers); `at` is the time, or
the number of design paths; then the share of wrong modes and the root-mean-square error of the
state, each with its standard error over paths.
"""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter, finite_memory, large_order
from seedslib.evaluation import compare
from seedslib.filters import GridBayesFilter
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import SwitchingSystem

TIMES = np.arange(31.0)
WINDOW = (10, 30)
DESIGN_PATHS, TEST_PATHS = 20_000, 20_000
DESIGN, TEST, AVERAGE = 101, 202, 303  # seeds
SIZES = (500, 2000, 10_000, 50_000)
SENSORS = {  # axes of the measurement for exact filters of orders 1 and 2
    "A1H": ((-16, 18, 137), (-16, 18, 137)),
    "A1L": ((-11, 13, 241), (-11, 13, 121)),
    "A2": ((-8, 26, 545), (-8, 26, 273)),
}
COLUMNS = (
    "part",
    "sensor",
    "filter",
    "at",
    "wrong_mode",
    "wrong_mode_error",
    "rms",
    "rms_error",
)


def designed(system, memory, linearization, paths=DESIGN_PATHS):
    return synthesize(system, memory, linearization, TIMES, paths=paths, seed=DESIGN)


def averaged_switching(system, times, paths, seed) -> SwitchingSystem:
    """The same system, A_il the mean of A_il(X_k) over the later half of the times.

    And over the paths in mode i. A filter made for it shows what it is worth to know how
    switching depends on the state (section 8.4 of the switching paper's benchmarks).
    """
    data = system.simulate(times, paths, seed)
    later = range(len(data.times) // 2, len(data.times))
    switching = []
    for i, row in enumerate(system.branches):
        total = np.zeros(len(row))
        for k in later:
            x = data.states[k][:, data.modes[k] == i]
            for l, branch in enumerate(row):
                if branch is not None:
                    total[l] += branch.probability(data.times[k], x).sum()
        switching.append(total / total.sum())
    shares = [[0 if b is None else b.map.weight_expression for b in row] for row in system.readings]
    return SwitchingSystem.from_maps(
        system.dynamics,
        switching,
        system.sensors,
        system.initial,
        indicator=shares if system.indicators else None,
        drives=system.drives,
    )


def filters(sensor) -> dict:
    """All filters of the table, by name."""
    system = zoo.scalar_switching(sensor)
    constant = averaged_switching(system, np.arange(61.0), 20_000, AVERAGE)
    found = {
        "grid Bayes": GridBayesFilter(system, (-8, 8, 161)),
        "AOF-G": SwitchingFilter(system, ExactGaussian()),
        "IMM-EKF": SwitchingFilter(system, Taylor()),
        "AOF-G, constant switching": SwitchingFilter(constant, ExactGaussian()),
        "IMM-EKF, constant switching": SwitchingFilter(constant, Taylor()),
        "soft FBP-G 1": designed(system, Memory(1, log_odds=True), ExactGaussian()),
    }
    for letter, linearization in (("G", ExactGaussian()), ("L", Taylor())):
        for l in (1, 2, 3):
            found[f"FBP-{letter} {l}"] = designed(system, large_order(l), linearization)
            found[f"FKP-{letter} {l}"] = designed(system, finite_memory(l), linearization)
    return found | exact(sensor)


def exact(sensor) -> dict:
    """The exact filters of orders one and two, tables from the grid."""
    system = zoo.scalar_switching(sensor)
    return {
        f"exact FBP {l}": grid_synthesis(
            system, large_order(l), TIMES, x=(-8, 8, 161), z=(-6, 6, count), y=y
        )
        for l, count, y in zip((1, 2), (241, 61), SENSORS[sensor], strict=True)
    }


def row(part, sensor, name, at, *numbers) -> dict:
    shown = (part, sensor, name, at, *(f"{number:.6g}" for number in numbers))
    return dict(zip(COLUMNS, shown, strict=True))


def scored(sensor, found) -> list[dict]:
    """Averages over the window, and the course over time."""
    system = zoo.scalar_switching(sensor)
    table = compare(found, system, TIMES, TEST_PATHS, TEST, window=WINDOW)
    rows, late = [], slice(WINDOW[0], WINDOW[1] + 1)
    for name, one in found.items():
        if name.startswith("exact"):
            wrong, square = one.predicted.mode_rate[late], one.predicted.rms[late] ** 2
            rows.append(
                row("risk", sensor, name, "10-30", wrong.mean(), 0, square.mean() ** 0.5, 0)
            )
    for name, one in table.items():
        mode, mode_error = one.average_mode_error, one.average_mode_error_error
        average, error = one.average[0], one.average_error[0]
        rows.append(row("average", sensor, name, "10-30", mode, mode_error, average, error))
        print(*rows[-1].values(), sep="\t", flush=True)
    for name, one in table.items():
        for k in range(len(TIMES)):
            parts = one.mode_error[k], one.mode_error_error[k], one.rms[k, 0], one.rms_error[k, 0]
            rows.append(row("time", sensor, name, k, *parts))
    return rows


def sizes(sensor) -> list[dict]:
    """Gaussian filters designed on fewer and on more paths."""
    system = zoo.scalar_switching(sensor)
    found = {
        (f"FBP-G {l}", paths): designed(system, large_order(l), ExactGaussian(), paths)
        for l in (1, 3)
        for paths in SIZES
    }
    table = compare(found, system, TIMES, TEST_PATHS, TEST, window=WINDOW)
    rows = []
    for (name, paths), one in table.items():
        mode, mode_error = one.average_mode_error, one.average_mode_error_error
        average, error = one.average[0], one.average_error[0]
        rows.append(row("training size", sensor, name, paths, mode, mode_error, average, error))
        print(*rows[-1].values(), sep="\t", flush=True)
    return rows


def main() -> None:
    begin, rows = time.process_time(), []
    for sensor in SENSORS:
        rows += scored(sensor, filters(sensor))
    for sensor in SENSORS:
        rows += sizes(sensor)
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(f"{time.process_time() - begin:.0f} s of processor time")


if __name__ == "__main__":
    main()
