"""Extended Kalman-Bucy filter of a linear diffusion augmented by a function of its state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_shape, as_times
from seedslib.base.clock import when
from seedslib.two_step.augmented import AugmentedDiffusion
from seedslib.two_step.kalman_bucy import KalmanBucyFilter


class AugmentedPaths(NamedTuple):
    """Estimates of z (K+1, N) along paths and the variances (K+1, N) that the filter claims."""

    mean: np.ndarray
    variance: np.ndarray


def augmented_extended_kalman(
    augmented: AugmentedDiffusion, times: ArrayLike, increments: ArrayLike
) -> AugmentedPaths:
    """Extended Kalman-Bucy filter of the pair (x, z) along measured paths.

    The measurement does not contain z, so the estimate of x and its covariance are those of the
    Kalman-Bucy filter; only the estimate of z, its covariance with x and its variance depend on
    the linearisation. Over a step comes first a discrete correction, which is stable for a
    precise sensor, and then Euler's method for the drift.

    Parameters
    ----------
    augmented : AugmentedDiffusion
    times : array_like
        Grid, shape (K+1,), from time 0.
    increments : array_like
        Shape (K, m, N).

    Returns
    -------
    AugmentedPaths

    Raises
    ------
    NoClosedForm
        The moments of z at time 0 have no closed form.
    TypeError, ValueError
        An illegal grid or increments; steps that are not short.
    """
    times = as_times("times", times)
    if times[0] != 0:
        raise ValueError(f"times: wanted a grid from time 0, got {when(times[0])}")
    system = augmented.system
    increments = as_shape("increments", increments, (times.size - 1, system.measurement_size, -1))
    state = KalmanBucyFilter(system).run(times, increments)
    known = system.matrices(0.0)
    first, mixed, spread = augmented.initial_moments()
    paths = increments.shape[2]
    mean, variance = np.empty((2, times.size, paths))
    mean[0], variance[0] = first, spread
    cross = np.tile(mixed[:, None], (1, paths))
    for k, step in enumerate(np.diff(times)):
        cov = state.cov[k]
        seen = known.sensor @ cross
        innovation_cov = known.sensor @ cov @ known.sensor.T + known.sensor_intensity / step
        gain = np.linalg.solve(innovation_cov, seen)
        innovation = increments[k] / step - known.sensor @ state.mean[k]
        value = mean[k] + np.sum(gain * innovation, axis=0)
        spread = variance[k] - np.sum(gain * seen, axis=0)
        cross = cross - cov @ known.sensor.T @ gain
        drift, by_state, by_value, noise, power = augmented.functions(state.mean[k + 1], value)
        mean[k + 1] = value + drift * step
        grown = 2 * (np.sum(by_state * cross, axis=0) + by_value * spread) + power
        variance[k + 1] = spread + grown * step
        grown = state.cov[k + 1] @ by_state + by_value * cross + known.drift @ cross + noise
        cross = cross + grown * step
    return AugmentedPaths(mean, variance)
