"""Time of one step of one path: filters of the scalar switching system in Python.

Run by hand, ``python benchmarks/switching_step.py`` (half a minute); writes
``benchmarks/switching_step.csv`` beside itself. A step is the forecast to a measurement and the
correction by it, for a single path, as a program would do it that waits for measurements. Each
filter makes ROUNDS runs of 31 steps, the rounds of all filters interleaved; `median` and `slowest`
are over all its steps but those of the first round, in microseconds of the clock on the wall.
Steps in C are in `benchmarks/native.csv`.
"""

from __future__ import annotations

import csv
import os
import platform
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import SwitchingFilter, large_order
from seedslib.linearization import ExactGaussian, Taylor

TIMES = np.arange(31.0)
ROUNDS, DESIGN_PATHS = 30, 2000
COLUMNS = ("filter", "form", "median", "slowest", "steps", "processor", "load")


def filters(system) -> dict:
    """Filters by name; designed on few paths, as their accuracy is not asked for here."""
    order, design = large_order(1), {"paths": DESIGN_PATHS, "seed": 1}
    return {
        "exact FBP 1": grid_synthesis(
            system, order, TIMES, x=(-8, 8, 81), z=(-6, 6, 61), y=(-16, 18, 137)
        ),
        "FBP-G 1": synthesize(system, order, ExactGaussian(), TIMES, **design),
        "FBP-L 1": synthesize(system, order, Taylor(), TIMES, **design),
        "AOF-G": SwitchingFilter(system, ExactGaussian()),
        "IMM-EKF": SwitchingFilter(system, Taylor()),
    }


def processor() -> str:
    """Name of the processor, as the system gives it."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def main() -> None:
    system = zoo.scalar_switching("A1H")
    made = filters(system)
    y = system.simulate(TIMES, ROUNDS, 3).measurements
    seconds: dict[str, list[float]] = {name: [] for name in made}
    begin = os.getloadavg()[0]
    for turn in range(ROUNDS):
        for name, filter in made.items():
            state = filter.initial()
            for t, shown in zip(TIMES, y[..., turn], strict=True):
                start = time.perf_counter()
                state = filter.step(state, t, shown)
                if turn:
                    seconds[name].append(time.perf_counter() - start)
    load = f"{begin:.2f} to {os.getloadavg()[0]:.2f}"
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for name, spent in seconds.items():
            micro = 1e6 * np.array(spent)
            row = (name, "Python, one path", f"{np.median(micro):.0f}", f"{micro.max():.0f}")
            table.writerow((*row, len(spent), processor(), load))
            print(*row, len(spent), load)


if __name__ == "__main__":
    main()
