"""Plants with delays on which the filters are compared; each call builds a new system."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from seedslib.delay.system import DelaySystem


def scalar(near: float, far: float, sensor_var: float = 1.0, delay: int = 1) -> DelaySystem:
    """One component, ``x_k = near x_{k-1} + far x_{k-1-delay} + w``, unit variances otherwise."""
    return DelaySystem(
        {0: near, delay: far} if delay else {0: near + far}, sensor=1.0, noise_cov=1.0,
        sensor_cov=sensor_var, cov0=1.0, history_cov=1.0 if delay else None,
    )  # fmt: skip


def rotation(damping: float = 0.7, delay: int = 3) -> DelaySystem:
    """Oscillator turning by 0.5 rad a step with a delayed coupling; its first component is seen.

    Stable for damping 0.7 and delay 3 (spectral radius 0.972), unstable for damping 0.8.
    """
    return _plane({0: damping * _turn(0.5), delay: [[0.1, 0.3], [-0.2, 0.1]]}, history=0.5)


def precise_sensor() -> DelaySystem:
    """Stable plant E2 (spectral radius 0.946), delay 2, on which structure (6) does badly."""
    dynamics = {0: [[0.0, -0.75], [-0.5, 1.0]], 2: [[0.0, -0.5], [0.0, -1.0]]}
    return _plane(dynamics, sensor_cov=0.1)


def two_noises() -> DelaySystem:
    """Stable plant E1 (spectral radius 0.954), delay 1, on which greedy gains are unstable."""
    dynamics = {0: [[0.5, 0.75], [1.0, 0.75]], 1: [[-0.75, -1.0], [0.5, 0.5]]}
    return _plane(dynamics, noise_cov=np.eye(2), noise_input=None)


def nearly_parallel_sensors() -> DelaySystem:
    """Two sensors that differ by 1e-7, noise variance 1e-12, start variance 1e6; delay 4.

    An ill-conditioned plant: a recursion of covariances in double precision keeps five digits.
    """
    return _plane(
        {0: 0.7 * _turn(0.5), 4: [[0.1, 0.3], [-0.2, 0.1]]}, start=1e6, history=1e6,
        sensor=[[1.0, 0.0], [1.0, 1e-7]], noise_cov=1e-4, sensor_cov=1e-12 * np.eye(2),
    )  # fmt: skip


def random_plants(count: int, seed: int = 11) -> Iterator[DelaySystem]:
    """Stable plants with delays 0 and N, of 1 to 3 components and N from 1 to 6.

    In this order are drawn: n, N, m (at most n); A, Ā, C standard normal; G (n, 1); the common
    sensor variance, 0.1 to 10; the spectral radius, 0.6 to 0.98, to which A and Ā are scaled.
    """
    rng = np.random.default_rng(seed)
    for _ in range(count):
        n, delay = int(rng.integers(1, 4)), int(rng.integers(1, 7))
        m = int(rng.integers(1, n + 1))
        near, far = rng.standard_normal((n, n)), rng.standard_normal((n, n))
        sensor, noise_input = rng.standard_normal((m, n)), rng.standard_normal((n, 1))
        sensor_var = 10.0 ** rng.uniform(-1.0, 1.0)
        scale = _scale_to(near, far, delay, rng.uniform(0.6, 0.98))
        yield DelaySystem(
            {0: scale * near, delay: scale * far}, sensor, 1.0, sensor_var * np.eye(m),
            np.eye(n), 0.3 * np.eye(n), noise_input=noise_input,
        )  # fmt: skip


def spectral_radius(system: DelaySystem) -> float:
    """Largest modulus of the characteristic roots, from the stacked matrix."""
    return float(np.abs(np.linalg.eigvals(system.augmented().transition)).max())


def _plane(
    dynamics: dict, *, start: float = 1.0, history: float = 1.0, **others: object
) -> DelaySystem:
    """Plant of two components: unless `others` say otherwise the first is seen, the second driven.

    With unit variances, and x_0 and its history of `start` and `history` times the identity.
    """
    usual = {
        "sensor": [[1.0, 0.0]], "noise_cov": 1.0, "sensor_cov": 1.0, "noise_input": [[0.0], [1.0]],
    }  # fmt: skip
    cov0, history_cov = start * np.eye(2), history * np.eye(2)
    return DelaySystem(dynamics, cov0=cov0, history_cov=history_cov, **(usual | others))


def _turn(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, sin], [-sin, cos]])


def _scale_to(near: np.ndarray, far: np.ndarray, delay: int, wanted: float) -> float:
    """Common factor of both matrices, by bisection, that gives the wanted spectral radius."""
    n = len(near)
    stacked = np.eye((delay + 1) * n, k=-n)

    def radius(factor: float) -> float:
        stacked[:n] = 0.0
        stacked[:n, :n] = factor * near
        stacked[:n, -n:] += factor * far
        return np.abs(np.linalg.eigvals(stacked)).max()

    low, high = 0.0, 1.0
    while radius(high) < wanted:
        high *= 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < wanted else (low, middle)
    return 0.5 * (low + high)
