"""Errors and costs of filters of the univariate growth model, for the table of all filters.

Run by hand, ``OPENBLAS_NUM_THREADS=1 python benchmarks/field_growth.py``, about 4
minutes on one core; writes ``benchmarks/field_growth.csv``. The protocol is that of Table 3.2 of
the manual of the EKF/UKF toolbox (Hartikainen, Solin, Särkkä 2011).
"""

import csv
import time
import warnings
from pathlib import Path

import numpy as np
import sympy

from seedslib.base import Nodes
from seedslib.design import grid_synthesis
from seedslib.designed import Memory
from seedslib.filters import CovarianceFilter, GridBayesFilter, ParticleFilter, extended_kalman
from seedslib.linearization import Cubature, GaussHermite, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap

STEPS, RUNS, SOME, TRANSIENT, TURN = 500, 2000, 500, 22, 178


def moved(x, k, cos=np.cos):
    """The state one step after step k, without its noise."""
    return x / 2 + 25 * x / (1 + x**2) + 8 * cos(1.2 * k)


def growth(mean, cov):
    """The system with a distribution of the state at its first time."""
    x, u, v, k = sympy.symbols("x u v k", real=True)
    step = StochasticMap([x], [moved(x, k, sympy.cos) + u], Noise([u]), time=k)
    return DiscreteSystem(step, StochasticMap([x], [x**2 / 20 + v], Noise([v])), mean, cov)


def dense(count, reach):
    """Nodes that are some seven times as dense about 0, where the state's map is steep."""
    w = np.linspace(-reach - 1.7, reach + 1.7, count)
    return Nodes(w - 1.7 * np.tanh(w / 2), (w[1] - w[0]) * (1 - 0.85 / np.cosh(w / 2) ** 2))


def by_phase(design):
    """The filter of all steps, each with the table nearest in phase after the transient."""
    turn = np.arange(TRANSIENT, TRANSIENT + TURN)
    nearest = [int(turn[np.argmax(np.cos(1.2 * (turn - k)))]) for k in range(TRANSIENT, STEPS)]
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
    for k, measured in enumerate(y):
        x = moved(mean + np.sqrt(cov) * points[0][:, None], k) + points[1][:, None]
        seen = x**2 / 20 + points[2][:, None]
        ahead, expected = (weights * x).sum(axis=0), (weights * seen).sum(axis=0)
        spread = (centred * (seen - expected) ** 2).sum(axis=0)
        gain = (centred * (x - ahead) * (seen - expected)).sum(axis=0) / spread
        mean = ahead + gain * (measured - expected)
        cov = (centred * (x - ahead) ** 2).sum(axis=0) - gain**2 * spread
        found.append(mean)
    return np.array(found)


def minimax(states, measured, y):
    """Means of the conditionally minimax filter with four functions, fitted to other runs."""
    both, found = np.full(states.shape[1] + y.shape[1], 0.1), []
    one, fitted = np.ones_like(both), slice(states.shape[1])
    for k in range(len(y)):
        all_y = np.append(measured[k], y[k])
        ahead = np.array([one, moved(both, k)])
        both = np.linalg.lstsq(ahead[:, fitted].T, states[k], rcond=None)[0] @ ahead
        rest, size = all_y - both**2 / 20, np.sqrt(20 * np.maximum(all_y, 0))
        basic = np.array([one, rest, both * rest, np.sign(both) * size, np.tanh(both)])
        line = np.linalg.lstsq(basic[:, fitted].T, states[k] - both[fitted], rcond=None)[0]
        both = both + line @ basic
        found.append(both[states.shape[1] :])
    return np.array(found)


def main() -> None:
    warnings.simplefilter("ignore")
    times, early = np.arange(1.0, STEPS + 1), np.arange(0.0, STEPS + 1)
    truth, system = growth(float(moved(0.1, 0)), 1.0), growth(0.1, 1.0)
    data, others = truth.simulate(times, RUNS, 1), truth.simulate(times, 20_000, 2)
    y = data.measurements
    late = np.concatenate([np.full((1, 1, RUNS), np.nan), y])
    parts = np.array_split(np.arange(RUNS), 10)
    bayes, particles = GridBayesFilter(truth, dense(301, 36)), ParticleFilter(system, 1000)
    filters = {"EKF": extended_kalman(system), "CKF": CovarianceFilter(system, Cubature())}
    filters["UKF alpha .5"] = CovarianceFilter(system, Unscented(0.5, 2.0, 2.0))
    filters["UKF alpha 1"] = CovarianceFilter(system, Unscented(1.0, 0.0, 2.0))
    filters["Gauss-Hermite 10"] = CovarianceFilter(system, GaussHermite(10))
    axes = {"x": dense(161, 34), "z": (-30, 30, 241), "y": (-6, 58, 257)}
    tables = {"one table a step": grid_synthesis(truth, Memory(1), times, **axes)}
    tables["tables by phase"] = by_phase(tables["one table a step"].taking(range(200)))
    runs = {"Bayes": lambda: np.concatenate([bayes.run(times, y[..., p]).mean for p in parts], 2)}
    runs |= {name: lambda f=f: f.run(early, late).mean[1:] for name, f in filters.items()}
    for alpha, beta in ((0.5, 2), (1, 0)):
        name = f"UKF augmented alpha {alpha}".replace(" 0", " ")
        runs[name] = lambda a=alpha, b=beta: augmented(y[:, 0], a, b, 0)[:, None]
    fitted = others.states[:, 0], others.measurements[:, 0]
    runs["minimax four functions"] = lambda: minimax(*fitted, y[:, 0])[:, None]
    runs |= {name: lambda f=f: f.run(times, y).mean for name, f in tables.items()}
    runs["bootstrap 1000"] = lambda: particles.run(early, late[..., :SOME], seed=0).mean[1:]
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("row", "runs", "mse", "error", "microseconds"))
        for name, run in runs.items():
            begin = time.process_time()
            means = run()[:, 0]
            count = means.shape[1]
            spent = 1e6 * (time.process_time() - begin) / count / STEPS
            each = ((means - data.states[:, 0, :count]) ** 2).mean(axis=0)
            error = each.std() / count**0.5
            table.writerow((name, count, f"{each.mean():.5f}", f"{error:.5f}", f"{spent:.3f}"))


if __name__ == "__main__":
    main()
