"""Errors of filters of Lorenz-96, five of ten components measured, for the table of all filters.

Run by hand, ``OPENBLAS_NUM_THREADS=1 python benchmarks/field_lorenz96.py``, about 4
minutes on one core; writes ``benchmarks/field_lorenz96.csv``. The setting is that of Fig. 1 of
M. Bocquet, C. Pires, L. Wu, Mon. Weather Rev. 138 (2010) 2997-3023, as DAPPER has it. The error is
the root of the mean over the components, averaged over the times from 20 to 64 and over runs.
"""

import csv
import time
from dataclasses import replace
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np

from seedslib.design import minimax_synthesis
from seedslib.designed import Memory
from seedslib.filters import CovarianceFilter
from seedslib.linearization import PointRule, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap

STEP, SPIN, VARIANCE = 0.05, 400, 2.25
TIMES = STEP * np.arange(1281)


def flow(t, x, v=0.0):
    """The state one step of Runge and Kutta later, and noise."""

    def slope(x):
        return (np.roll(x, -1, 0) - np.roll(x, 2, 0)) * np.roll(x, 1, 0) - x + 8

    k1 = slope(x)
    k2 = slope(x + STEP / 2 * k1)
    k3 = slope(x + STEP / 2 * k2)
    return x + STEP / 6 * (k1 + 2 * (k2 + k3) + slope(x + STEP * k3)) + v


def shown(t, x, v=0.0):
    """A measurement, and noise."""
    return x[::2] + v


def fixed(matrix):
    """A matrix that does not depend on the state."""
    return lambda t, x: np.multiply.outer(matrix, np.ones(x.shape[1:]))


def lorenz96(noise=0.0, mean=0.0, variance=0.001, **options):
    """The system, by default from N(0, .001 I), with a variance of the noise of its model."""
    spread, error = noise * np.eye(10), VARIANCE * np.eye(5)
    given = (Noise(10, cov=spread),) if noise else ()
    step = flow if noise else lambda t, x, v: flow(t, x)
    move = StochasticMap.from_functions(10, 10, step, *given, mean=flow, cov=fixed(spread))
    noises = Noise(5, cov=error)
    show = StochasticMap.from_functions(10, 5, shown, noises, mean=shown, cov=fixed(error))
    return DiscreteSystem(move, show, np.full(10, mean), variance * np.eye(10), **options)


def attractor(rng, count):
    """States that have forgotten their start."""
    x = 8.0 + np.asarray(rng.standard_normal((10, count)))
    for _ in range(240):
        x = flow(0.0, x)
    return x


class Differences(PointRule):
    """The extended Kalman filter by central differences, for maps that are no formulas."""

    def rule(self, size):
        """Points, weights of means and weights of squares; the middle one is the mean."""
        points = 1e-4 * np.hstack([np.zeros((size, 1)), np.eye(size), -np.eye(size)])
        mean = np.append(1.0, np.zeros(2 * size))
        return points, mean, (1.0 - mean) * 0.5e8


def jittered(y, members, share, width):
    """Means of particles that are resampled below a share of effective ones, copies jittered."""
    rng, runs = np.random.default_rng(0), y.shape[2]
    x, found = np.sqrt(0.001) * rng.standard_normal((10, members, runs)), []
    log_weight, width = np.zeros((members, runs)), width * members ** (-1 / 14)
    for k, measured in enumerate(y):
        x = flow(0.0, x) if k else x
        log_weight = log_weight - ((measured[:, None] - x[::2]) ** 2).sum(axis=0) / 2 / VARIANCE
        weight = np.exp(log_weight - log_weight.max(axis=0))
        weight = weight / weight.sum(axis=0)
        found.append(np.einsum("inp,np->ip", x, weight))
        log_weight = np.log(np.maximum(weight, 1e-300))
        for p in np.flatnonzero((weight**2).sum(axis=0) * members * share >= 1):
            w, own = weight[:, p], x[:, :, p]
            w = w if w @ w < 1 - 1e-10 else np.full(members, 1 / members)
            apart = own - (own @ w)[:, None]
            root = np.linalg.cholesky((apart * w) @ apart.T / (1 - w @ w) + 1e-12 * np.eye(10))
            places = (rng.random() + np.arange(members)) / members
            chosen = np.searchsorted(np.cumsum(weight[:, p]), places).clip(max=members - 1)
            copies = np.bincount(chosen, minlength=members)[chosen] > 1
            noise = width * root @ rng.standard_normal((10, members))
            x[:, :, p], log_weight[:, p] = own[:, chosen] + noise * copies, 0.0
    return np.array(found)


def gain(degree, paths, near=2):
    """A minimax filter with its last step for ever, its gain a polynomial of the forecast."""

    def correction(t, x, y):
        rest, level = np.clip(y - x[::2], -6.0, 6.0), np.clip((x - 2.35) / 3.63, -2.2, 2.2)
        parts = [*rest]
        for i, one in enumerate(rest):
            local = level[(2 * i + np.arange(-near, near + 1)) % 10]
            for count in range(1, degree + 1):
                groups = combinations_with_replacement(local, count)
                parts += [one * np.prod(group, axis=0) for group in groups]
        return np.array(parts)

    settled = lorenz96(mean=2.35, variance=3.63**2, initial=attractor)
    made = minimax_synthesis(
        settled, Memory(1), TIMES[:60], paths=paths, seed=1, correction=correction
    )
    return replace(made, cycle=1)


def main() -> None:
    y = (data := lorenz96().simulate(TIMES, 60, 1)).measurements
    unscented = CovarianceFilter(lorenz96(), Unscented(1.0, 2.0, 0.0))
    extended = CovarianceFilter(lorenz96(0.01), Differences())
    runs = {("extended", "q 0.01"): (60, lambda y: extended.run(TIMES, y).mean)}
    runs["unscented", "inflation 1.0"] = 60, lambda y: unscented.run(TIMES, y).mean
    for how in ((50, 0.3, 1.7), (100, 0.2, 1.3), (800, 0.2, 0.8)):
        setting = f"share {how[1]} width {how[2]}"
        runs[f"jittered {how[0]}", setting] = 20, lambda y, how=how: jittered(y, *how)
    for degree, paths in ((0, 16384), (2, 16384), (3, 32768)):
        filter = gain(degree, paths)
        runs[f"gain {degree}", f"{paths} runs"] = 60, lambda y, f=filter: f.run(TIMES, y).mean
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("filter", "setting", "runs", "rmse", "error", "microseconds"))
        for (name, setting), (count, run) in runs.items():
            begin = time.process_time()
            means = run(y[..., :count])
            spent = 1e6 * (time.process_time() - begin) / count / len(TIMES)
            each = np.sqrt(((means - data.states[..., :count]) ** 2).mean(axis=1))
            each = each[SPIN:].mean(axis=0)
            numbers = each.mean(), each.std(ddof=1) / count**0.5, spent
            table.writerow((name, setting, count, *(f"{value:.4f}" for value in numbers)))
            file.flush()


if __name__ == "__main__":
    main()
