"""A linear diffusion, its filter and smoother by integrating their differential equations."""

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from seedslib.two_step import LinearDiffusion

TIGHT = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}


def varying_diffusion():
    """Time-varying in everything, not symmetric, two unlike correlated sensors, one noise."""
    return LinearDiffusion(
        drift=lambda t: [[0.2 * np.cos(t), 1.0 + 0.1 * t], [-2.0, -0.3]],
        noise_intensity=lambda t: [[0.4 + 0.3 * t]],
        sensor=lambda t: [[1.0, 0.5 * np.sin(t)], [0.2 * t, 1.0]],
        sensor_intensity=lambda t: np.array([[0.2, 0.05], [0.05, 0.4]]) * (1 + 0.5 * np.sin(3 * t)),
        mean0=[1.0, -1.0],
        cov0=[[0.5, 0.1], [0.1, 0.3]],
        noise_input=lambda t: [[0.3], [1.5 - 0.2 * t]],
    )


def constant_diffusion(**changes):
    """Constant, not symmetric, two unlike correlated sensors."""
    known = {
        "drift": [[0.2, 1.0], [-2.0, -0.3]],
        "noise_intensity": [[0.4, 0.1], [0.1, 0.2]],
        "sensor": [[1.0, 0.5], [0.0, 1.0]],
        "sensor_intensity": [[0.2, 0.05], [0.05, 0.4]],
        "mean0": [1.0, -1.0],
        "cov0": [[0.5, 0.1], [0.1, 0.3]],
    }
    return LinearDiffusion(**{**known, **changes})


def transition(system, start, stop):
    """Transition matrix and noise covariance of the state between two times."""
    n = system.state_size

    def slope(t, y):
        f, w, *_ = system.matrices(t)
        move, noise = y.reshape(2, n, n)
        return np.stack([f @ move, f @ noise + noise @ f.T + w]).ravel()

    first = np.stack([np.eye(n), np.zeros((n, n))]).ravel()
    return solve_ivp(slope, (start, stop), first, **TIGHT).y[:, -1].reshape(2, n, n)


def start_law(system, t):
    """Mean and covariance of the state at t from those at 0."""
    move, noise = transition(system, 0.0, t)
    return move @ system.mean0, move @ system.cov0 @ move.T + noise


def filtered(system, times, increments=None):
    """Means (K+1, n), error covariances (K+1, n, n), and both over each step as functions.

    With increments (K, m) their rates are constant over a step, and so are the coefficients, those
    of its middle; NaN is missing. Without increments nothing is frozen, all is measured.
    """
    n, laws, steps = system.state_size, [start_law(system, times[0])], []
    for k, (a, b) in enumerate(pairwise(times)):

        def slope(t, y, k=k, a=a, b=b):
            m, p = y[:n], y[n:].reshape(n, n)
            f, w, h, r = system.matrices(t if increments is None else 0.5 * (a + b))
            seen = np.ones(len(h), bool) if increments is None else ~np.isnan(increments[k])
            rate = h @ m if increments is None else increments[k] / (b - a)
            gain = p @ h[seen].T @ np.linalg.inv(r[np.ix_(seen, seen)])
            dm = f @ m + gain @ (rate - h @ m)[seen]
            return np.concatenate([dm, (f @ p + p @ f.T + w - gain @ h[seen] @ p).ravel()])

        first = np.concatenate([laws[-1][0], laws[-1][1].ravel()])
        if a == b:
            laws.append(laws[-1])
            continue
        run = solve_ivp(slope, (a, b), first, dense_output=True, **TIGHT)
        steps.append((a, b, run.sol))
        laws.append((run.y[:n, -1], run.y[n:, -1].reshape(n, n)))
    means, covs = (np.stack(parts) for parts in zip(*laws, strict=True))
    return means, covs, steps


def smoothed(system, times, increments=None):
    """Means and covariances by the equations of Rauch, Tung and Striebel, backward in time."""
    means, covs, steps = filtered(system, times, increments)
    n, laws = system.state_size, [(means[-1], covs[-1])]
    for a, b, forward in steps[::-1]:

        def slope(t, y, a=a, b=b, forward=forward):
            m, p = y[:n], y[n:].reshape(n, n)
            f, w, *_ = system.matrices(t if increments is None else 0.5 * (a + b))
            now = forward(t)
            gain = w @ np.linalg.inv(now[n:].reshape(n, n))
            back = f + gain
            return np.concatenate(
                [f @ m + gain @ (m - now[:n]), (back @ p + p @ back.T - w).ravel()]
            )

        first = np.concatenate([laws[-1][0], laws[-1][1].ravel()])
        y = solve_ivp(slope, (b, a), first, **TIGHT).y[:, -1]
        laws.append((y[:n], y[n:].reshape(n, n)))
    return [np.stack(parts[::-1]) for parts in zip(*laws, strict=True)]
