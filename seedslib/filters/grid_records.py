"""Whole records on a grid: how good their numbers are, and exact smoothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Law = np.ndarray


class GridAccuracy(NamedTuple):
    """How good the numbers of a `GridBayesFilter` are, told by every second node.

    Attributes
    ----------
    loglik : ndarray, shape (*batch)
        Difference of the log-likelihoods of whole records. The trapezoid rule's error falls
        faster than any power of the step, so it bounds that of all nodes amply.
    mean : ndarray, shape (n, *batch)
        Largest difference of the estimates.
    lost : ndarray, shape (*batch)
        Sum of the probabilities that left the nodes; 0 of a switching system, which keeps them.
    """

    loglik: np.ndarray
    mean: np.ndarray
    lost: np.ndarray


def followed(
    filter: Any, times: np.ndarray, y: np.ndarray, seen: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log-likelihood (*batch), estimates (K+1, n, *batch) and lost probability (*batch)."""
    batch = y.shape[2:]
    state, loglik, means, lost = filter.initial(batch), np.zeros(batch), [], np.zeros(batch)
    for k, t in enumerate(times):
        state = filter.predict(state, t)
        lost = lost + (1.0 - np.exp(state.log_prob).sum(axis=0))
        state = filter.correct(state, y[k], *(() if seen is None else (seen[k],)))
        loglik = loglik + state.loglik
        means.append(state.mean)
    return loglik, np.array(means), lost


def smoothed_laws(filtered: list[Law], moves: list[np.ndarray], lag: int | None) -> list[Law]:
    """Laws of a chain's states at each time from what was measured up to a later one.

    p(x | later) = p(x) sum over x' of P(x' | x) p(x' | later) / p'(x'), with the forecast
    p' = P p: nothing is approximated but the nodes.

    Parameters
    ----------
    filtered : list of ndarray, shape (S, N)
        Laws after each measurement, of N records.
    moves : list of ndarray, shape (S, S)
        P from each time to the next.
    lag : int or None
        How many later times count; None for all.
    """

    def back(k: int, later: Law) -> Law:
        ahead = moves[k] @ filtered[k]
        ratio = np.divide(later, ahead, out=np.zeros_like(later), where=ahead > 0)
        return filtered[k] * (moves[k].T @ ratio)

    return _interval(filtered, back) if lag is None else _lagged(filtered, back, lag)


def _interval(filtered: list[Law], back: Callable[[int, Law], Law]) -> list[Law]:
    found = [filtered[-1]]
    for k in reversed(range(len(filtered) - 1)):
        found.append(back(k, found[-1]))
    return found[::-1]


def _lagged(filtered: list[Law], back: Callable[[int, Law], Law], lag: int) -> list[Law]:
    found = []
    for k in range(len(filtered)):
        end = min(k + lag, len(filtered) - 1)
        law = filtered[end]
        for j in reversed(range(k, end)):
            law = back(j, law)
        found.append(law)
    return found
