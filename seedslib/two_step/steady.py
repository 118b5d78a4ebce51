"""Where the laws of state and estimate settle under constant coefficients."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, solve_continuous_are, solve_continuous_lyapunov

from seedslib.models.propagation import balanced
from seedslib.two_step.linear import PlantMatrices, needed
from seedslib.two_step.riccati import information_rate

UNDAMPED = 1e-10
"""Part of the largest rate, or singular value, that is none."""


def steady_errors(known: PlantMatrices) -> np.ndarray:
    """Steady error covariance (n, n): the stabilising solution of the Riccati equation.

    Raises
    ------
    ValueError
        See `KalmanBucyFilter.steady_error_cov`.
    """
    m, n = known.sensor.shape
    information = information_rate(known, np.ones(m, bool))
    unit, drift, _, diffusion = balanced(known.drift, information, known.diffusion)
    # white measurements: unit intensity
    sensor = np.linalg.solve(np.linalg.cholesky(known.sensor_intensity), known.sensor) * unit
    margin = UNDAMPED * np.abs(drift).max()
    for value in np.linalg.eigvals(drift):
        shifted = value * np.eye(n) - drift
        if value.real >= -margin and _deficient(np.vstack([shifted, sensor])):
            raise ValueError(
                "system: wanted a detectable pair (drift, sensor) for a steady error "
                f"covariance, but the sensor does not see the mode of eigenvalue {value:.4g}"
            )
        if abs(value.real) <= margin and _deficient(np.hstack([shifted, diffusion])):
            raise ValueError(
                "system: wanted every undamped mode reached by noise for a steady error "
                f"covariance, but the mode of eigenvalue {value:.4g} is not"
            )
    try:
        cov = solve_continuous_are(drift.T, sensor.T, diffusion, np.eye(m), balanced=False)
    except (LinAlgError, ValueError) as error:
        raise ValueError(
            f"system: the equation of the steady error covariance cannot be solved: {error}"
        ) from error
    return 0.5 * (cov + cov.T) * unit[:, None] * unit


def steady_law(
    known: PlantMatrices, components: ArrayLike | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steady mean (1, n), prior covariance and error covariance (1, n, n) of some components.

    Raises
    ------
    ValueError
        See `KalmanBucyFilter.steady_moments`.
    """
    n = len(known.drift)
    here = np.ones(n, bool)
    if components is not None and np.linalg.eigvals(known.drift).real.max() >= 0:
        here = needed(known.drift, np.asarray(components, bool))
    block = np.ix_(here, here)
    drift, diffusion = known.drift[block], known.diffusion[block]
    values = np.linalg.eigvals(drift)
    if values.real.max() >= 0:
        raise ValueError(
            "drift: wanted eigenvalues with negative real parts (Hurwitz) for a steady "
            f"covariance of the state, got {values[values.real.argmax()]:.4g}"
        )
    cov = solve_continuous_lyapunov(drift, -diffusion)
    prior, errors = np.zeros((2, 1, n, n))
    prior[0][block] = 0.5 * (cov + cov.T)
    if here.all():
        errors[0] = steady_errors(known)
    else:  # without the components that neither these nor the sensor see
        kept = needed(known.drift, here | (known.sensor != 0.0).any(axis=0))
        seen, whole = np.ix_(kept, kept), np.zeros((n, n))
        part = known.drift[seen], known.diffusion[seen], known.sensor[:, kept]
        whole[seen] = steady_errors(PlantMatrices(*part, known.sensor_intensity))
        errors[0][block] = whole[block]
    return np.zeros((1, n)), prior, errors


def _deficient(pencil: np.ndarray) -> bool:
    """Whether the rank is below the smaller side, as far as rounding lets one tell."""
    values = np.linalg.svd(pencil, compute_uv=False)
    return bool(values[-1] <= UNDAMPED * values[0])
