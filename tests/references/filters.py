"""References: filters of linear systems in discrete time, and Gaussian filters of a pendulum."""

from __future__ import annotations

from typing import Any

import mpmath as mp

from references.high import STEP, column, family, law_values, matrix, relative
from references.record import STEPS, wave

TREND = {
    "F": [[1.0, 0.5], [0.0, 0.875]],
    "Q": [[0.25, 0.0625], [0.0625, 0.125]],
    "H": [[1.0, 0.0]],
    "R": [[0.5]],
    "mean0": [0.5, -0.25],
    "cov0": [[1.0, 0.25], [0.25, 2.0]],
    "offset": 0.0,
    "size": 1.0,
}
PAIR = TREND | {"H": [[1.0, 0.0], [1.0, 1.0]], "R": [[0.5, 0.125], [0.125, 1.0]]}
LINEAR = {
    "ordinary": TREND,
    "two_sensors": PAIR,
    "exact_sensor": TREND | {"R": [[0.0]]},
    "wide_prior": TREND | {"cov0": [[1e10, 0.0], [0.0, 1e8]]},
    "known_start": TREND | {"cov0": [[0.0, 0.0], [0.0, 0.0]]},
    "small": TREND
    | {"Q": [[2.5e-13, 0.0], [0.0, 1e-13]], "R": [[1e-10]], "cov0": [[1e-8, 0.0], [0.0, 1e-8]]},
    "large": TREND | {"F": [[1.0, 0.5], [0.0, 1.0]], "mean0": [1e9, 0.0], "offset": 1e9},
    "nearly_singular": PAIR
    | {"H": [[1.0, 0.0], [1.0, 2.0**-20]], "R": [[1.0, 1 - 1e-8], [1 - 1e-8, 1.0]]},
}


def record(k: int, m: int, offset: Any, size: Any, nudge: Any = None) -> Any:
    """Measurement k; larger by a small part of itself where its condition is asked for."""
    part = 1 + STEP if k == nudge else 1
    return column([part * (offset + size * mp.mpf(wave(k, j))) for j in range(m)])


def corrected(mean: Any, cov: Any, error: Any, cross: Any, spread: Any) -> tuple[Any, Any, Any]:
    """Gaussian law given a measurement that is `error` off its mean, and the log-density."""
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


@family("Kalman filter", "recursion", **LINEAR)
def kalman(**told: Any) -> dict[str, Any]:
    with mp.workdps(100):
        mean, cov, total = kalman_run(**told)
        return {**law_values(mean, cov), "loglik": relative(total, 1)}


@family(
    "diffuse Kalman filter",
    "recursion",
    one={**TREND, "cov0": [[0.0, 0.0], [0.0, 2.0]], "diffuse": [0]},
    both={**TREND, "cov0": [[0.0, 0.0], [0.0, 0.0]], "diffuse": [0, 1]},
    two_sensors={**PAIR, "cov0": [[0.0, 0.0], [0.0, 0.0]], "diffuse": [0, 1]},
    large={
        **TREND,
        "cov0": [[0.0, 0.0], [0.0, 0.0]],
        "diffuse": [0, 1],
        "offset": 1e9,
        "F": [[1.0, 0.5], [0.0, 1.0]],
    },
)
def diffuse_kalman(diffuse: Any, cov0: Any, **told: Any) -> dict[str, Any]:
    """With 1e80 for the infinite variance, which is taken out of the log-likelihood again."""
    with mp.workdps(260):
        wide, cov = mp.mpf(10) ** 80, [list(row) for row in cov0]
        for k in diffuse:
            cov[k][k] = wide
        mean, cov, total = kalman_run(cov0=cov, **told)
        total += len(diffuse) * mp.log(wide) / 2
        return {**law_values(mean, cov), "loglik": relative(total, 1)}


@family(
    "smoother",
    "Gaussian conditioning at once",
    **{name: LINEAR[name] for name in ("ordinary", "two_sensors", "exact_sensor", "small")},
)
def smoother(F: Any, Q: Any, H: Any, R: Any, mean0: Any, cov0: Any, offset: Any, size: Any) -> Any:
    """The joint law of all states, given all measurements: no recursion back."""
    with mp.workdps(100):
        F, Q, H, R, start = map(matrix, (F, Q, H, R, cov0))
        n, m, steps = F.rows, H.rows, STEPS // 2
        powers, covs = [mp.eye(n)], [start]
        for _ in range(steps):
            powers.append(F * powers[-1])
            covs.append(F * covs[-1] * F.T + Q)

        def joint(i: int, j: int) -> Any:
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
            found |= law_values(mean, covs[k] - gain * cross.T, f"step {k} ")
        return found


def sines(mean: Any, cov: Any) -> tuple[Any, Any, Any]:
    """Mean of sin x1, its covariance with the state, and its variance, exact."""
    p, blunt = cov[0, 0], mp.exp(-cov[0, 0] / 2)
    first = blunt * mp.sin(mean[0])
    lean = cov[:, 0] * blunt * mp.cos(mean[0])
    return first, lean, (1 - mp.exp(-2 * p) * mp.cos(2 * mean[0])) / 2 - first**2


def transformed(kind: str, mean: Any, cov: Any, slope: Any, bend: Any) -> tuple[Any, Any, Any]:
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


PENDULUM = {
    "step": 0.125,
    "pull": 1.5,
    "damping": 0.25,
    "Q": [[1e-3, 0.0], [0.0, 4e-3]],
    "R": 0.0625,
    "mean0": [0.5, 0.0],
    "cov0": [[0.25, 0.0625], [0.0625, 0.5]],
    "size": 0.25,
}
QUIET = PENDULUM | {"Q": [[1e-10, 0.0], [0.0, 1e-10]], "R": 1e-6, "size": 2.0**-9}


@family(
    "nonlinear filters",
    "recursion",
    **{
        f"{kind} {name}": {"kind": kind, **told}
        for kind in ("extended", "unscented", "cubature", "exact")
        for name, told in (("ordinary", PENDULUM), ("quiet", QUIET))
    },
)
def nonlinear(
    kind: Any, step: Any, pull: Any, damping: Any, Q: Any, R: Any, mean0: Any, cov0: Any, size: Any
) -> dict[str, Any]:
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
        return {**law_values(mean, cov), "loglik": relative(total, 1)}
