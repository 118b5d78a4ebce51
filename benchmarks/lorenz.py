"""Errors of filters of Lorenz's system, seen every .25, for the table of all filters.

Run by hand, ``OPENBLAS_NUM_THREADS=1 python benchmarks/lorenz.py``, about 20 minutes on
one core; writes ``benchmarks/lorenz.csv``. The setting is that of P. Sakov, D. Oliver, L. Bertino,
Mon. Weather Rev. 140 (2012) 1988-2004, as DAPPER has it. The error is the root of the mean over
the components, averaged over the times from 16 on and over runs.
"""

import csv
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import sympy

from seedslib.design import BoundedPolynomial, minimax_synthesis
from seedslib.designed import Memory
from seedslib.filters import extended_kalman, unscented_kalman
from seedslib.models import DiscreteSystem, Noise, StochasticMap

INTERVAL, INNER, SPIN = 0.25, 25, 64
DESIGNED = {1: 20_000, 2: 20_000, 3: 40_000, 4: 60_000, 5: 60_000}
"""Paths that the polynomial of each degree is fitted to, over 48 measurements."""


def step(x, h, stack=np.stack):
    """One step of Runge and Kutta."""

    def slope(x):
        a, b, c = x
        return stack([10 * (b - a), a * (28 - c) - b, a * b - 8 * c / 3])

    k1 = slope(x)
    k2 = slope(x + h / 2 * k1)
    k3 = slope(x + h / 2 * k2)
    return x + h / 6 * (k1 + 2 * (k2 + k3) + slope(x + h * k3))


def flow(t, x, v=None):
    """The state one interval later."""
    for _ in range(INNER):
        x = step(x, INTERVAL / INNER)
    return x


X, R = sympy.symbols("x:3", real=True), sympy.symbols("r:3", real=True)
SENSOR = StochasticMap(X, [x + r for x, r in zip(X, R, strict=True)], Noise(R, cov=2 * np.eye(3)))
FIRST = [1.509, -1.531, 25.46], 2 * np.eye(3)
FINE = StochasticMap(X, list(step(np.array(X, dtype=object), sympy.Rational(1, 100), np.array)))
COARSE = StochasticMap.from_functions(
    3, 3, flow, mean=flow, cov=lambda t, x: np.zeros((3, *x.shape))
)
SYSTEM = DiscreteSystem(COARSE, SENSOR, *FIRST)


def inflated(filter, inner, inflation, data):
    """Means of a filter of moments whose covariances grow by a factor in a unit of time."""
    paths = data.states.shape[2]
    grown, state, found = inflation ** (INTERVAL / inner), filter.initial((paths,)), []
    for k, y in enumerate(data.measurements):
        for i in range(inner if k else 1):
            state = filter.predict(state, INTERVAL * (k - 1 + (i + 1) / inner) if k else 0.0)
            state = state._replace(cov=grown * state.cov)
        state = filter.correct(state, y)
        found.append(state.mean)
    return np.array(found)


def main() -> None:
    times = INTERVAL * np.arange(600)
    few, many = SYSTEM.simulate(times[:400], 100, 9), SYSTEM.simulate(times, 400, 9)
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("filter", "setting", "paths", "rmse", "error", "microseconds"))

        def put(name, setting, data, run):
            begin = time.perf_counter()
            errors = np.sqrt(((run(data) - data.states) ** 2).mean(axis=1))
            spent = 1e6 * (time.perf_counter() - begin) / errors.size
            each = errors[SPIN:].mean(axis=0)
            doubt = each.std(ddof=1) / np.sqrt(len(each))
            numbers = f"{each.mean():.4f}", f"{doubt:.4f}", f"{spent:.2f}"
            table.writerow((name, setting, len(each), *numbers))
            file.flush()

        extended = extended_kalman(DiscreteSystem(FINE, SENSOR, *FIRST))
        for factor in (1, 60, 180, 600):
            put("extended", factor, few, lambda d, a=factor: inflated(extended, INNER, a, d))
        unscented = unscented_kalman(SYSTEM)
        for factor in (1, 2, 4, 10):
            put("unscented", factor, few, lambda d, a=factor: inflated(unscented, 1, a, d))
        for degree, paths in DESIGNED.items():
            rule = BoundedPolynomial(degree)
            made = minimax_synthesis(
                SYSTEM, Memory(1), times[:48], paths=paths, seed=1, correction=rule
            )
            filter = replace(made, cycle=1)
            put(f"degree {degree}", 1, many, lambda d, f=filter: f.run(times, d.measurements).mean)


if __name__ == "__main__":
    main()
