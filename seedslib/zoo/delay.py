"""Systems with delay on which the filters are compared; each call builds a new system."""

from __future__ import annotations

import numpy as np

from seedslib.delay.system import DelaySystem


def delayed_scalar(near: float, far: float, sensor_var: float = 1.0, delay: int = 1) -> DelaySystem:
    """One component, ``x_k = near x_{k-1} + far x_{k-1-delay} + w``, unit variances otherwise."""
    dynamics = {0: near, delay: far} if delay else {0: near + far}
    return DelaySystem(dynamics, 1.0, 1.0, sensor_var, cov0=1.0, history_cov=1.0)


def delayed_oscillator(damping: float = 0.7, delay: int = 3) -> DelaySystem:
    """Oscillator turning by 0.5 rad a step, with a delayed coupling, measured in one component.

    Stable for damping 0.7 and delay 3 (spectral radius 0.972), unstable for damping 0.8.
    """
    cos, sin = np.cos(0.5), np.sin(0.5)
    turn = np.array([[cos, sin], [-sin, cos]])
    return _plane({0: damping * turn, delay: [[0.1, 0.3], [-0.2, 0.1]]}, history=0.5)


def precise_sensor() -> DelaySystem:
    """Stable system E2 (spectral radius 0.946), delay 2, on which structure (6) does badly."""
    dynamics = {0: [[0.0, -0.75], [-0.5, 1.0]], 2: [[0.0, -0.5], [0.0, -1.0]]}
    return _plane(dynamics, sensor_var=0.1)


def two_noises() -> DelaySystem:
    """Stable system E1 (spectral radius 0.954), delay 1, on which greedy gains are unstable."""
    dynamics = {0: [[0.5, 0.75], [1.0, 0.75]], 1: [[-0.75, -1.0], [0.5, 0.5]]}
    return _plane(dynamics, drive=np.eye(2))


def _plane(dynamics: dict, history: float = 1.0, sensor_var: float = 1.0, drive=((0,), (1,))):
    """Two components of which the first is measured; unit variances but for the named ones."""
    noise_cov = np.eye(np.shape(drive)[1])
    return DelaySystem(
        dynamics, [[1, 0]], noise_cov, sensor_var, np.eye(2), history, noise_input=drive
    )
