"""The optimal filter of a piecewise-linear system, Kolessa's theorem 2 and equation (29)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from seedslib.base.checks import as_real
from seedslib.base.clock import when
from seedslib.base.conditioning import update
from seedslib.filters.base import Filter, require_time, stays
from seedslib.gaussian import lift
from seedslib.linearization import Moments
from seedslib.models.kinds import as_steps, as_system
from seedslib.piecewise.system import Coefficients, PiecewiseLinearSystem

NEGLIGIBLE = 80.0  # nats below the best bound of a weight where no integral is taken
SINGULAR = 1e-13  # relative eigenvalue of a predicted measurement's covariance that counts as zero


class Branches(NamedTuple):
    """Posterior distribution ``sum_b U_b N(v; mean_b, cov_b) [s in region_b]`` for each record.

    A branch keeps its region in coordinates s in which it has volume: ``v = (s, x2)`` with
    ``x = shift + slope v``. Usually v is x itself; where the dynamics contract or collapse x1,
    s is x1 at an earlier time.

    Attributes
    ----------
    cell : ndarray of int, shape (B,)
        Cell in which x1 lies now.
    regions : ndarray, shape (2, B) or (V, 2, B)
        Ends of intervals, or vertices of polygons, the last one repeated.
    slope, shift : ndarray, shapes (k, k, B) and (k, B)
    mean : ndarray, shape (k, B, N)
    cov : ndarray, shape (k, k, B, 1 or N)
        Common to all records unless missing measurements, or coefficients that follow the
        estimate, make it differ.
    log_unit : ndarray, shape (B, N)
        ``ln U``; not a probability: the weight of a branch is U times the mass of its region.
    """

    cell: np.ndarray
    regions: np.ndarray
    slope: np.ndarray
    shift: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    log_unit: np.ndarray

    def pieces(self, parent: np.ndarray, cell: np.ndarray, regions: np.ndarray) -> Branches:
        """Branches with the distributions of their parents on regions and in cells of their own."""
        slope, shift, mean = self.slope[..., parent], self.shift[:, parent], self.mean[:, parent]
        dist = slope, shift, mean, self.cov[:, :, parent], self.log_unit[parent]
        return Branches(cell, regions, *dist)


class PiecewiseState(NamedTuple):
    """What the filter knows at one time.

    Attributes
    ----------
    time : float or None
    mean, cov : ndarray, shapes (k, *batch) and (k, k, *batch)
    mode_prob : ndarray, shape (n, *batch)
        Probability of every cell.
    loglik : ndarray, shape (*batch)
        Logarithm of the predictive density of the last measurement.
    weights : ndarray, shape (B, *batch)
        Probabilities of the branches.
    dropped : ndarray, shape (*batch)
        Share of the weight that was cut at this time.
    diverged : ndarray of bool, shape (*batch)
        Records whose measurement no branch could explain.
    branches : Branches
        One axis of records, whatever the batch.
    """

    time: float | None
    mean: np.ndarray
    cov: np.ndarray
    mode_prob: np.ndarray
    loglik: np.ndarray
    weights: np.ndarray
    dropped: np.ndarray
    diverged: np.ndarray
    branches: Branches


class PiecewiseLinearFilter(Filter):
    """Posterior moments of a piecewise-linear system, exact where its structure allows it.

    The posterior is a sum of Gaussian distributions, each restricted to a region: a *branch*. A
    transition keeps that form when the restricted components (the leading one or two, of which the
    cells are made) receive no noise and depend on themselves only; noise in the others does no
    harm.
    Regions then stay (the paper's case), or move and split, and the branches multiply unless they
    are pruned. Other transitions are refused.

    Kolessa, theorem 2 and equation (29); all branches and records are batch axes.

    Parameters
    ----------
    system : PiecewiseLinearSystem
    prune : float
        At every measurement the branches of smallest weight that together hold at most this share
        are dropped. With the dropped share delta, the predictive density c of the measurement and
        the largest possible likelihood J, the total variation to the exact distribution is at most
        ``lost / (1 + lost)``, where ``lost <- (lost J / c + delta) / (1 - delta)``.
    """

    alone = True  # a measurement that no branch explains is an error there

    def __init__(self, system: PiecewiseLinearSystem, *, prune: float = 0.0) -> None:
        as_system("system", system, "PiecewiseLinearSystem")
        if not 0.0 <= as_real("prune", prune, ()) < 1.0:
            raise ValueError(f"prune: wanted a share in [0, 1), got {prune:g}")
        self.system, self.prune = system, float(prune)

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> PiecewiseState:
        """State before any measurement, with no time yet; `seed` is not used."""
        mean0, cov0, cells = self.system.mean0, self.system.cov0, self.system.regions
        one, zero, size = np.eye(mean0.size)[..., None], 0.0 * mean0[:, None], cells.size
        mean = np.repeat(mean0[:, None, None], np.prod(batch, dtype=int), axis=2)
        dist = one, zero, mean, cov0[:, :, None, None], np.zeros(mean.shape[1:])
        whole = Branches(np.zeros(1, int), cells.whole(mean0, cov0), *dist)
        pieces = cells.split(whole.regions, one[:size, :size], zero[:size])
        none, clean = np.zeros((1, *batch)), np.zeros(batch)
        state = PiecewiseState(None, none, none, none, clean, none, clean, clean > 0.0, whole)
        return self._weighed(whole.pieces(*pieces), state)

    def predict(self, state: PiecewiseState, t: float, *, inputs: None = None) -> PiecewiseState:
        """State at time t without a measurement; a state without a time is only given one.

        Raises
        ------
        ValueError
            A time before that of the state; a transition after which branches are no longer
            Gaussian distributions on regions.
        """
        if stays(state, t):
            return state._replace(time=float(t), loglik=np.zeros_like(state.loglik))
        return self._weighed(self._moved(state), state._replace(time=float(t)))

    def correct(self, state: PiecewiseState, y: object, *, inputs: None = None) -> PiecewiseState:
        """State after the measurement y, (m, *batch), at the time of `state`; NaN is missing.

        Raises
        ------
        ValueError
            A measurement without noise of a known state; for a single record, a measurement that
            no branch can explain.
        """
        require_time(state)
        return self._weighed(self._measured(state, state.branches, y), state, update=True)

    def step(self, state: PiecewiseState, t: float, y: object) -> PiecewiseState:
        """Forecast to time t and correct there; the forecast's own moments are not formed."""
        if self.system.adaptive or stays(state, t):
            return self.correct(self.predict(state, t), y)
        branches, state = self._moved(state), state._replace(time=float(t))
        return self._weighed(self._measured(state, branches, y), state, update=True)

    def states(self, times: object, measurements: object) -> Iterator[PiecewiseState]:
        """The states at all times, one after the other; arguments as `run`."""
        times, y = self.record(times, measurements)
        state = self.initial(y.shape[2:])
        for t, now in zip(times, y, strict=True):
            yield (state := self.step(state, float(t), now))

    def record(self, times: object, measurements: object) -> tuple[np.ndarray, np.ndarray]:
        """Times, also from the number of steps K, and measurements (K+1, m, *batch), checked."""
        times, y = as_steps(times), as_real("measurements", measurements, nan=True)
        rows = len(self.system.sensor_at(float(times[-1])).offset)
        return times, as_real("measurements", y, (len(times), rows, ...), nan=True)

    def _estimate(self, state: PiecewiseState) -> np.ndarray | None:
        return state.mean.reshape(len(state.mean), -1) if self.system.adaptive else None

    def _moved(self, state: PiecewiseState) -> Branches:
        """Every branch carried through the dynamics of its cell and cut along the cells."""
        branches, cells, size = state.branches, self.system.regions, self.system.regions.size
        c = self.system.dynamics_at(state.time, self._estimate(state))
        unlike = np.ptp(c.offset[:size], -1).any() or np.ptp(c.matrix[:size, :size], -1).any()
        if c.noise[:size].any() or c.matrix[:size, size:].any() or unlike:
            wanted = "restricted components that move by themselves, alike in all records"
            raise ValueError(f"system: wanted {wanted}, not so at t = {when(state.time)}")
        offset, matrix, noise = _from_branches(branches, c)
        # a map that spreads is applied to the region; under one that shrinks it stays, and the
        # cells are pulled back
        head = matrix[:size, :size, :, 0].copy(), offset[:size, :, 0].copy()
        follow = np.abs(np.linalg.det(np.moveaxis(head[0], 2, 0))) >= 1.0
        still = np.eye(size)[..., None], np.zeros((size, 1))
        turn, origin = (np.where(follow, *pair) for pair in zip(head, still, strict=True))
        back, start = (np.where(follow, *pair) for pair in zip(still, head, strict=True))
        matrix[:size, :size], offset[:size] = turn[..., None], origin[..., None]
        mean, cov = _mapped(offset, matrix, branches.mean, branches.cov)
        slope = np.repeat(np.eye(len(mean))[..., None], follow.size, axis=2)
        shift = np.zeros(slope.shape[1:])
        slope[:size, :size], shift[:size] = back, start
        moved = branches._replace(slope=slope, shift=shift, mean=mean, cov=cov + noise)
        images = cells.image(branches.regions, turn, origin)
        return moved.pieces(*cells.split(images, back, start))

    def _measured(self, state: PiecewiseState, branches: Branches, y: object) -> Branches:
        """Every branch corrected linearly, its likelihood put into U."""
        y, batch = as_real("y", y, nan=True), state.mean.shape[1:]
        if np.isnan(y).all():  # a sensor need not exist when nothing is measured
            return branches
        c = self.system.sensor_at(state.time, self._estimate(state))
        y = as_real("y", y, (len(c.offset), *batch), nan=True).reshape(len(y), -1)
        offset, matrix, noise = _from_branches(branches, c)
        predicted, spread = _mapped(offset, matrix, branches.mean, branches.cov)
        cross = np.einsum("ij...,kj...->ik...", branches.cov, matrix)
        values = np.linalg.eigvalsh(np.moveaxis(spread + noise, (0, 1), (-2, -1)))
        if (values[..., 0] <= SINGULAR * values[..., -1]).any():
            raise ValueError(f"sensor_noise: a prediction has no spread at t = {when(state.time)}")
        known = branches.mean, branches.cov, y[:, None], Moments(predicted, cross, spread + noise)
        with np.errstate(over="ignore", invalid="ignore"):
            mean, cov, loglik = update(*known, noise=lambda: noise)
            log_unit = branches.log_unit + loglik
        mean = np.where(log_unit > -np.inf, mean, 0.0)  # where a measurement was out of all range
        return branches._replace(mean=mean, cov=cov, log_unit=log_unit)

    def _weighed(self, branches: Branches, state: PiecewiseState, update=False) -> PiecewiseState:
        """State from branches whose U are not normalised; after an update some are cut."""
        cells, size, batch = self.system.regions, self.system.regions.size, state.mean.shape[1:]
        log_unit, records = branches.log_unit, branches.log_unit.shape[1]
        bound = log_unit
        if size == 1:  # a mean d deviations outside of an interval: ln P <= -d²/2
            lower, upper = branches.regions[:, :, None]
            gap = np.maximum(np.maximum(lower - branches.mean[0], branches.mean[0] - upper), 0.0)
            bound = log_unit - 0.5 * gap**2 / np.maximum(branches.cov[0, 0], 1e-300)
        least = np.maximum(bound.max(axis=0) - NEGLIGIBLE, -1e300)
        branch, record = pair = np.nonzero(bound > least)
        mean, shared = branches.mean[:, branch, record], branches.cov.shape[3] == 1
        cov = branches.cov[:, :, branch, 0 if shared else record]
        inside = cells.moments(branches.regions, branch, mean[:size], cov[:size, :size])
        log_joint = np.full(log_unit.shape, -np.inf)
        log_joint[pair] = log_unit[pair] + inside.log_mass
        loglik = logsumexp(log_joint, axis=0)
        failed = ~(loglik > -np.inf)
        if failed.any() and not batch:
            raise ValueError(f"y: incompatible with every branch at t = {when(state.time)}")
        total = np.where(failed, 0.0, loglik)
        weight, log_unit, dropped = np.exp(log_joint - total), log_unit - total, np.zeros(records)
        if update and self.prune > 0.0:
            # in single precision, so that of weights that differ by rounding the first one goes
            order = np.argsort(weight.astype(np.float32), axis=0, kind="stable")
            rising = np.take_along_axis(weight, order, axis=0).cumsum(axis=0)
            small = np.take_along_axis(rising <= self.prune, np.argsort(order, axis=0), axis=0)
            dropped = np.where(small, weight, 0.0).sum(axis=0)
            log_unit = np.where(small, -np.inf, log_unit - np.log1p(-dropped))
            weight = np.where(small, 0.0, weight / (1.0 - dropped))

        def summed(values: np.ndarray) -> np.ndarray:
            """Sums (..., N) over the branches of values (..., F) of pairs, with their weights."""
            rows = (weight[pair] * values).reshape(int(np.prod(values.shape[:-1])), -1)
            rows = [np.bincount(record, row, records) for row in rows]
            return np.array(rows, dtype=float).reshape((*values.shape[:-1], records))

        # a region without mass has weight zero and moments NaN; moments are those of x, not of v
        whole, some = lift(inside, mean, cov), weight[pair] > 0.0
        mean, cov = np.where(some, whole.mean, 0.0), np.where(some, whole.cov, 0.0)
        if branches.shift.any() or (branches.slope != np.eye(len(mean))[..., None]).any():
            mean, cov = _mapped(branches.shift[:, branch], branches.slope[..., branch], mean, cov)
        estimate = summed(mean)
        gap = mean - estimate[:, record]
        cov, prob = summed(cov + gap[:, None] * gap), np.zeros((len(cells), records))
        np.add.at(prob, branches.cell, weight)
        for part in (estimate, cov, prob):
            part[..., failed] = np.nan

        branches = branches._replace(log_unit=log_unit)
        if dropped.any():
            kept = np.flatnonzero((log_unit > -np.inf).any(axis=1))
            regions = branches.regions[..., kept]
            branches, weight = branches.pieces(kept, branches.cell[kept], regions), weight[kept]
        loglik = np.where(state.diverged.ravel(), np.nan, loglik) if update else np.zeros(records)
        parts = (estimate, cov, prob, loglik, weight, dropped)
        parts = (part.reshape((*part.shape[:-1], *batch)) for part in parts)
        diverged = state.diverged | failed.reshape(batch)
        return PiecewiseState(state.time, *parts, diverged, branches)


def _from_branches(branches: Branches, c: Coefficients) -> list[np.ndarray]:
    """Offset, matrix and noise covariance of the map in the cell of a branch, as one of its v."""
    offset, matrix, noise = (part[..., branches.cell, :] for part in c)
    offset = offset + np.einsum("ijbd,jb->ibd", matrix, branches.shift)
    matrix = np.einsum("ijbd,jkb->ikbd", matrix, branches.slope)
    return [offset, matrix, np.einsum("ip...,jp...->ij...", noise, noise)]


def _mapped(offset, matrix, mean, cov) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance, exactly symmetric, after an affine map."""
    half = np.einsum("ij...,jk...->ik...", matrix, cov)
    full = np.einsum("ij...,kj...->ik...", half, matrix)
    mean = offset + np.einsum("ij...,j...->i...", matrix, mean)
    return mean, 0.5 * (full + full.swapaxes(0, 1))
