"""The interacting multiple model filter of a jump-linear system, in plain matrices.

One record at a time, one mode at a time, probabilities as they are; the filter with a memory is
the same recursion with the distribution that the memory stands for in place of the posterior one.
"""

from __future__ import annotations

import numpy as np

from oracles.linear import corrected, mixed


def merged(dist):
    """Mean and covariance of a distribution [(probability, mean, cov)] over all modes."""
    return mixed(*(np.array(part) for part in zip(*dist, strict=True)))


class SwitchingOracle:
    """
    Parameters
    ----------
    initial : list of (probability, mean, cov)
    moves : callable (step, mode) -> (matrix, shift, cov)
        From measurement `step` to the next.
    chain : callable (step) -> array (L, L)
    sensors : callable (step, mode) -> (matrix, offset, cov)
    tells : callable (step) -> array (L, J), optional
    drives : {"old", "new"}
    """

    def __init__(self, initial, moves, chain, sensors, tells=None, drives="old"):
        self.initial, self.moves, self.chain = initial, moves, chain
        self.sensors, self.tells, self.drives = sensors, tells, drives

    def ahead(self, k, dist):
        """Forecast from a distribution [(probability, mean, cov)] after measurement k."""
        modes, chain = range(len(dist)), self.chain(k)

        def moved(i, mean, cov):
            matrix, shift, noise = self.moves(k, i)
            return matrix @ mean + shift, matrix @ cov @ matrix.T + noise

        if self.drives == "old":
            dist = [(p, *moved(i, m, c)) for i, (p, m, c) in enumerate(dist)]
        found = []
        for l in modes:
            parts = [(chain[i, l] * dist[i][0], *dist[i][1:]) for i in modes]
            mass, (mean, cov) = sum(part[0] for part in parts), merged(parts)
            if self.drives == "new":
                mean, cov = moved(l, mean, cov)
            found.append((mass, mean, cov))
        return found

    def run(self, y, shown=None, recall=None):
        """Distributions, forecasts, log-densities of one record (K + 1, m), NaN and -1 where
        missing.

        `recall(k, distribution, expected)` gives the distribution that a memory stands for after
        measurement k.
        """
        dist, dists, forecasts, logliks = self.initial, [], [], []
        for k in range(len(y)):
            if k:
                dist = self.ahead(k - 1, dist)
            forecasts.append(dist)
            parts, expected, weight = [], [], 0.0
            for i, (p, mean, cov) in enumerate(dist):
                if shown is not None and shown[k] >= 0:
                    p = p * self.tells(k)[i, shown[k]]
                matrix, offset, noise = self.sensors(k, i)
                expected.append(p * (matrix @ mean + offset))
                *moved, loglik = corrected(mean, cov, y[k], matrix, offset, noise)
                parts.append((p * np.exp(loglik), *moved))
                weight += p
            total = sum(p for p, *_ in parts)
            logliks.append(np.log(total))
            dist = [(p / total, *rest) for p, *rest in parts]
            dists.append(dist)
            if recall is not None and k < len(y) - 1:
                dist = recall(k, dist, sum(expected) / weight)
        return dists, forecasts, np.array(logliks)
