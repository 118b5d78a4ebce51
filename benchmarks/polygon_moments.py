"""Gaussian moments over regions against SciPy: hexagon, rectangle and interval.

Run by hand, ``python benchmarks/polygon_moments.py``; writes ``benchmarks/polygon_moments.csv``
beside itself. Hexagon: ten thousand pairs of mean and covariance, all six moments (mass, two
means, three second moments) of each, against six calls of `scipy.integrate.dblquad` at a
tolerance of 1e-10. Rectangle: all six moments against the mass alone by
`scipy.stats.multivariate_normal.cdf`. Interval: mass, mean and variance against
`scipy.stats.truncnorm`, vectorised as well. One process, one thread; the peers run on a few of
the same items, and the ratio of each row is the peer's time over its own in this run.
"""

from __future__ import annotations

import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.integrate import dblquad
from scipy.stats import multivariate_normal, truncnorm

from seedslib.gaussian import interval, polygon

PAIRS = 10_000
ANGLES = np.arange(6) * np.pi / 3.0
HEXAGON = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
BOX = np.array([[-1.0, -0.5], [1.0, -0.5], [1.0, 0.5], [-1.0, 0.5]])
POWERS = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]


def dists(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Means around the hexagon, deviations 0.5 to 2, any correlation up to 0.9."""
    rng = np.random.default_rng(seed)
    s = rng.uniform(0.5, 2.0, size=(2, count))
    rho = rng.uniform(-0.9, 0.9, size=count)
    cov = np.array([[s[0] ** 2, rho * s[0] * s[1]], [rho * s[0] * s[1], s[1] ** 2]])
    return rng.normal(size=(2, count)), cov


def by_dblquad(mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """The six moments over the hexagon, one call each."""
    precision = np.linalg.inv(cov)
    factor = np.sqrt(np.linalg.det(precision)) / (2.0 * np.pi)
    (a, b), (_, c) = precision

    def upper(x: float) -> float:
        return min(np.sqrt(0.75), np.sqrt(3.0) * (1.0 - abs(x)))

    def integrand(y: float, x: float, i: int, j: int) -> float:
        u, v = x - mean[0], y - mean[1]
        form = a * u * u + 2.0 * b * u * v + c * v * v
        return factor * x**i * y**j * np.exp(-0.5 * form)

    options = {"epsabs": 1e-10, "epsrel": 1e-10}
    return np.array(
        [
            dblquad(integrand, -1.0, 1.0, lambda x: -upper(x), upper, args=power, **options)[0]
            for power in POWERS
        ]
    )


def seconds(work, items: int, repeats: int = 5) -> float:
    """Best time per item."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times) / items


def hexagon() -> list[tuple[str, str, float, float]]:
    mean, cov = dists(PAIRS)
    few = 5
    peer = seconds(lambda: [by_dblquad(mean[:, k], cov[:, :, k]) for k in range(few)], few, 3)
    own = seconds(lambda: polygon(mean, cov, HEXAGON), PAIRS)
    return [("hexagon", "polygon", own, peer / own), ("hexagon", "six calls of dblquad", peer, 1.0)]


def rectangle() -> list[tuple[str, str, float, float]]:
    mean, cov = dists(PAIRS)
    few = 200

    def scipy_way() -> None:
        for k in range(few):
            multivariate_normal.cdf(BOX[2], mean[:, k], cov[:, :, k], lower_limit=BOX[0])

    peer = seconds(scipy_way, few)
    own = seconds(lambda: polygon(mean, cov, BOX), PAIRS)
    return [
        ("rectangle", "polygon", own, peer / own),
        ("rectangle", "multivariate_normal.cdf (mass only)", peer, 1.0),
    ]


def line() -> list[tuple[str, str, float, float]]:
    lower = np.random.default_rng(1).normal(size=PAIRS) * 2.0
    upper = lower + 1.0

    def scipy_way() -> None:
        dist = truncnorm(lower[:1000], upper[:1000])
        dist.mean(), dist.var()

    peer = seconds(scipy_way, 1000, 3)
    own = seconds(lambda: interval(0.0, 1.0, lower, upper), PAIRS)
    return [
        ("interval", "interval", own, peer / own),
        ("interval", "truncnorm (mean and variance)", peer, 1.0),
    ]


def main() -> None:
    rows = [*hexagon(), *rectangle(), *line()]
    with Path(__file__).with_suffix(".csv").open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["region", "route", "microseconds", "times_faster"])
        for region, route, own, ratio in rows:
            writer.writerow([region, route, f"{own * 1e6:.3g}", f"{ratio:.3g}"])
            print(f"{region:10s} {route:38s} {own * 1e6:10.2f} us {ratio:9.0f} x")


if __name__ == "__main__":
    main()
