"""Filter of a switching system that knows the modes: a bound for those that estimate them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Seed, align
from seedslib.base.values import Values, of_paths
from seedslib.filters.base import Estimates, Filter, as_modes
from seedslib.filters.covariance import SensorUpdate
from seedslib.linearization.moments import Linearization, as_linearization
from seedslib.models.kinds import AnySystem, as_system
from seedslib.models.switching import Branch


class KnownModeState(NamedTuple):
    """Time, known mode (*batch), mean (n, *batch), covariance (n, n, *batch), log-likelihood.

    ``interval`` is the length of the first step.
    """

    time: float | None
    mode: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray
    interval: float | None = None


class KnownModeFilter(Filter):
    """Mean and covariance of the state given measurements and the true modes.

    For a jump-linear system it is the Kalman filter with known modes, and no filter that has to
    estimate the modes has a smaller mean-square error. Where the switch or the indicator depends
    on the state, they are information on the state: the moments are those in the branch that was
    taken, so that a good linearization comes close to the bound.

    Parameters
    ----------
    system : SwitchingSystem
    linearization : Linearization, optional
        `Taylor` by default, which is exact for jump-linear systems.

    Raises
    ------
    TypeError
        No switching system, or something that is no linearization.
    NoClosedForm
        The linearization has no formulas for this system; the message offers one that works.
    """

    takes: ClassVar[tuple[str, ...]] = ("indicators", "modes")

    def __init__(self, system: AnySystem, linearization: Linearization | None = None) -> None:
        as_system("system", system, "SwitchingSystem")
        if linearization is None:
            from seedslib.linearization.taylor_and_exact import Taylor

            linearization = Taylor()
        self.system: Any = system
        self.linearization: Linearization = as_linearization(linearization)
        _ = self._transitions, self._sensors, self._readings  # what has no formulas is refused now

    @cached_property
    def _transitions(self) -> list[list[Any]]:
        return [
            [self._transition(i, l, branch) for l, branch in enumerate(row)]
            for i, row in enumerate(self.system.branches)
        ]

    @cached_property
    def _sensors(self) -> list[SensorUpdate]:
        return [SensorUpdate(map, self.linearization) for map in self.system.sensors]

    @cached_property
    def _readings(self) -> list[list[Any]]:
        weighted = self.linearization.weighted
        return [
            [None if b is None or b.constant else weighted(b.map) for b in row]
            for row in self.system.readings
        ]

    def _transition(
        self, i: int, l: int, branch: Branch | None
    ) -> Callable[..., tuple[Any, ...]] | None:
        """Moments of the next state in a branch, the covariance last; None for no branch."""
        if branch is None:
            return None
        new = self.system.drives == "new"
        whole = self.linearization.moments(self.system.dynamics[l if new else i])
        if branch.constant:
            return whole
        weighted = self.linearization.weighted((branch.switch_only if new else branch).map)
        if new:  # given the switch, and then the dynamics
            return lambda t, mean, cov, p: whole(t, *weighted(t, mean, cov, p).state, p)
        return lambda t, mean, cov, p: weighted(t, mean, cov, p).value

    def initial(
        self, batch: tuple[int, ...] = (), seed: Seed | None = None, *, mode: ArrayLike = 0
    ) -> KnownModeState:
        """State before any measurement, for known modes of shape (*batch) or one for all.

        `seed` is not used, every filter has the same verbs.
        """
        mode = as_modes("mode", np.broadcast_to(mode, batch), batch, self.system.modes)
        mean = np.stack([part.mean for part in self.system.initial], axis=1)[:, mode]
        cov = np.stack([part.cov for part in self.system.initial], axis=2)[:, :, mode]
        return KnownModeState(None, mode, mean, cov, np.zeros(batch))

    def propagate(
        self, state: KnownModeState, t: float, p: Values, mode: ArrayLike | None = None
    ) -> KnownModeState:
        """Moments one step of the system later, where the mode is `mode` (*batch).

        Raises
        ------
        ValueError
            A step without its mode, a switch that never happens.
        """
        if mode is None:
            raise ValueError("mode: wanted the mode at the later time, got None")
        mode = as_modes("mode", mode, state.mode.shape, self.system.modes)
        mean, cov = np.empty(state.mean.shape), np.empty(state.cov.shape)
        for i, row in enumerate(self._transitions):
            for l, transition in enumerate(row):
                mask = (state.mode == i) & (mode == l)
                if not mask.any():
                    continue
                if transition is None:
                    raise ValueError(f"mode: wanted possible switches, got one from {i} to {l}")
                own = of_paths(p, mask.shape, mask)
                moments = transition(state.time, state.mean[:, mask], state.cov[:, :, mask], own)
                _put(mean, cov, mask, moments)
        return state._replace(mode=mode, mean=mean, cov=cov)

    def update(
        self, state: KnownModeState, y: np.ndarray, p: Values, indicator: np.ndarray | None = None
    ) -> KnownModeState:
        """See `Filter.update`; an indicator is used only where it depends on the state."""
        mean, cov = np.empty(state.mean.shape), np.empty(state.cov.shape)
        loglik = np.empty(state.mode.shape)
        for i, branches in enumerate(self._readings):
            for j, branch in ((-1, None), *enumerate(branches)):
                mask = (state.mode == i) & (indicator == j if indicator is not None else j < 0)
                if not mask.any():
                    continue
                prior, moments = (state.mean[:, mask], state.cov[:, :, mask]), None
                own = of_paths(p, mask.shape, mask)
                if branch is not None:
                    _, prior, moments = branch(state.time, *prior, own)
                sensor = self._sensors[i]
                *posterior, loglik[mask] = sensor(state.time, *prior, y[:, mask], own, moments)
                _put(mean, cov, mask, posterior)
        return state._replace(mean=mean, cov=cov, loglik=loglik)

    def predictive(self, state: KnownModeState, p: Values) -> tuple[np.ndarray, np.ndarray]:
        """See `Filter.predictive`; of the given modes."""
        m = self.system.measurement_size
        mean, cov = (np.empty((*shape, *state.mode.shape)) for shape in ((m,), (m, m)))
        for i, sensor in enumerate(self._sensors):
            mask = state.mode == i
            if mask.any():
                own = of_paths(p, mask.shape, mask)
                prior = state.mean[:, mask], state.cov[:, :, mask]
                _put(mean, cov, mask, sensor.moments(state.time, *prior, own))
        return mean, cov

    def report(self, state: KnownModeState) -> Estimates:
        """Mean and covariance; the mode is the given one, with probability one."""
        certain = np.stack([state.mode == i for i in range(self.system.modes)]).astype(float)
        return Estimates(state.mean, state.cov, certain, state.loglik, None, state.mode)


def _put(mean: np.ndarray, cov: np.ndarray, mask: np.ndarray, moments: Sequence[Any]) -> None:
    """Write moments of some items, whose covariance may be common to them all, and comes last."""
    mean[:, mask], cov[:, :, mask] = moments[0], align(np.asarray(moments[-1]), 2, 1)
