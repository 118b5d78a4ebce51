"""Independent routes for linear-Gaussian systems, with and without modes, and for moments.

`Regression` writes all states and measurements as linear functions of the start and the noises and
conditions once: filtering, prediction over any number of steps and smoothing are one formula.
`kalman` is the recursion of the textbooks, `moments` the moment equations of a linear
jump-diffusion, and `histories` the exact mixture over all histories of modes.
"""

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag


class Linear(NamedTuple):
    """x_{k+1} = F_k x_k + b_k + N(0, Q_k) for K steps, y_k = H_k x_k + d_k + N(0, R_k)."""

    F: np.ndarray  # (K, n, n)
    b: np.ndarray  # (K, n)
    Q: np.ndarray
    H: np.ndarray  # (K+1, m, n)
    d: np.ndarray  # (K+1, m)
    R: np.ndarray
    mean0: np.ndarray
    cov0: np.ndarray


def constant(F, Q, H, R, mean0, cov0, steps):
    """A `Linear` system of K steps whose matrices do not change, without offsets."""
    F, Q, H, R, cov0 = (np.atleast_2d(part).astype(float) for part in (F, Q, H, R, cov0))
    moves = np.tile(F, (steps, 1, 1)), np.zeros((steps, len(F))), np.tile(Q, (steps, 1, 1))
    count = steps + 1
    shows = np.tile(H, (count, 1, 1)), np.zeros((count, len(H))), np.tile(R, (count, 1, 1))
    return Linear(*moves, *shows, np.atleast_1d(mean0).astype(float), cov0)


class Regression:
    """States and measurements as linear functions of the start and of all noises."""

    def __init__(self, model):
        (steps, n), m = model.b.shape, model.d.shape[1]
        self.n, self.m = n, m
        self.cov = block_diag(model.cov0, *model.Q, *model.R)
        size, first = len(self.cov), n * (steps + 1)
        self.states, self.state_means = np.zeros((steps + 1, n, size)), np.zeros((steps + 1, n))
        self.states[0, :, :n], self.state_means[0] = np.eye(n), model.mean0
        for k in range(steps):
            self.states[k + 1] = model.F[k] @ self.states[k]
            self.states[k + 1, :, n * (k + 1) : n * (k + 2)] += np.eye(n)
            self.state_means[k + 1] = model.F[k] @ self.state_means[k] + model.b[k]
        self.measured = model.H @ self.states
        for k in range(steps + 1):
            self.measured[k, :, first + m * k : first + m * (k + 1)] += np.eye(m)
        self.measured_means = np.einsum("kij,kj->ki", model.H, self.state_means) + model.d

    def _condition(self, rows, means, y, last):
        """Mean and covariance of rows given y_0..y_last, and the log density of these."""
        present = ~np.isnan(y[: last + 1])
        seen = self.measured[: last + 1][present]
        error = (y[: last + 1] - self.measured_means[: last + 1])[present]
        spread = seen @ self.cov @ seen.T
        cross = rows @ self.cov @ seen.T
        weights = np.linalg.solve(spread, cross.T).T
        logdet = np.linalg.slogdet(2 * np.pi * spread)[1]
        loglik = -0.5 * (error @ np.linalg.solve(spread, error) + logdet)
        return means + weights @ error, rows @ self.cov @ rows.T - weights @ cross.T, loglik

    def estimate(self, y, k, last):
        """Mean and covariance of x_k given y_0..y_last: last = k filters, last > k smooths.

        `last` may be -1 for nothing; NaN is missing.
        """
        return self._condition(self.states[k], self.state_means[k], y, last)[:2]

    def pair(self, y, k, last):
        """Mean and covariance of (x_k, x_{k+1}) given y_0..y_last."""
        rows, means = self.states[k : k + 2], self.state_means[k : k + 2]
        return self._condition(rows.reshape(2 * self.n, -1), means.ravel(), y, last)[:2]

    def measurement(self, y, k, last):
        """Mean and covariance of y_k given y_0..y_last, last < k."""
        return self._condition(self.measured[k], self.measured_means[k], y, last)[:2]

    def loglik(self, y, last=None):
        """Log density of y_0..y_last, all of them by default."""
        last = len(y) - 1 if last is None else last
        return self._condition(self.states[0], self.state_means[0], y, last)[2]

    def logliks(self, y):
        """Log predictive densities of y_0, y_1, ..., (K+1,)."""
        return np.diff([self.loglik(y, k) for k in range(len(y))], prepend=0.0)

    def filtered(self, y):
        """Means (K+1, n) and covariances (K+1, n, n) given the measurements up to each time."""
        return _stacked(self.estimate(y, k, k) for k in range(len(y)))

    def smoothed(self, y):
        """Means and covariances given all measurements."""
        return _stacked(self.estimate(y, k, len(y) - 1) for k in range(len(y)))


class Filtered(NamedTuple):
    """Of `kalman`, at each time: after and before the correction, and the log densities."""

    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray
    predicted_mean: np.ndarray
    predicted_cov: np.ndarray


def kalman(model, y, move=None):
    """The Kalman filter; ``move(k, m, P)``, where given, makes the step k in its own way."""
    if move is None:

        def move(k, m, P):
            return model.F[k] @ m + model.b[k], model.F[k] @ P @ model.F[k].T + model.Q[k]

    m, P, rows = model.mean0, model.cov0, []
    for k in range(len(y)):
        before = m, P = move(k - 1, m, P) if k else (m, P)
        m, P, loglik = corrected(m, P, y[k], model.H[k], model.d[k], model.R[k])
        rows.append((m, P, loglik, *before))
    return Filtered(*_stacked(rows))


def corrected(m, P, y, H, d, R):
    """Mean and covariance given y = H x + d + N(0, R) without its missing parts, log density."""
    i = ~np.isnan(y)
    H, R, error = H[i], R[np.ix_(i, i)], (y - H @ m - d)[i]
    spread = H @ P @ H.T + R
    gain = np.linalg.solve(spread, H @ P).T
    logdet = np.linalg.slogdet(2 * np.pi * spread)[1]
    loglik = -0.5 * (error @ np.linalg.solve(spread, error) + logdet)
    return m + gain @ error, P - gain @ spread @ gain.T, loglik


class Continuous(NamedTuple):
    """dX = (A x + a + B u) dt + G dW + jumps C x + k z of intensity mu, Y = H x + D u + w."""

    A: Callable
    a: Callable
    B: Callable
    G: Callable
    mu: Callable
    C: Callable
    k: Callable
    mark_mean: float
    mark_cov: float
    H: Callable
    D: Callable
    noise_mean: np.ndarray
    noise_cov: np.ndarray
    mean0: np.ndarray
    cov0: np.ndarray

    def sensor(self, times, u=None):
        """H, d and R of the measurements, on a grid."""
        u = np.zeros(len(times)) if u is None else u
        H = np.array([self.H(now) for now in times])
        d = np.array([self.D(now) * v + self.noise_mean for now, v in zip(times, u, strict=True)])
        return H, d, np.tile(self.noise_cov, (len(times), 1, 1))


def moment_rates(model, t, m, P, u=0.0, *, first_order=False):
    """dm/dt and dP/dt, exact; a first-order filter takes the jump's square at the mean."""
    slope, jump = (
        model.A(t) + model.mu(t) * model.C(t),
        model.C(t) @ m + model.k(t) * model.mark_mean,
    )
    square = np.outer(jump, jump) + model.mark_cov * np.outer(model.k(t), model.k(t))
    if not first_order:
        square = square + model.C(t) @ P @ model.C(t).T
    drift = model.A(t) @ m + model.a(t) + model.B(t) * u + model.mu(t) * jump
    return drift, slope @ P + P @ slope.T + model.G(t) @ model.G(t).T + model.mu(t) * square


def moments(model, start, stop, m, P, u=0.0, **options):
    """Mean and covariance at `stop` from those at `start`, u constant in between."""
    n = len(m)

    def rate(t, packed):
        parts = moment_rates(model, t, packed[:n], packed[n:].reshape(n, n), u, **options)
        return np.concatenate([part.ravel() for part in parts])

    packed = solve_ivp(rate, (start, stop), np.append(m, P), "DOP853", rtol=1e-11, atol=1e-13)
    return packed.y[:n, -1], packed.y[n:, -1].reshape(n, n)


def discretised(model, times, u=None):
    """The `Linear` system that a `Continuous` one without jumps is on a grid."""
    u, parts, n = np.zeros(len(times)) if u is None else u, [], len(model.mean0)
    for k in range(len(times) - 1):
        span, zero = (times[k], times[k + 1]), np.zeros((n, n))
        b, Q = moments(model, *span, np.zeros(n), zero, u[k])
        columns = [moments(model, *span, e, zero, u[k])[0] - b for e in np.eye(n)]
        parts.append((np.transpose(columns), b, Q))
    return Linear(*_stacked(parts), *model.sensor(times, u), model.mean0, model.cov0)


class Switching(NamedTuple):
    """A `Linear` for each mode, and probabilities of the first mode, of switches, of indicators."""

    modes: list
    initial: np.ndarray  # (L,)
    switching: np.ndarray  # (K, L, L)
    indicator: np.ndarray  # (K+1, L, M)


class Mixture(NamedTuple):
    """Distribution of the state and of its mode: moments, P(mode), moments in each mode, log
    density."""

    mean: np.ndarray
    cov: np.ndarray
    mode_prob: np.ndarray
    means: np.ndarray
    covs: np.ndarray
    loglik: float


def along(system, modes, drives="old"):
    """The `Linear` system of given modes; its steps are driven by the old or by the new ones."""
    drivers, first = modes[1:] if drives == "new" else modes[:-1], system.modes[modes[0]]
    moves = [[getattr(system.modes[i], f)[j] for j, i in enumerate(drivers)] for f in "FbQ"]
    shows = [[getattr(system.modes[i], f)[j] for j, i in enumerate(modes)] for f in "HdR"]
    shapes = [(-1, *np.shape(getattr(first, f))[1:]) for f in "FbQ"]
    moves = [np.reshape(part, shape) for part, shape in zip(moves, shapes, strict=True)]
    return Linear(*moves, *map(np.array, shows), first.mean0, first.cov0)


def histories(system, y, indicators, k, last, drives="old"):
    """Distribution of (x_k, mode at k) given the records up to `last`, over all histories of the
    modes."""
    reach, count, parts = max(k, last), len(system.initial), []
    for modes in product(range(count), repeat=reach + 1):
        chain = Regression(along(system, modes, drives))
        chance = np.log(system.initial[modes[0]])
        chance += sum(np.log(system.switching[j][modes[j], modes[j + 1]]) for j in range(reach))
        for j in range(last + 1):
            if indicators is not None and indicators[j] >= 0:
                chance += np.log(system.indicator[j][modes[j], indicators[j]])
        log_weight = chance + chain.loglik(y, last)
        parts.append((log_weight, modes[k], *chain.estimate(y, k, last)))
    logs, at, means, covs = _stacked(parts)
    loglik = np.logaddexp.reduce(logs)
    weights = np.exp(logs - loglik)
    mode_prob = np.array([weights[at == i].sum() for i in range(count)])
    inside = [mixed(weights[at == i], means[at == i], covs[at == i]) for i in range(count)]
    return Mixture(*mixed(weights, means, covs), mode_prob, *_stacked(inside), loglik)


def mixed(weights, means, covs):
    """Mean and covariance of a mixture, weights up to a factor."""
    weights = weights / weights.sum()
    mean = weights @ means
    apart = means - mean
    return mean, np.einsum("p,pij->ij", weights, covs + apart[:, :, None] * apart[:, None, :])


def _stacked(rows):
    return tuple(np.array(part) for part in zip(*rows, strict=True))
