"""Independent routes for systems with delays: regression on all data, and the printed recursion."""

import numpy as np
from scipy.linalg import block_diag

from seedslib.delay import DelaySystem


def general_system(delays, seed=3, **changes):
    """Not symmetric, n = 3, two unlike sensors, singular Q, a mean, unlike blocks of history."""
    rng = np.random.default_rng(seed)
    reach = max(delays)
    roots = rng.standard_normal((reach + 1, 3, 3))
    start = roots @ roots.swapaxes(1, 2) / 3
    given = {
        "dynamics": {d: 0.4 * rng.standard_normal((3, 3)) for d in delays},
        "sensor": rng.standard_normal((2, 3)),
        "noise_cov": [[1.3, 0.0], [0.0, 0.0]],
        "sensor_cov": [[0.8, 0.2], [0.2, 0.5]],
        "cov0": start[0],
        "history_cov": start[1:] if reach else 0.0,
        "mean0": [0.4, -0.9, 1.2],
        "noise_input": [[1.0, 2.0], [-0.6, 0.0], [0.5, 1.0]],
    }
    return DelaySystem(**(given | changes))


class Regression:
    """Everything as a linear function of start and noises; estimates by one regression.

    `states` (N + 1 + K, n, size) and `means` hold x_{-N}, ..., x_K, and `outputs` and
    `output_means` y_0 (which is nothing), ..., y_K; `spread` is the covariance of the start, of
    the noises w_0, ..., w_{K-1} and of v_1, ..., v_K, in this order.
    """

    def __init__(self, system, steps):
        n, m, reach = system.state_size, system.measurement_size, system.max_delay
        q = len(system.noise_cov)
        start = (reach + 1) * n
        size = start + steps * (q + m)
        self.n, self.m, self.reach = n, m, reach
        self.states, self.means = np.zeros((reach + 1 + steps, n, size)), []
        self.outputs, self.output_means = np.zeros((steps + 1, m, size)), [np.zeros(m)]
        for j in range(reach, -1, -1):
            self.states[reach - j, :, j * n : (j + 1) * n] = np.eye(n)
            self.means.append(np.zeros(n) if j else system.mean0)
        for k in range(1, steps + 1):
            now, at = reach + k, start + (k - 1) * q
            mean = 0.0
            for d, a in system.dynamics.items():
                self.states[now] += a @ self.states[now - 1 - d]
                mean = mean + a @ self.means[now - 1 - d]
            self.means.append(mean)
            self.states[now, :, at : at + q] += system.noise_input
            at = start + steps * q + (k - 1) * m
            self.outputs[k] = system.sensor @ self.states[now]
            self.outputs[k, :, at : at + m] += np.eye(m)
            self.output_means.append(system.sensor @ mean)
        self.spread = block_diag(
            *system.start_blocks(), *[system.noise_cov] * steps, *[system.sensor_cov] * steps
        )

    def estimate(self, y, k, last):
        """Mean, covariance of x_k given y (K+1, m) up to `last`; log density; weights of y_last."""
        state, prior = self.states[self.reach + k], self.means[self.reach + k]
        present = ~np.isnan(y[1 : last + 1]).ravel()
        if not present.any():
            return prior, state @ self.spread @ state.T, 0.0, np.zeros((self.n, self.m))
        rows = self.outputs[1 : last + 1].reshape(-1, len(self.spread))[present]
        left = (y - np.array(self.output_means))[1 : last + 1].ravel()[present]
        spread, cross = rows @ self.spread @ rows.T, state @ self.spread @ rows.T
        gain = np.linalg.solve(spread, cross.T).T
        scatter = left @ np.linalg.solve(spread, left)
        loglik = -0.5 * (scatter + np.linalg.slogdet(2 * np.pi * spread)[1])
        weights = np.zeros((self.n, present.size))
        weights[:, present] = gain
        cov = state @ self.spread @ state.T - gain @ cross.T
        return prior + gain @ left, cov, loglik, weights[:, -self.m :]


def printed_recursion(system, steps):
    """(9)-(29) of the paper with one loop per index: K, L and the claimed matrix."""
    reach, n, m = system.max_delay, system.state_size, system.measurement_size
    lags = {(j, i): np.zeros((n, n)) for j in range(2 * reach + 1) for i in range(2 * reach + 1)}
    for j, block in enumerate(system.start_blocks()):
        lags[j, j] = block

    a, b = system.dynamics.get(0, np.zeros((n, n))), system.dynamics[reach]
    c, r = system.sensor, system.sensor_cov
    gains, pasts, claims = [], [], []
    for k in range(1, steps + 1):
        used = range(1, min(reach, k - 1) + 1)
        ahead = {}
        for j in (0, *used):
            for i in (0, *used):
                ahead[j, i] = a @ lags[j, i] @ a.T + b @ lags[reach + j, i] @ a.T
                ahead[j, i] += a @ lags[j, reach + i] @ b.T
                ahead[j, i] += b @ lags[reach + j, reach + i] @ b.T
                if i == j:
                    ahead[j, i] += system.state_noise
        inverse = {j: np.linalg.inv(c @ ahead[j, j] @ c.T + r) for j in (0, *used)}
        past = {j: ahead[0, j] @ c.T @ inverse[j] for j in used}
        removed = sum((past[j] @ c @ ahead[0, j].T for j in used), np.zeros((n, n)))
        gain = (ahead[0, 0] - removed) @ c.T @ inverse[0]
        keep = np.eye(n) - gain @ c
        claimed = keep @ (ahead[0, 0] - removed.T)
        for i in used:
            for j in used:
                if i != j:
                    claimed += past[i] @ c @ ahead[i, j] @ c.T @ past[j].T
        moved = {(j, i): lags[j - 1, i - 1] for j, i in lags if i and j}
        for j in range(1, 2 * reach + 1):
            row = keep @ (a @ lags[0, j - 1] + b @ lags[reach, j - 1])
            for i in used:
                older = a @ lags[i, j - 1] + b @ lags[reach + i, j - 1]
                row -= past[i] @ c @ older
            moved[0, j], moved[j, 0] = row, row.T
        moved[0, 0] = claimed
        lags = moved
        gains.append(gain)
        pasts.append([past.get(j, np.zeros((n, m))) for j in range(1, reach + 1)])
        claims.append(claimed)
    return np.array(gains), np.array(pasts), np.array(claims)
