"""Stationary gains of the delay filter from one spectral factor, without a Riccati equation.

For a scalar measurement and a stable plant all smoothing gains K^{[0]}, ..., K^{[N]} of the
steady state are Fourier coefficients of one function on the unit circle, the solution of a
Riemann boundary value problem (`seedslib.riemann.wiener_gain`). The stacked matrices do not occur.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.delay.system import DelaySystem
from seedslib.models.kinds import as_system
from seedslib.riemann import wiener_gain


class StationaryGains(NamedTuple):
    """Steady state: gain (N+1, n, 1), innovation_cov (1, 1), predicted and cov (n, n), nodes M."""

    gain: np.ndarray
    innovation_cov: np.ndarray
    predicted: np.ndarray
    cov: np.ndarray
    nodes: int


def stationary_gains(system: DelaySystem, nodes: int | None = None) -> StationaryGains:
    """Gains to which those of `DelayKalmanFilter` converge.

    Parameters
    ----------
    system : DelaySystem
        Constant coefficients, one measurement component, all characteristic roots inside the
        unit circle.
    nodes : int, optional
        Number M of points on the circle; by default doubled until the spectra are resolved.

    Returns
    -------
    StationaryGains

    Raises
    ------
    TypeError, ValueError
        The system is time-varying, has several measurement components, is not stable, or has a
        characteristic root so near the unit circle that the spectra are not resolved.

    Notes
    -----
    Stability is read off the winding number of ``det(I - sum_d A_d t^{d+1})``, which counts the
    roots outside the unit circle: on an unstable plant the spectra still exist formally and would
    give wrong gains. The cost is n³M for the spectra and M log M for the rest.
    """
    as_system("system", system, "DelaySystem")
    if not system.constant:
        raise ValueError("system: wanted constant coefficients")
    if system.measurement_size != 1:
        raise ValueError(f"system: wanted one measurement component, got {system.measurement_size}")
    step = system.step(1)
    transition = np.zeros((system.max_delay + 1, system.state_size, system.state_size))
    transition[list(step.dynamics)] = list(step.dynamics.values())
    try:
        steady = wiener_gain(
            transition, step.sensor, step.state_noise, step.sensor_cov[0, 0], nodes=nodes
        )
    except ValueError as error:
        raise ValueError(f"system: no stationary gains, {error}") from None
    gain, inner = steady.lag_gains[..., None], np.array([[steady.innovation]])
    predicted = steady.cov + gain[0] @ inner @ gain[0].T
    return StationaryGains(gain, inner, predicted, steady.cov, steady.nodes)
