"""Semidefinite matrices in batches: Cholesky factors, repair, and what counts as zero."""

from __future__ import annotations

import math
import sys
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

RELATIVE = 1e-13
"""A pivot at or below this fraction of its variance counts as zero: a redundant component."""

ABSOLUTE = sys.float_info.min
"""A variance at or below this counts as zero: smaller numbers have lost digits."""

INDEFINITE = 1e-9
"""A pivot below minus this part of its variance is no rounding error."""

NEGATIVE = 1e-12
"""A covariance with an eigenvalue below minus this, in units of the deviations, is mended."""

ROUNDING = 1e-15
"""An eigenvalue above minus this part of the largest is what rounding has made of zero."""

WIDE = 1e-8
"""A variance that falls below this part of itself has lost half of its digits."""

LOST = 1e-12
"""One that falls below this part of itself has lost all that matter."""

LOG_2PI = math.log(2.0 * math.pi)


def symmetrized(matrix: np.ndarray) -> np.ndarray:
    """Mean of a square matrix and its transpose: what rounding has made unequal is equal again."""
    return 0.5 * (matrix + matrix.T)


@lru_cache(maxsize=64)
def lower_triangle(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the entries on and below the diagonal, row by row."""
    return np.tril_indices(n)


@lru_cache(maxsize=64)
def mirrored(n: int) -> np.ndarray:
    """Number of each entry of a symmetric (n, n) matrix among those of `lower_triangle`."""
    rows, columns = lower_triangle(n)
    index = np.empty((n, n), dtype=int)
    index[rows, columns] = index[columns, rows] = np.arange(len(rows))
    return index


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
    # lists of components: for few of them and many items faster than slices
    rest = [[cov[k, q] for q in range(k + 1)] for k in range(n)]
    for j in range(n):
        pivot, variance = rest[j][j], np.abs(cov[j, j])
        regular = pivot > RELATIVE * variance + ABSOLUTE
        if np.all(regular):
            root = np.sqrt(pivot)
            inverse = 1.0 / root
        else:
            broken = ~(pivot >= -INDEFINITE * (variance if scale is None else scale[j]))
            root = np.where(broken, np.nan, np.sqrt(np.where(regular, pivot, 0.0)))
            inverse = np.where(broken, np.nan, regular / np.where(regular, root, 1.0))
        lower[j, j] = root
        for k in range(j + 1, n):
            lower[k, j] = rest[k][j] * inverse
            for q in range(j + 1, k + 1):
                rest[k][q] = rest[k][q] - lower[k, j] * lower[q, j]
    return lower


def square_root(cov: np.ndarray) -> np.ndarray:
    """Lower triangular L with L Lᵀ = P of one or more covariances (..., n, n), batch axes first.

    With its diagonal not negative L is unique, so that what is drawn or integrated along its
    columns does not depend on the processor, as eigenvectors would where eigenvalues repeat. A
    pivot at or below 1e-13 of its variance gives a zero column. What rounding has made indefinite
    is bent back: a negative pivot counts as zero, and no entry exceeds what its variance allows.
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
    zero = (np.einsum("ii...->i...", root) == 0).any(axis=0)
    if not zero.any():
        return cov
    return np.where(zero, np.einsum("ij...,kj...->ik...", root, root), cov)


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
    suspect = ~(np.einsum("ii...->i...", factor(cov)) > 0).all(axis=0)
    suspect &= np.isfinite(cov).all(axis=(0, 1))
    if not suspect.any():
        return cov, 0
    squares = np.abs(np.einsum("ii...->i...", cov) if variances is None else variances)
    unit = np.sqrt(squares[:, suspect]).T
    unit = np.where(unit > 0, unit, 1.0)
    unit = unit[:, :, None] * unit[:, None, :]
    items = np.moveaxis(cov[:, :, suspect], -1, 0) / unit
    # a function of the matrix, V f(d) Vᵀ: where eigenvalues repeat, the basis V of their space is
    # free, and every one gives the same covariance
    values, vectors = np.linalg.eigh(0.5 * (items + np.swapaxes(items, 1, 2)))
    below = values[:, 0] < -ROUNDING * values[:, -1]
    if not below.any():
        return cov, 0
    negative = values < -NEGATIVE
    raised = np.where(negative, NEGATIVE, np.maximum(values, 0.0))
    rebuilt = (vectors * raised[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    rebuilt = np.where(below[:, None, None], rebuilt, items) * unit
    result = cov.copy()
    result[:, :, suspect] = np.moveaxis(rebuilt, 0, -1)
    return result, int(np.count_nonzero(negative.any(axis=1)))
