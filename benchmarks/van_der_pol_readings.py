"""Filters of figure 2 on the Van der Pol oscillator: errors by reading, and leads under reading A.

Run by hand, ``python benchmarks/van_der_pol_readings.py``; writes two tables beside itself.
``van_der_pol_readings.csv``: RMS errors of x1 at t = 3 under fourteen readings, with standard
errors, and less that of two others on the same runs. ``van_der_pol_leads.csv``: the RMS error of x1
of the extended filter less that of another, after each measurement and a step of 0.01 before it,
on sixteen sets of runs; object, extended filter and continuous forecast by Euler's method.
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

TIMES = np.arange(7) * 0.5
RECIPES = {
    "one estimate, continuous": (Memory(1), Continuous()),
    "one estimate": (Memory(1), Affine()),
    "four estimates": (Memory(4), Affine()),
    "four measurements": (finite_memory(4), Affine()),
}


def designed(system, paths: int, **options) -> dict[str, Filter]:
    made = {}
    for name, (memory, predictor) in RECIPES.items():
        choice = {"predictor": predictor, "paths": paths, "seed": 1, **options}
        made[name] = synthesize(system, memory, Taylor(), TIMES, **choice)
    return made


def reading_rows(reading: str):
    system = zoo.van_der_pol(reading)
    filters: dict[str, Filter] = {"extended": extended_kalman(system, integrator="euler", bound=50)}
    filters |= designed(system, 4096, nodes=0)
    table = compare(filters, system, TIMES, 5120, 2, components=1)
    for name in filters:
        one = [table[name].rms[-1, 0], table[name].rms_error[-1, 0]]
        for other in ("extended", "four measurements"):
            gap = table.difference(name, other)
            one += [gap.rms[-1, 0], gap.error[-1, 0]]
        yield [reading, name, *(f"{value:.8f}" for value in one)]


def lead_rows(sets: int = 16):
    system = zoo.van_der_pol()
    clock = np.unique(np.round(np.concatenate([TIMES, TIMES[1:] - 0.01]), 9))
    filters: dict[str, Filter] = {"extended": extended_kalman(system, integrator="euler")}
    for name, made in designed(system, 16_384).items():
        filters[name] = made.forecasting("piecewise constant")
    for number in range(sets):
        table = compare(filters, system, clock, 32_768, 100 + number, components=1)
        for name in RECIPES:
            lead = table.difference("extended", name).rms[:, 0]
            for t in TIMES[1:]:
                at = np.searchsorted(clock, t - 1e-6)
                for when, place in (("before", at - 1), ("after", at)):
                    yield [number, name, f"{t:g}", when, f"{lead[place]:.6f}"]


def write(name: str, head: list[str], rows) -> None:
    with (Path(__file__).parent / f"{name}.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *rows])


if __name__ == "__main__":
    head = ["reading", "filter", "rms", "error", "to_extended", "to_extended_error"]
    rows = [row for reading in "ABCDEFGHIJKLMN" for row in reading_rows(reading)]
    write("van_der_pol_readings", [*head, "to_measurements", "to_measurements_error"], rows)
    write("van_der_pol_leads", ["set", "filter", "measurement", "when", "lead"], lead_rows())
