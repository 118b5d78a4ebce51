"""Least errors of filters of the scalar switching systems with a given memory, on fine grids.

Run by hand, ``python benchmarks/switching_exact.py``; writes ``benchmarks/switching_exact.csv``
beside itself. No random numbers are used: only the column of seconds (of the processor) depends
on the machine. The rows of order 2 with the finest memory take up to a minute. Averages are over
k = 10..30.
"""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import optimal_risk
from seedslib.designed import finite_memory, large_order

SHOWN = {"A1H": (-16, 18, 0.25), "A1L": (-11, 13, 0.1), "A2": (-8, 26, 0.0625)}
STATE_STEP = 0.2
STEPS = 31
COLUMNS = (
    "sensor",
    "memory",
    "order",
    "memory_step",
    "measurement_step",
    "steps",
    "mode_error",
    "rmse",
    "rmse_first",
    "rmse_second",
    "seconds",
)


def axis(low, high, step):
    return low, high, round((high - low) / step) + 1


def row(sensor, kind, order, memory_step, measurement_step):
    """One line of the table."""
    low, high, fine = SHOWN[sensor]
    measurement_step = measurement_step or fine
    memory = large_order(order) if kind == "estimates" else finite_memory(order)
    begin = time.process_time()
    risk = optimal_risk(
        zoo.scalar_switching(sensor),
        memory,
        np.arange(STEPS),
        x=axis(-8, 8, STATE_STEP),
        z=axis(-6, 6, memory_step) if memory_step else None,
        y=axis(low, high, measurement_step),
    )
    seconds = time.process_time() - begin
    wrong, rmse = risk.mode_error[10:].mean(), np.sqrt(risk.mse[10:].mean())
    first, second = np.sqrt(risk.mse[:2])
    return (
        sensor,
        kind,
        order,
        memory_step or "",
        measurement_step,
        STEPS,
        f"{wrong:.6f}",
        f"{rmse:.6f}",
        f"{first:.6f}",
        f"{second:.6f}",
        f"{seconds:.1f}",
    )


def main() -> None:
    coarse = {"A1H": 0.5, "A1L": 0.15, "A2": 0.25}
    jobs = []
    for sensor in SHOWN:
        jobs += [(sensor, "estimates", 1, step, None) for step in (0.4, 0.2, 0.1, 0.05, 0.025)]
        jobs.append((sensor, "measurements", 1, None, None))
        jobs.append((sensor, "measurements", 2, None, coarse[sensor]))
        jobs += [(sensor, "estimates", 2, step, None) for step in (0.8, 0.4, 0.2)]
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for job in jobs:
            found = row(*job)
            print(*found, flush=True)
            table.writerow(found)
            file.flush()


if __name__ == "__main__":
    main()
