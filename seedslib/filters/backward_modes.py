"""Step back of the filter that is told the modes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.filters.backward import Smoother, gain_of, stepped_back
from seedslib.filters.estimates import Estimates
from seedslib.filters.known_modes import KnownModeState
from seedslib.linearization.moments import Gaussian, Weighted


class SmoothedState(NamedTuple):
    """Modes (*batch), means as one column (n, *batch, 1) and covariances (n, n, *batch)."""

    mode: np.ndarray
    columns: np.ndarray
    cov: np.ndarray


class KnownModeSmoother(Smoother):
    """The smoother of Rauch, Tung and Striebel given the modes: exact for jump-linear systems.

    Where the switch depends on the state, a step back starts from the moments of the state in
    the branch that was taken.
    """

    def __init__(self, filter: Any) -> None:
        super().__init__(filter)
        self._joint = [[b and self._jointly(b) for b in row] for row in filter.system.branches]

    def _jointly(self, branch):
        """Function (t, mean, cov) -> Weighted of the state before the step and after it."""
        if not branch.constant:
            return self.filter.linearization.weighted(branch.map)
        moments = self.filter.linearization.moments(branch.whole)
        return lambda t, mean, cov: Weighted(
            np.ones(()), Gaussian(mean, cov), moments(t, mean, cov)
        )

    def forecast(self, state: Any, t: float, *told: ArrayLike) -> tuple[Any, Any]:
        """See `Smoother.forecast`; the link is the law before the step, the forecast, the gain."""
        later = self.filter.predict(state, t, *told)
        if state.time is None:
            return later, None
        mean, cov = np.empty(state.mean.shape), np.empty(state.cov.shape)
        cross = np.empty(cov.shape)
        for i, row in enumerate(self._joint):
            for l, joint in enumerate(row):
                here = (state.mode == i) & (later.mode == l)
                if not here.any():
                    continue
                _, before, value = joint(state.time, state.mean[:, here], state.cov[:, :, here])
                mean[:, here] = before.mean
                for whole, part in ((cov, before.cov), (cross, value.cross)):
                    whole[:, :, here] = part if part.ndim == 3 else part[:, :, None]
        gain = gain_of(cross, later.cov)
        return later, (mean[..., None], cov, later.mean[..., None], later.cov, gain)

    def last(self, state: KnownModeState) -> SmoothedState:
        """See `Smoother.last`."""
        return SmoothedState(state.mode, state.mean[..., None], state.cov)

    def back(
        self, state: KnownModeState, part: SmoothedState, link: Any, indicator: MaybeArray = None
    ) -> SmoothedState:
        """See `Smoother.back`."""
        return SmoothedState(state.mode, *stepped_back(*link, part.columns, part.cov))

    def report(self, part: SmoothedState) -> Estimates:
        """Mean and covariance; the mode is the given one, with probability one."""
        state = KnownModeState(None, part.mode, part.columns[..., 0], part.cov, np.zeros(()))
        return self.filter.report(state)
