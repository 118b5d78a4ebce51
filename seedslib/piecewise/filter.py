"""The optimal filter of a piecewise-linear system, and its pruned, merged and matched relatives."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from seedslib.base.checks import as_count, as_real
from seedslib.base.clock import when
from seedslib.filters.estimates import Estimates, require_time, stays
from seedslib.filters.verbs import Filter
from seedslib.models.kinds import as_steps, as_system
from seedslib.piecewise import weights
from seedslib.piecewise.branches import (
    Branches,
    alive,
    measure,
    move,
    obstacle,
    prior_branches,
    spread_out,
)
from seedslib.piecewise.local import localise
from seedslib.piecewise.merging import merge
from seedslib.piecewise.state import PiecewiseState, check_noise, lost_mass
from seedslib.piecewise.system import PiecewiseLinearSystem

_PAIRS = 2_000_000  # pairs (branch, data set) that are worked on together by `run`


class PiecewiseLinearFilter(Filter):
    """Posterior moments of a piecewise-linear system, exact where its structure allows it.

    The posterior is a sum of Gaussian laws, each restricted to a region: a *branch*. A transition
    keeps that form when the restricted components (the leading one or two, of which the cells
    are made) receive no noise and depend on themselves only; noise in the others does no harm.
    Regions then stay (the paper's case), move and split, or are carried in earlier coordinates
    where the dynamics collapse them. Any other transition is met by moment matching: one
    Gaussian law per cell, which is approximate but does not grow.

    Kolessa, theorem 2 and equation (29); all regions, branches and data sets are batch axes.

    Parameters
    ----------
    system : PiecewiseLinearSystem
    method : {"auto", "exact", "matched"}
        "auto" decides for every transition; "exact" refuses what is not exact; "matched" always
        matches moments.
    prune : float
        At every step the branches of smallest weight that together hold at most this share are
        dropped. `PiecewiseState.lost` bounds what that can have cost: with the dropped share
        delta, the predictive density c of the measurement, the largest possible likelihood J and
        the projective distance d of merging,
        ``lost <- (lost J e^d / c + delta e^d) / (1 - delta e^d)``.
    keep : int, optional
        Drop all but this many branches of largest weight, at any price; the bound counts it.
    merge : float
        Largest projective distance at which branches are merged; scalar states only.
    neglect : float
        Share of the mass whose integrals may be left out because an elementary bound shows that
        they are small; nothing is dropped, and the default is far below rounding.
    max_branches : int
        More branches than this are an error.

    Raises
    ------
    TypeError, ValueError
        Options outside their ranges; merging of a state that is not scalar.
    """

    alone = True  # a measurement that no branch explains is an error there
    _shown = "method", "prune", "keep", "merge"

    def __init__(
        self, system: PiecewiseLinearSystem, *, method: str = "auto", prune: float = 0.0,
        keep: int | None = None, merge: float = 0.0, neglect: float = 1e-30,
        max_branches: int = 20_000,
    ) -> None:  # fmt: skip
        as_system("system", system, "PiecewiseLinearSystem")
        if method not in ("auto", "exact", "matched"):
            raise ValueError(f'method: wanted "auto", "exact" or "matched", got {method!r}')
        for name, value in (("prune", prune), ("neglect", neglect)):
            if not 0.0 <= as_real(name, value, ndim=0) < 1.0:
                raise ValueError(f"{name}: wanted a share in [0, 1), got {value:g}")
        if not as_real("merge", merge, ndim=0) >= 0.0:
            raise ValueError(f"merge: wanted a nonnegative distance, got {merge:g}")
        if merge > 0.0 and system.state_size > 1:
            raise ValueError(f"merge: wanted 0 for a state of {system.state_size} components")
        if not max_branches >= system.regions.count:
            raise ValueError(f"max_branches: wanted at least one per cell, got {max_branches}")
        self.system: Any = system
        self.method: str = method
        self.keep: int | None = None if keep is None else as_count("keep", keep)
        self._cuts = prune > 0.0 or keep is not None
        self.prune: float = float(prune)
        self.merge: float = float(merge)
        self.neglect: float = float(neglect)
        self.max_branches: int = int(max_branches)

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> PiecewiseState:
        """State before any measurement, with no time yet; `seed` is not used."""
        datasets = int(np.prod(batch, dtype=int))
        branches = prior_branches(self.system, datasets)
        clean = np.zeros(batch)
        return self._weighed(branches, batch, None, clean, clean, clean > 0.0)

    def predict(self, state: PiecewiseState, t: float) -> PiecewiseState:
        """State at time t without a measurement; a state without a time is only given one.

        Raises
        ------
        ValueError
            A time before that of the state; a transition that the chosen method cannot make.
        """
        if stays(state, t):
            return state._replace(time=float(t), loglik=np.zeros_like(state.loglik))
        batch = state.mean.shape[1:]
        branches, lost = self._moved(state, t)
        return self._weighed(branches, batch, float(t), lost, state.distance, state.diverged)

    def correct(self, state: PiecewiseState, y: object) -> PiecewiseState:
        """State after the measurement y, (m, *batch), at the time of `state`; NaN is missing.

        Raises
        ------
        TypeError, ValueError
            A state without a time; a measurement of the wrong shape or infinite; a noise-free
            sensor of a known state; for a single data set, a measurement that no branch can
            explain.
        """
        require_time(state)
        return self._corrected(state, state.branches, state.time, y, state.lost)

    def step(self, state: PiecewiseState, t: float, y: object) -> PiecewiseState:
        """Prediction for time t and correction by y in one."""
        if self._adaptive or stays(state, t):
            return self.correct(self.predict(state, t), y)
        branches, lost = self._moved(state, t)
        return self._corrected(state, branches, float(t), y, lost)

    def report(self, state: PiecewiseState) -> Estimates:
        """Mean, covariance and probabilities of the cells."""
        return Estimates(state.mean, state.cov, state.mode_prob, state.loglik, state.diverged)

    def states(self, times: object, measurements: object) -> Iterator[PiecewiseState]:
        """The states at all times, one after the other; arguments as `run`."""
        times, y = self.record(times, measurements)
        state = self.initial(y.shape[2:])
        for t, now in zip(times, y, strict=True):
            state = self.step(state, float(t), now)
            yield state

    @property
    def _adaptive(self) -> bool:
        return self.system.functions is not None and self.system.functions.adaptive

    def record(self, times: object, measurements: object) -> tuple[np.ndarray, np.ndarray]:
        """Times, also from the number of steps K, and measurements (K+1, m, *batch), checked.

        The system measures nothing at the first time, so NaN there is the rule.
        """
        times = as_steps(times)
        y = as_real("measurements", measurements, nan=True)
        outputs = self.system.sensor_at(float(times[-1])).offset.shape[0]
        if y.ndim < 2 or y.shape[:2] != (times.size, outputs):
            raise ValueError(
                f"measurements: wanted shape ({times.size}, {outputs}, *batch), got {y.shape}"
            )
        return times, y

    def block(self, times: np.ndarray, paths: int, workers: int) -> int:
        """Data sets worked on together: all, unless matching makes too many pairs of cells."""
        cells = self.system.regions
        if self.method != "matched" and not obstacle(
            self.system.dynamics_at(float(times[0])), cells.size
        ):
            return max(1, paths)
        return max(1, min(paths, _PAIRS // cells.count**2))

    def _moved(self, state: PiecewiseState, t: float) -> tuple[Branches, np.ndarray]:
        """Branches at time t before its measurement, and the bound of the lost mass."""
        system = self.system
        estimate = state.mean.reshape(system.state_size, -1) if self._adaptive else None
        c = system.dynamics_at(state.time, estimate)
        reason = obstacle(c, system.regions.size)
        if self.method == "exact" and reason:
            raise ValueError(f'method: "exact" is impossible at t = {when(t)}, {reason}')
        if self.method == "matched" or reason:
            count = system.regions.count
            share, mean, cov = weights.by_cell(state.law, count)
            with np.errstate(divide="ignore"):
                branches = spread_out(system.regions, c, np.log(share), mean, cov)
            return branches, state.lost if count == 1 else np.full(state.lost.shape, np.nan)
        branches = move(state.branches, system.regions, c)
        if len(branches.cell) > self.max_branches:
            raise ValueError(
                f"max_branches: got {len(branches.cell)} branches at t = {when(t)}, more than "
                f"{self.max_branches}; prune, merge or match moments"
            )
        return branches, state.lost

    def _corrected(
        self, state: PiecewiseState, branches: Branches, t: float, y: object, lost: np.ndarray
    ) -> PiecewiseState:
        batch = state.mean.shape[1:]
        y, peak = as_real("y", y, nan=True), np.zeros(batch)
        if y.shape[1:] != batch or y.ndim != 1 + len(batch):
            raise ValueError(f"y: wanted shape {('any', *batch)}, got {y.shape}")
        if not np.isnan(y).all():  # a sensor need not exist when nothing is measured
            estimate = state.mean.reshape(self.system.state_size, -1) if self._adaptive else None
            c = self.system.sensor_at(t, estimate)
            if len(y) != len(c.offset):
                raise ValueError(f"y: wanted shape {(len(c.offset), *batch)}, got {y.shape}")
            y = y.reshape(len(y), -1)
            branches, innovation = measure(branches, c, y)
            check_noise(c, innovation, t, self._cuts)
            branches = localise(branches)
            peak = weights.log_peak(c, y).reshape(batch) if self._cuts else peak
        return self._weighed(
            branches, batch, t, lost, state.distance, state.diverged, peak=peak, update=True
        )

    def _weighed(
        self,
        branches: Branches,
        batch: tuple[int, ...],
        t: float,
        lost: np.ndarray,
        distance: np.ndarray,
        diverged: np.ndarray,
        *,
        peak: np.ndarray | None = None,
        update: bool = False,
    ) -> PiecewiseState:
        """State from branches whose U are not normalised; prunes and merges after an update."""
        weighed = weights.weigh_branches(branches, self.neglect)
        total = weights.log_sum(weighed.log_joint)
        failed = ~(total > -np.inf)
        if failed.any() and not batch:
            raise ValueError(f"y: measurement incompatible with every branch at t = {when(t)}")
        norm = np.where(failed, 0.0, total)
        log_unit, log_weight = branches.log_unit - norm, weighed.log_joint - norm
        loglik = np.where(diverged, np.nan, total.reshape(batch))
        if update and self._cuts:
            dropped, share = weights.prune(np.exp(log_weight), self.prune, self.keep)
            kept = -np.log1p(-share)
            log_unit, log_weight = (
                np.where(dropped, -np.inf, part + kept) for part in (log_unit, log_weight)
            )
            share = (share + self.neglect).reshape(batch)
            lost = lost_mass(
                lost, share, distance, peak - np.where(failed.reshape(batch), 0.0, loglik)
            )
        branches = branches._replace(log_unit=log_unit)
        law = weights.CellLaw(weighed, np.exp(log_weight), branches.cell)
        mean, cov = weights.mixture(law)
        prob = weights.cell_probabilities(law, self.system.regions.count)
        for part in (mean, cov, prob):
            part[..., failed] = np.nan
        if update and (self._cuts or self.merge > 0.0):
            kept = alive(log_unit)
            branches, log_weight = branches.take(kept), log_weight[kept]
        if update and self.merge > 0.0:
            branches, log_weight, added = merge(branches, log_weight, self.merge)
            distance = distance + added.reshape(batch)
        return PiecewiseState(
            time=t,
            mean=mean.reshape(-1, *batch),
            cov=cov.reshape(*cov.shape[:2], *batch),
            mode_prob=prob.reshape(-1, *batch),
            loglik=loglik if update else np.zeros(batch),
            weights=np.exp(log_weight).reshape(-1, *batch),
            lost=lost,
            distance=distance,
            diverged=diverged | failed.reshape(batch),
            branches=branches,
            law=law,
        )
