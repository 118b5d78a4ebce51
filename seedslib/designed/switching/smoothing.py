"""Smoothing of mode and state: the step back of a switching filter that carries whole laws."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.correction import correct
from seedslib.base.semidefinite import factor, mended
from seedslib.designed.switching.lemmas import ModeLaw, decide, mix_logs, total_covariance
from seedslib.designed.switching.rules import SwitchingState
from seedslib.filters.base import Estimates
from seedslib.filters.smoothing import Smoother, gain_of, stepped_back
from seedslib.filters.weights import logarithm, normalised


class SwitchingSmoother(Smoother):
    """Smoothed laws of all modes, by interacting steps back.

    Given the later mode and state, the earlier ones do not depend on later measurements. Within
    each later mode the filter knows the forecast as a mixture over the earlier modes, each with a
    Gaussian law of both states. What later measurements say in that mode is taken as *one
    Gaussian likelihood* of the later state, the one that makes the mode's smoothed law of its
    forecast, both with matched moments. Every pair of modes is corrected by it and weighted by
    it, takes a step of Rauch, Tung and Striebel back, and the pairs of an earlier mode are merged
    with matched moments. Where a smoothed law is wider than its forecast, which no Gaussian
    likelihood makes, the excess is added to the pairs.

    Two things are neglected: that the likelihood is a mixture itself, over the modes still to
    come, and that the law within a mode is one. It is exact with one mode, with modes that move
    and measure alike, with modes that never switch, and where no measurement follows; all for
    linear dynamics. Where the state moves the modes, the pairs have the moments, and the
    probability, of the filter's own branches.

    Parameters
    ----------
    filter : SwitchingFilter
        Without a memory.
    """

    def last(self, state: SwitchingState) -> ModeLaw:
        """See `Smoother.last`."""
        return state.law

    def back(
        self, state: SwitchingState, part: ModeLaw, link: Any, indicator: MaybeArray = None
    ) -> ModeLaw:
        """See `Smoother.back`."""
        rules, t, law = self.filter.rules, state.time, state.law
        switch = rules.switch
        if switch is None:
            return self._back(rules.rows, t, law, indicator, part)
        # the new mode drives the step: a switch of a state that stands still, and then a move
        part = self._back(rules.rows, t, rules.switched(t, law), indicator, part)
        return self._back(switch, t, law, None, part)

    def _back(self, rows, t, law, shown, part):
        """Smoothed law of mode and state before the moves in `rows`, from that after them."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            found = [
                _corrected(*pairs, ModeLaw(*(p[..., l, :] for p in part)))
                for l, pairs in enumerate(self._pairs(rows, t, law, shown))
            ]
            log_prob, mean, cov = (
                np.stack(p, axis=p[0].ndim - 1) for p in zip(*found, strict=True)
            )
            # the pairs of each old mode: its parts and all new modes together
            modes, n, paths = self.filter.system.modes, len(mean), log_prob.shape[-1]
            merged = mix_logs(
                *(p.reshape(*core, modes, -1, paths).swapaxes(-3, -2)
                  for p, core in ((log_prob, ()), (mean, (n,)), (cov, (n, n))))
            )  # fmt: skip
        return ModeLaw(normalised(merged[0], 0)[0], *merged[1:])

    def report(self, part: ModeLaw) -> Estimates:
        """Mean, covariance over all modes, and the modes with their probabilities."""
        modes, mean = decide(part)
        return Estimates(mean, total_covariance(part), part.prob, modes=modes)

    def _pairs(self, rows, t, law, shown):
        """For each new mode, (log_prob, both, spread) of its pairs with old modes and their parts.

        Shapes (P, paths), (2n, P, paths) and (2n, 2n, P, paths): the state before and after.
        """
        rules, (n, modes, paths) = self.filter.rules, law.mean.shape
        rows = [row(t, law.mean[:, i], law.cov[:, :, i]) for i, row in enumerate(rows)]
        size = len(rows[0][0])
        for l in range(modes):
            log_prob = np.full((modes, size, paths), -np.inf)
            both = np.zeros((2 * n, modes, size, paths))
            spread = np.zeros((2 * n, 2 * n, modes, size, paths))
            for i in range(modes):
                for g, pair in enumerate(rows[i][l]):
                    if pair is None:
                        continue
                    mass, old, new = pair
                    log_prob[i, g] = law.log_prob[i] + logarithm(np.asarray(mass))
                    both[:n, i, g], both[n:, i, g] = _wide(old.mean, 1), _wide(new.mean, 1)
                    spread[:n, :n, i, g] = _wide(old.cov, 2)
                    spread[n:, n:, i, g] = _wide(new.cov, 2)
                    cross = _wide(new.cross, 2)
                    spread[:n, n:, i, g], spread[n:, :n, i, g] = cross, cross.swapaxes(0, 1)
            if (
                rules.split and shown is not None
            ):  # a part is what one value of the indicator goes with
                told = (shown < 0) | (np.arange(size)[:, None] == shown)
                possible = (told & (log_prob > -np.inf)).any(axis=(0, 1))
                log_prob = np.where(told | ~possible, log_prob, -np.inf)
            if rules.guarded:
                spread = mended(spread)[0]
            flat = modes * size
            yield (
                log_prob.reshape(flat, paths), both.reshape(2 * n, flat, paths),
                spread.reshape(2 * n, 2 * n, flat, paths),
            )  # fmt: skip


def _corrected(log_prob, both, spread, later):
    """Pairs of one new mode, of which the smoothed law is known: weights and laws before it.

    The later measurements are those of u = Lᵀ S⁻¹ (x - m) + noise, with L Lᵀ = S - P the loss of
    covariance from the forecast N(m, S) to the smoothed law N(m', P): it has unit covariance,
    and the value L⁻¹ (m' - m).
    """
    n = len(later.mean)
    mean, cov = both[n:], spread[n:, n:]
    _, middle, whole = mix_logs(log_prob, mean, cov)
    variances = np.einsum("ii...->i...", whole)
    loss, _ = mended(whole - later.cov, variances)
    excess = later.cov - (whole - loss)
    root = factor(loss, variances)
    value = _solved(root, later.mean - middle)
    slope = gain_of(np.swapaxes(root, 0, 1), whole)[:, :, None]
    expected = np.einsum("ij...,j...->i...", slope, mean - middle[:, None])
    cross = np.einsum("ij...,kj...->ik...", cov, slope)
    change = np.einsum("ij...,jk...,lk...->il...", slope, cov - whole[:, :, None], slope)
    unit = np.eye(n).reshape(n, n, *(1,) * (change.ndim - 2))
    found, less, loglik = correct(mean, cov, value[:, None], (expected, cross, unit + change))
    less = less + excess[:, :, None]
    columns, before = stepped_back(
        both[:n, ..., None], spread[:n, :n], mean[..., None], cov,
        gain_of(spread[:n, n:], cov), found[..., None], less,
    )  # fmt: skip
    share = normalised(np.where(log_prob > -np.inf, log_prob + loglik, -np.inf), 0)[0]
    return later.log_prob + share, columns[..., 0], before


def _solved(lower, value):
    """Forward substitution of L u = v; of a zero column zero."""
    rest, found = list(value), []
    for j in range(len(rest)):
        root = lower[j, j]
        found.append(np.where(root > 0, rest[j], 0.0) / np.where(root > 0, root, 1.0))
        for k in range(j + 1, len(rest)):
            rest[k] = rest[k] - lower[k, j] * found[j]
    return np.stack(found)


def _wide(part, core):
    """The same with an axis of paths, of length one where it has none."""
    part = np.asarray(part)
    return part if part.ndim > core else part[..., None]
