"""Weights of branches, moments of their mixture, pruning with a guaranteed bound."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.base.correction import correct
from seedslib.gaussian.regions import lift
from seedslib.linearization.moments import Moments
from seedslib.piecewise.branches import Branches
from seedslib.piecewise.coefficients import Coefficients

_FIRST = 3.0  # log-weight below the best bound down to which branches are evaluated at once


class Weighed(NamedTuple):
    """Joint log-weights of branches and the moments of those that matter.

    Attributes
    ----------
    log_joint : ndarray, shape (B, N)
        ``ln U + ln P``; -inf for branches proven to be negligible.
    branch, dataset : ndarray of int, shape (F,)
        The pairs that were evaluated.
    mean, cov : ndarray, shapes (k, F) and (k, k, F)
        Moments of x in those pairs.
    """

    log_joint: np.ndarray
    branch: np.ndarray
    dataset: np.ndarray
    mean: np.ndarray
    cov: np.ndarray


class CellLaw(NamedTuple):
    """Mixture of conditioned laws: what was weighed, its weights (B, N), and the cells (B,)."""

    weighed: Weighed
    weight: np.ndarray
    cell: np.ndarray


def weigh_branches(branches: Branches, neglect: float) -> Weighed:
    """Masses and conditioned moments of the branches that can matter.

    Each log-weight is first bounded from above without an integral. The best branches are
    evaluated; then all whose bounds are above a share ``neglect / B`` of the mass found, so
    that what is left out is at most `neglect` of the whole, for every data set by itself.
    """
    size, count = len(branches.shift), len(branches.log_unit)
    with np.errstate(invalid="ignore"):
        bound = branches.log_unit + branches.regions.log_mass_bound(
            branches.mean[:size], branches.cov[:size, :size]
        )
    bound[~(branches.log_unit > -np.inf)] = -np.inf
    log_joint = np.full(bound.shape, -np.inf)
    chosen = (bound >= bound.max(axis=0) - _FIRST) & (bound > -np.inf)
    first = _evaluate(branches, chosen, log_joint)
    found = log_sum(log_joint)
    floor = found + np.log(neglect / count) if neglect > 0.0 else np.full(found.shape, -np.inf)
    second = _evaluate(branches, (bound > floor) & ~chosen, log_joint)
    return Weighed(
        log_joint, *(np.concatenate(p, axis=-1) for p in zip(first, second, strict=True))
    )


def log_sum(log_joint: np.ndarray) -> np.ndarray:
    """Logarithm of the sum over the branches; -inf where all are -inf."""
    top = log_joint.max(axis=0)
    top = np.where(top > -np.inf, top, 0.0)
    with np.errstate(divide="ignore"):
        return top + np.log(np.exp(log_joint - top).sum(axis=0))


def mixture(law: CellLaw) -> tuple[np.ndarray, np.ndarray]:
    """Mean (k, N) and covariance (k, k, N)."""
    return _grouped(law, law.weighed.dataset, law.weight.shape[1])[1:]


def by_cell(law: CellLaw, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weight, mean and covariance of the law in every cell: (n, N), (k, n, N), (k, k, n, N)."""
    shape = (count, law.weight.shape[1])
    group = law.cell[law.weighed.branch] * shape[1] + law.weighed.dataset
    total, mean, cov = _grouped(law, group, shape[0] * shape[1])
    return total.reshape(shape), mean.reshape(-1, *shape), cov.reshape(*cov.shape[:2], *shape)


def cell_probabilities(law: CellLaw, count: int) -> np.ndarray:
    """Probability of every cell, shape (n, N)."""
    probability = np.zeros((count, law.weight.shape[1]))
    order = np.argsort(law.cell, kind="stable")
    present, start = np.unique(law.cell[order], return_index=True)
    probability[present] = np.add.reduceat(law.weight[order], start, axis=0)
    return probability


def prune(weight: np.ndarray, share: float, keep: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Branches to drop, the smallest first, for each data set.

    Those that together hold at most `share` of the weight, and all but the `keep` largest.

    Returns
    -------
    dropped : ndarray of bool, shape (B, N)
    lost : ndarray, shape (N,)
        Weight of what is dropped.
    """
    # in single precision, so that of weights that differ by rounding the smallest index goes first
    order = np.argsort(weight.astype(np.float32), axis=0, kind="stable")
    held = np.take_along_axis(weight, order, axis=0).cumsum(axis=0)
    small = held <= share
    if keep is not None:
        small[: max(0, len(weight) - keep)] = True
    dropped = np.empty_like(small)
    np.put_along_axis(dropped, order, small, axis=0)
    return dropped, np.where(dropped, weight, 0.0).sum(axis=0)


def log_peak(c: Coefficients, y: np.ndarray) -> np.ndarray:
    """Largest value that a likelihood factor can take, ``ln J``, shape (N,).

    The density of the sensor noise at zero, of the components of y (m, N) that are present, and
    of the cell where it is largest.
    """
    noise = np.einsum("ipnd,jpnd->ijnd", c.noise, c.noise)
    zero, shown = np.zeros((len(y), 1, 1)), np.where(np.isnan(y), np.nan, 0.0)[:, None]
    moments = Moments(zero, np.zeros((len(y), len(y), 1, 1)), noise)
    loglik = correct(zero, None, shown, moments)[2]
    return np.broadcast_to(loglik, (noise.shape[2], y.shape[1])).max(axis=0)


def _evaluate(branches: Branches, chosen: np.ndarray, log_joint: np.ndarray) -> tuple:
    """Moments of x in the chosen pairs; their log-weights are written into `log_joint`."""
    branch, dataset = np.nonzero(chosen)
    size, order = len(branches.shift), len(branches.mean)
    if not branch.size:
        return branch, dataset, np.zeros((order, 0)), np.zeros((order, order, 0))
    mean = branches.mean[:, branch, dataset]
    shared = branches.cov.shape[-1] == 1
    cov = branches.cov[:, :, branch, 0 if shared else dataset]
    inside = branches.regions.moments(branch, mean[:size], cov[:size, :size])
    log_joint[branch, dataset] = branches.log_unit[branch, dataset] + inside.log_mass
    whole = lift(inside, mean, cov)
    mean, cov = whole.mean, whole.cov
    slope = branches.slope[:, :, branch]
    if (slope != np.eye(size)[:, :, None]).any() or branches.shift.any():
        lead = branches.shift[:, branch] + np.einsum("ijf,jf->if", slope, mean[:size])
        mean, cov = np.concatenate([lead, mean[size:]]), cov.copy()
        cov[:size] = np.einsum("ijf,jkf->ikf", slope, cov[:size])
        cov[:, :size] = np.einsum("ijf,kjf->ikf", cov[:, :size], slope)
    return branch, dataset, mean, cov


def _grouped(
    law: CellLaw, group: np.ndarray, groups: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Total weight, mean and covariance of groups of pairs; zeros where a group has no weight."""
    weighed = law.weighed
    pair = law.weight[weighed.branch, weighed.dataset]
    order = len(weighed.mean)
    # a region without mass has weight zero and moments NaN
    inside = np.where(pair > 0.0, weighed.mean, 0.0)
    spread = np.where(pair > 0.0, weighed.cov, 0.0)

    def collect(values: np.ndarray) -> np.ndarray:
        return np.bincount(group, pair * values, minlength=groups)

    total = np.bincount(group, pair, minlength=groups)
    divisor = np.where(total > 0.0, total, 1.0)
    mean = np.stack([collect(row) for row in inside]) / divisor
    offset = inside - mean[:, group]
    cov = np.empty((order, order, groups))
    for i in range(order):
        for j in range(i + 1):
            cov[i, j] = cov[j, i] = collect(spread[i, j] + offset[i] * offset[j]) / divisor
    return total, mean, cov
