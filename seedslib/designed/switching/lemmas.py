"""The steps of a filter of a switching system as pure functions: the lemmas of the paper.

Layout: components first, then the mode, then (for forecasts) the parts of a mode's law, then any
batch axes: probabilities (L, *batch), means (n, L, *batch), covariances (n, n, L, *batch).
Probabilities are carried as logarithms, so that none is lost however small it becomes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import align
from seedslib.base.circle import Periods
from seedslib.base.conditioning import update
from seedslib.filters.weights import logarithm, mix, most_probable, normalised, relative
from seedslib.linearization.moments import Moments, Weighted

FAINT = 1e-200
"""A sum of weights below this part of the largest weight is formed again by itself."""


class ModeLaw(NamedTuple):
    """Law of mode and state: for each mode its probability and the moments of the state in it.

    Forecasts have one more axis after the modes: the Gaussian parts of a mode's law, (6.19).

    Attributes
    ----------
    log_prob : ndarray, shape (L, *batch)
        Logarithms of the probabilities.
    mean, cov : ndarray, shapes (n, L, *batch) and (n, n, L, *batch)
    """

    log_prob: np.ndarray
    mean: np.ndarray
    cov: np.ndarray

    @classmethod
    def of(cls, prob: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> ModeLaw:
        """Law from the probabilities themselves."""
        return cls(logarithm(prob), mean, cov)

    @property
    def prob(self) -> np.ndarray:
        """Probabilities, (L, *batch)."""
        return np.exp(self.log_prob)


class Sensed(NamedTuple):
    """Law of mode and state given the indicator, and the moments of the measurement in each mode.

    Attributes
    ----------
    log_prob : ndarray, shape (L, *batch)
        Logarithms of Q, not normalised over the modes.
    mean, cov : ndarray, shapes (n, L, *batch) and (n, n, L, *batch)
    moments : Moments
        mu (m, L, *batch), Delta (n, m, L, *batch), Phi (m, m, L, *batch).
    """

    log_prob: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    moments: Moments

    @property
    def prob(self) -> np.ndarray:
        """Q, (L, *batch)."""
        return np.exp(self.log_prob)


def propagate(rows: Any, t: float, law: ModeLaw) -> ModeLaw:
    """Forecast of mode and state from their law: lemmas 4 and 6, (6.35).

    Parameters
    ----------
    rows : sequence of callable
        For each old mode ``row(t, mean, cov)``, which gives for each new mode and each part a
        `Weighted` with the moments of the next state, or None where it never switches there.
    t : float
        The old time.
    law : ModeLaw
        Xi (L, *batch), gamma (n, L, *batch), T (n, n, L, *batch).

    Returns
    -------
    ModeLaw
        Q (L, G, *batch), lambda (n, L, G, *batch), Psi (n, n, L, G, *batch).
    """
    n, modes, batch = len(law.mean), len(law.log_prob), law.log_prob.shape[1:]
    heavy, highest, lost = relative(law.log_prob, 0)
    highest = np.where(lost, 0.0, highest)
    made = [row(t, law.mean[:, i], law.cov[:, :, i]) for i, row in enumerate(rows)]
    parts = len(made[0][0])
    log_prob = np.empty((modes, parts, *batch))
    mean = np.empty((n, modes, parts, *batch))
    cov = np.empty((n, n, modes, parts, *batch))
    for l in range(modes):
        for g in range(parts):
            found = [(i, made[i][l][g]) for i in range(modes) if made[i][l][g] is not None]
            if not found:
                log_prob[l, g], mean[:, l, g] = -np.inf, 0.0
                cov[:, :, l, g] = np.eye(n).reshape(n, n, *(1,) * len(batch))
                continue
            mass = np.empty((len(found), *batch))
            means, covs = np.empty((n, len(found), *batch)), np.empty((n, n, len(found), *batch))
            for p, (i, w) in enumerate(found):
                mass[p] = heavy[i] * w.mass
                means[:, p] = align(w.value.mean, 1, len(batch))
                covs[:, :, p] = align(w.value.cov, 2, len(batch))
            if len(found) == 1 and (mass > 0).all():
                total, mean[:, l, g], cov[:, :, l, g] = mass[0], means[:, 0], covs[:, :, 0]
            else:
                total, mean[:, l, g], cov[:, :, l, g] = mix(mass, means, covs)
            log_prob[l, g] = highest + logarithm(total)
            faint = total < FAINT
            if faint.any():
                logs = np.stack([law.log_prob[i] + logarithm(w.mass) for i, w in found])
                log_prob[l, g, faint], mean[:, l, g][..., faint], cov[:, :, l, g][..., faint] = (
                    mix_logs(logs[:, faint], means[..., faint], covs[..., faint])
                )
    return ModeLaw(log_prob, mean, cov)


def sense(readings: Any, t: float, law: ModeLaw, column: Any = None) -> Sensed:
    """Moments of the measurement from the forecast: lemma 3 in its consistent form.

    Parameters
    ----------
    readings : sequence of callable
        For each mode ``reading(t, mean, cov) -> Weighted``: the measurement together with the
        value of the indicator that was seen.
    t : float
    law : ModeLaw
        Forecast with its parts.
    column : int, optional
        Give (6.21) as it is printed, with this part of the forecast as the one of the indicator's
        value: divided by the forecast probability, not by the mass of the mixture.

    Returns
    -------
    Sensed
    """
    n, modes, batch = len(law.mean), len(law.log_prob), law.log_prob.shape[2:]
    log_prob, laws = np.empty((modes, *batch)), []
    for i, reading in enumerate(readings):
        mean, cov = law.mean[:, i], law.cov[:, :, i]
        if reading is None:
            laws.append(None)
            log_prob[i] = -np.inf
            continue
        w = reading(t, mean, cov)
        logs, (both, spread) = law.log_prob[i] + logarithm(w.mass), joined(w, mean.shape[1:])
        if column is not None:
            part = ModeLaw(law.log_prob[i], mean, cov)
            log_prob[i], *found = _printed(logs, both, spread, part, column)
        elif len(logs) == 1 and (logs > -np.inf).all():
            log_prob[i], found = logs[0], (both[:, 0], spread[:, :, 0])
        else:
            log_prob[i], *found = mix_logs(logs, both, spread)
        laws.append(found)
    size = next(len(found[0]) for found in laws if found is not None)
    mean, cov = np.empty((size, modes, *batch)), np.empty((size, size, modes, *batch))
    for i, found in enumerate(laws):
        if found is None:
            mean[:, i] = 0.0
            cov[:, :, i] = np.eye(size).reshape(size, size, *(1,) * len(batch))
        else:
            mean[:, i], cov[:, :, i] = found
    moments = Moments(mean[n:], cov[:n, n:], cov[n:, n:])
    return Sensed(log_prob, mean[:n], cov[:n, :n], moments)


def joined(moments: Weighted, batch: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n + m, *batch) and covariance of the state and, below it, the value."""
    state, value = moments.state, moments.value
    n, depth = len(state.mean), len(batch)
    size = n + len(value.mean)
    mean, cov = np.empty((size, *batch)), np.empty((size, size, *batch))
    mean[:n], mean[n:] = align(state.mean, 1, depth), align(value.mean, 1, depth)
    cross = align(value.cross, 2, depth)
    cov[:n, :n], cov[:n, n:] = align(state.cov, 2, depth), cross
    cov[n:, :n], cov[n:, n:] = np.swapaxes(cross, 0, 1), align(value.cov, 2, depth)
    return mean, cov


def mix_logs(log_mass: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> Any:
    """As `mix`, from and to logarithms of masses, which may be too small for numbers."""
    mass, highest, lost = relative(log_mass, 0)
    total, mean, cov = mix(mass, mean, cov)
    return np.where(lost, 0.0, highest) + logarithm(total), mean, cov


def _printed(logs, both, spread, part, column):
    """(6.21) as printed, for one mode: sums over the parts, divided by the forecast Q^(ij)."""
    n = part.mean.shape[0]
    q = part.log_prob[column]
    seen = q > -np.inf
    share = np.where(seen & (logs > -np.inf), np.exp(logs - np.where(seen, q, 0.0)), 0.0)
    both, spread = np.nan_to_num(both), np.nan_to_num(spread)
    x, mu = part.mean[:, column], (share * both[n:]).sum(axis=1)
    raw = spread + both[:, None] * both[None, :]
    second = (share * raw).sum(axis=2)
    mean = np.concatenate([x, mu])
    cov = second - mean[:, None] * mean[None, :]
    cov[:n, :n] = part.cov[:, :, column]
    unit = np.eye(len(mean)).reshape(len(mean), len(mean), *(1,) * q.ndim)
    return q, np.where(seen, mean, 0.0), np.where(seen, cov, unit)


def weigh(
    sensed: Sensed, y: np.ndarray, noise: Any = None, periods: Periods = ()
) -> tuple[ModeLaw, np.ndarray]:
    """Posterior law of mode and state: lemma 1, (6.15) to (6.17).

    Parameters
    ----------
    sensed : Sensed
    y : ndarray, shape (m, *batch)
        NaN components are left out exactly.
    noise : callable, optional
        ``noise() -> (m, m, L, *batch)``, see `update`.
    periods : tuple
        Components of y on a circle, see `as_periods`.

    Returns
    -------
    law : ModeLaw
        P (L, *batch), rho (n, L, *batch), Upsilon (n, n, L, *batch).
    loglik : ndarray, shape (*batch)
        Logarithm of the density of the measurement, indicator included.
    """
    mean, cov, each = update(
        sensed.mean, sensed.cov, y[:, None], sensed.moments, noise=noise, periods=periods
    )
    score = np.where(sensed.log_prob > -np.inf, sensed.log_prob + each, -np.inf)
    log_prob, loglik = normalised(score, 0)
    lost = ~np.isfinite(loglik)
    if np.any(lost):  # no mode explains the measurement: keep what was forecast
        log_prob = np.where(lost, normalised(sensed.log_prob, 0)[0], log_prob)
    return ModeLaw(log_prob, mean, cov), loglik


def decide(law: ModeLaw) -> tuple[np.ndarray, np.ndarray]:
    """Most probable mode (`most_probable`) and mean of the state: lemma 2, (6.18)."""
    prob = law.prob
    return most_probable(prob), (prob * law.mean).sum(axis=1)


def total_covariance(law: ModeLaw) -> np.ndarray:
    """Covariance of the state over all modes, (n, n, *batch)."""
    return mix(law.prob, law.mean, law.cov).cov if len(law.log_prob) > 1 else law.cov[:, :, 0]
