"""The steps of a filter of a switching system as pure functions: the lemmas of the paper.

Layout: components first, then the mode, then (for forecasts) the parts of a mode's distribution,
then any batch axes: probabilities (L, *batch), means (n, L, *batch), covariances (n, n, L, *batch).
Probabilities are carried as logarithms, so that none underflows.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import align
from seedslib.base.checks import outside
from seedslib.base.circle import Periods
from seedslib.base.conditioning import update
from seedslib.filters.weights import logarithm, mix, most_probable, normalised, relative
from seedslib.linearization.moments import Moments, Weighted

ROUNDING = 1e-9
"""By how much the mean of a probability may be out of range."""

FAINT = 1e-200
"""A sum of weights below this part of the largest weight is formed again by itself."""


class ModeDistribution(NamedTuple):
    """Distribution of mode and state: of each mode its probability and the moments of the state.

    Forecasts have one more axis after the modes: the Gaussian parts within a mode, (6.19).

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
    def of(cls, prob: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> ModeDistribution:
        """From the probabilities themselves."""
        return cls(logarithm(prob), mean, cov)

    @property
    def prob(self) -> np.ndarray:
        """Probabilities, (L, *batch)."""
        return np.exp(self.log_prob)


class Sensed(NamedTuple):
    """Mode and state given the indicator, and the moments of the measurement in each mode.

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


def propagate(
    rows: Sequence[Callable[..., Any]], t: float, dist: ModeDistribution
) -> ModeDistribution:
    """Forecast of mode and state: lemmas 4 and 6, (6.35).

    Parameters
    ----------
    rows : sequence of callable
        For each old mode ``row(t, mean, cov)``, which gives for each new mode and each part a
        `Weighted` with the moments of the next state, or None where it never switches there.
    t : float
        The old time.
    dist : ModeDistribution
        Xi (L, *batch), gamma (n, L, *batch), T (n, n, L, *batch).

    Returns
    -------
    ModeDistribution
        Q (L, G, *batch), lambda (n, L, G, *batch), Psi (n, n, L, G, *batch).
    """
    n, modes, batch = len(dist.mean), len(dist.log_prob), dist.log_prob.shape[1:]
    weight, highest, infinite = relative(dist.log_prob, 0)
    highest = np.where(infinite, 0.0, highest)
    moments = [row(t, dist.mean[:, i], dist.cov[:, :, i]) for i, row in enumerate(rows)]
    parts = len(moments[0][0])
    log_prob = np.empty((modes, parts, *batch))
    mean = np.empty((n, modes, parts, *batch))
    cov = np.empty((n, n, modes, parts, *batch))
    for l, g in np.ndindex(modes, parts):
        sources = [(i, moments[i][l][g]) for i in range(modes) if moments[i][l][g] is not None]
        if not sources:
            log_prob[l, g], mean[:, l, g] = -np.inf, 0.0
            cov[:, :, l, g] = align(np.eye(n), 2, len(batch))
            continue
        mass = np.empty((len(sources), *batch))
        means, covs = np.empty((n, *mass.shape)), np.empty((n, n, *mass.shape))
        for p, (i, source) in enumerate(sources):
            _warn_of_probability(source.mass)
            mass[p] = weight[i] * source.mass
            means[:, p] = align(source.value.mean, 1, len(batch))
            covs[:, :, p] = align(source.value.cov, 2, len(batch))
        if len(sources) == 1 and (mass > 0).all():
            total, mean[:, l, g], cov[:, :, l, g] = mass[0], means[:, 0], covs[:, :, 0]
        else:
            total, mean[:, l, g], cov[:, :, l, g] = mix(mass, means, covs)
        log_prob[l, g] = highest + logarithm(total)
        faint = total < FAINT
        if faint.any():
            logs = np.stack([dist.log_prob[i] + logarithm(w.mass) for i, w in sources])
            log_prob[l, g, faint], mean[:, l, g][..., faint], cov[:, :, l, g][..., faint] = (
                mix_logs(logs[:, faint], means[..., faint], covs[..., faint])
            )
    return ModeDistribution(log_prob, mean, cov)


def _warn_of_probability(mean: np.ndarray | float) -> None:
    """Warn of a mean of a probability that is out of range: of a switch where the state may be."""
    if np.any(mean < -ROUNDING) or np.any(mean > 1.0 + ROUNDING):
        warnings.warn(
            "switching: wanted probabilities from 0 to 1 wherever the state may be, got others",
            stacklevel=outside(),
        )


def sense(
    readings: Sequence[Callable[..., Weighted] | None],
    t: float,
    dist: ModeDistribution,
    column: int | None = None,
) -> Sensed:
    """Moments of the measurement from the forecast: lemma 3 in its consistent form.

    Parameters
    ----------
    readings : sequence of callable or None
        For each mode ``reading(t, mean, cov) -> Weighted``: the measurement together with the
        observed value of the indicator; None where the mode never gives that value.
    t : float
    dist : ModeDistribution
        Forecast with its parts.
    column : int, optional
        Give (6.21) as it is printed, with this part of the forecast as the one of the indicator's
        value: divided by the forecast probability, not by the mass of the mixture.

    Returns
    -------
    Sensed
    """
    n, modes, batch = len(dist.mean), len(dist.log_prob), dist.log_prob.shape[2:]
    log_prob, joint = np.full((modes, *batch), -np.inf), {}
    for i, reading in enumerate(readings):
        if reading is None:
            continue
        mean, cov = dist.mean[:, i], dist.cov[:, :, i]
        weighted = reading(t, mean, cov)
        logs = dist.log_prob[i] + logarithm(weighted.mass)
        both, covs = joined(weighted, mean.shape[1:])
        if column is not None:
            part = ModeDistribution(dist.log_prob[i], mean, cov)
            log_prob[i], *joint[i] = _printed(logs, both, covs, part, column)
        elif len(logs) == 1 and (logs > -np.inf).all():
            log_prob[i], joint[i] = logs[0], (both[:, 0], covs[:, :, 0])
        else:
            log_prob[i], *joint[i] = mix_logs(logs, both, covs)
    size = len(next(iter(joint.values()))[0])
    mean = np.zeros((size, modes, *batch))
    cov = np.empty((size, size, modes, *batch))
    cov[...] = align(np.eye(size), 2, 1 + len(batch))
    for i, (one, its_cov) in joint.items():
        mean[:, i], cov[:, :, i] = one, its_cov
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


def mix_logs(
    log_mass: np.ndarray, mean: np.ndarray, cov: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `mix`, from and to logarithms of masses, which may underflow as numbers."""
    mass, highest, infinite = relative(log_mass, 0)
    total, mean, cov = mix(mass, mean, cov)
    return np.where(infinite, 0.0, highest) + logarithm(total), mean, cov


def _printed(logs, both, covs, part, column):
    """(6.21) as printed, for one mode: sums over the parts, divided by the forecast Q^(ij)."""
    n = part.mean.shape[0]
    q = part.log_prob[column]
    possible = q > -np.inf
    share = np.exp(logs - np.where(possible, q, 0.0))
    share = np.where(possible & (logs > -np.inf), share, 0.0)
    both, covs = np.nan_to_num(both), np.nan_to_num(covs)
    x, mu = part.mean[:, column], (share * both[n:]).sum(axis=1)
    second = (share * (covs + both[:, None] * both[None, :])).sum(axis=2)
    mean = np.concatenate([x, mu])
    cov = second - mean[:, None] * mean[None, :]
    cov[:n, :n] = part.cov[:, :, column]
    unit = align(np.eye(len(mean)), 2, q.ndim)
    return q, np.where(possible, mean, 0.0), np.where(possible, cov, unit)


def weigh(
    sensed: Sensed,
    y: np.ndarray,
    noise: Callable[[], np.ndarray] | None = None,
    periods: Periods = (),
) -> tuple[ModeDistribution, np.ndarray]:
    """Posterior of mode and state: lemma 1, (6.15) to (6.17).

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
    dist : ModeDistribution
        P (L, *batch), rho (n, L, *batch), Upsilon (n, n, L, *batch).
    loglik : ndarray, shape (*batch)
        Logarithm of the density of the measurement, indicator included.
    """
    mean, cov, mode_loglik = update(
        sensed.mean, sensed.cov, y[:, None], sensed.moments, noise=noise, periods=periods
    )
    score = np.where(sensed.log_prob > -np.inf, sensed.log_prob + mode_loglik, -np.inf)
    log_prob, loglik = normalised(score, 0)
    unexplained = ~np.isfinite(loglik)
    if np.any(unexplained):  # by any mode: the forecast stays
        log_prob = np.where(unexplained, normalised(sensed.log_prob, 0)[0], log_prob)
    return ModeDistribution(log_prob, mean, cov), loglik


def decide(dist: ModeDistribution) -> tuple[np.ndarray, np.ndarray]:
    """Most probable mode (`most_probable`) and mean of the state: lemma 2, (6.18)."""
    prob = dist.prob
    return most_probable(prob), (prob * dist.mean).sum(axis=1)


def total_covariance(dist: ModeDistribution) -> np.ndarray:
    """Covariance of the state over all modes, (n, n, *batch)."""
    return mix(dist.prob, dist.mean, dist.cov).cov if len(dist.log_prob) > 1 else dist.cov[:, :, 0]
