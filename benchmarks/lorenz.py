"""Errors of filters of Lorenz's system, seen every .25: designed and usual ones.

Run by hand, ``python benchmarks/lorenz.py``, about 25 minutes on one core; writes
``benchmarks/lorenz.csv`` beside itself. The setting is that of P. Sakov, D. Oliver, L. Bertino,
Mon. Weather Rev. 140 (2012) 1988-2004, as the package DAPPER has it: Runge-Kutta steps of .01, no
noise of the model, measurement noise 2 I, errors from time 16 on. The error is the mean over
measurements and paths of the root of the mean over the components of the squared error.

A designed filter is designed step by step over `DESIGN` measurements, and its last step is frozen.
"""

from __future__ import annotations

import csv
import os
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy

from seedslib.design import BoundedPolynomial, minimax_synthesis
from seedslib.designed import Memory
from seedslib.filters import extended_kalman, unscented_kalman
from seedslib.models import DiscreteSystem, Noise, StochasticMap

HERE = Path(__file__).parent
INTERVAL, INNER, SPIN = 0.25, 25, 64
DESIGN = 48
START = [1.509, -1.531, 25.46]
DESIGNED = (
    (1, 1, 20_000),
    (2, 1, 20_000),
    (3, 1, 40_000),
    (4, 1, 60_000),
    (3, 2, 40_000),
    (5, 1, 60_000),
    (4, 2, 40_000),
)
"""Degree, remembered estimates, paths that a function is fitted to."""

FROZEN = 4, 1, 60_000, 1000, 10_000
"""The same, paths and measurements of the long run."""

COLUMNS = (
    "filter",
    "setting",
    "design_paths",
    "design_seconds",
    "paths",
    "measurements",
    "rmse",
    "error",
    "last_tenth",
    "largest",
    "microseconds",
)


def slope(x):
    """The right-hand side of Lorenz's equations."""
    a, b, c = x
    return [10 * (b - a), a * (28 - c) - b, a * b - 8 / 3 * c]


def flow(t, x, v=None):
    """The state one interval later, by steps of Runge and Kutta."""
    h = INTERVAL / INNER
    for _ in range(INNER):
        k1 = np.stack(slope(x))
        k2 = np.stack(slope(x + h / 2 * k1))
        k3 = np.stack(slope(x + h / 2 * k2))
        k4 = np.stack(slope(x + h * k3))
        x = x + h / 6 * (k1 + 2 * (k2 + k3) + k4)
    return x


X, R = sympy.symbols("x:3", real=True), sympy.symbols("r:3", real=True)
SENSOR = StochasticMap(X, [x + r for x, r in zip(X, R, strict=True)], Noise(R, cov=2 * np.eye(3)))


def lorenz():
    """The system from measurement to measurement, of array functions."""
    move = StochasticMap.from_functions(
        3, 3, flow, mean=flow, cov=lambda t, x: np.zeros((3, *x.shape))
    )
    return DiscreteSystem(move, SENSOR, START, 2 * np.eye(3))


def fine():
    """The same from one inner step to the next, as formulas."""
    h, x = sympy.Rational(1, 100), np.array(X, dtype=object)
    k1 = np.array(slope(x))
    k2 = np.array(slope(x + h / 2 * k1))
    k3 = np.array(slope(x + h / 2 * k2))
    k4 = np.array(slope(x + h * k3))
    step = StochasticMap(X, list(x + h / 6 * (k1 + 2 * (k2 + k3) + k4)))
    return DiscreteSystem(step, SENSOR, START, 2 * np.eye(3))


def designed(degree, remembered, paths, steps=DESIGN, seed=1):
    """A filter of bounded polynomials with its last step frozen, and seconds of the design."""
    begin = time.perf_counter()
    made = minimax_synthesis(
        lorenz(),
        Memory(remembered),
        INTERVAL * np.arange(steps),
        paths=paths,
        seed=seed,
        correction=BoundedPolynomial(degree),
    )
    return replace(made, cycle=1), time.perf_counter() - begin


def summary(errors, seconds):
    """Columns of a table from errors (measurements, paths) and the time of the run."""
    kept = errors[SPIN:]
    each = kept.mean(axis=0)
    last = kept[-max(1, len(kept) // 10) :].mean()
    return (
        errors.shape[1],
        len(errors),
        f"{each.mean():.4f}",
        f"{each.std(ddof=1) / np.sqrt(len(each)):.4f}",
        f"{last:.4f}",
        f"{kept.max():.2f}",
        f"{1e6 * seconds / errors.size:.2f}",
    )


def held(filter, paths, measurements, seed=9, part=500):
    """Errors (measurements, paths) of a designed filter, in parts."""
    times, found, seconds = INTERVAL * np.arange(measurements), [], 0.0
    for number in range(-(-paths // part)):
        data = lorenz().simulate(times, min(part, paths), seed + number)
        begin = time.perf_counter()
        mean = filter.run(times, data.measurements).mean
        seconds += time.perf_counter() - begin
        found.append(np.sqrt(((mean - data.states) ** 2).mean(axis=1)))
    return np.concatenate(found, axis=1), seconds


def inflated(filter, inner, inflation, paths=100, measurements=400, seed=9):
    """Errors of a filter of moments whose covariances grow by a factor in a unit of time."""
    data = lorenz().simulate(INTERVAL * np.arange(measurements), paths, seed)
    grown, state, found = inflation ** (INTERVAL / inner), filter.initial((paths,)), []
    begin = time.perf_counter()
    for k, (x, y) in enumerate(zip(data.states, data.measurements, strict=True)):
        if k == 0:
            state = filter.predict(state, 0.0)
        else:
            for i in range(inner):
                state = filter.predict(state, INTERVAL * (k - 1 + (i + 1) / inner))
                state = state._replace(cov=grown * state.cov)
        state = filter.correct(state, y)
        found.append(np.sqrt(((state.mean - x) ** 2).mean(axis=0)))
    return np.array(found), time.perf_counter() - begin


def main() -> None:
    """Write the table."""
    with (HERE / "lorenz.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")

        def write(*row):
            table.writerow(row)
            file.flush()

        write(*COLUMNS)
        for inflation in (1, 60, 180, 600):
            found = inflated(extended_kalman(fine()), INNER, inflation)
            write("extended", inflation, "", "", *summary(*found))
        for inflation in (1, 2, 4, 10):
            found = inflated(unscented_kalman(lorenz()), 1, inflation)
            write("unscented", inflation, "", "", *summary(*found))
        for degree, remembered, paths in DESIGNED:
            filter, seconds = designed(degree, remembered, paths)
            found = held(filter, 400, 600)
            write(f"degree {degree}", remembered, paths, f"{seconds:.0f}", *summary(*found))
            if (degree, remembered, paths) == FROZEN[:3]:
                write(
                    "frozen",
                    remembered,
                    paths,
                    f"{seconds:.0f}",
                    *summary(*held(filter, *FROZEN[3:])),
                )


if __name__ == "__main__":
    main()
