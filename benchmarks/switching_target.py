"""Errors of filters of the manoeuvring target for its three indicators.

Run by hand, ``python benchmarks/switching_target.py``; writes ``benchmarks/switching_target.csv``
beside itself, and ``benchmarks/switching_target_course.csv`` with errors after each step. All
filters of one indicator are scored on the same 20 000 paths, averaged over
k = 10..40; designs are made on 40 000 other paths. The Rao-Blackwellised particle filter sees
2000 paths, and so does the IMM filter that it is compared with. Lines of kind "filter" hold the
share of wrong modes, the root-mean-square errors of position and velocity, and the mean-square
error summed over both; lines of kind "difference" hold paired differences of these; standard
errors stand beside each number.
"""

from __future__ import annotations

import csv
import os
import warnings
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.evaluation import compare
from seedslib.filters import KnownModeFilter, RaoBlackwellFilter
from seedslib.linearization import Taylor

DESIGN, TEST, DRAWN, PARTICLES = 40_000, 20_000, 2000, 100
SEED = 11
TIMES = np.arange(41.0)
WINDOW = (10, 40)
COURSE = ["indicator", "name", "step", "total", "total_error", "mode", "mode_error"]
FIELDS = [
    "indicator",
    "kind",
    "name",
    "paths",
    "mode",
    "mode_error",
    "position",
    "position_error",
    "velocity",
    "velocity_error",
    "square",
    "square_error",
]


def memories(indicator: str) -> dict[str, Memory]:
    """What the filters of finite order remember."""
    seen = indicator != "none"
    found = {f"FBP {l}": large_order(l) for l in (1, 2, 3)}
    if indicator == "exact":
        found["FBP 4"] = large_order(4)
    found |= {f"FKP {l}": Memory(0, l, l if seen else 0) for l in (1, 3)}
    found["soft FBP 1"] = Memory(1, log_odds=True)
    if indicator == "noisy":
        found["FBP 1 with J"] = Memory(1, 0, 1)
    return found


def pairs(indicator: str) -> list[tuple[str, str]]:
    """Filters whose difference is of interest."""
    found = [("FBP 1", "IMM"), ("FBP 2", "FBP 1"), ("FBP 3", "FBP 2")]
    if indicator == "exact":
        found.append(("FBP 4", "FBP 3"))
    found += [("FBP 1", "FKP 1"), ("FBP 3", "FKP 3"), ("soft FBP 1", "FBP 1")]
    if indicator == "noisy":
        found += [("FBP 1 with J", "FBP 1"), ("soft FBP 1", "FBP 3")]
    return found


def filter_row(indicator, name, found) -> dict:
    """Errors of one filter."""
    numbers = [found.average_mode_error, found.average_mode_error_error]
    for value, error in zip(found.average, found.average_error, strict=True):
        numbers += [value, error]
    square = found.average_total**2
    numbers += [square, 2 * found.average_total * found.average_total_error]
    return _row(indicator, "filter", name, found.paths, numbers)


def difference_row(indicator, table, first, second) -> dict:
    """Paired difference of two filters."""
    apart = table.difference(first, second)
    numbers = [apart.average_mode, apart.average_mode_error]
    for value, error in zip(apart.average, apart.average_error, strict=True):
        numbers += [value, error]
    numbers += [apart.average_square, apart.average_square_error]
    return _row(indicator, "difference", f"{first} minus {second}", table[first].paths, numbers)


def _row(indicator, kind, name, paths, numbers):
    texts = [f"{number:.6f}" for number in numbers]
    return dict(zip(FIELDS, [indicator, kind, name, paths, *texts], strict=True))


def course_rows(indicator, table) -> list[dict]:
    """Errors of all filters after each step: both components together, and wrong modes."""
    rows = []
    for name, found in table.items():
        parts = (found.total, found.total_error, found.mode_error, found.mode_error_error)
        for k, numbers in enumerate(zip(*parts, strict=True)):
            texts = [f"{number:.5f}" for number in numbers]
            rows.append(dict(zip(COURSE, [indicator, name, k, *texts], strict=True)))
    return rows


def scored(indicator: str) -> tuple[list[dict], list[dict]]:
    """All lines of one indicator for the two tables."""
    system = zoo.manoeuvring_target(indicator)
    filters = {"known modes": KnownModeFilter(system), "IMM": SwitchingFilter(system, Taylor())}
    with warnings.catch_warnings():
        # cells of histories of modes that hardly ever happen are thin, which is as it should be
        warnings.simplefilter("ignore")
        for name, memory in memories(indicator).items():
            filters[name] = synthesize(system, memory, Taylor(), TIMES, paths=DESIGN, seed=SEED)
    table = compare(filters, system, TIMES, TEST, SEED + 11, window=WINDOW)
    rows = [filter_row(indicator, name, found) for name, found in table.items()]
    few = {
        f"RBPF {PARTICLES}": RaoBlackwellFilter(system, PARTICLES),
        "IMM again": filters["IMM"],
    }
    drawn = compare(few, system, TIMES, DRAWN, SEED + 22, window=WINDOW)
    rows += [filter_row(indicator, name, found) for name, found in drawn.items()]
    rows += [difference_row(indicator, table, *pair) for pair in pairs(indicator)]
    rows.append(difference_row(indicator, drawn, *few))
    return rows, course_rows(indicator, table)


def main() -> None:
    """Score all and write the tables."""
    rows, course = [], []
    for indicator in ("noisy", "exact", "none"):
        for kept, made in zip((rows, course), scored(indicator), strict=True):
            kept += made
        for row in rows:
            if row["indicator"] == indicator:
                print(*row.values())
    here = Path(__file__)
    for path, fields, lines in (
        (here.with_suffix(".csv"), FIELDS, rows),
        (here.with_name(here.stem + "_course.csv"), COURSE, course),
    ):
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, fields, lineterminator="\n")
            writer.writeheader()
            writer.writerows(lines)


if __name__ == "__main__":
    main()
