"""Time online of designed filters against the library's own extended Kalman filter.

Run by hand, ``python benchmarks/finite_order.py``; writes ``benchmarks/finite_order.csv`` beside
itself. Van der Pol oscillator, seven measurements from 0 to 3, integration step 0.01. All filters
run in one process, their repetitions interleaved, with one BLAS thread; the time of each is its
shortest. `ratio` is the time of the extended filter with Euler steps over the own time in the
same column of work: estimates at the measurements only, or forecasts on a grid of 301 times.
"""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import Continuous, synthesize
from seedslib.designed import Memory, finite_memory
from seedslib.filters import assumed_density, extended_kalman
from seedslib.linearization import Taylor

TACTS = np.arange(7) * 0.5
GRID = np.linspace(0.0, 3.0, 301)
BATCH = 20_000
WANTED = {("batch", "measurements"): 2.5, ("single", "measurements"): 15.0}


def filters() -> dict:
    system = zoo.van_der_pol()
    options = {"paths": 4096, "seed": 1}
    designed = {
        "FBP 1": (Memory(1), {}),
        "FBP 2": (Memory(2), {}),
        "FBP 4": (Memory(4), {}),
        "FKP 4": (finite_memory(4), {}),
        "FMP": (Memory(1), {"predictor": Continuous()}),
    }
    found = {
        "EKF Euler": extended_kalman(system, integrator="euler"),
        "EKF RK4": extended_kalman(system, integrator="rk4"),
        "FNA RK4": assumed_density(system, integrator="rk4"),
    }
    for name, (memory, more) in designed.items():
        made = synthesize(system, memory, Taylor(), TACTS, **options, **more)
        found[name] = made.forecasting("piecewise constant")
    return found


def shortest(works: dict, rounds: int) -> dict[str, float]:
    """Least seconds of each piece of work, their repetitions interleaved."""
    best = dict.fromkeys(works, np.inf)
    for _ in range(rounds + 1):
        for name, work in works.items():
            begin = time.perf_counter()
            work()
            best[name] = min(best[name], time.perf_counter() - begin)
    return best


def main() -> None:
    found, system = filters(), zoo.van_der_pol()
    rows = []
    for paths, size, rounds in (("single", 1, 60), ("batch", BATCH, 7)):
        whole = system.simulate(GRID, size, 5, measured=np.arange(7) * 50).measurements
        whole = whole[..., 0] if size == 1 else whole
        for output, times, y in (
            ("measurements", TACTS, whole[::50]),
            ("grid", GRID, whole),
        ):
            works = {
                name: (lambda f=f, times=times, y=y: f.run(times, y)) for name, f in found.items()
            }
            seconds = shortest(works, rounds)
            for name, value in seconds.items():
                rows.append(
                    {
                        "filter": name,
                        "paths": paths,
                        "output": output,
                        "microseconds_per_path": f"{1e6 * value / size:.4g}",
                        "ratio_to_ekf_euler": f"{seconds['EKF Euler'] / value:.3g}",
                        "ratio_to_ekf_rk4": f"{seconds['EKF RK4'] / value:.3g}",
                    }
                )
                print(*rows[-1].values(), sep="\t")
    target = Path(__file__).with_suffix(".csv")
    with target.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    for (paths, output), wanted in WANTED.items():
        ratio = min(
            float(row["ratio_to_ekf_rk4"])
            for row in rows
            if (row["paths"], row["output"]) == (paths, output) and row["filter"].startswith("FBP")
        )
        verdict = "reached" if ratio >= wanted else "MISSED"
        print(
            f"{paths}, {output}: {ratio:.3g} times the extended filter, wanted {wanted}: {verdict}"
        )


if __name__ == "__main__":
    main()
