"""Plain Kalman recursion for the stacked state: the reference the fast forms are held against."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve

from seedslib.base.semidefinite import symmetrized
from seedslib.delay.gains import StepGains, innovation_factor, present_sensor
from seedslib.delay.system import DelaySystem


class DenseCovariance(NamedTuple):
    """Instant k and covariance (D, D) of the stacked state, newest block first."""

    k: int
    cov: np.ndarray

    def copy(self) -> DenseCovariance:
        """Independent copy."""
        return DenseCovariance(self.k, self.cov.copy())


def start(system: DelaySystem) -> DenseCovariance:
    """Covariance before the first measurement, at k = 0."""
    return DenseCovariance(0, system.start_cov())


def advance(
    system: DelaySystem, state: DenseCovariance, missing: np.ndarray | None = None
) -> tuple[DenseCovariance, StepGains]:
    """One prediction ``F P Fᵀ + W`` and one correction in Joseph's form.

    Raises
    ------
    ValueError
        The innovation covariance is not positive definite.
    """
    k, n = state.k + 1, system.state_size
    model = system.augmented(k)
    sensor, noise = present_sensor(system.step(k), missing)
    predicted = symmetrized(model.transition @ state.cov @ model.transition.T + model.noise)
    cross = predicted[:, :n] @ sensor.T
    inner = symmetrized(sensor @ cross[:n] + noise)
    gain = cho_solve(innovation_factor(inner, k), cross.T).T
    left = predicted - gain @ (sensor @ predicted[:n])
    cov = symmetrized(left - (left[:, :n] @ sensor.T - gain @ noise) @ gain.T)
    by_lag = gain.reshape(-1, n, system.measurement_size)
    return DenseCovariance(k, cov), StepGains(by_lag, inner, predicted[:n, :n], cov[:n, :n])
