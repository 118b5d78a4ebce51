"""Gaussian means of a function for many laws: closed forms against a Gauss-Hermite loop.

The peer adds up the function at shifted nodes, all means at once, with the smallest number of
nodes per axis that reaches the closed form's value to 1e-10 (functions with a kink never do; they
get the largest rule tried, and the error is shown). Run by hand:

    python benchmarks/gaussian_moments.py
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy as sp

from seedslib.gaussian import expectation_function

MEANS = 10_000
WANTED = 1e-10
LARGEST = 40
FUNCTIONS = {
    "quartic form of 3 variables": "(x**2 + y**2 + z**2)**2",
    "full quartic of 3 variables": "(1 + x + 2*y + 3*z)**4",
    "x + 1.8 sin x": "x + 1.8*sin(x)",
    "y^2 cos x": "y**2*cos(x)",
    "Gaussian bump of 2 variables": "x*exp(-x**2 - y**2)",
    "maximum of 2 variables": "Max(x, y)",
    "norm of 3 variables": "sqrt(x**2 + y**2 + z**2)",
}


def best_time(call: Callable[[], object], repeats: int = 5) -> float:
    """Smallest time of several calls, seconds."""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        call()
        times.append(perf_counter() - start)
    return min(times)


def gauss_hermite_loop(f: Callable, mean: np.ndarray, cov: np.ndarray, nodes: int) -> np.ndarray:
    """Mean of f under N(mean, cov) for every column of `mean`, node by node."""
    points, weights = np.polynomial.hermite_e.hermegauss(nodes)
    weights = weights / weights.sum()
    root = np.linalg.cholesky(cov)
    total = 0.0
    for index in np.ndindex(*(nodes,) * len(mean)):
        shift = root @ points[list(index)]
        total = total + np.prod(weights[list(index)]) * f(*(mean + shift[:, None]))
    return total


def compare(name: str, text: str) -> dict[str, object]:
    """One row of the table."""
    f = sp.sympify(text)
    symbols = sorted(f.free_symbols, key=str)
    n = len(symbols)
    rng = np.random.default_rng(0)
    mean = rng.normal(size=(n, MEANS))
    root = 0.5 * rng.normal(size=(n, n))
    cov = root @ root.T
    start = perf_counter()
    function = expectation_function(f, symbols)
    built = perf_counter() - start
    numeric = sp.lambdify(symbols, f, "numpy")
    value = function(mean, cov)
    for nodes in range(1, LARGEST + 1):
        # the rule is chosen on the first means and timed on all of them
        error = np.abs(gauss_hermite_loop(numeric, mean[:, :50], cov, nodes) - value[:50]).max()
        if error < WANTED * np.abs(value).max():
            break
    closed = best_time(lambda: function(mean, cov))
    peer = best_time(lambda: gauss_hermite_loop(numeric, mean, cov, nodes), repeats=1)
    return {
        "function": name,
        "variables": n,
        "means": MEANS,
        "build_ms": round(1e3 * built, 1),
        "closed_ms": round(1e3 * closed, 3),
        "nodes_per_axis": nodes,
        "gauss_hermite_ms": round(1e3 * peer, 2),
        "gauss_hermite_error": f"{error:.1e}",
        "ratio": round(peer / closed, 1),
    }


def main() -> None:
    """Time every function, print the rows and write them beside this file."""
    rows = [compare(name, text) for name, text in FUNCTIONS.items()]
    for row in rows:
        print("  ".join(f"{key}={value}" for key, value in row.items()))
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
