"""Log-likelihood of a volatility model of the S&P 500 by four routes, and its maximum.

Run by hand, ``python benchmarks/spx_likelihood.py``, about 4 minutes on one core; writes
``benchmarks/spx_likelihood.csv``, ``benchmarks/spx_maximum.csv`` and ``benchmarks/spx_sides.csv``
beside itself; with the word ``sides`` it writes the last one alone, in some 15 seconds. Only the
particles are random. The model, and the parameters that the likelihood is computed at, are those
of the package pypomp (``pypomp/models/spx.py``); its equations are written anew here.

- nodes: densities of the next variance on nodes that are even in arcsinh(sqrt(V) / .003);
- cells, cells of log V: probabilities of cells of sqrt(V), of log(V), which a variance in the
  middle of each stands for; errors fall with the square of the cells' size;
- clipped: cells of log V, and what falls below the lowest one is put into it (a fault);
- particles: 20 000 particles, resampled at every step, the mean of 8 likelihoods.
"""

from __future__ import annotations

import csv
import os
import sys
import time
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp, ndtr

HERE = Path(__file__).parent
NAMES = ("mu", "kappa", "theta", "xi", "rho", "sigma0")
PUBLISHED = np.array([3.68e-4, 3.14e-2, 1.12e-4, 2.27e-3, -0.738, 7.66e-3])
TOP, SCALE, LOWEST, HIGHEST = 0.09, 0.003, 1e-9, 8e-3
REACH, BLOCKS = 8.5, 16
STEP = np.array([1.0, 0.15, 0.11, 0.05, 0.07, 0.4])
"""About one standard error of each of the free numbers."""


def returns():
    """Daily log returns; the prices were numbers of single precision, and are kept in cents."""
    prices = np.loadtxt(HERE / "data" / "spx.csv", delimiter=",", skiprows=1, usecols=1)
    return np.diff(np.log(prices.astype(np.float32).astype(float)))


def moved(V, values):
    """Mean, but for the return of the day before, and deviation of the next variance."""
    mu, kappa, theta, xi, rho, _ = values
    mean = V + kappa * (theta - V) + xi * rho * (0.5 * V - mu)
    return mean, xi * np.sqrt((1 - rho**2) * V), xi * rho


def pushed(low, high):
    """Rows that each block of columns reaches: slices, and where they begin and end."""
    parts = np.unique(np.linspace(0, len(low), BLOCKS + 1).astype(int))
    return [(slice(a, b), low[a:b].min(), high[a:b].max()) for a, b in pairwise(parts)]


def filtered(y, values, V, first, forward):
    """Sum of the logarithms of the factors, and the probability lost at each step."""
    mu, scale, level = values[0], -0.5 / V, -0.5 * np.log(2 * np.pi * V)
    total, lost, dist, before = 0.0, [], None, 0.0
    slope = values[3] * values[4]
    for shown in y:
        dist = first if dist is None else forward(dist, slope * before)
        lost.append(1.0 - dist.sum())
        dist = dist * np.exp(level + scale * (shown - mu + 0.5 * V) ** 2)
        factor = dist.sum()
        total, dist, before = total + np.log(factor), dist / factor, shown
    return total, np.array(lost)


def by_nodes(y, values, count):
    """Quadrature: the density of the next variance at nodes."""
    u = (np.arange(count) + 0.5) * np.arcsinh(TOP / SCALE) / count
    root = SCALE * np.sinh(u)
    V, weights = root**2, 2 * root * SCALE * np.cosh(u) * (u[1] - u[0])
    mean, spread, _ = moved(V, values)
    blocks = pushed(mean - REACH * spread, mean + REACH * spread)
    known = values[5] ** 2
    start, width, _ = moved(known, values)
    first = weights * np.exp(-0.5 * ((V - start) / width) ** 2) / (width * np.sqrt(2 * np.pi))

    def forward(dist, shift):
        part, found = dist / (spread * np.sqrt(2 * np.pi)), np.zeros(count)
        for own, low, high in blocks:
            i, j = np.searchsorted(V, (low + shift, high + shift))
            z = (V[i:j, None] - (mean[own] + shift)) / spread[own]
            found[i:j] += np.exp(-0.5 * z**2) @ part[own]
        return found * weights

    return filtered(y, values, V, first, forward)


def by_cells(y, values, edges, clip=False):
    """Probabilities of cells; the state in a cell is the one in its middle."""
    middle = 0.5 * (edges[1:] + edges[:-1])
    mean, spread, _ = moved(middle, values)
    blocks = pushed(mean - REACH * spread, mean + REACH * spread)
    start, width, _ = moved(values[5] ** 2, values)
    first = np.diff(ndtr((edges - start) / width))
    first[0] += clip * ndtr((edges[0] - start) / width)

    def forward(dist, shift):
        found = np.zeros(len(middle))
        for own, low, high in blocks:
            i, j = np.searchsorted(edges, (low + shift, high + shift))
            i, j = max(i - 1, 0), min(j + 1, len(edges))
            if j - i > 1:
                below = ndtr((edges[i:j, None] - (mean[own] + shift)) / spread[own]) @ dist[own]
                found[i : j - 1] += np.diff(below)
        if clip:
            found[0] += ndtr((edges[0] - mean - shift) / spread) @ dist
        return found

    return filtered(y, values, middle, first, forward)


def root_cells(y, values, count):
    """Cells of one size in the root of the variance, from zero."""
    return by_cells(y, values, np.linspace(0.0, TOP, count + 1) ** 2)


def log_cells(y, values, count, clip=False):
    """Cells of one size in the logarithm of the variance."""
    return by_cells(y, values, np.geomspace(LOWEST, HIGHEST, count + 1), clip)


def by_particles(y, values, count, seed):
    """Bootstrap filter with systematic resampling; one replicate."""
    rng = np.random.default_rng(seed)
    V, before, total = np.full(count, values[5] ** 2), 0.0, 0.0
    for shown in y:
        mean, spread, slope = moved(V, values)
        V = np.maximum(mean + slope * before + spread * rng.standard_normal(count), 1e-32)
        score = -0.5 * (np.log(2 * np.pi * V) + (shown - values[0] + 0.5 * V) ** 2 / V)
        top = score.max()
        weight = np.exp(score - top)
        total += top + np.log(weight.mean())
        places = (np.arange(count) + rng.random()) * (weight.sum() / count)
        V = V[np.minimum(np.searchsorted(np.cumsum(weight), places), count - 1)]
        before = shown
    return total


def free(values):
    """The parameters as six numbers without bounds."""
    mu, kappa, theta, xi, rho, sigma0 = values
    return np.array([1e4 * mu, *np.log([kappa, theta, xi]), np.arctanh(rho), np.log(sigma0)])


def bound(u):
    """The parameters of six free numbers, and the derivatives of each."""
    kappa, theta, xi, sigma0 = np.exp(u[[1, 2, 3, 5]])
    values = np.array([1e-4 * u[0], kappa, theta, xi, np.tanh(u[4]), sigma0])
    return values, np.array([1e-4, kappa, theta, xi, 1 - values[4] ** 2, sigma0])


def curvature(function, u):
    """Value, gradient and second derivatives by central differences of `STEP`."""
    p, middle = len(u), function(u)
    up, down, bend = np.zeros(p), np.zeros(p), np.zeros((p, p))
    for i, d in enumerate(np.diag(STEP)):
        up[i], down[i] = function(u + d), function(u - d)
        bend[i, i] = up[i] - 2 * middle + down[i]
    for i, d in enumerate(np.diag(STEP)):
        for j, e in enumerate(np.diag(STEP)[:i]):
            both = function(u + d + e) + function(u - d - e)
            around = up[i] + down[i] + up[j] + down[j]
            bend[i, j] = bend[j, i] = 0.5 * (both - around + 2 * middle)
    return middle, (up - down) / (2 * STEP), bend / np.outer(STEP, STEP)


def maximum(y):
    """The six values with the largest likelihood, their standard errors, the likelihood."""

    def coarse(u):
        return -root_cells(y, bound(u)[0], 100)[0]

    def loss(u, count):
        return -by_nodes(y, bound(u)[0], count)[0]

    u = minimize(coarse, free(PUBLISHED), method="BFGS", options={"gtol": 1e-2, "eps": 1e-4}).x
    bend = curvature(lambda u: loss(u, 200), u)[2]
    for _ in range(4):  # Newton's steps on finer nodes, with the curvature of the coarser ones
        slope = np.array([loss(u + e, 400) - loss(u - e, 400) for e in 0.1 * np.diag(STEP)])
        step = np.linalg.solve(bend, slope / (0.2 * STEP))
        u = u - step
        print(f"{-loss(u, 400):.6f} on 400 nodes, about {0.05 * step @ (slope / STEP):.1g} before")
    values, turn = bound(u)
    return values, turn * np.sqrt(np.diagonal(np.linalg.inv(bend)))


def extrapolated(y, values):
    """The limit of the cells of the root, from two sizes."""
    coarse, fine = (root_cells(y, values, n)[0] for n in (400, 800))
    return fine + (fine - coarse) / 3


def likelihoods(y) -> None:
    """Write the table of routes."""
    routes = {
        "nodes": (by_nodes, (100, 200, 400, 800, 1600)),
        "cells": (root_cells, (100, 200, 400, 800)),
        "cells of log V": (log_cells, (200, 400, 800)),
        "clipped": (lambda *given: log_cells(*given, clip=True), (200, 400)),
    }
    with (HERE / "spx_likelihood.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("route", "size", "loglik", "error", "lost_most", "lost_total", "seconds"))
        for name, (function, sizes) in routes.items():
            for size in sizes:
                begin = time.process_time()
                found, lost = function(y, PUBLISHED, size)
                row = f"{found:.6f}", "", f"{lost.max():.6f}", f"{lost.sum():.4f}"
                table.writerow((name, size, *row, f"{time.process_time() - begin:.1f}"))
                file.flush()
        begin = time.process_time()
        each = np.array([by_particles(y, PUBLISHED, 20_000, seed) for seed in range(8)])
        found = logsumexp(each) - np.log(len(each))
        # of the mean of the likelihoods, relative
        error = np.std(np.exp(each - found), ddof=1) / np.sqrt(len(each))
        seconds = f"{time.process_time() - begin:.1f}"
        table.writerow(("particles", 20_000, f"{found:.3f}", f"{error:.3f}", "", "", seconds))


def best(y) -> None:
    """Write the maximum."""
    values, errors = maximum(y)
    with (HERE / "spx_maximum.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("parameter", "value", "error"))
        for name, value, error in zip(NAMES, values, errors, strict=True):
            table.writerow((name, f"{value:.8g}", f"{error:.4g}"))
        table.writerow(("loglik", f"{extrapolated(y, values):.6f}", ""))


def sides(y) -> None:
    """Write what is lost one standard error to either side, about the maximum and the published."""
    with (HERE / "spx_maximum.csv").open(newline="") as file:
        found = {row["parameter"]: row for row in csv.DictReader(file)}
    top, errors = (np.array([float(found[n][key]) for n in NAMES]) for key in ("value", "error"))
    with (HERE / "spx_sides.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("about", "parameter", "below", "above"))
        for about, values in (("best", top), ("published", PUBLISHED)):
            middle = root_cells(y, values, 100)[0]
            for name, move in zip(NAMES, np.diag(errors), strict=True):
                lost = [middle - root_cells(y, values + sign * move, 100)[0] for sign in (-1, 1)]
                table.writerow((about, name, *(f"{loss:.6f}" for loss in lost)))


def main() -> None:
    if sys.argv[1:] == ["sides"]:
        sides(returns())
        return
    likelihoods(returns())
    best(returns())
    sides(returns())


if __name__ == "__main__":
    main()
