"""Semidefinite matrices in batches: triangular factor, pseudo-inverse, and what counts as zero."""

from __future__ import annotations

import math
import sys
from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

RELATIVE = 1e-13
"""A pivot at or below this fraction of its variance counts as zero: a redundant component."""

ABSOLUTE = sys.float_info.min
"""A variance at or below this counts as zero: smaller numbers have lost digits."""

INDEFINITE = 1e-9
"""An eigenvalue of the innovation correlations below minus this is no rounding error."""

NEGATIVE = 1e-12
"""A covariance with an eigenvalue below minus this, in units of the deviations, is mended."""

LEVEL = 1e-6
"""An innovation without variance up to this part of what it is a difference of is rounding."""

FAINT = 1e-5
"""The same as a part of a deviation: what `RELATIVE` counts as zero has deviations of 3e-7."""

LOG_2PI = math.log(2.0 * math.pi)


def symmetrized(matrix: np.ndarray) -> np.ndarray:
    """Mean of a square matrix and its transpose: what rounding has made unequal is equal again."""
    return 0.5 * (matrix + matrix.T)


def logs(pivots: list, everywhere: Any) -> list:
    """Logarithms whose sum is that of all pivots: one for two of them where numbers allow it."""
    found = []
    # numbers of Python say nothing when they overflow
    with nullcontext() if everywhere is bool else np.errstate(over="ignore", under="ignore"):
        pairs = [(a, b, a * b) for a, b in zip(pivots[::2], pivots[1::2], strict=False)]
    for a, b, both in pairs:
        sound = everywhere((both > ABSOLUTE) & (both < np.inf))
        found += [np.log(both)] if sound else [np.log(a), np.log(b)]
    return found + [np.log(p) for p in pivots[len(pivots) & ~1 :]]


def pseudo_correct(
    parts: Any, bad: np.ndarray, missing: np.ndarray, sizes: np.ndarray | None,
    new_mean: np.ndarray, new_cov: np.ndarray, loglik: np.ndarray,
) -> None:  # fmt: skip
    """Write the Moore-Penrose correction over the flagged items.

    An innovation out of the range of its covariance, by more than the rounding of numbers of the
    `sizes` (m, *batch) of measurement and forecast, is impossible: its loglik is -inf. Without
    sizes nothing is.
    """
    mean, cov, error, cross, spread = parts

    def pick(part: np.ndarray, core: int, batch: tuple[int, ...]) -> np.ndarray:
        """Flagged items of one part, item axis first."""
        whole = np.broadcast_to(part, part.shape[:core] + batch)
        return np.moveaxis(whole[..., np.broadcast_to(bad, batch)], -1, 0)

    def gains(batch: tuple[int, ...]) -> tuple[np.ndarray, ...]:
        root, log_det, rank = range_root(pick(spread, 2, batch))
        return root, root @ np.swapaxes(pick(cross, 2, batch), 1, 2), log_det, rank

    batch = loglik.shape
    chosen = np.broadcast_to(bad, batch)
    root, gain, log_det, rank = gains(batch)
    whitened = np.einsum("brm,bm->br", root, pick(error, 1, batch))
    new_mean[:, chosen] = (pick(mean, 1, batch) + np.einsum("brk,br->bk", gain, whitened)).T
    count = rank - np.broadcast_to(missing, batch)[chosen]
    loglik[chosen] = -0.5 * ((whitened**2).sum(axis=1) + log_det + count * LOG_2PI)
    if sizes is not None:
        picked = (
            pick(part, k, batch) for part, k in ((error, 1), (spread, 2), (mean, 1), (sizes, 1))
        )
        loglik[chosen] = np.where(_outside(*picked, root, whitened), -np.inf, loglik[chosen])
    if cov is not None:
        batch = new_cov.shape[2:]
        if batch != loglik.shape:
            _, gain, _, _ = gains(batch)
        reduced = pick(cov, 2, batch) - np.einsum("brk,brq->bkq", gain, gain)
        new_cov[:, :, np.broadcast_to(bad, batch)] = np.moveaxis(reduced, 0, -1)


def _outside(error, spread, mean, sizes, root, whitened):
    """Items whose innovation is not in the range of S, by more than rounding."""
    off = error - np.einsum("bij,brj,br->bi", spread, root, whitened)
    deviations = np.sqrt(np.abs(np.einsum("bii->bi", spread)))
    least = LEVEL * (sizes + np.abs(mean).max(axis=1)[:, None]) + FAINT * deviations
    return (np.abs(off) > least).any(axis=1)


def range_root(spread: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matrices R with Rᵀ R = S⁺, the log pseudo-determinant of S and its rank, item by item.

    `spread` has shape (items, m, m). Rank and range are decided on S scaled to unit diagonal, so
    that units do not matter: S = B Bᵀ with B of full column rank, B = Q T gives R = T⁻¹ Qᵀ.
    Redundant columns are carried as zeros to keep one shape. NaN for an indefinite S.
    """
    variances = np.einsum("bii->bi", spread)
    finite = np.isfinite(spread).all(axis=(1, 2)) & (variances >= -ABSOLUTE).all(axis=1)
    spread = np.where(finite[:, None, None], spread, 0.0)
    deviations = np.sqrt(
        np.maximum(variances, 0.0), where=finite[:, None], out=np.zeros_like(variances)
    )
    positive = deviations**2 > ABSOLUTE
    scale = np.where(positive, 1.0, 0.0) / np.where(positive, deviations, 1.0)
    # the basis is free, but RᵀR, the determinant and the rank do not depend on it
    values, vectors = np.linalg.eigh(spread * scale[:, :, None] * scale[:, None, :])
    kept = values > RELATIVE
    finite &= (values > -INDEFINITE).all(axis=1)
    # the kept columns first, so that the triangular factor of the others stays zero
    order = np.argsort(~kept, axis=1, kind="stable")
    kept = np.take_along_axis(kept, order, 1)
    lengths = np.sqrt(np.where(kept, np.take_along_axis(values, order, 1), 0.0))
    vectors = np.take_along_axis(vectors, order[:, None, :], 2)
    basis, triangle = np.linalg.qr(deviations[:, :, None] * vectors * lengths[:, None, :])
    diagonal = np.abs(np.einsum("bii->bi", triangle))
    log_det = 2.0 * np.log(np.where(kept, diagonal, 1.0)).sum(axis=1)
    triangle = triangle + np.eye(spread.shape[1]) * ~kept[:, None, :]
    root = np.linalg.solve(triangle, np.swapaxes(basis, 1, 2)) * kept[:, :, None]
    root[~finite] = np.nan
    return root, log_det, kept.sum(axis=1)


def factor(cov: ArrayLike, scale: np.ndarray | None = None) -> np.ndarray:
    """Lower triangular L with L Lᵀ = P, item by item; a zero pivot gives a zero column.

    Parameters
    ----------
    cov : ndarray, shape (n, n, *batch)
        Symmetric positive semidefinite; only the part on and below the diagonal is read.
    scale : ndarray, shape (n, *batch), optional
        Variances that a negative pivot is judged by: of a corrected covariance those before
        the correction. The diagonal by default.

    Returns
    -------
    ndarray, shape (n, n, *batch)
        NaN in the items that are not positive semidefinite: a pivot below -1e-9 of the scale
        (between that and 1e-13 of its variance a pivot counts as zero).
    """
    cov = np.asarray(cov, dtype=float)
    n = len(cov)
    lower = np.zeros_like(cov)
    rest = [[cov[k, q] for q in range(k + 1)] for k in range(n)]
    for j in range(n):
        pivot, variance = rest[j][j], np.abs(cov[j, j])
        regular = pivot > RELATIVE * variance + ABSOLUTE
        if np.all(regular):
            root = np.sqrt(pivot)
            inverse = 1.0 / root
        else:
            broken = ~(pivot >= -INDEFINITE * (variance if scale is None else scale[j]))
            root = np.sqrt(np.where(regular, pivot, 0.0))
            inverse = np.where(regular, 1.0, 0.0) / np.where(regular, root, 1.0)
            root = np.where(broken, np.nan, root)
            inverse = np.where(broken, np.nan, inverse)
        lower[j, j] = root
        for k in range(j + 1, n):
            lower[k, j] = rest[k][j] * inverse
            for q in range(j + 1, k + 1):
                rest[k][q] = rest[k][q] - lower[k, j] * lower[q, j]
    return lower


def settled(cov: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Corrected covariances without what rounding has left of directions that are known exactly.

    Items whose factor meets no zero pivot are returned as they are, and so are those that are
    clearly indefinite.

    Parameters
    ----------
    cov : ndarray, shape (n, n, *batch)
    before : ndarray, shape (n, n, *batch) or (n, n)
        Those before the correction, whose variances rounding is judged by.
    """
    scale = np.einsum("ii...->i...", before)
    root = factor(cov, scale.reshape(*scale.shape, *(1,) * (cov.ndim - before.ndim)))
    zero = np.zeros((), dtype=bool)
    for k in range(len(cov)):
        zero = zero | (root[k, k] == 0)
    if not zero.any():
        return cov
    return np.where(zero, np.einsum("ij...,kj...->ik...", root, root), cov)


def square_root(cov: np.ndarray) -> np.ndarray:
    """Lower triangular L with L Lᵀ = P of one or more covariances (..., n, n), batch axes first.

    With its diagonal not negative L is unique, so that what is drawn or integrated along its
    columns does not depend on the processor, as eigenvectors would where eigenvalues repeat. A
    pivot at or below 1e-13 of its variance gives a zero column. What rounding has made indefinite
    is bent back: a negative pivot counts as zero, and no entry exceeds what its variance allows.
    `factor` takes batch axes last and gives NaN where a covariance is clearly none.
    """
    rest = np.array(cov, dtype=float)
    least = RELATIVE * np.abs(np.einsum("...ii->...i", rest)) + ABSOLUTE
    lower = np.zeros_like(rest)
    for j in range(rest.shape[-1]):
        pivot = rest[..., j, j]
        root = np.sqrt(np.where(pivot > least[..., j], pivot, 0.0))
        left = np.sqrt(np.maximum(np.einsum("...ii->...i", rest)[..., j + 1 :], 0.0))
        below = rest[..., j + 1 :, j] / np.where(root > 0, root, np.inf)[..., None]
        below = np.clip(below, -left, left)
        lower[..., j, j], lower[..., j + 1 :, j] = root, below
        rest[..., j + 1 :, j + 1 :] -= below[..., :, None] * below[..., None, :]
    return lower


def mended(cov: np.ndarray, variances: np.ndarray | None = None) -> tuple[np.ndarray, int]:
    """Covariances (n, n, *batch) whose eigenvalues are not negative, and how many had to be mended.

    In units of the deviations an eigenvalue below -1e-12 is raised to 1e-12 and counts; what
    rounding leaves between that and zero becomes zero. Semidefinite covariances pass. Each item
    is looked at alone; one with a NaN is left as it is.

    Parameters
    ----------
    cov : ndarray, shape (n, n, *batch)
    variances : ndarray, shape (n, *batch), optional
        Squares of the deviations, by default the diagonal; for a posterior those before it.
    """
    suspect = _suspect(cov)
    if not suspect.any():
        return cov, 0
    suspect &= np.isfinite(cov).all(axis=(0, 1))
    squares = np.abs(np.einsum("ii...->i...", cov) if variances is None else variances)
    unit = np.sqrt(squares[:, suspect]).T
    unit = np.where(unit > 0, unit, 1.0)
    unit = unit[:, :, None] * unit[:, None, :]
    items = np.moveaxis(cov[:, :, suspect], -1, 0) / unit
    # a function of the matrix, V f(d) Vᵀ: where eigenvalues repeat, the basis V of their space is
    # free, and every one gives the same covariance
    values, vectors = np.linalg.eigh(0.5 * (items + np.swapaxes(items, 1, 2)))
    negative = values < -NEGATIVE
    bent = (values < 0).any(axis=1)
    raised = np.where(negative, NEGATIVE, np.maximum(values, 0.0))
    rebuilt = (vectors * raised[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    rebuilt = np.where(bent[:, None, None], rebuilt, items) * unit
    result = cov.copy()
    result[:, :, suspect] = np.moveaxis(rebuilt, 0, -1)
    return result, int(np.count_nonzero(negative.any(axis=1)))


def _suspect(cov):
    """Where the elimination of a covariance (n, n, *batch) meets a pivot that is not positive.

    A zero covariance is no suspect.
    """
    rows = [list(row[: i + 1]) for i, row in enumerate(cov)]
    suspect = np.zeros(cov.shape[2:], dtype=bool)
    for j in range(len(rows)):
        bad = ~(rows[j][j] > 0)
        if bad.any():
            nothing = rows[j][j] == 0
            for i in range(j + 1, len(rows)):
                nothing &= rows[i][j] == 0
            suspect |= bad & ~nothing
        if j + 1 == len(rows):
            break
        inverse = 1.0 / np.where(bad, 1.0, rows[j][j])
        for i in range(j + 1, len(rows)):
            factor = rows[i][j] * inverse
            for k in range(j + 1, i + 1):
                rows[i][k] = rows[i][k] - factor * rows[k][j]
    return suspect
