"""The interacting multiple model filter of a jump-linear system, in plain matrices.

One record at a time, one mode at a time, probabilities as they are; the filter with a memory is
the same recursion with the law that the memory stands for in the place of the posterior one.
"""

from __future__ import annotations

import numpy as np

from oracles.linear import corrected, mixed


def merged(law):
    """Mean and covariance of a law [(probability, mean, cov)] over all modes."""
    return mixed(*(np.array(part) for part in zip(*law, strict=True)))


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

    def ahead(self, k, law):
        """Forecast from a law [(probability, mean, cov)] after measurement k."""
        modes, chain = range(len(law)), self.chain(k)

        def moved(i, mean, cov):
            matrix, shift, noise = self.moves(k, i)
            return matrix @ mean + shift, matrix @ cov @ matrix.T + noise

        if self.drives == "old":
            law = [(p, *moved(i, m, c)) for i, (p, m, c) in enumerate(law)]
        found = []
        for l in modes:
            parts = [(chain[i, l] * law[i][0], *law[i][1:]) for i in modes]
            mass, (mean, cov) = sum(part[0] for part in parts), merged(parts)
            if self.drives == "new":
                mean, cov = moved(l, mean, cov)
            found.append((mass, mean, cov))
        return found

    def run(self, y, shown=None, recall=None):
        """Laws, forecasts, log-densities of one record (K + 1, m), NaN and -1 where missing.

        `recall(k, law, expected)` gives the law that a memory stands for after measurement k.
        """
        law, laws, forecasts, logliks = self.initial, [], [], []
        for k in range(len(y)):
            if k:
                law = self.ahead(k - 1, law)
            forecasts.append(law)
            parts, expected, weight = [], [], 0.0
            for i, (p, mean, cov) in enumerate(law):
                if shown is not None and shown[k] >= 0:
                    p = p * self.tells(k)[i, shown[k]]
                matrix, offset, noise = self.sensors(k, i)
                expected.append(p * (matrix @ mean + offset))
                *moved, loglik = corrected(mean, cov, y[k], matrix, offset, noise)
                parts.append((p * np.exp(loglik), *moved))
                weight += p
            total = sum(p for p, *_ in parts)
            logliks.append(np.log(total))
            law = [(p / total, *rest) for p, *rest in parts]
            laws.append(law)
            if recall is not None and k < len(y) - 1:
                law = recall(k, law, sum(expected) / weight)
        return laws, forecasts, np.array(logliks)
