"""What a longer memory buys: paired differences of filters of switching systems.

Run by hand, ``python benchmarks/switching_order.py`` (minutes); writes
``benchmarks/switching_order.csv`` beside itself. The scalar system with three sensors and the
manoeuvring target with three indicators; filters are designed on 40 000 paths and scored on
20 000 others, averages over the times from 10. Then a system of one mode, where all these filters
should be the Kalman filter: how far those designed on N paths are from it. Every figure depends
on nothing but the seeds.

Columns: `part` is "error" (of one filter: share of wrong modes; root-mean-square error, of the
position for the target), "difference" (`filter` minus `other`: shares of wrong modes; mean-square
errors summed over components) or "distance" (root mean square over components, times and designs;
`other` is the number of design paths). Each figure has its standard error over paths; that of a
distance is over designs.
"""

from __future__ import annotations

import csv
import os
import time
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter, finite_memory, large_order
from seedslib.evaluation import compare
from seedslib.filters import KnownModeFilter
from seedslib.linearization import ExactGaussian, Taylor

DESIGN_PATHS, TEST_PATHS = 40_000, 20_000
SIZES, DESIGNS = (2500, 10_000, 40_000, 160_000), 4
SENSORS = {  # axes of the measurement for exact filters of orders 1 and 2
    "A1H": ((-16, 18, 137), (-16, 18, 137)),
    "A1L": ((-11, 13, 241), (-11, 13, 121)),
    "A2": ((-8, 26, 545), (-8, 26, 273)),
}
COLUMNS = ("part", "system", "filter", "other", "wrong_mode", "wrong_mode_error", "value", "error")


def row(part, system, name, other, *numbers) -> dict:
    shown = (part, system, name, other, *(f"{number:.6g}" for number in numbers))
    print(*shown, sep="\t", flush=True)
    return dict(zip(COLUMNS, shown, strict=True))


def scalar(sensor):
    """System, times, seeds, filters and pairs of them."""
    system, times = zoo.scalar_switching(sensor), np.arange(31.0)
    found = {
        "AOF-G": SwitchingFilter(system, ExactGaussian()),
        "IMM-EKF": SwitchingFilter(system, Taylor()),
    }
    for letter, linearization in (("G", ExactGaussian()), ("L", Taylor())):
        for l in (1, 2, 3):
            found[f"FBP-{letter} {l}"] = synthesize(
                system, large_order(l), linearization, times, paths=DESIGN_PATHS, seed=101
            )
    for l, count, y in zip((1, 2), (241, 61), SENSORS[sensor], strict=True):
        found[f"exact FBP {l}"] = grid_synthesis(
            system, large_order(l), times, x=(-8, 8, 161), z=(-6, 6, count), y=y
        )
    pairs = [("FBP-G 1", "AOF-G")]
    pairs += [(f"FBP-{x} {l + 1}", f"FBP-{x} {l}") for x in "GL" for l in (1, 2)]
    pairs += [(f"FBP-L {l}", f"FBP-G {l}") for l in (1, 2, 3)]
    pairs += [(f"FBP-{x} {l}", "IMM-EKF") for x in "GL" for l in (1, 2, 3)]
    pairs += [("IMM-EKF", "AOF-G"), ("exact FBP 2", "exact FBP 1")]
    return system, times, 202, found, pairs


def target(indicator):
    system, times, mean = zoo.manoeuvring_target(indicator), np.arange(41.0), ExactGaussian()

    def designed(memory):
        return synthesize(system, memory, mean, times, paths=DESIGN_PATHS, seed=11)

    found = {"AOF-G": SwitchingFilter(system, mean), "known modes": KnownModeFilter(system)}
    count = int(system.indicators > 0)
    for l in (1, 2, 3, 4):
        found[f"FBP-G {l}"] = designed(large_order(l))
        found[f"FKP-G {l}"] = designed(Memory(0, l, indicators=l * count))
    pairs = [(f"FBP-G {b}", f"FBP-G {a}") for a, b in pairwise((1, 2, 3, 4))]
    pairs.append(("FBP-G 1", "AOF-G"))
    if indicator != "exact":
        found["soft FBP-G 1"] = designed(Memory(1, log_odds=True))
        pairs += [("soft FBP-G 1", "FBP-G 1"), ("soft FBP-G 1", "FBP-G 3")]
    if indicator == "noisy":
        found["FBP-G 1 with indicator"] = designed(Memory(1, indicators=1))
        pairs.append(("FBP-G 1 with indicator", "FBP-G 1"))
    return system, times, 22, found, pairs


def scored(name, system, times, seed, found, pairs) -> list[dict]:
    table, rows = compare(found, system, times, TEST_PATHS, seed, window=(10, None)), []
    for filter, one in table.items():
        modes = (0.0, 0.0)
        if one.average_mode_error is not None:
            modes = one.average_mode_error, one.average_mode_error_error
        rows.append(row("error", name, filter, "", *modes, one.average[0], one.average_error[0]))
    for first, second in pairs:
        apart = table.difference(first, second)
        numbers = (
            apart.average_mode,
            apart.average_mode_error,
            apart.average_square,
            apart.average_square_error,
        )
        rows.append(row("difference", name, first, second, *numbers))
    return rows


def distances() -> list[dict]:
    """One mode: root-mean-square distance of designed filters to the Kalman filter."""
    system, times, mean = zoo.steady_target(), np.arange(16.0), ExactGaussian()
    data = system.simulate(times, 4000, 3)
    best = SwitchingFilter(system, mean).run(times, data.measurements).mean
    memories = {f"FBP {l}": large_order(l) for l in (1, 2, 3)}
    memories |= {f"FKP {l}": finite_memory(l) for l in (3, 15)}
    rows = []
    for name, memory in memories.items():
        for paths in SIZES:
            squares = []
            for seed in range(1, DESIGNS + 1):
                made = synthesize(system, memory, mean, times, paths=paths, seed=seed)
                apart = made.run(times, data.measurements).mean - best
                squares.append(np.square(apart).mean())
            root = np.sqrt(np.mean(squares))
            error = np.std(squares, ddof=1) / np.sqrt(DESIGNS) / (2 * root)
            rows.append(row("distance", "one mode", name, paths, 0, 0, root, error))
    return rows


def main() -> None:
    begin, rows = time.process_time(), distances()
    for sensor in SENSORS:
        rows += scored(sensor, *scalar(sensor))
    for indicator in ("noisy", "exact", "none"):
        rows += scored(f"B {indicator}", *target(indicator))
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(f"{time.process_time() - begin:.0f} s of processor time")


if __name__ == "__main__":
    main()
