"""What tables of the growth model lose under other noises, for one to three remembered estimates.

Run by hand, ``python benchmarks/field_growth_noise.py``, about 3 minutes on one core; writes
``benchmarks/field_growth_noise.csv`` beside itself: a row a pair of deviations and an order, with
mean squares of the steps 11 to 30 and their standard errors.

- least: the error of the conditional mean;
- far, extended: the distance of the table and of the extended Kalman filter from it;
- predicted: the error that the table predicts of itself; state: the mean square of the state.
"""

from __future__ import annotations

import csv
import os
import warnings
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy

from seedslib.base import Nodes
from seedslib.design import grid_synthesis
from seedslib.designed import Memory
from seedslib.filters import GridBayesFilter, extended_kalman
from seedslib.models import DiscreteSystem, Noise, StochasticMap

HERE = Path(__file__).parent
SENSORS, PROCESSES, NODES = (0.3, 1.0, 3.0, 10.0), (1.0, 3.0), {1: 241, 2: 61, 3: 17}
RUNS, TIMES, LATE = 400, np.arange(1.0, 31.0), slice(10, None)


def growth(sensor: float, process: float) -> DiscreteSystem:
    """The model with these deviations of its noises."""
    x, u, v, t = sympy.symbols("x u v t", real=True)
    step = x / 2 + 25 * x / (1 + x**2) + 8 * sympy.cos(sympy.Rational(6, 5) * t) + u
    moves = StochasticMap([x], [step], Noise([u], cov=[[process**2]]), time=t)
    shows = StochasticMap([x], [x**2 / 20 + v], Noise([v], cov=[[sensor**2]]))
    return DiscreteSystem(moves, shows, 0.05 + 2.5 / 1.01 + 8, process**2)


def dense(count: int, reach: float, near: float = 0.15, width: float = 2.0) -> Nodes:
    """Nodes that are seven times as dense about zero."""
    top = reach + (1 - near) * width
    u = np.linspace(-top, top, count)
    weights = (u[1] - u[0]) * (1 - (1 - near) / np.cosh(u / width) ** 2)
    return Nodes(u - (1 - near) * width * np.tanh(u / width), weights)


def point(sensor: float, process: float, order: int) -> dict[str, float]:
    """One row of the table."""
    system, reach = growth(sensor, process), 24 + 8 * process
    top = reach**2 / 20
    count = int(np.clip((top + 10 * sensor) / (0.75 * sensor), 65, 161))
    z = (-(22 + 4 * process), 22 + 4 * process, NODES[order])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a millionth of the probability leaves the axes
        table = grid_synthesis(
            system,
            Memory(order),
            TIMES,
            x=dense(161, reach),
            z=z,
            y=(-5 * sensor, top + 5 * sensor, count),
        )
        best = GridBayesFilter(system, dense(241, reach))
    data = system.simulate(TIMES, RUNS, 1)
    exact, far, extended = (
        filter.run(TIMES, data.measurements).mean[LATE, 0]
        for filter in (best, table, extended_kalman(system))
    )
    states, row = data.states[LATE, 0], {"sensor": sensor, "process": process, "order": order}
    for name, gap in (
        ("extended", extended - exact),
        ("far", far - exact),
        ("least", exact - states),
    ):
        each = (gap**2).mean(axis=0)
        row |= {name: each.mean(), f"{name}_error": each.std() / np.sqrt(RUNS)}
    predicted = (table.predicted.rms[LATE, 0] ** 2).mean()
    return row | {"predicted": predicted, "state": (states**2).mean()}


def main() -> None:
    """Write the table."""
    rows = [point(r, q, order) for r in SENSORS for q in PROCESSES for order in NODES]
    with (HERE / "field_growth_noise.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows({name: f"{value:.10g}" for name, value in row.items()} for row in rows)


if __name__ == "__main__":
    main()
