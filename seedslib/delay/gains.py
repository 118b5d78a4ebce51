"""What every covariance recursion of the delay filter gives, and how a missing value enters it."""

from __future__ import annotations

from types import ModuleType
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor

from seedslib.delay.coefficients import InstantStep, require_finite
from seedslib.delay.system import DelaySystem


class StepGains(NamedTuple):
    """One instant: gain (N+1, n, m), innovation_cov (m, m), predicted and cov (n, n).

    Block s of the gain corrects x_{k-s}; block 0 is the filter's own.
    """

    gain: np.ndarray
    innovation_cov: np.ndarray
    predicted: np.ndarray
    cov: np.ndarray


class DelayGains(NamedTuple):
    """Gains and covariances for k = 0..K; they do not depend on the data.

    Attributes
    ----------
    gain : ndarray, shape (K+1, N+1, n, m)
        Entry [k, s] is K_k^{[s]}, the gain of the measurement of instant k for x_{k-s}: the
        filter's for s = 0, the smoother's of lag s otherwise. Zero for a missing component.
    innovation_cov : ndarray, shape (K+1, m, m)
        S_k, with a unit pivot in place of a missing component.
    predicted, cov : ndarray, shape (K+1, n, n)
        Covariance of x_k given the measurements before k, and up to k.
    method : str
        The recursion that was used, with the reason where it is not the one asked for.
    """

    gain: np.ndarray
    innovation_cov: np.ndarray
    predicted: np.ndarray
    cov: np.ndarray
    method: str

    def lagged_cov(self, lag: int) -> np.ndarray:
        """Covariance of x_k given the measurements up to ``min(k + lag, K)``, shape (K+1, n, n).

        Each later measurement takes ``K^{[s]} S K^{[s]T}`` off the filter's covariance.
        """
        cov = self.cov.copy()
        for s in range(1, min(lag, len(cov) - 1) + 1):
            gain = self.gain[s:, s]
            cov[:-s] -= gain @ self.innovation_cov[s:] @ gain.swapaxes(1, 2)
        return cov


def empty_gains(steps: int, blocks: int, cov: np.ndarray, m: int, method: str) -> DelayGains:
    """Table of K = `steps` instants whose entry 0 is the start, where nothing is measured."""
    n = len(cov)
    gain, inner = np.zeros((steps + 1, blocks, n, m)), np.empty((steps + 1, m, m))
    table = DelayGains(gain, inner, *np.empty((2, steps + 1, n, n)), method)
    table.innovation_cov[0] = np.eye(m)
    table.predicted[0] = table.cov[0] = cov
    return table


def present_sensor(step: InstantStep, missing: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Sensor and its noise covariance with missing components switched off.

    A missing component measures nothing (zero row) with an independent noise of variance one:
    its gain is zero and its pivot one, so the others are treated exactly.
    """
    if missing is None or not missing.any():
        return step.sensor, step.sensor_cov
    present = ~missing
    noise = np.where(np.outer(present, present), step.sensor_cov, 0.0)
    noise[missing, missing] = 1.0
    return np.where(present[:, None], step.sensor, 0.0), noise


def advanced(
    engine: ModuleType, system: DelaySystem, state: object, missing: np.ndarray | None, k: int
) -> tuple[object, StepGains]:
    """Step k of a recursion, refused where it overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        state, now = engine.advance(system, state, missing)
    require_finite("covariances", k, *now)
    return state, now


def innovation_factor(inner: np.ndarray, k: int) -> tuple[np.ndarray, bool]:
    """Cholesky factor of an innovation covariance.

    Raises
    ------
    ValueError
        It is not positive definite.
    """
    require_finite("covariances", k, inner)
    try:
        return cho_factor(inner, lower=True, check_finite=False)
    except np.linalg.LinAlgError:
        raise ValueError(
            f"innovation covariance at step {k}: wanted positive definite, "
            f"got eigenvalue {np.linalg.eigvalsh(inner)[0]:.3g}"
        ) from None
