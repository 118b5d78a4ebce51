"""Square-root (array) recursion of the delay filter, for ill-conditioned problems.

The covariance is carried as ``Σ Σᵀ`` with the blocks of the stack oldest first, so that Σ stays
lower triangular. One orthogonal triangularisation does the prediction and the correction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from seedslib.base.semidefinite import square_root
from seedslib.delay.gains import StepGains, present_sensor
from seedslib.delay.system import DelaySystem


class RootCovariance(NamedTuple):
    """Instant k and a factor (D, D) of the covariance of the stacked state, oldest block first."""

    k: int
    root: np.ndarray

    def copy(self) -> RootCovariance:
        """Independent copy."""
        return RootCovariance(self.k, self.root.copy())


def start(system: DelaySystem) -> RootCovariance:
    """Factor before the first measurement, at k = 0."""
    blocks, n = system.max_delay + 1, system.state_size
    joint = system.start_cov().reshape(blocks, n, blocks, n)[::-1, :, ::-1]
    return RootCovariance(0, square_root(joint.reshape(blocks * n, blocks * n)))


def advance(
    system: DelaySystem, state: RootCovariance, missing: np.ndarray | None = None
) -> tuple[RootCovariance, StepGains]:
    """One prediction and correction by ``[[R^½, C W_0], [0, W]] = [[S^½, 0], [K S^½, Σ]] Θ``.

    W is the factor of the predicted covariance and W_0 its block of the newest instant.

    Raises
    ------
    ValueError
        The innovation covariance is singular.
    """
    k, n, m = state.k + 1, system.state_size, system.measurement_size
    c = system.step(k)
    sensor, noise = present_sensor(c, missing)
    size = state.root.shape[0]
    drive = c.noise_input @ square_root(c.noise_cov)

    array = np.zeros((m + size, m + size + drive.shape[1]))
    array[:m, :m] = np.linalg.cholesky(noise)
    array[m:-n, m : m + size] = state.root[n:]
    newest = array[-n:, m:]
    for d, a in c.dynamics.items():
        at = size - (d + 1) * n
        newest[:, :size] += a @ state.root[at : at + n]
    newest[:, size:] = drive
    array[:m, m:] = sensor @ newest
    predicted = newest @ newest.T

    # the order of the columns is free; with the large ones first the elimination keeps the digits
    # of the small ones
    order = np.argsort(-np.abs(array).max(axis=0), kind="stable")
    # the signs of its columns are free, and cancel in every product that leaves this function
    low = np.linalg.qr(array[:, order].T, mode="r").T
    pivot, root = low[:m, :m], low[m:, m:]
    if not np.abs(np.diag(pivot)).min() > 0.0:
        raise ValueError(f"innovation covariance at step {k}: wanted positive definite")
    gain = solve_triangular(pivot, low[m:, :m].T, lower=True, trans="T").T
    by_lag = gain.reshape(-1, n, m)[::-1]
    filtered = root[-n:] @ root[-n:].T
    return RootCovariance(k, root), StepGains(by_lag, pivot @ pivot.T, predicted, filtered)
