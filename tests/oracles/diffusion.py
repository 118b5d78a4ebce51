"""A linear diffusion and its filter by integrating their differential equations."""

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from seedslib.two_step import LinearDiffusion

TIGHT = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}


def constant_diffusion(**changes):
    """Constant, not symmetric, two unlike correlated sensors."""
    system = {
        "drift": [[0.2, 1.0], [-2.0, -0.3]],
        "noise_intensity": [[0.4, 0.1], [0.1, 0.2]],
        "sensor": [[1.0, 0.5], [0.0, 1.0]],
        "sensor_intensity": [[0.2, 0.05], [0.05, 0.4]],
        "mean0": [1.0, -1.0],
        "cov0": [[0.5, 0.1], [0.1, 0.3]],
    }
    return LinearDiffusion(**{**system, **changes})


def transition(system, start, stop):
    """Transition matrix and noise covariance of the state between two times."""
    n = system.state_size

    def slope(t, y):
        f, (move, noise) = system.drift, y.reshape(2, n, n)
        return np.stack([f @ move, f @ noise + noise @ f.T + system.diffusion]).ravel()

    first = np.stack([np.eye(n), np.zeros((n, n))]).ravel()
    return solve_ivp(slope, (start, stop), first, **TIGHT).y[:, -1].reshape(2, n, n)


def start_dist(system, t):
    """Mean and covariance of the state at t from those at 0."""
    move, noise = transition(system, 0.0, t)
    return move @ system.mean0, move @ system.cov0 @ move.T + noise


def filtered(system, times, increments=None):
    """Means (K+1, n) and error covariances (K+1, n, n) of the Kalman-Bucy filter.

    With increments (K, m) their rates are constant over a step; NaN is missing. Without
    increments all is measured and the mean is that of the state.
    """
    n, dists = system.state_size, [start_dist(system, times[0])]
    for k, (a, b) in enumerate(pairwise(times)):
        h = system.sensor
        observed = np.ones(len(h), bool) if increments is None else ~np.isnan(increments[k])
        noise = np.linalg.inv(system.sensor_intensity[np.ix_(observed, observed)])

        def slope(t, y, k=k, h=h[observed], noise=noise, observed=observed, length=b - a):
            m, p = y[:n], y[n:].reshape(n, n)
            rate = h @ m if increments is None else increments[k, observed] / length
            gain = p @ h.T @ noise
            free = system.drift @ p + p @ system.drift.T + system.diffusion
            dm = system.drift @ m + gain @ (rate - h @ m)
            return np.concatenate([dm, (free - gain @ h @ p).ravel()])

        first = np.concatenate([dists[-1][0], dists[-1][1].ravel()])
        y = first if a == b else solve_ivp(slope, (a, b), first, **TIGHT).y[:, -1]
        dists.append((y[:n], y[n:].reshape(n, n)))
    return [np.stack(parts) for parts in zip(*dists, strict=True)]
