"""Filters of the stochastic Van der Pol oscillator of the projection-filter paper, and its
distribution.

Run by hand, ``python benchmarks/field_projection.py``, some minutes on one core; writes
``benchmarks/field_projection.csv`` beside itself. The model is that of the example of M. Emzir,
Z. Sawlan, S. El Ferik, arXiv 2504.17324; all equations are written anew here, and no number of
theirs is used.

- least: the distribution on nodes of the plane, moved by the Kolmogorov equation, and its mean;
- unseen: the distribution that no measurement has changed; moments: the normal distribution with
the exact ones;
- Kalman filters, particles, designed filters of the library, each with its normal distribution;
- projection: a filter on an exponential family, ours: powers up to the fourth, sin and sin² of
  both components, moved by the projected equation, on nodes of a box; records of which it
  loses the distribution are left out of its row, whose `runs` says how many are left.
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

from seedslib.design import Affine, Polynomial, simulated_synthesis, synthesize
from seedslib.designed import FiniteOrderFilter, Memory
from seedslib.filters import (
    CovarianceFilter,
    ParticleFilter,
    assumed_density,
    extended_kalman,
    unscented_kalman,
)
from seedslib.linearization import ExactGaussian, GaussHermite
from seedslib.models import JumpDiffusion, Noise, PlaneChain

HERE = Path(__file__).parent
TIMES = 0.25 * np.arange(5)
RECORDS, BLOCK = {2.0: 1000, 1.0: 1000, 0.5: 250}, 250
STEPS = {2.0: 0.025, 1.0: 0.025, 0.5: 0.005}
"""Of the projection filter: its equation is stiff where measurements tell much."""
AXES = [(-6.5, 6.5, 131), (-8.0, 8.0, 129)]
PEAK = np.array([1.0, -1.0])
X1, X2, V1, V2 = sympy.symbols("x1 x2 v1 v2", real=True)
PUSH = sympy.Rational(1, 2)


def mixture(rng, count):
    """States at time 0: half about (1, -1), half about (-1, 1), unit variances."""
    side = np.where(rng.random(count) < 0.5, 1.0, -1.0)
    return side * PEAK[:, None] + rng.standard_normal((2, count))


def oscillator(noise):
    """The system, its sensor's noise of so large a deviation."""
    return JumpDiffusion(
        (X1, X2),
        [X2, PUSH * (1 - X1**2) * X2 - X1],
        [[0], [1]],
        [sympy.sin(X1) + V1, sympy.sin(X2) + V2],
        Noise((V1, V2), cov=noise**2 * np.eye(2)),
        [0.0, 0.0],
        np.eye(2) + np.outer(PEAK, PEAK),
        initial=mixture,
    )


def first_dist(values):
    """The mixture on nodes (2, S)."""
    parts = [np.exp(-0.5 * ((values - s * PEAK[:, None]) ** 2).sum(axis=0)) for s in (-1, 1)]
    return sum(parts) / sum(parts).sum()


def exact_dists(chain, y, start=None):
    """Distributions after each measurement y (K, 2, N): (K, S, N); those before any with y None."""
    dist = first_dist(chain.values)[:, None] if start is None else start
    found = []
    for k in range(1, len(TIMES)):
        dist = chain.move(dist, TIMES[k - 1], TIMES[k])
        if y is not None:
            seen = chain.log_likelihood(float(TIMES[k]), y[k - 1]).T
            dist = dist * np.exp(seen - seen.max(axis=0))
        dist = dist / dist.sum(axis=0)
        found.append(dist)
    return np.array(found)


def moments(values, dists):
    """Means (K, 2, N) and covariances (K, 2, 2, N) of distributions (K, S, N) on nodes (2, S)."""
    mean = np.einsum("is,ksn->kin", values, dists)
    second = np.einsum("ps,ksn->kpn", values[[0, 0, 1]] * values[[0, 1, 1]], dists)
    second = second[:, [[0, 1], [1, 2]]]
    return mean, second - mean[:, :, None] * mean[:, None]


def normal_dists(values, mean, cov):
    """Normal distributions on nodes: mean (K, 2, N), cov (K, 2, 2, N) or (K, 2, 2) give (K, S,
    N)."""
    cov = cov if cov.ndim == 4 else cov[..., None]
    a, b, c = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    u, v = (values[:, None, :, None] - np.swapaxes(mean, 0, 1)[:, :, None]) * 1.0
    form = c[:, None] * u**2 - 2 * b[:, None] * u * v + a[:, None] * v**2
    dist = np.exp(-0.5 * form / (a * c - b**2)[:, None])
    return dist / dist.sum(axis=1, keepdims=True)


def hellinger(p, q):
    """Distances (K, N) of distributions (K, S, N), between 0 and 1."""
    return np.sqrt(np.maximum(1 - np.sqrt(p * q).sum(axis=1), 0))


class Projection:
    """Filter on the family exp(theta c(x)) on nodes of a box, by projection of the generator.

    Between measurements theta' = cov(c)^-1 E L c, by the method of Runge and Kutta; a measurement
    adds to the coefficients of sin and sin², without error: the family is closed under it.
    """

    def __init__(self, noise, axes=((-6.5, 6.5, 53), (-8.0, 8.0, 53)), step=0.025):
        self.noise, self.step = noise, step
        a, b = sympy.symbols("a b", real=True)
        powers = [a**i * b**j for n in range(1, 5) for i in range(n, -1, -1) for j in [n - i]]
        known = [*powers, sympy.sin(a), sympy.sin(b), sympy.sin(a) ** 2, sympy.sin(b) ** 2]
        moved = [
            b * sympy.diff(c, a)
            + (PUSH * (1 - a**2) * b - a) * sympy.diff(c, b)
            + sympy.diff(c, b, 2) / 2
            for c in known
        ]
        grid = np.meshgrid(*(np.linspace(*axis) for axis in axes), indexing="ij")
        self.values = np.stack([part.ravel() for part in grid])
        first, second = (
            np.stack(
                np.broadcast_arrays(*sympy.lambdify((a, b), part)(*self.values), self.values[0])
            )
            for part in (known, moved)
        )
        self.scale = np.abs(first[:-1]).max(axis=1)[:, None]
        self.known, self.moved = first[:-1] / self.scale, second[:-1] / self.scale
        count = len(self.known)
        self.pairs = np.triu_indices(count)
        products = self.known[self.pairs[0]] * self.known[self.pairs[1]]
        self.table = np.concatenate([self.known, self.moved, products])

    def dist(self, theta):
        """Distributions on the nodes, (S, N), of parameters (P, N)."""
        log = self.known.T @ theta
        dist = np.exp(log - log.max(axis=0))
        return dist / dist.sum(axis=0)

    def _means(self, theta):
        found = self.table @ self.dist(theta)
        count = len(self.known)
        mean, moved = found[:count], found[count : 2 * count]
        fisher = np.empty((count, count, theta.shape[1]))
        fisher[self.pairs] = found[2 * count :]
        fisher[self.pairs[::-1]] = found[2 * count :]
        fisher -= mean[:, None] * mean[None]
        return mean, moved, np.moveaxis(fisher, 2, 0)

    def _slope(self, theta):
        _, moved, fisher = self._means(theta)
        scale = np.sqrt(np.maximum(np.einsum("nii->ni", fisher), 1e-300))
        alike = fisher / (scale[:, :, None] * scale[:, None, :])
        # a record whose coefficients run away is given up: it is NaN from there on
        lost = ~(np.isfinite(alike).all(axis=(1, 2)) & np.isfinite(theta).all(axis=0))
        alike[lost] = np.eye(len(theta))
        lost |= ~np.isfinite(np.linalg.slogdet(alike)[1])
        alike[lost] = np.eye(len(theta))
        slope = np.linalg.solve(alike, (moved.T / scale)[..., None])[..., 0] / scale
        return np.where(lost, np.nan, slope.T)

    def start(self):
        """Parameters with the moments of the mixture, by Newton's method."""
        target = self.known @ first_dist(self.values)
        theta = np.zeros((len(self.known), 1))
        theta[[2, 4]] = -0.25 * self.scale[[2, 4]]
        for _ in range(500):
            mean, _, fisher = self._means(theta)
            change = np.linalg.solve(fisher[0], target - mean[:, 0])[:, None]
            if np.abs(target - mean[:, 0]).max() < 1e-12:
                return theta
            # a full step may put the distribution into a corner of the box: halved until the convex
            # function whose minimum is sought falls
            part, now = 1.0, self._height(theta, target)
            while self._height(theta + part * change, target) > now + 1e-15 and part > 1e-9:
                part /= 2
            theta = theta + part * change
        raise RuntimeError("no parameters with these moments were found")

    def _height(self, theta, target):
        """Logarithm of the integral of exp(theta c), less theta times the wanted moments."""
        log = (self.known.T @ theta)[:, 0]
        return np.log(np.exp(log - log.max()).sum()) + log.max() - target @ theta[:, 0]

    def move(self, theta, length):
        """Parameters after a time."""
        count = round(length / self.step)
        h = length / count
        for _ in range(count):
            one = self._slope(theta)
            two = self._slope(theta + h / 2 * one)
            three = self._slope(theta + h / 2 * two)
            four = self._slope(theta + h * three)
            theta = theta + h / 6 * (one + 2 * two + 2 * three + four)
        return theta

    def see(self, theta, y):
        """Parameters after a measurement (2, N): added, no more."""
        theta = np.array(np.broadcast_to(theta, (len(theta), y.shape[1])))
        theta[-4:-2] += y / self.noise**2 * self.scale[-4:-2]
        theta[-2:] -= 0.5 / self.noise**2 * self.scale[-2:]
        return theta

    def run(self, y):
        """Parameters (K, P, N) after measurements (K, 2, N)."""
        theta, found = self.start(), []
        for k, shown in enumerate(y):
            theta = self.see(self.move(theta, TIMES[k + 1] - TIMES[k]), shown)
            found.append(theta)
        return np.array(found)


def kalman_filters(system):
    """Filters that need no design, by name."""
    return {
        "extended Kalman": extended_kalman(system),
        "unscented, alpha 1, beta 0, kappa 0": unscented_kalman(system),
        "Gauss-Hermite 5": CovarianceFilter(system, GaussHermite(5)),
        "assumed density": assumed_density(system),
    }


def seen_first(noise):
    """The oscillator from its first measurement on, which is what a design begins with."""
    chain = PlaneChain(oscillator(noise), AXES, 0.05)
    mean, cov = moments(chain.values, exact_dists(chain, None)[:1])

    def at_first(rng, count):
        x, h = mixture(rng, count), TIMES[1] / 25
        for _ in range(25):
            force = 0.5 * (1 - x[0] ** 2) * x[1] - x[0]
            x = x + h * np.stack([x[1], force])
            x[1] += np.sqrt(h) * rng.standard_normal(count)
        return x

    system = oscillator(noise)
    return JumpDiffusion(
        system.state,
        system.drift_expressions,
        system.diffusion_expressions,
        [sympy.sin(X1) + V1, sympy.sin(X2) + V2],
        Noise((V1, V2), cov=noise**2 * np.eye(2)),
        mean[0, :, 0],
        cov[0, :, :, 0],
        initial=at_first,
    )


def designed_filters(noise, paths=100_000):
    """Designed filters by name, each with the seconds of its design."""
    found, system = {}, seen_first(noise)
    lines = {f"finite memory {l}": (Memory(measurements=l), Affine()) for l in (1, 2, 3)}
    lines |= {f"large order {l}": (Memory(l), Affine()) for l in (1, 2)}
    lines["large order 1, cubic forecast"] = Memory(1), Polynomial(3, 2)
    for name, (memory, predictor) in lines.items():
        begin = time.process_time()
        filter = synthesize(
            system, memory, ExactGaussian(), TIMES[1:], paths=paths, seed=5, predictor=predictor
        )
        found[name] = filter, time.process_time() - begin
    reach = 1 + 2.5 * noise
    begin = time.process_time()
    filter = simulated_synthesis(
        system,
        Memory(1),
        TIMES[1:],
        paths=paths // 5,
        seed=5,
        nodes=0,
        z=[(-2.4, 2.4, 17), (-2.4, 2.4, 17)],
        y=[(-reach, reach, 17), (-reach, reach, 17)],
    )
    found["table of order 1"] = filter, time.process_time() - begin
    return found


def own_covariance(filter, y):
    """Predicted covariances of a designed filter, (K, 2, 2) or (K, 2, 2, N)."""
    if isinstance(filter, FiniteOrderFilter):
        return filter.run(TIMES[1:], y, covariances=True).cov
    return filter.covariances


def simulated(noise, runs, seed):
    """States and measurements at the four times, and the record with nothing at time 0."""
    data = oscillator(noise).simulate(TIMES, runs, seed)
    y = data.measurements.copy()
    y[0] = np.nan
    return data.states[1:], y


def main() -> None:
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    with (HERE / "field_projection.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        names = "noise", "row", "runs", "mse", "error", "far", "far_error", "hellinger"
        table.writerow((*names, "hellinger_error", "last", "microseconds", "design_seconds"))
        for noise in RECORDS:
            for row in rows_of(noise):
                table.writerow(row)
                file.flush()
                print(*row, flush=True)


def rows_of(noise):
    """Rows of the table for a deviation of the sensor's noise, as they are found."""
    system, records = oscillator(noise), RECORDS[noise]
    states, y = simulated(noise, records, 1)
    chain = PlaneChain(system, AXES, 0.05)
    begin = time.process_time()
    dists = [exact_dists(chain, y[1:, :, a : a + BLOCK]) for a in range(0, records, BLOCK)]
    spent = time.process_time() - begin
    each = [moments(chain.values, part) for part in dists]
    best, spread = (np.concatenate(parts, axis=-1) for parts in zip(*each, strict=True))

    def distance(mean, cov):
        """Of normal distributions to the exact ones, block by block."""
        found = []
        for i, dist in enumerate(dists):
            part = slice(i * BLOCK, i * BLOCK + BLOCK)
            given = cov[..., part] if cov.ndim == 4 else cov
            found.append(hellinger(dist, normal_dists(chain.values, mean[..., part], given)))
        return np.concatenate(found, axis=1)

    def told(name, mean, far_dists, spent, design=None):
        kept = np.isfinite(mean).all(axis=(0, 1))
        runs = int(kept.sum())
        square = ((mean - states) ** 2).sum(axis=1).mean(axis=0)[kept]
        far = ((mean - best) ** 2).sum(axis=1).mean(axis=0)[kept]
        values = [v for part in (square, far) for v in (part.mean(), part.std() / runs**0.5)]
        dist = ["", "", ""]
        if far_dists is not None:
            whole = far_dists.mean(axis=0)[kept]
            parts = whole.mean(), whole.std() / runs**0.5, far_dists[-1, kept].mean()
            dist = [f"{v:.5f}" for v in parts]
        cost = "" if spent is None else f"{1e6 * spent / records / 4:.3f}"
        cost = cost, "" if design is None else f"{design:.2f}"
        return noise, name, runs, *(f"{v:.6f}" for v in values), *dist, *cost

    yield told("least", best, np.zeros((4, records)), spent)
    yield told("moments", best, distance(best, spread), None)
    unseen = exact_dists(chain, None)
    mean = np.broadcast_to(moments(chain.values, unseen)[0], best.shape)
    yield told("unseen", mean, np.concatenate([hellinger(p, unseen) for p in dists], axis=1), None)
    for name, filter in kalman_filters(system).items():
        filter.run(TIMES, y[..., :5])
        begin = time.process_time()
        run = filter.run(TIMES, y)
        spent = time.process_time() - begin
        cov = run.cov[1:]
        yield told(name, run.mean[1:], distance(run.mean[1:], cov), spent)
    for name, (filter, design) in designed_filters(noise).items():
        begin = time.process_time()
        run = filter.run(TIMES[1:], y[1:])
        spent = time.process_time() - begin
        yield told(name, run.mean, distance(run.mean, own_covariance(filter, y[1:])), spent, design)
    for count in (1000, 10_000):
        begin, parts = time.process_time(), []
        for a in range(0, records, 50):
            run = ParticleFilter(system, count).run(TIMES, y[..., a : a + 50], seed=a)
            parts.append(run.mean[1:])
        spent = time.process_time() - begin
        yield told(f"{count} particles", np.concatenate(parts, axis=2), None, spent)
    begin = time.process_time()
    filter = Projection(noise, step=STEPS[noise])
    design = time.process_time() - begin
    begin = time.process_time()
    theta = np.concatenate(
        [filter.run(y[1:, :, a : a + BLOCK]) for a in range(0, records, BLOCK)], axis=2
    )
    spent = time.process_time() - begin
    found = np.array([filter.values @ filter.dist(part) for part in theta])
    fine = Projection(noise, AXES)
    far = []
    for i, dist in enumerate(dists):
        part = theta[..., i * BLOCK : i * BLOCK + BLOCK] * (fine.scale / filter.scale)
        far.append(hellinger(dist, np.array([fine.dist(p) for p in part])))
    yield told("projection", found, np.concatenate(far, axis=1), spent, design)


if __name__ == "__main__":
    main()
