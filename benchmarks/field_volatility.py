"""Errors of filters of a stochastic volatility against the exact mean, by the published protocol.

Run by hand, ``python benchmarks/field_volatility.py``, about 2 minutes on one core; writes
``benchmarks/field_volatility.csv`` beside itself. The model and the two measures are those of the
package PyDPF (its notebook on a fully specified model), but for the reference, which is the mean
on a grid in place of 10 000 particles; all equations are written anew here.

- e_x: mean square of the distance from the exact mean; e_l: mean of |1 - l' / l|, where l and l'
  are the densities of a measurement given those before it;
- 500 paths of 1000 steps, and for the rows "long" 10 paths of 100 000.
"""

from __future__ import annotations

import csv
import os
import time
import warnings
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy

from seedslib.base import interpolate
from seedslib.design import JointDistribution, grid_synthesis, optimal_steps, stationary
from seedslib.designed import Memory
from seedslib.filters import GridBayesFilter, ParticleFilter
from seedslib.models import DiscreteSystem, Noise, StochasticMap

HERE = Path(__file__).parent
ALPHA, BETA = 0.91, 0.5
STEPS, PATHS, LONG, FEW = 1000, 500, 100_000, 10
STATES = (-14, 14, 113)
"""Nodes of the exact filter."""
TABLES = {
    1: {"x": (-13, 13, 105), "z": (-10, 10, 161), "y": (-32, 20, 209)},
    2: {"x": (-12, 12, 73), "z": (-9, 9, 91), "y": (-26, 18, 177)},
}
"""Axes of the designs of order 1 and 2."""
DESIGNED = 20


def chi(rng, count):
    """Draws of the logarithm of a squared normal number."""
    return np.log(rng.standard_normal((1, count)) ** 2)


def log_chi(v):
    """The logarithm of its density."""
    return 0.5 * (v[0] - np.exp(v[0]) - np.log(2 * np.pi))


def volatility():
    """X' = .91 X + W, and the logarithm of the squared return: X + log .25 + log V²."""
    X, W, V = sympy.symbols("x w v", real=True)
    noise = Noise([V], -np.euler_gamma - np.log(2), [[np.pi**2 / 2]], chi, log_chi)
    return DiscreteSystem(
        StochasticMap([X], [ALPHA * X + W], Noise([W])),
        StochasticMap([X], [X + 2 * sympy.log(BETA) + V], noise),
        0,
        1 / (1 - ALPHA**2),
    )


def predictive(system, order):
    """Logarithm of the density of a measurement given the memory, (1, Y, memory...), and axes."""
    dist = JointDistribution(system, Memory(order), np.arange(float(DESIGNED)), **TABLES[order])
    *_, last = optimal_steps(dist)
    likely = np.exp(dist.chain.log_likelihood(0.0, dist.y_grid))
    axes = dist.measurement_axes + dist.block_axes * order
    found = np.maximum(likely @ last.dist.T, 1e-300)
    return axes, np.log(found).reshape(1, *(axis.count for axis in axes))


def distances(exact, means, factors):
    """e_x and e_l of each path; factors are logarithms (K, paths)."""
    e_x = ((means - exact.mean[:, 0]) ** 2).mean(axis=0)
    late = len(factors)
    e_l = np.abs(1 - np.exp(factors - exact.loglik[-late:])).mean(axis=0)
    return e_x, e_l


def frozen(system, order):
    """The table of the last step of a design, for ever, and the seconds it took."""
    begin = time.process_time()
    design = grid_synthesis(system, Memory(order), np.arange(float(DESIGNED)), **TABLES[order])
    spent = time.process_time() - begin
    return stationary(design, transient=order), design, spent


def looked_up(axes, logs, y, means):
    """Log densities of the measurements y (K, paths) after the memory has filled."""
    order = len(axes) - 1
    past = [means[order - 1 - k : len(means) - 1 - k] for k in range(order)]
    return interpolate(logs, axes, [y[order:], *past])[0]


def main() -> None:
    warnings.simplefilter("ignore")
    system = volatility()
    file = (HERE / "field_volatility.csv").open("w", newline="")
    table = csv.writer(file, lineterminator="\n")
    names = "row", "paths", "e_x", "error", "e_l", "e_l_error", "worst", "microseconds"
    table.writerow((*names, "predicted", "megabytes", "design_seconds"))

    def put(name, e_x, e_l, spent, steps, told=("", "", "")):
        paths = len(e_x)
        values = [v for part in (e_x, e_l) for v in (part.mean(), part.std() / paths**0.5)]
        numbers = [f"{v:.7f}" for v in (*values, e_x.max())]
        row = name, paths, *numbers, f"{1e6 * spent / paths / steps:.3f}", *told
        table.writerow(row)
        file.flush()
        print(*row, flush=True)

    times = np.arange(float(STEPS))
    data = system.simulate(times, PATHS, 2)
    y = data.measurements
    begin = time.process_time()
    exact = GridBayesFilter(system, STATES).run(times, y)
    spent = time.process_time() - begin
    error = ((exact.mean - data.states) ** 2)[DESIGNED:, 0].mean(axis=0)
    put("Bayes", 0 * error, 0 * error, spent, STEPS, (f"{error.mean():.6f}", "", ""))
    for count, paths in ((100, PATHS), (400, 200), (1600, 50)):
        begin = time.process_time()
        found = ParticleFilter(system, count).run(times, y[..., :paths], seed=3)
        spent = time.process_time() - begin
        part = exact._replace(mean=exact.mean[..., :paths], loglik=exact.loglik[:, :paths])
        put(f"bootstrap {count}", *distances(part, found.mean[:, 0], found.loglik), spent, STEPS)
    made = {}
    for order in TABLES:
        filter, design, spent = frozen(system, order)
        axes, logs = predictive(system, order)
        room = filter.steps[-1].update.estimate.nbytes / 1e6
        told = f"{design.predicted.rms[-1, 0] ** 2:.8f}", f"{room:.2f}", f"{spent:.2f}"
        filter.run(times[:9], y[:9])
        begin = time.process_time()
        means = filter.run(times, y).mean[:, 0]
        spent = time.process_time() - begin
        factors = looked_up(axes, logs, y[:, 0], means)
        put(f"order {order}", *distances(exact, means, factors), spent, STEPS, told)
        made[order] = filter, axes, logs
    times = np.arange(float(LONG))
    y = system.simulate(times, FEW, 4).measurements
    exact = GridBayesFilter(system, STATES).run(times, y)
    for order, (filter, axes, logs) in made.items():
        begin = time.process_time()
        means = filter.run(times, y).mean[:, 0]
        spent = time.process_time() - begin
        factors = looked_up(axes, logs, y[:, 0], means)
        put(f"order {order} long", *distances(exact, means, factors), spent, LONG)
    file.close()


if __name__ == "__main__":
    main()
