"""Filters of switching systems with Gaussian functions, designed on simulated paths.

Plain NumPy from [R-SW theorem 3, section 7], one nested loop over the two modes, means of functions
by quadrature, random numbers of its own; nothing of the library. What is known of a path is a
triple (prob, mean, cov) of shapes (2, paths), (2, n, paths) and (2, n, n, paths).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import product

import numpy as np

CLIP = 8.0  # of remembered log-odds


@dataclass(frozen=True)
class Scalar:
    """The scalar system whose state moves its modes."""

    sensor: str
    size, degree = 1, 16
    start = np.array([0.5, 0.5]), np.eye(1)
    tells = None

    def chance(self, i, x):
        return (0.35 - 0.3 * np.exp(-(x[0] ** 2) / 8), 0.9 - 0.5 * np.exp(-(x[0] ** 2) / 2))[i]

    def moved(self, i, x):
        return x + 1.8 * np.sin(x) if i == 0 else 0.6 * x

    def noise(self, i):
        return np.array([[0.25]])

    def shown(self, i, x):
        return x[0] / 2 + x[0] ** 2 / 5 if self.sensor == "A2" else x[0] + 2 * i

    def error(self, i):
        return {"A1H": 2.0, "A1L": 0.5, "A2": 1.0}[self.sensor]


@dataclass(frozen=True)
class Target:
    """The manoeuvring target; an indicator that tells nothing is none."""

    indicator: str
    size, degree = 2, 2
    start = np.array([0.8, 0.2]), np.diag([4.0, 1.0])

    @cached_property
    def tells(self):
        tables = {"noisy": [[0.9, 0.1], [0.2, 0.8]], "exact": [[1.0, 0.0], [0.0, 1.0]]}
        return np.array(tables[self.indicator]) if self.indicator in tables else None

    def chance(self, i, x):
        return np.full(x.shape[1:], (0.05, 0.85)[i])

    def moved(self, i, x):
        return np.stack([x[0] + x[1] + 0.5 * i, (0.98, 0.9)[i] * x[1] + i])

    def noise(self, i):
        return (0.01, 0.25)[i] * np.array([[0.25, 0.5], [0.5, 1.0]])

    def shown(self, i, x):
        return x[0]

    def error(self, i):
        return (1.0, 3.0)[i]


def simulated(system, steps, paths, seed):
    """Modes and measurements and indicators (steps, paths), states (steps, n, paths)."""
    rng = np.random.default_rng(seed)
    mode = (rng.random(paths) < system.start[0][1]).astype(int)
    x = np.sqrt(system.start[1]) @ rng.standard_normal((system.size, paths))
    found = []
    for _ in range(steps):
        w = rng.standard_normal(paths)
        y = np.choose(mode, [system.shown(i, x) + system.error(i) * w for i in (0, 1)])
        told = np.zeros(paths, int)
        if system.tells is not None:
            told = (rng.random(paths) < system.tells[mode, 1]).astype(int)
        found.append((mode, x, y, told))
        v, draw = rng.standard_normal(paths), rng.random(paths)
        # all noises are of rank one
        ahead = [
            system.moved(i, x) + np.sqrt(np.diag(system.noise(i)))[:, None] * v for i in (0, 1)
        ]
        next_mode = (draw < np.choose(mode, [system.chance(i, x) for i in (0, 1)])).astype(int)
        x, mode = np.where(mode == 0, ahead[0], ahead[1]), next_mode
    return [np.array(part) for part in zip(*found, strict=True)]


@cache
def rule(size, degree):
    """Nodes (size, nodes) of a standard normal distribution and their weights."""
    points, weights = np.polynomial.hermite_e.hermegauss(degree)
    grid = np.array(list(product(points, repeat=size))).T
    weights = np.array([np.prod(w) for w in product(weights, repeat=size)])
    return grid[:, :, None], weights / weights.sum()


def nodes(system, mean, cov):
    """Quadrature of one normal distribution a path: (n, nodes, paths) and weights."""
    grid, weights = rule(system.size, system.degree)
    first = np.sqrt(cov[0, 0])
    x = [mean[0] + first * grid[0]]
    if system.size == 2:
        slope = cov[0, 1] / first
        x.append(mean[1] + slope * grid[0] + np.sqrt(cov[1, 1] - slope**2) * grid[1])
    return np.array(x), weights


def forecast(system, dist):
    """Lemma 6: chance, mean and covariance in each next mode."""
    parts = []
    for i in (0, 1):
        prob, mean, cov = (part[i] for part in dist)
        x, weights = nodes(system, mean, cov)
        into, ahead = system.chance(i, x), system.moved(i, x)
        share = weights[:, None] * np.stack([1 - into, into])
        mass = share.sum(axis=1)
        weighted = share[:, None] * ahead
        first = weighted.sum(axis=2)
        second = (weighted[:, :, None] * ahead).sum(axis=3)
        second += system.noise(i)[:, :, None] * mass[:, None, None]
        parts.append([prob * part for part in (mass, first, second)])
    mass, first, second = (a + b for a, b in zip(*parts, strict=True))
    mean = first / mass[:, None]
    return mass, mean, second / mass[:, None, None] - mean[:, :, None] * mean[:, None]


def corrected(system, dist, y, told):
    """Lemmas 1 and 3."""
    logs, means, covs = [], [], []
    for i in (0, 1):
        prob, mean, cov = (part[i] for part in dist)
        x, weights = nodes(system, mean, cov)
        b = system.shown(i, x)
        expected = weights @ b
        spread = weights @ (b - expected) ** 2 + system.error(i) ** 2
        cross = ((x - mean[:, None]) * (weights[:, None] * (b - expected))).sum(axis=1)
        away = y - expected
        with np.errstate(divide="ignore"):
            log = np.log(prob) - 0.5 * (away**2 / spread + np.log(spread))
            if system.tells is not None:
                log += np.log(system.tells[i, told])
        logs.append(log)
        means.append(mean + cross * away / spread)
        covs.append(cov - cross[:, None] * cross / spread)
    logs = np.array(logs) - np.max(logs, axis=0)
    return np.exp(logs) / np.exp(logs).sum(axis=0), np.array(means), np.array(covs)


class Parameters:
    """Lemma 5: what a memory says, from true modes and states on simulated paths."""

    def __init__(self, modes, states, cells, z):
        self.fits, self.paths = {}, len(modes)
        self.everywhere = modes, states, z
        for u in range(cells.max() + 1):
            here = cells == u
            if here.sum():
                self.fits[u] = self.fit(modes[here], states[:, here], z[:, here])
        self.missing = self.fit(modes, states, z)

    def fit(self, modes, states, z):
        enough = z if len(modes) > 2 else self.everywhere[2]
        size, axes = np.linalg.eigh(np.atleast_2d(np.cov(enough)))
        kept = size > 1e-9 * size.max()
        turn = (axes[:, kept] / np.sqrt(size[kept])).T
        least, parts = max(50, 3 * (kept.sum() + 1)), []
        for i in (0, 1):
            here = modes == i
            x, t, count = states[:, here], turn @ z[:, here], here.sum()
            if count < least:  # of the cell, or of the mode
                x, t = states, turn @ z
                if len(modes) < least:
                    all_modes, all_x, all_z = self.everywhere
                    x, t = all_x[:, all_modes == i], turn @ all_z[:, all_modes == i]
            both = np.cov(np.concatenate([x, t]))
            n = len(x)
            inner = both[n:, n:] + 1e-8 * np.eye(len(t))
            gain = np.linalg.solve(inner, both[n:, :n]).T
            rest = both[:n, :n] - gain @ both[n:, :n]
            parts.append(
                (max(count, 0.5) / self.paths, x.mean(axis=1), t.mean(axis=1), inner, gain, rest)
            )
        return turn, parts

    def recall(self, cells, z):
        """Chances, means and covariances of the modes, a path's cell and vector given."""
        n, paths = len(self.everywhere[1]), len(cells)
        logs, means = np.empty((2, paths)), np.empty((2, n, paths))
        covs = np.empty((2, n, n, paths))
        for u in np.unique(cells):
            here = cells == u
            turn, parts = self.fits.get(u, self.missing)
            for i, (weight, mean, center, inner, gain, rest) in enumerate(parts):
                away = turn @ z[:, here] - center[:, None]
                square = (away * np.linalg.solve(inner, away)).sum(axis=0)
                logs[i, here] = np.log(weight) - 0.5 * (square + np.linalg.slogdet(inner)[1])
                means[i][:, here] = mean[:, None] + gain @ away
                covs[i][:, :, here] = (rest + 1e-12 * np.eye(n))[:, :, None]
        logs -= logs.max(axis=0)
        return np.exp(logs) / np.exp(logs).sum(axis=0), means, covs


@dataclass(frozen=True)
class Filter:
    """`estimates` or `measurements` say how many are remembered; none of both is the IMM filter."""

    system: object
    estimates: int = 0
    measurements: int = 0
    odds: bool = False
    told: bool = False
    fits: tuple = ()

    def run(self, data, design=False):
        """Decided modes (steps, paths), estimates (steps, n, paths), fits where designed."""
        modes, states, measured, tells = data
        system, fits = self.system, list(self.fits)
        paths = len(modes[0])
        prob, cov = system.start
        dist = (
            np.repeat(prob[:, None], paths, axis=1),
            np.zeros((2, system.size, paths)),
            np.repeat(np.stack([cov, cov])[..., None], paths, axis=-1),
        )
        decided, estimated, blocks, told = [], [], [], []
        for k, y in enumerate(measured):
            if k:
                dist = forecast(system, dist)
            dist = corrected(system, dist, y, tells[k])
            decided.append(dist[0].argmax(axis=0))
            estimated.append((dist[0][:, None] * dist[1]).sum(axis=0))
            if not self.estimates + self.measurements:
                continue
            block = y[None] if self.measurements else estimated[-1]
            if self.odds:
                with np.errstate(divide="ignore"):
                    odds = np.log(dist[0][1]) - np.log(dist[0][0])
                block = np.concatenate([block, np.clip(odds, -CLIP, CLIP)[None]])
            depth = self.estimates + self.measurements
            blocks = [block, *blocks][:depth]
            cells = np.zeros(paths, int)
            if self.estimates:
                for past in decided[::-1][:depth]:
                    cells = 2 * cells + past
            if self.told or (self.measurements and system.tells is not None):
                told = [tells[k], *told][: 1 if self.told else depth]
                for past in told:
                    cells = 2 * cells + past
            z = np.concatenate(blocks)
            if design:
                fits.append(Parameters(modes[k], states[k], cells, z))
            dist = fits[k].recall(cells, z)
        return np.array(decided), np.array(estimated), tuple(fits)

    def designed(self, paths, seed, steps):
        data = simulated(self.system, steps, paths, seed)
        return replace(self, fits=self.run(data, design=True)[2])


def scores(found, data, begin=10):
    """A path's share of wrong modes and mean squares of each component: (1 + n, paths)."""
    wrong = (found[0] != data[0])[begin:].mean(axis=0)
    return np.concatenate([wrong[None], ((found[1] - data[1])[begin:] ** 2).mean(axis=0)])


def averages(score):
    """Share of wrong modes and root-mean-squared errors, with their standard errors."""
    mean, doubt = score.mean(axis=1), score.std(axis=1) / np.sqrt(score.shape[1])
    root = np.sqrt(mean)
    return np.append(mean[0], root[1:]), np.append(doubt[0], doubt[1:] / (2 * root[1:]))
