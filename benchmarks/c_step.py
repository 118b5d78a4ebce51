"""Time of one step in exported C against the same filters in Python.

Run by hand, ``python benchmarks/c_step.py``; writes ``benchmarks/c_step.csv`` beside itself. Wants
a C compiler called ``cc``. The Van der Pol oscillator, seven measurements of two numbers; a step is
the forecast to a measurement and the correction by it, its covariance and likelihood included. The
filter of finite order n' l = 2 l has exact Gaussian means; the extended Kalman filter (EKF) and the
assumed-density filter (FNA) move by Runge-Kutta or Euler steps of 0.02, 25 to an interval. C runs
512 records one after another (``cc -O2 -ffp-contract=off``), Python one path step by step, or 4096
paths together (there the likelihood too, for orders 2 and 4 not the covariance). All run in one
process, their repetitions interleaved; the time of each is its shortest. `load` is the load average
of the machine before and after.
"""

from __future__ import annotations

import csv
import ctypes
import os
import subprocess
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import Polynomial, synthesize
from seedslib.designed import large_order
from seedslib.extra import to_c
from seedslib.filters import assumed_density, extended_kalman
from seedslib.linearization import ExactGaussian

TIMES = 0.5 * np.arange(7)
BATCH, RECORDS, SINGLE, ROUNDS = 4096, 512, 5, 25

DRIVER = """
#include "NAME.h"
double NAME_records(int records, int count, const double *t, const double *y);
double NAME_records(int records, int count, const double *t, const double *y)
{
    double sum = 0.0;
    int i, k;
    (void)t;
    for (i = 0; i < records; i++) {
        NAME_state s;
        NAME_init(&s);
        for (k = 0; k < count; k++) {
            NAME_step(&s, TIME y + (i * count + k) * 2);
            sum += s.mean[0] + s.mean[1] + s.cov[1][0] + s.loglik;
        }
    }
    return sum;
}
"""


def filters(system) -> dict:
    """Filters by name; designed on few paths, as their accuracy is not asked for here."""
    design = {"paths": 2000, "seed": 1, "nodes": 0}
    one, two = large_order(1), large_order(2)
    rule = ExactGaussian()
    return {
        "order 2": synthesize(system, one, rule, TIMES, **design),
        "order 4": synthesize(system, two, rule, TIMES, **design),
        "order 2, polynomial": synthesize(
            system, one, rule, TIMES, predictor=Polynomial(3, 2), **design
        ),
        "EKF, Runge-Kutta": extended_kalman(system, step=0.02),
        "EKF, Euler": extended_kalman(system, step=0.02, integrator="euler"),
        "FNA, Runge-Kutta": assumed_density(system, step=0.02),
    }


def compiled(made, folder) -> dict:
    """One library with all filters: its functions, seconds of which are to be measured."""
    sources = []
    for number, (name, filter) in enumerate(made.items()):
        prefix = f"f{number}"
        to_c(filter, Path(folder) / f"{prefix}.h", name=prefix)
        timed = "t[k]," if "," in name and "order" not in name else ""
        sources.append(DRIVER.replace("NAME", prefix).replace("TIME", timed))
    (Path(folder) / "all.c").write_text("\n".join(sources))
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "all.c", "-o", "all.so", "-lm"], cwd=folder, check=True)
    library = ctypes.CDLL(str(Path(folder) / "all.so"))
    found = {}
    for number, name in enumerate(made):
        function = getattr(library, f"f{number}_records")
        function.restype = ctypes.c_double
        function.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
        found[name] = function
    return found


def measure(system) -> tuple[dict, float]:
    """Least seconds a step by (filter, form), and how far C and Python are apart."""
    made = filters(system)
    y = system.simulate(TIMES, BATCH, 3).measurements
    records = np.ascontiguousarray(np.moveaxis(y, -1, 0))
    best: dict = {}

    def note(key, work, steps):
        begin = time.perf_counter()
        result = work()
        best[key] = min(best.get(key, np.inf), (time.perf_counter() - begin) / steps)
        return result

    apart = 0.0
    with tempfile.TemporaryDirectory() as folder:
        in_c = compiled(made, folder)
        for turn in range(ROUNDS):
            for name, filter in made.items():
                given = (RECORDS, len(TIMES), TIMES.ctypes.data, records.ctypes.data)
                for _ in range(8):  # short enough to fit between interruptions
                    run = lambda f=in_c[name], a=given: f(*a)  # noqa: E731
                    total = note((name, "C"), run, RECORDS * len(TIMES))
                note((name, "Python, one path"), lambda f=filter: steps(f, y), SINGLE * len(TIMES))
                run = lambda f=filter: f.run(TIMES, y)  # noqa: E731
                note((name, "Python, 4096 paths"), run, BATCH * len(TIMES))
                if turn == 0:
                    apart = max(apart, abs(total / checksum(filter, y[..., :RECORDS]) - 1.0))
    return best, apart


def steps(filter, y):
    """Some paths, one after another, measurement by measurement."""
    for i in range(SINGLE):
        state = filter.initial()
        for t, shown in zip(TIMES, y[..., i], strict=True):
            state = filter.step(state, t, shown)


def checksum(filter, y) -> float:
    """What the C program returns, by Python."""
    options = {"covariances": True} if hasattr(filter, "fits") else {}
    found = filter.run(TIMES, y, **options)
    return found.mean.sum() + found.cov[:, 1, 0].sum() + found.loglik.sum()


def main():
    load = os.getloadavg()[0]
    best, apart = measure(zoo.van_der_pol())
    load = f"{load:.2f} to {os.getloadavg()[0]:.2f}"
    print(f"load average {load}; sums of C and Python differ by {apart:.1e}")
    rows = []
    for (name, form), seconds in best.items():
        own = seconds / best[name, "C"]
        ekf = best["EKF, Runge-Kutta", form] / seconds
        rows.append([name, form, f"{1e9 * seconds:.4g}", f"{own:.3g}", f"{ekf:.3g}", load])
        print(f"{name:20s} {form:20s} {1e9 * seconds:12.1f} ns {own:10.3g} {ekf:10.3g}")
    with open(Path(__file__).with_suffix(".csv"), "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            ["filter", "form", "nanoseconds_per_step", "ratio_to_c", "ekf_rk4_over_own", "load"]
        )
        writer.writerows(rows)


if __name__ == "__main__":
    main()
