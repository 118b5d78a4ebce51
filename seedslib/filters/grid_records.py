"""Whole records on a grid: how good their numbers are, and exact smoothing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.filters.backward import Smoother
from seedslib.filters.estimates import Estimates
from seedslib.filters.weights import most_probable


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


def record_followed(
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


class GridSmoother(Smoother):
    """The exact step back on nodes, of mode and state together.

    p(x | later) = p(x) sum over x' of P(x' | x) p(x' | later) / p'(x'), with the forecast p' = P p:
    nothing is approximated but the nodes. A part is the joint law (S, N) of N records.
    """

    def forecast(self, state: Any, t: float) -> tuple[Any, Any]:
        """See `Smoother.forecast`; the link is the transition."""
        before = state.time
        later, _ = super().forecast(state, t)
        return later, None if before is None else self.filter.chain.transition(before, t)

    def lost(self, state: Any) -> Any:
        """Where no node explains what was seen."""
        return state.diverged

    def last(self, state: Any) -> Any:
        """See `Smoother.last`."""
        joint = np.exp(state.log_prob)[:, None] * state.law
        return joint.reshape(joint.shape[0] * joint.shape[1], -1)

    def back(self, state: Any, part: Any, link: Any, indicator: MaybeArray = None) -> Any:
        """See `Smoother.back`."""
        now = self.last(state)
        ahead = link @ now
        ratio = np.divide(part, ahead, out=np.zeros_like(part), where=ahead > 0)
        return now * (link.T @ ratio)

    def report(self, part: Any) -> Estimates:
        """Mean, covariance, and the modes with their probabilities, where there are modes."""
        prob, mean, cov = self.filter.moments_of(part)
        modes = None if prob is None else most_probable(prob)
        return Estimates(mean, cov, prob, modes=modes)
