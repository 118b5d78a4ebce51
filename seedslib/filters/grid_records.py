"""Exact smoothing on a grid."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.filters.backward import Smoother
from seedslib.filters.estimates import Estimates
from seedslib.filters.weights import most_probable


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
