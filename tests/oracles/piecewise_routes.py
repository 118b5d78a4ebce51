"""Systems of the tests of the piecewise-linear filter, and routes to its answers without it.

There is no Kalman recursion on restricted laws here.
"""

from itertools import pairwise

import numpy as np
import pytest
import sympy as sp

from seedslib.piecewise import PiecewiseLinearSystem
from seedslib.piecewise.cells import line_cells

INF = np.inf


def panels(edges, per_panel=1, order=60):
    """Gauss-Legendre nodes and weights between consecutive edges."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    edges = np.concatenate(
        [np.linspace(a, b, per_panel, endpoint=False) for a, b in pairwise(edges)] + [edges[-1:]]
    )
    half, middle = 0.5 * np.diff(edges), 0.5 * (edges[:-1] + edges[1:])
    return (middle[:, None] + half[:, None] * nodes).ravel(), (half[:, None] * weights).ravel()


def posterior(points, log_prior, weights, move, sensor, noise, y):
    """Mean, variance and log-likelihood at every time, by summing over deterministic paths."""
    weight = weights * np.exp(log_prior)
    weight = weight / weight.sum()
    x, out = points.copy(), []
    for value in y:
        x = move(x)
        if np.isfinite(value):
            density = np.exp(-0.5 * ((value - sensor(x)) / noise) ** 2) / noise / np.sqrt(2 * np.pi)
        else:
            density = np.ones_like(x)
        total = (weight * density).sum()
        weight = weight * density / total
        mean = (weight * x).sum()
        out.append((mean, (weight * (x - mean) ** 2).sum(), np.log(total)))
    return np.array(out).T


def kalman(system, y):
    """Plain Kalman filter with the coefficients of the first cell."""
    mean, cov, out = system.mean0, system.cov0, []
    for t, value in enumerate(y, start=1):
        a, A, G = (part[..., 0, 0] for part in system.dynamics_at(t - 1))
        b, B, H = (part[..., 0, 0] for part in system.sensor_at(t))
        mean, cov = a + A @ mean, A @ cov @ A.T + G @ G.T
        spread = B @ cov @ B.T + H @ H.T
        gain, error = np.linalg.solve(spread, B @ cov).T, value - b - B @ mean
        density = error @ np.linalg.solve(spread, error) + np.linalg.slogdet(2 * np.pi * spread)[1]
        mean, cov = mean + gain @ error, cov - gain @ spread @ gain.T
        out.append((mean, cov, -0.5 * density))
    return [np.stack(part) for part in zip(*out, strict=True)]


def compare(estimates, route, dataset, tolerance):
    """Mean in posterior deviations and ulps, variance relative, log-likelihood absolute."""
    mean, var, loglik = route
    error = np.abs(estimates.mean[1:, 0, dataset] - mean)
    assert (error <= tolerance * np.sqrt(var) + 1e-15 * np.abs(mean)).all()
    assert estimates.cov[1:, 0, 0, dataset] == pytest.approx(var, rel=tolerance, abs=1e-15)
    assert estimates.loglik[1:, dataset] == pytest.approx(loglik, abs=tolerance)


def tent(**changes):
    parts = {
        "regions": [-INF, 0.0, INF],
        "dynamics": ([[1.0, 1.0]], [[[1.8, -1.8]]]),
        "sensor": ([[0.0, 0.0]], [[[-1.0, 1.0]]]),
        "sensor_noise": [[0.2]],
        "mean0": [0.1],
        "cov0": [[0.25]],
    }
    return PiecewiseLinearSystem(**(parts | changes))


def tent_nodes(steps):
    """Nodes between all points that some iterate of the tent map sends to its kink."""
    kinks = level = np.zeros(1)
    for _ in range(steps):
        level = np.concatenate([(1 - level) / 1.8, (level - 1) / 1.8])
        kinks = np.concatenate([kinks, level])
    kinks = np.unique(kinks[np.abs(kinks - 0.1) < 6.0])
    return panels(np.concatenate([[-5.9], kinks[np.abs(kinks - 0.1) < 5.9], [6.1]]), 6, 24)


def measurements(values):
    """Records with nothing measured at the first time; values (K, N) or (K,)."""
    values = np.asarray(values, dtype=float)
    return np.concatenate([np.full((1, 1, *values.shape[1:]), np.nan), values[:, None]])


def falling(start, noise):
    """Angles of a body that starts at range `start` and angle 0.1; noise (runs, 10)."""
    t = np.arange(1, noise.shape[1] + 1)[:, None]
    return measurements(0.1 - 0.005 * t**2 / start + 1e-3 * noise.T)


def saturation():
    return PiecewiseLinearSystem(
        regions=[-INF, -1.0, 1.0, INF],
        dynamics=([[-1.2, 0.1, 1.4]], [[[0.0, 1.3, 0.0]]]),
        sensor=([[-0.5, 0.0, 0.5]], [[[0.5, 1.0, 0.5]]]),
        sensor_noise=[[0.3]],
        mean0=[0.2],
        cov0=[[0.6]],
    )


def noisy_block(gain=0.4):
    """Tent map in x1; x2 is driven by x1 and by noise, and differently in the two cells."""
    return PiecewiseLinearSystem(
        regions=[-INF, 0.0, INF],
        dynamics=(
            [[1.0, 1.0], [0.2, -0.1]],
            [[[1.8, -1.8], [0.0, 0.0]], [[0.5, 0.3], [0.8, 0.6]]],
        ),
        noise=[[0.0], [gain]],
        sensor=([[0.0, 0.1]], [[[0.3, 0.3], [1.0, 0.5]]]),
        sensor_noise=[[0.5]],
        mean0=[0.1, -0.3],
        cov0=[[0.25, 0.1], [0.1, 0.5]],
    )


def wave(cells, **changes):
    x, v, w = sp.symbols("x v w")
    parts = {
        "state": (x,),
        "dynamics": [2 * sp.sin(x) + w / 2],
        "sensor": [x**2 / 5 + 3 * v / 10],
        "noise": (v, w),
        "breakpoints": np.linspace(-4, 4, cells + 1),
        "initial": ([1.0], [[0.5]]),
    }
    return PiecewiseLinearSystem.from_functions(**(parts | changes))


def lozi(third=False, regions=None):
    """Lozi map; optionally with a third state, driven by noise and seen by the sensor."""
    matrix = np.array([[[1.7, -1.7], [1.0, 1.0]], [[0.5, 0.5], [0.0, 0.0]]])
    mean0, cov0 = np.array([0.1, 0.1]), np.array([[0.3, 0.05], [0.05, 0.2]])
    offset, sensor, noise = np.array([1.0, 0.0]), np.array([[1.0, 0.0]]), None
    if third:
        full = np.zeros((3, 3, 2))
        full[:2, :2], full[2, 0], full[2, 2] = matrix, 0.3, [0.6, -0.4]
        matrix, offset, sensor = full, np.array([1.0, 0.0, 0.1]), np.array([[1.0, 0.0, 0.5]])
        noise = np.array([[0.0], [0.0], [0.4]])
        mean0, cov0 = np.append(mean0, -0.2), np.diag([0.3, 0.2, 0.5])
        cov0[0, 1] = cov0[1, 0] = 0.05
    return PiecewiseLinearSystem(
        regions=line_cells([[1.0], [0.0]], [0.0]) if regions is None else regions,
        dynamics=(offset, matrix),
        noise=noise,
        sensor=([0.0], sensor),
        sensor_noise=[[0.3]],
        mean0=mean0,
        cov0=cov0,
    )
