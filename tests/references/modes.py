"""References: filters of systems with delay and of systems that switch, and weights in the tail."""

from __future__ import annotations

from typing import Any

import mpmath as mp

from references.high import Value, column, density, family, law_values, matrix, relative
from references.motion import matrix_law
from references.record import STEPS, wave

LEVEL = {
    "A": [[[0.5]], [[0.375]]],
    "delays": [0, 3],
    "C": [[1.0]],
    "Q": [[1.0]],
    "R": [[0.5]],
    "cov0": [[1.0]],
    "past": [[0.5]],
}
COUPLED = {
    "A": [[[0.5, 0.25], [0.0, 0.75]], [[0.25, 0.0], [-0.125, 0.125]]],
    "delays": [0, 2],
    "C": [[1.0, 0.5]],
    "Q": [[1.0, 0.25], [0.25, 0.5]],
    "R": [[0.25]],
    "cov0": [[1.0, 0.0], [0.0, 1.0]],
    "past": [[0.5, 0.0], [0.0, 0.5]],
}
SLOW = {**LEVEL, "A": [[[0.625]], [[0.375 - 2.0**-20]]]}
SHARP = {**COUPLED, "R": [[1e-10]]}
DULL = {**LEVEL, "R": [[1e10]]}


def stacked(A: Any, delays: Any, C: Any, Q: Any) -> tuple[Any, ...]:
    """Transition, sensor and noise of the states of the last instants in one."""
    n, depth = len(A[0]), max(delays)
    size = n * (depth + 1)
    move, sensor, noise = mp.zeros(size), mp.zeros(len(C), size), mp.zeros(size)
    for d, block in zip(delays, A, strict=True):
        move[:n, n * d : n * d + n] = matrix(block)
    move[n:, : n * depth] = mp.eye(n * depth)
    sensor[:, :n], noise[:n, :n] = matrix(C), matrix(Q)
    return move, sensor, noise


def delay_values(gain: Any, spread: Any, cov: Any, n: int) -> dict[str, Any]:
    found = matrix_law(gain, "gain")
    law = law_values(column([1] * n), cov)
    return {**found, "innovation": spread, **{k: v for k, v in law.items() if k[:3] == "cov"}}


@family(
    "delay filter", "recursion", level=LEVEL, coupled=COUPLED, slow=SLOW, sharp=SHARP, dull=DULL
)
def delay(A: Any, delays: Any, C: Any, Q: Any, R: Any, cov0: Any, past: Any) -> dict[str, Any]:
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


TWO = {
    "a": [0.875, 0.5],
    "q": [0.25, 1.0],
    "h": [1.0, 1.0],
    "r": [0.5, 0.5],
    "A": [[0.75, 0.25], [0.125, 0.875]],
    "p": [0.5, 0.5],
    "mean0": [0.0, 1.0],
    "var0": [1.0, 0.5],
    "drives": "old",
}
SWITCHING = {
    "ordinary": TWO,
    "rare": {**TWO, "A": [[1 - 2.0**-30, 2.0**-30], [2.0**-30, 1 - 2.0**-30]]},
    "quiet": {**TWO, "q": [1e-6, 4e-6], "r": [1e-4, 4e-4], "var0": [1e-4, 1e-4]},
    "unlike": {**TWO, "h": [1.0, -0.5], "r": [0.0625, 4.0], "p": [0.875, 0.125]},
}
NEW = {f"{name}, new mode": {**told, "drives": "new"} for name, told in SWITCHING.items()}


def switching_values(told: dict[str, Any]) -> dict[str, Any]:
    """One Gaussian law in each of two modes; a forecast is that of the mixture it comes from."""
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
            **law_values([first], matrix([[second]])),
        }


def mixed(parts: Any) -> tuple[Any, Any, Any]:
    whole = sum(p for p, _, _ in parts)
    first = sum(p * m for p, m, _ in parts) / whole
    return whole, first, sum(p * (v + (m - first) ** 2) for p, m, v in parts) / whole


@family("switching filter", "recursion", **SWITCHING)
def switching(**told: Any) -> dict[str, Any]:
    return switching_values(told)


@family("multiple models (IMM)", "recursion", **NEW)
def multiple_models(**told: Any) -> dict[str, Any]:
    return switching_values(told)


@family(
    "log weights",
    "closed form",
    ordinary={"score": [-1.0, 0.5, 2.0]},
    tail={"score": [-900.0, 0.0, -2000.0]},
    deep={"score": [-1e9, -1e9 - 30, -1e9 + 2]},
    equal={"score": [-7e5, -7e5, -7e5]},
)
def weights(score: Any) -> dict[str, Any]:
    with mp.workdps(100):
        highest = max(score)
        total = highest + mp.log(sum(mp.exp(s - highest) for s in score))
        found = {f"log weight {k}": relative(s - total, 1) for k, s in enumerate(score)}
        return {"log sum": relative(total, 1), **found}


@family(
    "fixed mode",
    "closed form",
    **{
        name: {"count": count, "apart": apart, "r": r}
        for name, count, apart, r in (
            ("short", 4, 1.0, 1.0),
            ("ten", 11, 2.0, 1.0),
            ("thirty", 31, 4.0, 0.5),
            ("fifty", 51, 6.0, 1e-6),
            ("near", 20, 2.0**-20, 1.0),
            ("sharp", 3, 1.0, 1e-12),
        )
    },
)
def fixed_mode(count: Any, apart: Any, r: Any) -> dict[str, Any]:
    """Which of two constant levels is measured: exact log-odds, however small a probability."""
    with mp.workdps(100):
        odds = mp.mpf(0)
        for k in range(count):
            y = mp.mpf(wave(k)) / 16
            odds += (y * y - (y - apart) ** 2) / (2 * r)
        least = -mp.log1p(mp.exp(abs(odds)))
        sides = {"log odds": Value(odds, max(abs(odds), 1)), "lesser": Value(least, max(1, -least))}
        return sides
