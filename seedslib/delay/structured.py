"""Covariance recursion of the delay filter that moves nothing and multiplies no large matrices.

The covariance of the stacked state ``(x_k, ..., x_{k-N})`` sits in a ring: instant k occupies
block ``k mod (N+1)``, so the shift of the stack costs nothing and one step overwrites the oldest
block only. The correction is a symmetric rank-2m update of the lower triangle in place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve
from scipy.linalg.blas import dsyr2k

from seedslib.base.semidefinite import symmetrized
from seedslib.delay.gains import StepGains, innovation_factor, present_sensor
from seedslib.delay.system import DelaySystem


class RingCovariance(NamedTuple):
    """Instant k and covariance (D, D) in ring order, valid on and below the diagonal."""

    k: int
    cov: np.ndarray

    def copy(self) -> RingCovariance:
        """Independent copy."""
        return RingCovariance(self.k, self.cov.copy(order="F"))


def start(system: DelaySystem) -> RingCovariance:
    """Covariance before the first measurement, at k = 0."""
    blocks, n = system.max_delay + 1, system.state_size
    order = -np.arange(blocks) % blocks  # block of the ring -> lag
    joint = system.start_cov().reshape(blocks, n, blocks, n)[order][:, :, order]
    return RingCovariance(0, np.asfortranarray(joint.reshape(blocks * n, blocks * n)))


def advance(
    system: DelaySystem, state: RingCovariance, missing: np.ndarray | None = None
) -> tuple[RingCovariance, StepGains]:
    """One prediction and correction; the array of `state` is overwritten.

    The correction is Joseph's form ``(I-KH) Π (I-KH)ᵀ + K R Kᵀ``, which stays right for a gain
    that is not: with ``T = Π - K H Π`` it is ``T - V Kᵀ``, ``V = T Hᵀ - K R``. V is zero but for
    rounding; it is computed from block column 0 of T, because ``B - K S`` (the same on paper,
    ``B = Π Hᵀ``) has lost the digits that matter when S is nearly singular. The blocks of the
    newest instant, where the measurement bites, are written with ``I - K^{[0]} C`` multiplied
    out.

    Raises
    ------
    ValueError
        The innovation covariance is not positive definite.
    """
    k, cov = state.k + 1, state.cov
    c, n = system.step(k), system.state_size
    sensor, noise = present_sensor(c, missing)
    blocks = system.max_delay + 1
    here = (k % blocks) * n
    new = slice(here, here + n)

    # the new block row A Π, and its corner A Π Aᵀ + G Q Gᵀ, from the blocks the delays reach
    moves = [(a, ((k - 1 - d) % blocks) * n) for d, a in c.dynamics.items()]
    row = sum(a @ _rows(cov, at, n) for a, at in moves)
    corner = sum((row[:, at : at + n] @ a.T for a, at in moves), start=c.state_noise)
    row[:, new] = predicted = symmetrized(corner)

    cross = row.T @ sensor.T
    inner = symmetrized(sensor @ cross[new] + noise)
    root = innovation_factor(inner, k)
    # rows without a gap between them, as the update of the triangle wants them
    gain = np.ascontiguousarray(cho_solve(root, cross.T, check_finite=False).T)
    own = gain[new]
    keep = np.eye(n) - own @ sensor
    left = row.T - gain @ (sensor @ predicted)  # block column 0 of T = Π - K (C Π_0)
    left[new] = keep @ predicted
    rest = left @ sensor.T - gain @ noise
    cov[new, :here], cov[here:, new] = row[:, :here], row[:, here:].T
    cov = dsyr2k(-1.0, gain, 0.5 * (cross + rest), beta=1.0, c=cov, lower=1, overwrite_c=1)

    border = keep @ row - rest[new] @ gain.T
    filtered = symmetrized(keep @ predicted @ keep.T + own @ noise @ own.T)
    border[:, new] = filtered
    cov[new, :here], cov[here:, new] = border[:, :here], border[:, here:].T

    lags = (k - np.arange(blocks)) % blocks
    by_lag = gain.reshape(blocks, n, -1)[lags]
    return RingCovariance(k, cov), StepGains(by_lag, inner, predicted, filtered)


def _rows(cov: np.ndarray, at: int, n: int) -> np.ndarray:
    """Full block row (n, D) of a symmetric matrix of which the lower triangle is valid."""
    end = at + n
    rows = np.empty((n, len(cov)))
    rows[:, :at] = cov[at:end, :at]
    low = np.tril(cov[at:end, at:end])
    rows[:, at:end] = low + np.tril(low, -1).T
    rows[:, end:] = cov[end:, at:end].T
    return rows
