"""Filters of finite order of a linear system, by plain regression of everything on everything.

Every variable is a matrix of rows over (1, independent unit noises): column 0 is its mean, the
rest its coefficients. The best affine estimate of one from another is a projection.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from scipy.integrate import solve_ivp

Fit = namedtuple("Fit", "gain offset cov")


def regress(target, given):
    """Best affine estimate of `target` from `given`, both rows over (1, noises)."""
    gain = np.linalg.pinv(given[:, 1:].T, rcond=1e-10) @ target[:, 1:].T
    gain = gain.T if len(given) else np.zeros((len(target), 0))
    rest = (target - gain @ given)[:, 1:]
    return Fit(gain, target[:, 0] - gain @ given[:, 0], rest @ rest.T)


def transition(drift, offset, diffusion, start, stop):
    """Matrix, shift and noise covariance of dX = (A(t) X + a(t)) dt + S(t) dW over an interval."""
    n = len(offset(start))

    def rates(t, flat):
        phi, shift, cov = np.split(flat, [n * n, n * n + n])
        phi, cov, a, s = phi.reshape(n, n), cov.reshape(n, n), drift(t), diffusion(t)
        parts = a @ phi, a @ shift + offset(t), a @ cov + cov @ a.T + s @ s.T
        return np.concatenate([part.ravel() for part in parts])

    first = np.concatenate([np.eye(n).ravel(), np.zeros(n + n * n)])
    flat = solve_ivp(rates, (start, stop), first, rtol=1e-11, atol=1e-13).y[:, -1]
    phi, shift, cov = np.split(flat, [n * n, n * n + n])
    return phi.reshape(n, n), shift, cov.reshape(n, n)


class FiniteOrderOracle:
    """The filter of a linear system that remembers estimates and measurements.

    Parameters
    ----------
    mean0, cov0 : array
    moves : list of list of (matrix, shift, cov)
        For each interval its pieces: to each node, and to the next measurement.
    sensors : list of (matrix, offset, cov)
        At each measurement.
    estimates, measurements : int
        How many of each are remembered.
    components : int
        How many of the state are estimated.
    measured : array of bool, shape (K + 1, m)
    """

    def __init__(self, mean0, cov0, moves, sensors, estimates, measurements, components, measured):
        n, m = len(mean0), len(sensors[0][1])
        pieces = [piece for part in moves for piece in part]
        size = 1 + n + n * len(pieces) + m * len(sensors)
        self.sensors, self.measured = sensors, measured
        self.keeps, self.components = (estimates, measurements), components
        used = 1

        def noise(cov):
            nonlocal used
            rows = np.zeros((len(cov), size))
            rows[:, used : used + len(cov)] = np.linalg.cholesky(cov)
            used += len(cov)
            return rows

        one = np.eye(size)[0]
        x = np.outer(mean0, one) + noise(np.array(cov0))
        self.states, self.shown, self.fits, self.node_fits = [], [], [], []
        self.errors, self.node_errors = [], []
        past = [], []
        for k, (matrix, offset, cov) in enumerate(sensors):
            if k:
                x = self._moved(x, moves[k - 1][-1], noise, one)
            memory = np.concatenate([*past[0], *past[1], np.zeros((0, size))])
            fit = regress(x, memory)
            self.fits.append(fit)
            y = matrix @ x + np.outer(offset, one) + noise(cov)
            expected = matrix @ fit.gain @ memory + np.outer(matrix @ fit.offset + offset, one)
            seen = measured[k]
            estimate = regress(x[:components], np.concatenate([memory, y[seen]]))
            z = estimate.gain @ np.concatenate([memory, y[seen]]) + np.outer(estimate.offset, one)
            self.states.append(x)
            self.shown.append(y)
            self.errors.append(estimate.cov)
            remembered = np.where(seen[:, None], y, expected)
            past = [z, *past[0]][:estimates], [remembered, *past[1]][:measurements]
            given, row = np.concatenate([*past[0], *past[1]]), []
            for piece in moves[k][:-1] if k < len(moves) else []:
                x = self._moved(x, piece, noise, one)
                row.append(regress(x[:components], given))
            self.node_fits.append(row)
        self.size = size

    @staticmethod
    def _moved(x, piece, noise, one):
        matrix, shift, cov = piece
        return matrix @ x + np.outer(shift, one) + noise(cov)

    def draw(self, paths, seed):
        """Measurements (K + 1, m, paths), NaN where the schedule has none, and states."""
        draws = np.random.default_rng(seed).standard_normal((self.size, paths))
        draws[0] = 1.0
        y = np.array([rows @ draws for rows in self.shown])
        y[~self.measured] = np.nan
        return y, np.array([rows @ draws for rows in self.states])

    def run(self, y):
        """Estimates, covariances, log-densities and node forecasts of one record (K + 1, m)."""
        past, found = ([], []), []
        for k, (matrix, offset, cov) in enumerate(self.sensors):
            u = np.concatenate([*past[0], *past[1], np.zeros(0)])
            gain, shift, spread = self.fits[k]
            mean, here = gain @ u + shift, ~np.isnan(y[k])
            expected = matrix @ mean + offset
            look, error = matrix[here], (y[k] - expected)[here]
            square = look @ spread @ look.T + cov[np.ix_(here, here)]
            weight = np.linalg.solve(square, look @ spread).T if here.any() else np.zeros((2, 0))
            z = (mean + weight @ error)[: self.components]
            rest = (spread - weight @ look @ spread)[: self.components, : self.components]
            loglik = -0.5 * error @ np.linalg.solve(square, error)
            loglik -= 0.5 * np.linalg.slogdet(2 * np.pi * square)[1] if here.any() else 0.0
            remembered = np.where(here, y[k], expected)
            past = [z, *past[0]][: self.keeps[0]], [remembered, *past[1]][: self.keeps[1]]
            given = np.concatenate([*past[0], *past[1]])
            nodes = [f.gain @ given + f.offset for f in self.node_fits[k]]
            found.append((z, rest, loglik, nodes))
        return found
