"""State of the piecewise-linear filter, the bound of what pruning costs, and a check of noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.base.clock import when
from seedslib.piecewise.branches import Branches
from seedslib.piecewise.coefficients import Coefficients
from seedslib.piecewise.weights import CellLaw

_SINGULAR = 1e-13


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
    lost : ndarray, shape (*batch)
        Ratio of dropped to kept mass that pruning can have caused so far, at most; the
        recursion of `PiecewiseLinearFilter`. NaN once a transition was not exact.
    distance : ndarray, shape (*batch)
        Projective distance that merging can have caused so far, at most.
    diverged : ndarray of bool, shape (*batch)
        Data sets whose measurement no branch could explain.
    branches : Branches
        One axis of data sets, whatever the batch.
    law : CellLaw
        Moments of x in every branch, before merging.
    """

    time: float | None
    mean: np.ndarray
    cov: np.ndarray
    mode_prob: np.ndarray
    loglik: np.ndarray
    weights: np.ndarray
    lost: np.ndarray
    distance: np.ndarray
    diverged: np.ndarray
    branches: Branches
    law: CellLaw

    @property
    def error_bound(self) -> np.ndarray:
        """Guaranteed bound of the total variation to the exact posterior law, (*batch)."""
        return 1.0 - 1.0 / (1.0 + self.lost) + np.tanh(0.25 * self.distance)

    def noticeable(self, threshold: float, *, relative: bool = True) -> np.ndarray:
        """Number of branches whose weight reaches a threshold, shape (*batch).

        Parameters
        ----------
        threshold : float
        relative : bool
            Whether the threshold is a fraction of the largest weight.
        """
        top = self.weights.max(axis=0) if relative else 1.0
        return (self.weights >= threshold * top).sum(axis=0)


def lost_mass(
    lost: np.ndarray, share: np.ndarray, distance: np.ndarray, log_ratio: np.ndarray
) -> np.ndarray:
    """One step of the bound of the ratio between dropped and kept mass."""
    with np.errstate(over="ignore", invalid="ignore"):
        grown = np.where(lost > 0.0, lost * np.exp(log_ratio + distance), 0.0)
        dropped = share * np.exp(distance)
        kept = 1.0 - np.where(dropped < 1.0, dropped, 0.0)
        return np.where(dropped < 1.0, (grown + dropped) / kept, np.inf)


def check_noise(c: Coefficients, innovation: np.ndarray, t: float, bounded: bool) -> None:
    """Refuse predicted measurements without spread, whose likelihoods cannot be compared."""
    noise = np.einsum("ipnd,jpnd->ndij", c.noise, c.noise)
    if not _singular(noise):
        return
    if bounded:
        raise ValueError(
            "prune: the bound needs sensor noise in every component, H H' is singular at t = "
            f"{when(t)}"
        )
    if _singular(np.moveaxis(innovation, (0, 1), (-2, -1))):
        raise ValueError(
            f"sensor_noise: a predicted measurement has no spread at t = {when(t)}; wanted H H' "
            "such that B V B' + H H' is positive definite on every branch"
        )


def _singular(matrices: np.ndarray) -> bool:
    values = np.linalg.eigvalsh(matrices)
    return bool((values[..., 0] <= _SINGULAR * values[..., -1]).any())
