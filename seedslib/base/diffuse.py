"""Correction of a prior that is so wide that no digits of P - C S⁻¹ Cᵀ would remain.

Where P exceeds the noise by more than the numbers hold, the noise is rounded off in S. It is then
needed apart: with it the measurements are taken in one after another on factors, P = L U D Uᵀ Lᵀ
(Bierman), in which nothing is subtracted from a variance.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from seedslib.base.semidefinite import factor

WIDE = 1e-8
"""A variance that falls below this part of itself has lost half of its digits."""

LOST = 1e-12
"""One that falls below this part of itself has lost all that matter."""

ROUNDING = 1e-13
"""What the slope and the noise leave unexplained of cov y is rounding up to this part of it."""


def narrowed(cov: np.ndarray, new_cov: np.ndarray) -> np.ndarray:
    """Items (*batch) in which a variance fell so far that its digits are in doubt."""
    n = len(cov)
    suspect = new_cov[0, 0] < WIDE * cov[0, 0]
    for k in range(1, n):
        suspect = suspect | (new_cov[k, k] < WIDE * cov[k, k])
    return suspect


def correct_diffuse(
    cov: np.ndarray, cross: np.ndarray, spread: np.ndarray, noise: Any, suspect: Any,
    new_cov: np.ndarray,
) -> None:  # fmt: skip
    """Write the corrected covariances of the suspect items from the noise apart.

    Parameters
    ----------
    cov, cross, spread : ndarray
        P (n, n, *batch), cov(x, y) (n, m, *batch) and cov y (m, m, *batch).
    noise : ndarray, shape (m, m, *batch)
        Covariance of the measurement at a known state.
    suspect : ndarray of bool, shape (*batch)
    new_cov : ndarray, shape (n, n, *batch)

    Warns
    -----
    UserWarning
        On all paths cov y is more than slope and noise, and a variance has lost its digits.
    """
    batch = new_cov.shape[2:]
    suspect = np.broadcast_to(suspect, batch)

    def pick(part: np.ndarray) -> np.ndarray:
        return np.broadcast_to(part, part.shape[:2] + batch)[..., suspect]

    cov, cross, spread, noise = (pick(part) for part in (cov, cross, spread, noise))
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        root = factor(cov)
        slope = _solved(root, cross)
        rest = spread - noise - np.einsum("ki...,kj...->ij...", slope, slope)
        size = np.sqrt(np.einsum("ii...->i...", spread))
        exact = (np.abs(rest) <= ROUNDING * size[:, None] * size[None, :]).all(axis=(0, 1))
        found = _in_turn(root, slope, noise)
    before, after = (np.einsum("ii...->i...", part) for part in (cov, pick(new_cov)))
    noisy = ~(noise == 0.0).all(axis=(0, 1))
    lost = (after < LOST * before) & noisy & ~exact
    # of several paths all: single ones may be astray, which is no matter of the prior
    if suspect.all() and lost.any(axis=0).all():
        warnings.warn(
            f"cov: the variance of x{int(np.argmax(lost.any(axis=1))) + 1} fell below {LOST:g} of "
            "itself by one measurement, and its digits are lost; wanted a narrower prior",
            stacklevel=2,
        )
    exact &= noisy & np.isfinite(found).all(axis=(0, 1))
    new_cov[:, :, suspect] = np.where(exact, found, pick(new_cov))


def _solved(root: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """Slope in units of the factor, (n, m, items): L G = C; zero where the factor is."""
    slope = np.zeros_like(cross)
    for j, row in enumerate(root):
        right = cross[j] - (row[:j, None] * slope[:j]).sum(axis=0)
        slope[j] = np.where(row[j] > 0, right, 0.0) / np.where(row[j] > 0, row[j], 1.0)
    return slope


def _in_turn(root: np.ndarray, slope: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Corrected covariances by one measured component after another."""
    n, m, items = slope.shape
    noise, slope = noise.copy(), slope.copy()
    upper = np.zeros((n, n, items))
    upper[range(n), range(n)] = 1.0
    diagonal = np.ones((n, items))
    for i in range(m):
        f = np.einsum("kj...,k...->j...", upper, slope[:, i])
        gain, total = diagonal * f, np.maximum(noise[i, i], 0.0)
        for j in range(n):
            before, total = total, total + gain[j] * f[j]
            known = before > 0
            tilt = np.where(known, -f[j], 0.0) / np.where(known, before, 1.0)
            diagonal[j] *= np.where(total > 0, before, 1.0) / np.where(total > 0, total, 1.0)
            for k in range(j):
                old = upper[k, j].copy()
                upper[k, j] += gain[k] * tilt
                gain[k] += old * gain[j]
        for q in range(i + 1, m):  # what is left of the noise of the others
            share = np.where(noise[i, i] > 0, noise[q, i], 0.0)
            share = share / np.where(noise[i, i] > 0, noise[i, i], 1.0)
            slope[:, q] -= share * slope[:, i]
            for p in range(i + 1, q + 1):
                noise[q, p] = noise[q, p] - share * noise[p, i]
    wide = np.einsum("ik...,kj...->ij...", root, upper)
    return np.einsum("ik...,jk...,k...->ij...", wide, wide, diagonal)
