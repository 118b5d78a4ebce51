"""Smoothing of mode and state: the step back of a switching filter without a memory."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.base.arrays import MaybeArray, align
from seedslib.base.conditioning import kalman_gain, update
from seedslib.base.linalg import NEGATIVE, cholesky, nearest_psd, solve_psd, symmetrized
from seedslib.base.values import Values
from seedslib.designed.lemmas import ModeLaw, decide, joined, mix_logs, total_covariance
from seedslib.designed.rules import SwitchingState
from seedslib.filters.base import Estimates
from seedslib.filters.smoothing import Smoother, rts_step
from seedslib.filters.weights import logarithm, normalised

WIDER = 1e-8
"""Loss of variance, in units of the forecast, where there is none: what follows from it, and the
rounding of a value divided by its root, are both of this size."""


class SwitchingSmoother(Smoother):
    """Smoothed distributions in all modes, by interacting steps back.

    Given the later mode and state, the earlier ones do not depend on later measurements. Within
    each later mode the filter knows the forecast as a mixture over the earlier modes, each with a
    joint Gaussian of both states. The later measurements act in that mode as *one Gaussian
    likelihood* of the later state, the one that turns its forecast into its smoothed
    distribution, both with matched moments. Every pair of modes is corrected by it and weighted
    by it, takes a step of Rauch, Tung and Striebel back, and the pairs of an earlier mode are
    merged with matched moments. Where a smoothed distribution is wider than its forecast, which no
    Gaussian likelihood makes, the excess is added to the pairs.

    Two things are neglected: that the likelihood is a mixture itself, over the modes still to
    come, and that the distribution within a mode is one. It is exact with one mode, with modes
    that move and measure alike, with modes that never switch, and where no measurement follows;
    all for linear dynamics.

    Parameters
    ----------
    filter : SwitchingFilter
        Without a memory.
    """

    def last(self, state: SwitchingState) -> ModeLaw:
        """See `Smoother.last`."""
        return state.law

    def back(
        self,
        state: SwitchingState,
        later: ModeLaw,
        link: Any,
        p: Values,
        indicator: MaybeArray = None,
    ) -> ModeLaw:
        """See `Smoother.back`."""
        rules, t, law = self.filter.rules, state.time, state.law
        if rules.switch is None:
            return _back(rules, rules.rows, t, law, later, indicator, p)
        # the new mode drives the step: a switch of a state that does not move, then a move
        later = _back(rules, rules.rows, t, rules.switched(t, law, p), later, indicator, p)
        return _back(rules, rules.switch, t, law, later, None, p)

    def report(self, smoothed: ModeLaw) -> Estimates:
        """Mean, covariance over all modes, and the modes with their probabilities."""
        modes, mean = decide(smoothed)
        return Estimates(mean, total_covariance(smoothed), smoothed.prob, modes=modes)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # diverged records show as NaN
def _back(rules, rows, t, law, later, indicator, p) -> ModeLaw:
    """Smoothed mode and state before the moves in `rows`, from those after them."""
    sources, results = [], []
    moments = [row(t, law.mean[:, i], law.cov[:, :, i], p) for i, row in enumerate(rows)]
    for l in range(len(rows)):
        pairs = [
            (i, value, weighted)
            for i, row in enumerate(moments)
            for value, weighted in enumerate(row[l])
            if weighted is not None
        ]
        if not pairs:
            continue
        log_prob = np.stack([law.log_prob[i] + logarithm(w.mass) for i, _, w in pairs])
        if rules.split and indicator is not None:
            # a part of the forecast goes with one value of the indicator
            fits = np.stack([(indicator < 0) | (indicator == j) for _, j, _ in pairs])
            possible = (fits & (log_prob > -np.inf)).any(axis=0)
            log_prob = np.where(fits | ~possible, log_prob, -np.inf)
        both = [joined(w, log_prob.shape[1:]) for *_, w in pairs]
        mean, cov = (np.stack(parts, axis=-2) for parts in zip(*both, strict=True))
        cov = nearest_psd(cov)[0] if rules.guarded else cov
        sources += [i for i, *_ in pairs]
        one = ModeLaw(*(part[..., l, :] for part in later))
        results.append(_corrected(log_prob, mean, cov, one))
    results = [np.concatenate(part, axis=-2) for part in zip(*results, strict=True)]
    columns = [np.flatnonzero(np.array(sources) == i) for i in range(len(rows))]
    merged = [mix_logs(*(part[..., own, :] for part in results)) for own in columns]
    log_prob, mean, cov = (np.stack(part, axis=-2) for part in zip(*merged, strict=True))
    return ModeLaw(normalised(log_prob, 0)[0], mean, cov)


def _corrected(log_prob, both, joint, later):
    """Pairs of one later mode, whose smoothed distribution is known: weights and moments before."""
    n = len(later.mean)
    mean, cov = both[n:], joint[n:, n:]
    _, forecast, total = mix_logs(log_prob, mean, cov)
    slope, noise, value, excess = _likelihood(forecast, total, later)
    slope = slope[:, :, None]
    cross = np.einsum("ij...,kj...->ik...", cov, slope)
    moments = (
        np.einsum("ij...,j...->i...", slope, mean - forecast[:, None]),
        cross,
        np.einsum("ij...,jk...->ik...", slope, cross) + noise[:, :, None],
    )
    smoothed, reduced, loglik = update(mean, cov, value[:, None], moments)
    columns, before = rts_step(
        both[:n, None],
        joint[:n, :n],
        mean[:, None],
        cov,
        kalman_gain(joint[:n, n:], cov),
        smoothed[:, None],
        reduced + excess[:, :, None],
    )
    share = normalised(np.where(log_prob > -np.inf, log_prob + loglik, -np.inf), 0)[0]
    return later.log_prob + share, columns[:, 0], before


def _likelihood(forecast, total, later):
    """Measurement by which a forecast N(m, S) becomes the smoothed N(m', P).

    In units of the forecast, u = L⁻¹ (x - m) with S = L Lᵀ, the covariance loses 1 - L⁻¹ P L⁻ᵀ,
    with eigenvalues d and eigenvectors v. For each of them sqrt(d) vᵀu and noise of variance 1 - d
    are measured, whose variance over the forecast is one however little d is. Where P is wider
    than the forecast (d < 0) almost nothing is measured, by a value that still moves the mean.

    Returns
    -------
    slope, noise : ndarray, shape (n, n, *batch)
        Of the measurement of x - m.
    value : ndarray, shape (n, *batch)
    excess : ndarray, shape (n, n, *batch)
        By which P is wider than this measurement makes it.
    """
    root = cholesky(total)
    white = solve_psd(total, root).swapaxes(0, 1)  # L⁻¹, with zeros where L has them
    loss = np.einsum("ij...,jk...,lk...->il...", white, total - later.cov, white)
    d, v = np.linalg.eigh(np.moveaxis(symmetrized(loss), (0, 1), (-2, -1)))
    d, v = np.moveaxis(d, -1, 0), np.moveaxis(v, (-2, -1), (0, 1))
    d = np.where(np.abs(d) <= NEGATIVE, 0.0, np.clip(d, WIDER, 1.0))
    rows = np.einsum("ji...,jk...->ik...", v, white)
    shift = np.einsum("ij...,j...->i...", rows, later.mean - forecast)
    value = np.where(d > 0.0, shift / np.sqrt(np.where(d > 0.0, d, 1.0)), 0.0)
    noise = align(np.eye(len(d)), 2, d.ndim - 1) * (1.0 - d)
    columns = np.einsum("ij...,jk...->ik...", root, v)
    excess = later.cov - total + np.einsum("ij...,j...,kj...->ik...", columns, d, columns)
    return np.sqrt(d)[:, None] * rows, noise, value, excess
