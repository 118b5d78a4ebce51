"""References: filters of linear systems in discrete time, and Gaussian filters of a pendulum."""

import mpmath as mp

from references.high import STEP, column, dist_values, family, matrix, relative
from references.record import STEPS, wave


def record(k, m, offset, size, nudge=None):
    """Measurement k; larger by a small part of itself where its condition is asked for."""
    part = 1 + STEP if k == nudge else 1
    return column([part * (offset + size * mp.mpf(wave(k, j))) for j in range(m)])


def corrected(mean, cov, error, cross, spread):
    """Gaussian distribution given a measurement that is `error` off its mean, and the
    log-density."""
    inverse = spread**-1
    gain, weighted = cross * inverse, inverse * error
    told = -((error.T * weighted)[0] + mp.log(mp.det(spread)) + len(error) * mp.log(2 * mp.pi)) / 2
    cov = cov - gain * cross.T
    return mean + gain * error, (cov + cov.T) / 2, told


def kalman_run(F, Q, H, R, mean0, cov0, offset, size, nudge=None):
    F, Q, H, R, cov = map(matrix, (F, Q, H, R, cov0))
    mean, total = column(mean0), mp.mpf(0)
    for k in range(STEPS + 1):
        if k:
            mean, cov = F * mean, F * cov * F.T + Q
        cross = cov * H.T
        error = record(k, H.rows, offset, size, nudge) - H * mean
        mean, cov, told = corrected(mean, cov, error, cross, H * cross + R)
        total += told
    return mean, cov, total


@family("Kalman filter", "recursion")
def kalman(**told):
    with mp.workdps(100):
        mean, cov, total = kalman_run(**told)
        return {**dist_values(mean, cov), "loglik": relative(total, 1)}


@family("diffuse Kalman filter", "recursion")
def diffuse_kalman(diffuse, cov0, **told):
    """With 1e80 for the infinite variance, which is taken out of the log-likelihood again."""
    with mp.workdps(260):
        wide, cov = mp.mpf(10) ** 80, [list(row) for row in cov0]
        for k in diffuse:
            cov[k][k] = wide
        mean, cov, total = kalman_run(cov0=cov, **told)
        total += len(diffuse) * mp.log(wide) / 2
        return {**dist_values(mean, cov), "loglik": relative(total, 1)}


@family("smoother", "Gaussian conditioning at once")
def smoother(F, Q, H, R, mean0, cov0, offset, size):
    """The joint distribution of all states, given all measurements: no recursion back."""
    with mp.workdps(100):
        F, Q, H, R, start = map(matrix, (F, Q, H, R, cov0))
        n, m, steps = F.rows, H.rows, STEPS // 2
        powers, covs = [mp.eye(n)], [start]
        for _ in range(steps):
            powers.append(F * powers[-1])
            covs.append(F * covs[-1] * F.T + Q)

        def joint(i, j):
            return powers[i - j] * covs[j] if i >= j else (powers[j - i] * covs[i]).T

        spread, error = mp.zeros(m * (steps + 1)), mp.zeros(m * (steps + 1), 1)
        for i in range(steps + 1):
            here = slice(m * i, m * i + m)
            seen = record(i, m, offset, size) - H * powers[i] * column(mean0)
            for p in range(m):
                error[m * i + p] = seen[p]
            for j in range(steps + 1):
                spread[here, m * j : m * j + m] = H * joint(i, j) * H.T
            spread[here, here] += R
        found = {}
        inverse = spread**-1
        for k in (0, steps // 2, steps - 1):
            cross = mp.zeros(n, m * (steps + 1))
            for j in range(steps + 1):
                cross[:, m * j : m * j + m] = joint(k, j) * H.T
            gain = cross * inverse
            mean = powers[k] * column(mean0) + gain * error
            found |= dist_values(mean, covs[k] - gain * cross.T, f"step {k} ")
        return found


def sines(mean, cov):
    """Mean of sin x1, its covariance with the state, and its variance, exact."""
    p, blunt = cov[0, 0], mp.exp(-cov[0, 0] / 2)
    first = blunt * mp.sin(mean[0])
    lean = cov[:, 0] * blunt * mp.cos(mean[0])
    return first, lean, (1 - mp.exp(-2 * p) * mp.cos(2 * mean[0])) / 2 - first**2


def transformed(kind, mean, cov, slope, bend):
    """Mean, cross-covariance with x, and covariance of ``slope x + bend sin x1``."""
    n = len(mean)
    if kind == "exact":
        first, lean, var = sines(mean, cov)
        cross = cov * slope.T + lean * bend.T
        both = slope * lean * bend.T
        out = slope * cov * slope.T + both + both.T + bend * bend.T * var
        return slope * mean + bend * first, cross, out
    if kind == "extended":
        turn = slope.copy()
        turn[:, 0] += bend * mp.cos(mean[0])
        return slope * mean + bend * mp.sin(mean[0]), cov * turn.T, turn * cov * turn.T
    reach = mp.mpf(3 if kind == "unscented" else n)
    root = mp.cholesky(cov) * mp.sqrt(reach)
    points = [mean + sign * root[:, k] for k in range(n) for sign in (1, -1)]
    weights = [1 / (2 * reach)] * (2 * n)
    if kind == "unscented":
        points, weights = [mean, *points], [1 - n / reach, *weights]
    values = [slope * x + bend * mp.sin(x[0]) for x in points]
    first = mp.zeros(slope.rows, 1)
    for w, y in zip(weights, values, strict=True):
        first += w * y
    cross, out = mp.zeros(n, slope.rows), mp.zeros(slope.rows)
    for w, x, y in zip(weights, points, values, strict=True):
        cross += w * (x - mean) * (y - first).T
        out += w * (y - first) * (y - first).T
    return first, cross, out


@family("nonlinear filters", "recursion")
def nonlinear(kind, step, pull, damping, Q, R, mean0, cov0, size):
    """A damped pendulum whose sine is measured, by four ways to take means of the sine."""
    with mp.workdps(100):
        Q, cov, mean, total = matrix(Q), matrix(cov0), column(mean0), mp.mpf(0)
        slope = matrix([[mp.mpf(1), step], [mp.mpf(0), 1 - step * damping]])
        bend, none = column([mp.mpf(0), -step * pull]), mp.zeros(1, 2)
        for k in range(STEPS + 1):
            if k:
                mean, _, cov = transformed(kind, mean, cov, slope, bend)
                cov += Q
            first, cross, spread = transformed(kind, mean, cov, none, mp.eye(1))
            error = record(k, 1, mp.mpf(0), size) - first
            mean, cov, told = corrected(mean, cov, error, cross, spread + R * mp.eye(1))
            total += told
        return {**dist_values(mean, cov), "loglik": relative(total, 1)}
