"""Errors and costs of filters of the univariate growth model, by the published protocol.

Run by hand, ``python benchmarks/field_growth.py``, about 4 minutes on one core; writes
``benchmarks/field_growth.csv`` beside itself. The protocol is that of Table 3.2 of the manual of
the EKF/UKF toolbox (Hartikainen, Solin, Särkkä 2011); all equations are written anew here.

- rows of the library's filters and smoothers, of particles, and of tables designed on a grid;
- augmented: the unscented filter whose points carry both noises, and pass both maps;
- minimax: the conditionally minimax filter of Pankov, Bosov and Borisov, with the residual as
  basic correction and with four functions, its coefficients by regression on other paths;
- risk: predicted errors of orders 1 and 2 without random numbers, means of the steps 21 to 62.
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

from seedslib.base import Nodes
from seedslib.design import grid_synthesis, optimal_risk
from seedslib.designed import Memory
from seedslib.filters import (
    CovarianceFilter,
    GridBayesFilter,
    ParticleFilter,
    cubature_kalman,
    extended_kalman,
    smooth,
)
from seedslib.linearization import GaussHermite, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap

HERE = Path(__file__).parent
STEPS, RUNS, SOME = 500, 2000, 500
TRANSIENT, TURN = 22, 178
"""Tables of the first steps are kept for them; the next ones, two turns, are taken by phase."""
Z, Y = (-30, 30, 241), (-6, 58, 257)
X, U, V, T = sympy.symbols("x u v t", real=True)


def moved(x, k):
    """The state one step after step k, without its noise."""
    return x / 2 + 25 * x / (1 + x**2) + 8 * np.cos(1.2 * k)


def shown_by(x):
    """The measurement of a state, without its noise."""
    return x**2 / 20


def growth(mean, cov):
    """The system with a distribution of the state at its first time."""
    step = X / 2 + 25 * X / (1 + X**2) + 8 * sympy.cos(sympy.Rational(6, 5) * T) + U
    return DiscreteSystem(
        StochasticMap([X], [step], Noise([U]), time=T),
        StochasticMap([X], [X**2 / 20 + V], Noise([V])),
        mean,
        cov,
    )


def dense(count, reach):
    """Nodes that are some seven times as dense about 0, where the state's map is steep."""
    near, width = 0.15, 2.0
    top = reach + (1 - near) * width
    u = np.linspace(-top, top, count)
    return Nodes(
        u - (1 - near) * width * np.tanh(u / width),
        (u[1] - u[0]) * (1 - (1 - near) / np.cosh(u / width) ** 2),
    )


def by_phase(design, steps):
    """The filter of many steps, each with the table nearest in phase after the transient."""
    turn = np.arange(TRANSIENT, TRANSIENT + TURN)
    nearest = [int(turn[np.argmax(np.cos(1.2 * (turn - k)))]) for k in range(TRANSIENT, steps)]
    return design.taking([*range(TRANSIENT), *nearest])


def augmented(y, alpha, beta, kappa):
    """Means of the unscented filter of state and both noises, (K, runs), of y (K, runs)."""
    reach = alpha**2 * (3 + kappa)
    points = np.sqrt(reach) * np.hstack([np.zeros((3, 1)), np.eye(3), -np.eye(3)])
    weights = np.full((7, 1), 0.5 / reach)
    weights[0] = 1 - 3 / reach
    centred = weights.copy()
    centred[0] += 1 - alpha**2 + beta
    mean, cov, found = np.full(y.shape[1], 0.1), np.ones(y.shape[1]), []
    for k, shown in enumerate(y):
        x = moved(mean + np.sqrt(cov) * points[0][:, None], k) + points[1][:, None]
        seen = shown_by(x) + points[2][:, None]
        ahead, expected = (weights * x).sum(axis=0), (weights * seen).sum(axis=0)
        spread = (centred * (seen - expected) ** 2).sum(axis=0)
        gain = (centred * (x - ahead) * (seen - expected)).sum(axis=0) / spread
        mean = ahead + gain * (shown - expected)
        cov = (centred * (x - ahead) ** 2).sum(axis=0) - gain**2 * spread
        found.append(mean)
    return np.array(found)


def basic(x, y, several):
    """Basic corrections of the conditionally minimax filter, and a constant."""
    rest = y - shown_by(x)
    more = [x * rest, np.sign(x) * np.sqrt(20 * np.maximum(y, 0.0)), np.tanh(x)] if several else []
    return np.array([np.ones_like(x), rest, *more])


def minimax(paths, y, several):
    """Means of the conditionally minimax filter, (K, runs); `paths` are states and measurements."""
    states, shown = paths
    z, found = np.full(states.shape[1], 0.1), []
    mean = np.full(y.shape[1], 0.1)
    for k in range(len(y)):
        ahead = np.array([np.ones_like(z), moved(z, k)])
        line = np.linalg.lstsq(ahead.T, states[k], rcond=None)[0]
        z, mean = line @ ahead, line @ np.array([np.ones_like(mean), moved(mean, k)])
        given = basic(z, shown[k], several)
        line = np.linalg.lstsq(given.T, states[k] - z, rcond=None)[0]
        z, mean = z + line @ given, mean + line @ basic(mean, y[k], several)
        found.append(mean)
    return np.array(found)


def bootstrap(system, times, y, count):
    """Means of particles before and after resampling, (2, K, runs)."""
    filter = ParticleFilter(system, count)
    both = []
    for block in np.array_split(np.arange(y.shape[2]), max(1, y.shape[2] // 100)):
        state, found = filter.initial((len(block),), seed=int(block[0])), []
        for k, t in enumerate(times):
            state = filter.step(state, t, y[k][:, block])
            found.append((state.mean[0], state.particles[0].mean(axis=0)))
        both.append(np.array(found)[1:])
    return np.moveaxis(np.concatenate(both, axis=2), 1, 0)


def main() -> None:
    warnings.simplefilter("ignore")
    times, early = np.arange(1.0, STEPS + 1), np.arange(0.0, STEPS + 1)
    truth, system = growth(float(moved(0.1, 0)), 1.0), growth(0.1, 1.0)
    data = truth.simulate(times, RUNS, 1)
    states, shown = data.states[:, 0], data.measurements
    late = np.concatenate([np.full((1, 1, RUNS), np.nan), shown])
    best, begin = [], time.process_time()
    filter = GridBayesFilter(truth, dense(301, 36))
    for block in np.array_split(np.arange(RUNS), 10):
        best.append(filter.run(times, shown[..., block]).mean[:, 0])
    best = np.concatenate(best, axis=1)
    least = ((best - states) ** 2).mean(axis=0)

    file = (HERE / "field_growth.csv").open("w", newline="")
    table = csv.writer(file, lineterminator="\n")
    names = "row", "runs", "mse", "error", "above", "above_error", "microseconds", "predicted"
    table.writerow((*names, "megabytes", "design_seconds"))

    def put(name, means, begin, told=("", "", "")):
        spent = time.process_time() - begin
        runs = means.shape[1]
        square = ((means - states[:, :runs]) ** 2).mean(axis=0)
        above = square - least[:runs]
        values = [v for part in (square, above) for v in (part.mean(), part.std() / runs**0.5)]
        numbers = [f"{v:.5f}" for v in values]
        row = name, runs, *numbers, f"{1e6 * spent / runs / STEPS:.3f}", *told
        table.writerow(row)
        file.flush()
        print(*row, flush=True)

    put("Bayes", best, begin)
    shaped = {"alpha .5": Unscented(0.5, 2.0, 2.0), "alpha 1": Unscented(1.0, 0.0, 2.0)}
    rules = {"EKF": extended_kalman(system), "CKF": cubature_kalman(system)}
    rules |= {f"UKF {name}": CovarianceFilter(system, rule) for name, rule in shaped.items()}
    rules["Gauss-Hermite 10"] = CovarianceFilter(system, GaussHermite(10))
    for name, filter in rules.items():
        filter.run(early[:3], late[:3])
        begin = time.process_time()
        put(name, filter.run(early, late).mean[1:, 0], begin)
        begin = time.process_time()
        put(f"{name} smoother", smooth(filter, early, late).mean[1:, 0], begin)
    for name, given in {"alpha .5": (0.5, 2, 0), "alpha 1": (1, 0, 0)}.items():
        begin = time.process_time()
        put(f"UKF augmented {name}", augmented(shown[:, 0], *given), begin)
    others = truth.simulate(times, 20_000, 2)
    for name in ("residual", "four functions"):
        begin = time.process_time()
        paths = others.states[:, 0], others.measurements[:, 0]
        put(f"minimax {name}", minimax(paths, shown[:, 0], name != "residual"), begin)
    for several, order, z, y in (
        ("", 1, Z, Y),
        (" coarse", 1, (-30, 30, 121), (-6, 58, 161)),
        (" order 2", 2, (-27, 27, 61), (-6, 50, 97)),
    ):
        for name, count in (("one table a step", STEPS), ("tables by phase", TRANSIENT + TURN)):
            if order == 2 and count == STEPS:
                continue
            begin = time.process_time()
            design = grid_synthesis(truth, Memory(order), times[:count], x=dense(161, 34), z=z, y=y)
            spent = time.process_time() - begin
            filter = design if count == STEPS else by_phase(design, STEPS)
            room = sum(s.update.estimate.nbytes + s.forecast.estimate.nbytes for s in design.steps)
            foretold = (design.predicted.rms[:, 0] ** 2).mean()
            told = f"{foretold:.6f}", f"{room / 1e6:.1f}", f"{spent:.1f}"
            filter.run(times[:3], shown[:3])
            begin = time.process_time()
            put(name + several, filter.run(times, shown).mean[:, 0], begin, told)
            del design, filter
    begin = time.process_time()
    before, after = bootstrap(system, early, late[..., :SOME], 1000)
    put("bootstrap 1000", before, begin)
    put("bootstrap 1000 after resampling", after, begin)
    for order, z, y in ((1, 241, 257), (1, 481, 257), (2, 61, 129), (2, 91, 129), (2, 121, 161)):
        begin = time.process_time()
        risk = optimal_risk(
            truth, Memory(order), times[:62], x=dense(161, 34), z=(-30, 30, z), y=(-6, 58, y)
        )
        spent = time.process_time() - begin
        row = f"risk {order} of {z} nodes", "", "", "", "", "", ""
        table.writerow((*row, f"{risk.mse[20:].mean():.6f}", "", f"{spent:.1f}"))
        file.flush()
    file.close()


if __name__ == "__main__":
    main()
