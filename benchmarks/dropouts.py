"""Claimed and actual deviations of designs that know of dropouts, after 1 to 15 missing rows.

Run by hand, ``python benchmarks/dropouts.py``; takes minutes and writes ``benchmarks/dropouts.csv``
beside itself. Each design was told that a measurement arrives with probability 0.9, an indicator
always. On the same test paths, so many rows from the sixth on are missing; `claimed` is the root
mean of the variances that the filter gives at the last of them and at the first measurement after
them, `actual` its root-mean-square error there with its standard error `doubt`. First component.
"""

from __future__ import annotations

import csv
import os
import warnings
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import grid_synthesis, simulated_synthesis, synthesize
from seedslib.designed import Memory
from seedslib.linearization import ExactGaussian

COLUMNS = ("system", "design", "classes", "missing", "place", "claimed", "actual", "doubt")
COUNTS = (1, 2, 4, 8, 15)
FIRST, PATHS, RATE = 5, 20_000, 0.9
AXES = {"z": (-2.4, 2.4, 81), "y": (-8, 8, 121)}
MODES = {"z": (-6, 6, 81), "y": (-11, 13, 121)}


def designs():
    """Name of the system, of the design, the system, and what makes the filter."""
    flip, modes, target = (
        zoo.flip_process(), zoo.scalar_switching("A1L"), zoo.manoeuvring_target("noisy")
    )  # fmt: skip
    quarter, whole = 0.25 * np.arange(23), np.arange(23.0)
    told = {"availability": RATE}
    by_paths = {"paths": 20_000, "seed": 1, **told}
    yield (
        "flip process",
        "grid",
        flip,
        lambda: grid_synthesis(
            flip, Memory(1), quarter, x=(-3.5, 3.5, 71), nodes=0, **AXES, **told
        ),
    )
    yield (
        "flip process",
        "tables on paths",
        flip,
        lambda: simulated_synthesis(
            flip, Memory(1), quarter, nodes=0, method="histogram", **AXES, **by_paths
        ),
    )
    yield (
        "two modes A1L",
        "grid",
        modes,
        lambda: grid_synthesis(modes, Memory(1), whole, x=(-8, 8, 81), **MODES, **told),
    )
    yield (
        "two modes A1L",
        "Gaussian laws on paths",
        modes,
        lambda: synthesize(modes, Memory(1), ExactGaussian(), whole, **by_paths),
    )
    yield (
        "manoeuvring target",
        "Gaussian laws on paths",
        target,
        lambda: synthesize(
            target, Memory(1), ExactGaussian(), whole, **{**by_paths, "availability": [RATE, 1.0]}
        ),
    )


def rows(system, made, data):
    """Count, place, claimed and actual deviation and its doubt."""
    told = {} if data.indicators is None else {"indicators": data.indicators}
    for count in COUNTS:
        y = data.measurements.copy()
        y[FIRST : FIRST + count] = np.nan
        found = made.run(data.times, y, covariances=True, **told)
        for place, k in (("last missing", FIRST + count - 1), ("next", FIRST + count)):
            square = (found.mean - data.states)[k, 0] ** 2
            actual = np.sqrt(square.mean())
            doubt = square.std() / np.sqrt(PATHS) / 2 / actual
            yield count, place, np.sqrt(found.cov[k, 0, 0].mean()), actual, doubt


def main() -> None:
    warnings.simplefilter("ignore")
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for name, kind, system, make in designs():
            made = make()
            data = system.simulate(made.times, PATHS, 7)
            classes = max(len(part.prob) for part in made.arrivals)
            for count, place, *numbers in rows(system, made, data):
                row = (name, kind, classes, count, place, *(f"{x:.5f}" for x in numbers))
                print(*row, flush=True)
                table.writerow(row)
            file.flush()


if __name__ == "__main__":
    main()
