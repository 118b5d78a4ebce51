"""References: filters of systems with delay and of systems that switch, and weights in the tail."""

import mpmath as mp

from references.high import Value, column, density, dist_values, family, matrix, relative
from references.motion import matrix_dist
from references.record import STEPS, wave


def stacked(A, delays, C, Q):
    """Transition, sensor and noise of the states of the last instants in one."""
    n, depth = len(A[0]), max(delays)
    size = n * (depth + 1)
    move, sensor, noise = mp.zeros(size), mp.zeros(len(C), size), mp.zeros(size)
    for d, block in zip(delays, A, strict=True):
        move[:n, n * d : n * d + n] = matrix(block)
    move[n:, : n * depth] = mp.eye(n * depth)
    sensor[:, :n], noise[:n, :n] = matrix(C), matrix(Q)
    return move, sensor, noise


def delay_values(gain, spread, cov, n):
    found = matrix_dist(gain, "gain")
    dist = dist_values(column([1] * n), cov)
    return {**found, "innovation": spread, **{k: v for k, v in dist.items() if k[:3] == "cov"}}


@family("delay filter", "recursion")
def delay(A, delays, C, Q, R, cov0, past):
    with mp.workdps(100):
        n, (move, sensor, noise) = len(Q), stacked(A, delays, C, Q)
        cov = mp.zeros(move.rows)
        for d in range(move.rows // n):
            cov[n * d : n * d + n, n * d : n * d + n] = matrix(past if d else cov0)
        for _ in range(60):
            cov = move * cov * move.T + noise
            spread = (sensor * cov * sensor.T)[0] + R[0][0]
            gain = cov * sensor.T / spread
            cov = cov - gain * gain.T * spread
        return delay_values(gain, spread, cov[:n, :n], n)


@family("switching filter", "recursion")
@family("multiple models (IMM)", "recursion")
def switching(**told):
    """One Gaussian distribution in each of two modes; a forecast is that of the mixture it comes
    from."""
    with mp.workdps(100):
        a, q, h, r, A = (told[name] for name in "aqhrA")
        p, mean, var = (list(told[k]) for k in ("p", "mean0", "var0"))
        new, total = told["drives"] == "new", mp.mpf(0)
        size = mp.mpf(1) if r[0] > 0.01 else mp.mpf(2) ** -6
        for k in range(STEPS + 1):
            if k:
                parts = [
                    [
                        (p[i] * A[i][j], mean[i], var[i])
                        if new
                        else (p[i] * A[i][j], a[i] * mean[i], a[i] ** 2 * var[i] + q[i])
                        for i in range(2)
                    ]
                    for j in range(2)
                ]
                for j in range(2):
                    p[j], mean[j], var[j] = mixed(parts[j])
                    if new:
                        mean[j], var[j] = a[j] * mean[j], a[j] ** 2 * var[j] + q[j]
            y = wave(k) * size
            for j in range(2):
                spread = h[j] ** 2 * var[j] + r[j]
                error, gain = y - h[j] * mean[j], h[j] * var[j] / spread
                root = mp.sqrt(spread)
                p[j] *= density(error / root) / root
                mean[j], var[j] = mean[j] + gain * error, var[j] - gain * h[j] * var[j]
            whole = sum(p)
            total += mp.log(whole)
            p = [part / whole for part in p]
        _, first, second = mixed(list(zip(p, mean, var, strict=True)))
        return {
            "probability 0": p[0],
            "probability 1": p[1],
            "loglik": relative(total, 1),
            **dist_values([first], matrix([[second]])),
        }


def mixed(parts):
    whole = sum(p for p, _, _ in parts)
    first = sum(p * m for p, m, _ in parts) / whole
    return whole, first, sum(p * (v + (m - first) ** 2) for p, m, v in parts) / whole


@family("log weights", "closed form")
def weights(score):
    with mp.workdps(100):
        highest = max(score)
        total = highest + mp.log(sum(mp.exp(s - highest) for s in score))
        found = {f"log weight {k}": relative(s - total, 1) for k, s in enumerate(score)}
        return {"log sum": relative(total, 1), **found}


@family("fixed mode", "closed form")
def fixed_mode(count, apart, r):
    """Which of two constant levels is measured: exact log-odds, however small a probability."""
    with mp.workdps(100):
        odds = mp.mpf(0)
        for k in range(count):
            y = mp.mpf(wave(k)) / 16
            odds += (y * y - (y - apart) ** 2) / (2 * r)
        least = -mp.log1p(mp.exp(abs(odds)))
        sides = {"log odds": Value(odds, max(abs(odds), 1)), "lesser": Value(least, max(1, -least))}
        return sides
