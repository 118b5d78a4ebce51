"""Filters of the scalar system with dependent noises and an indicator that depends on the state.

Plain NumPy from [R-SW 6.21-6.23, 6.27, 6.35], means by quadrature in the state and the noise, and
the Bayes filter on a grid; random numbers of its own, nothing of the library but `ndtr` of SciPy.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from oracles.switching_design import Parameters

SWITCH, SLOPE, TIE = (1.2, -0.3), (-0.8, 0.5), (0.6, -0.4)
A0, A1, S = (0.2, -0.5), (0.9, 0.5), (0.6, 0.8)
TELL, TURN, BOND = (1.0, -0.2), (-0.7, 0.4), (0.5, -0.3)
B0, B1, B2, R = (0.0, 1.0), (1.0, 0.7), (0.1, -0.05), (0.7, 0.5)
START, MEAN, VAR = np.array([0.6, 0.4]), (0.0, 1.0), (0.5, 0.5)
POINTS, WEIGHTS = np.polynomial.hermite_e.hermegauss(10)
WEIGHTS = WEIGHTS / WEIGHTS.sum()
LEAST = 1e-12  # of variances, which the printed form may make negative


def bell(t):
    return np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi)


def above(level, noise, tie):
    """Chance that a normal number exceeds a level, given another one of correlation `tie`."""
    return ndtr((tie * noise - level) / np.sqrt(1 - tie**2))


def simulated(steps, paths, seed):
    rng = np.random.default_rng(seed)
    mode = (rng.random(paths) < START[1]).astype(int)
    x = np.choose(mode, MEAN) + np.sqrt(np.choose(mode, VAR)) * rng.standard_normal(paths)
    found = []
    for _ in range(steps):

        def of(numbers, mode=mode):
            return np.choose(mode, numbers)

        w, v = rng.standard_normal((2, paths))
        told = rng.random(paths) < above(of(TELL) + of(TURN) * x, w, of(BOND))
        y = of(B0) + of(B1) * x + of(B2) * x**2 + of(R) * w
        found.append((mode, x[None], y, told.astype(int)))
        into = rng.random(paths) < above(of(SWITCH) + of(SLOPE) * x, v, of(TIE))
        x, mode = of(A0) + of(A1) * x + of(S) * v, into.astype(int)
    return [np.array(part) for part in zip(*found, strict=True)]


def split(parts):
    """Chances, means, variances (2, 2, paths) by mode and indicator, from moments 0 to 2."""
    mass, first, second = parts
    mean = first / mass
    return mass, mean, np.maximum(second / mass - mean**2, LEAST)


def tells(i, x):
    """Chances of both indicators in mode i."""
    one = ndtr(-(TELL[i] + TURN[i] * x))
    return np.stack([1 - one, one])


def at_start(paths):
    parts = np.zeros((3, 2, 2, paths))
    for i in (0, 1):
        x = MEAN[i] + np.sqrt(VAR[i]) * POINTS[:, None]
        for n in range(3):
            parts[n, i] = START[i] * np.einsum("q,jqN,qN->jN", WEIGHTS, tells(i, x), x**n)
    return split(parts)


def forecast(prob, mean, var):
    """(6.35) by quadrature in the state and in the noise, ten nodes each."""
    parts = np.zeros((3, 2, 2, prob.shape[1]))
    for i in (0, 1):
        x = mean[i] + np.sqrt(var[i]) * POINTS[:, None]
        for v, weight in zip(POINTS, WEIGHTS, strict=True):
            into = above(SWITCH[i] + SLOPE[i] * x, v, TIE[i])
            ahead = A0[i] + A1[i] * x + S[i] * v
            for l, chance in enumerate((1 - into, into)):
                for n in range(3):
                    share = WEIGHTS[:, None] * chance * ahead**n
                    parts[n, l] += prob[i] * weight * (tells(l, ahead) * share).sum(axis=1)
    return split(parts)


def corrected(ahead, y, told, printed):
    """(6.21) as printed or in its consistent form, then lemma 1."""
    mass, mean, var = ahead
    logs, means, variances = [], [], []
    for i in (0, 1):
        sums = np.zeros((6, 2, len(y)))  # of 1, x, x^2, y, y^2, x y, for each indicator
        for g in (0, 1):
            x = mean[i, g] + np.sqrt(var[i, g]) * POINTS[:, None]
            t, b, chance = TELL[i] + TURN[i] * x, B0[i] + B1[i] * x + B2[i] * x**2, tells(i, x)
            bent = R[i] * BOND[i] * bell(t)
            nu, square = b * chance[1] + bent, b**2 * chance[1] + 2 * b * bent
            square += R[i] ** 2 * (chance[1] + BOND[i] ** 2 * t * bell(t))
            nu, square = np.stack([b - nu, nu]), np.stack([b**2 + R[i] ** 2 - square, square])
            for n, part in enumerate((chance, x * chance, x**2 * chance, nu, square, x * nu)):
                sums[n] += mass[i, g] * np.einsum("q,jqN->jN", WEIGHTS, part)
        s = np.where(told, sums[:, 1], sums[:, 0])
        if printed:
            weight, m, d = (np.where(told, part[i, 1], part[i, 0]) for part in ahead)
        else:
            weight, m = s[0], s[1] / s[0]
            d = s[2] / s[0] - m**2
        expected = s[3] / weight
        spread = np.maximum(s[4] / weight - expected**2, LEAST)
        cross, away = s[5] / weight - m * expected, y - expected
        logs.append(np.log(weight) - 0.5 * (away**2 / spread + np.log(spread)))
        means.append(m + cross * away / spread)
        variances.append(np.maximum(d - cross**2 / spread, LEAST))
    logs = np.array(logs) - np.max(logs, axis=0)
    return np.exp(logs) / np.exp(logs).sum(axis=0), np.array(means), np.array(variances)


def run(data, printed=False, fits=None, design=False):
    """The IMM filter; with `fits`, or while they are designed, the filter of order one."""
    modes, states, measured, indicated = data
    ahead, decided, estimated, made = at_start(len(modes[0])), [], [], list(fits or ())
    for k, y in enumerate(measured):
        dist = corrected(ahead, y, indicated[k], printed)
        mode, mean = dist[0].argmax(axis=0), (dist[0] * dist[1]).sum(axis=0)
        decided.append(mode)
        estimated.append(mean[None])
        if design:
            made.append(Parameters(modes[k], states[k], mode, mean[None]))
        if made:
            prob, means, covs = made[k].recall(mode, mean[None])
            dist = prob, means[:, 0], covs[:, 0, 0]
        ahead = forecast(*dist)
    return np.array(decided), np.array(estimated), made


def bayes(data, count=181):
    modes, _, measured, indicated = data
    x = np.linspace(-9, 9, count)
    blocks = []
    for i in (0, 1):
        v = (x - A0[i] - A1[i] * x[:, None]) / S[i]
        move = bell(v) / bell(v).sum(axis=1, keepdims=True)
        into = above((SWITCH[i] + SLOPE[i] * x)[:, None], v, TIE[i])
        blocks.append([(1 - into) * move, into * move])
    transition, both = np.block(blocks), np.concatenate([x, x])
    dist = np.concatenate([START[i] * bell((x - MEAN[i]) / np.sqrt(VAR[i])) for i in (0, 1)])
    dist = np.repeat(dist[None], len(modes[0]), axis=0)
    decided, estimated = [], []
    for k, y in enumerate(measured):
        dist = dist @ transition if k else dist
        for i in (0, 1):
            w = (y[:, None] - B0[i] - B1[i] * x - B2[i] * x**2) / R[i]
            one = above(TELL[i] + TURN[i] * x, w, BOND[i])
            likely = bell(w) / R[i] * np.where(indicated[k][:, None], one, 1 - one)
            dist[:, i * count : (i + 1) * count] *= likely
        dist /= dist.sum(axis=1, keepdims=True)
        decided.append((dist[:, count:].sum(axis=1) > 0.5).astype(int))
        estimated.append((dist @ both)[None])
    return np.array(decided), np.array(estimated)
