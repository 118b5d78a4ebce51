"""What filters of switching systems gain from a longer memory: paired differences.

Run by hand, ``python benchmarks/switching_order.py`` (minutes); writes
``benchmarks/switching_order.csv`` beside itself. The scalar system with three sensors and the
manoeuvring target with three indicators; filters are designed on 40 000 runs and scored on
20 000 others, averages over the times from 10. Every figure depends on nothing but the seeds.

Columns: `part` is "error" (of one filter: share of wrong modes; root-mean-square error, of the
position for the target) or "difference" (`filter` minus `other`: shares of wrong modes;
mean-square errors summed over components). Each figure has its standard error over runs.
"""

from __future__ import annotations

import csv
import os
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import Memory, SwitchingFilter, finite_memory, large_order
from seedslib.evaluation import compare
from seedslib.filters import GridBayesFilter, KnownModeFilter
from seedslib.linearization import ExactGaussian, Taylor

DESIGN_RUNS, TEST_RUNS = 40_000, 20_000
SENSORS = {  # axes of the measurement for exact filters of orders 1 and 2
    "A1H": ((-16, 18, 137), (-16, 18, 137)),
    "A1L": ((-11, 13, 241), (-11, 13, 121)),
    "A2": ((-8, 26, 545), (-8, 26, 273)),
}
COLUMNS = ("part", "system", "filter", "other", "wrong_mode", "wrong_mode_error", "value", "error")


def scalar(sensor):
    """System, times, seed of the test, filters and pairs of them."""
    system, times = zoo.scalar_switching(sensor), np.arange(31.0)

    def designed(memory, linearization):
        return synthesize(system, memory, linearization, times, paths=DESIGN_RUNS, seed=101)

    found = {
        "grid Bayes": GridBayesFilter(system, (-8, 8, 161)),
        "AOF-G": SwitchingFilter(system, ExactGaussian()),
        "IMM-EKF": SwitchingFilter(system, Taylor()),
        "soft FBP-G 1": designed(Memory(1, log_odds=True), ExactGaussian()),
    }
    for l in (1, 2, 3):
        found[f"FBP-G {l}"] = designed(large_order(l), ExactGaussian())
        found[f"FBP-L {l}"] = designed(large_order(l), Taylor())
        found[f"FKP-G {l}"] = designed(finite_memory(l), ExactGaussian())
    for l, count, y in zip((1, 2), (241, 61), SENSORS[sensor], strict=True):
        found[f"exact FBP {l}"] = grid_synthesis(
            system, large_order(l), times, x=(-8, 8, 161), z=(-6, 6, count), y=y
        )
    pairs = [("FBP-G 1", "AOF-G"), ("IMM-EKF", "AOF-G"), ("exact FBP 2", "exact FBP 1")]
    pairs += [(f"FBP-{x} {l + 1}", f"FBP-{x} {l}") for x in "GL" for l in (1, 2)]
    pairs += [(f"FBP-{x} {l}", "IMM-EKF") for x in "GL" for l in (1, 2, 3)]
    pairs += [(f"FBP-{x} 1", "exact FBP 1") for x in "GL"]
    for l in (1, 2, 3):
        pairs += [(f"FBP-L {l}", f"FBP-G {l}"), (f"FBP-G {l}", f"FKP-G {l}")]
    return system, times, 202, found, pairs


def target(indicator):
    """The same for the manoeuvring target."""
    system, times, mean = zoo.manoeuvring_target(indicator), np.arange(41.0), ExactGaussian()

    def designed(memory):
        return synthesize(system, memory, mean, times, paths=DESIGN_RUNS, seed=11)

    found = {"AOF-G": SwitchingFilter(system, mean), "known modes": KnownModeFilter(system)}
    count = int(system.indicators > 0)
    for l in (1, 2, 3, 4):
        found[f"FBP-G {l}"] = designed(large_order(l))
        found[f"FKP-G {l}"] = designed(Memory(0, l, indicators=l * count))
    pairs = [(f"FBP-G {b}", f"FBP-G {a}") for a, b in pairwise((1, 2, 3, 4))]
    pairs += [("FBP-G 1", "AOF-G"), *((f"FBP-G {l}", f"FKP-G {l}") for l in (1, 3))]
    if indicator != "exact":
        found["soft FBP-G 1"] = designed(Memory(1, log_odds=True))
        pairs += [("soft FBP-G 1", "FBP-G 1"), ("soft FBP-G 1", "FBP-G 3")]
    if indicator == "noisy":
        found["FBP-G 1 with indicator"] = designed(Memory(1, indicators=1))
        pairs.append(("FBP-G 1 with indicator", "FBP-G 1"))
    return system, times, 22, found, pairs


def scored(name, system, times, seed, found, pairs):
    """Lines of one system."""
    table = compare(found, system, times, TEST_RUNS, seed, window=(10, None))
    for filter, one in table.items():
        modes = one.average_mode_error, one.average_mode_error_error
        numbers = (*modes, one.average[0], one.average_error[0])
        yield "error", name, filter, "", *(f"{number or 0.0:.6g}" for number in numbers)
    for first, second in pairs:
        one = table.difference(first, second)
        modes = one.average_mode, one.average_mode_error
        numbers = (*modes, one.average_square, one.average_square_error)
        yield "difference", name, first, second, *(f"{number:.6g}" for number in numbers)


def main() -> None:
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for sensor in SENSORS:
            writer.writerows(scored(sensor, *scalar(sensor)))
        for indicator in ("noisy", "exact", "none"):
            writer.writerows(scored(f"B {indicator}", *target(indicator)))


if __name__ == "__main__":
    main()
