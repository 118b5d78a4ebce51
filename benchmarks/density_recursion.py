"""Theorem 1 on the Van der Pol oscillator: the density recursion on grids, and two bounds by paths.

Run by hand, ``python benchmarks/density_recursion.py``; writes ``benchmarks/density_recursion.csv``
beside itself. Each row is the root-mean-square error of the first component at the measurements
of t = 0.5 to 3 with one remembered estimate (n' = 2, l = 1): `grid` by the recursion (4.4) to
(4.10), where an estimate is remembered on the nodes of a grid; `neighbours` on simulated paths,
where the optimal function is a mean over the paths with the nearest memory, weighted by the
likelihood of the measurement (an upper bound, with its standard error); `particles` the posterior
mean, which remembers everything.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import plane_steps
from seedslib.filters import ParticleFilter
from seedslib.models import PlaneChain

TIMES = 0.5 * np.arange(7)
SHOWN = [(-5, 25, 31), (-10, 10, 21)]
GRID = 61, 0.05, 81, 61
PATHS, NEIGHBOURS, SEEDS = 40_000, 400, (1, 2, 3)
NAMES = ("kind", "detail", *(f"{part}_{t:g}" for part in ("rms", "error") for t in TIMES[1:]))


def by_grid(nodes: int, substep: float, first: int, second: int) -> list[float]:
    """Errors by the recursion; steps of 9 / (nodes - 1) and 12 / (nodes - 1) of the state."""
    chain = PlaneChain(zoo.van_der_pol(), [(-4.5, 4.5, nodes), (-6, 6, nodes)], substep)
    axes = [(-4, 4, first), (-5, 3, second)]
    return [float(step.mse[0]) ** 0.5 for step in plane_steps(chain, TIMES, z=axes, y=SHOWN)][1:]


def by_neighbours(paths: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors, and their standard errors, of means over the paths with the nearest memory."""
    from scipy.spatial import cKDTree

    system = zoo.van_der_pol()
    data = system.simulate(TIMES, paths, seed)
    found, memory = [], None
    for k in range(len(TIMES)):
        x, y = data.states[k], data.measurements[k]
        near = np.empty((paths, NEIGHBOURS), dtype=int)
        if memory is None:
            near[:] = np.random.default_rng(seed).integers(0, paths, near.shape)
        else:
            tree = cKDTree((memory / memory.std(axis=1, keepdims=True)).T)
            near[:] = tree.query(tree.data, NEIGHBOURS + 1)[1][:, 1:]  # itself is the first
        apart = (y[0][:, None] - x[0][near] ** 2) ** 2 + (y[1][:, None] - x[1][near]) ** 2
        weight = np.exp(-0.5 * (apart - apart.min(axis=1, keepdims=True)))
        weight /= weight.sum(axis=1, keepdims=True)
        memory = np.stack([(weight * row[near]).sum(axis=1) for row in x])
        square = (memory[0] - x[0]) ** 2
        rms = np.sqrt(square.mean())
        found.append((rms, square.std() / np.sqrt(paths) / 2 / rms))
    rms, error = np.array(found[1:]).T
    return rms, error


def by_particles(paths: int, particles: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors, and their standard errors, of a particle filter."""
    system = zoo.van_der_pol()
    data = system.simulate(TIMES, paths, seed)
    run = ParticleFilter(system, particles).run(TIMES, data.measurements, seed=seed)
    square = (run.mean[1:, 0] - data.states[1:, 0]) ** 2
    rms = np.sqrt(square.mean(axis=1))
    return rms, square.std(axis=1) / np.sqrt(paths) / 2 / rms


def main() -> None:
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(NAMES)

        def write(kind, detail, rms, error):
            table.writerow((kind, detail, *(f"{value:.4f}" for value in (*rms, *error))))
            file.flush()

        write("grid", " ".join(map(str, GRID)), by_grid(*GRID), [0.0] * 6)
        for seed in SEEDS:
            write("neighbours", f"{PATHS} {seed}", *by_neighbours(PATHS, seed))
        write("particles", "4000 1000", *by_particles(4000, 1000, 4))


if __name__ == "__main__":
    main()
