"""Checks and joint factor of a prior covariance C and an error covariance P."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_covariance, as_shape
from seedslib.base.semidefinite import square_root

EXCESS = 1e-8
SMALL_COMPONENT = 1e-6
RANK = 1e-13
UNINFORMED = 1e-14

REPEATED = 1e-12
"""Shares this near to each other, relatively, count as one share."""


def as_joint_law(
    mean: ArrayLike, cov: ArrayLike, error_cov: ArrayLike, size: int | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Checked mean (n,), covariance C (n, n) and error covariance P (n, n) with P <= C.

    The comparison P <= C is made in units of each component's own standard deviation
    (components below 1e-6 of the largest variance in units of that), so that metres and radians
    may stand side by side; eigenvalues of the scaled C - P down to -1e-8 count as rounding.

    Raises
    ------
    TypeError, ValueError
        As `as_covariance`; `ValueError` also "error_cov exceeds cov".
    """
    mean = as_shape("mean", mean, (-1 if size is None else size,))
    cov = as_covariance("cov", cov, mean.size)
    error_cov = as_covariance("error_cov", error_cov, mean.size)
    variances = np.diag(cov)
    largest = variances.max(initial=0.0)
    if largest == 0.0:
        smallest = -np.abs(error_cov).max(initial=0.0)
    else:
        scale = np.sqrt(np.maximum(variances, SMALL_COMPONENT * largest))
        smallest = np.linalg.eigvalsh((cov - error_cov) / np.outer(scale, scale))[0]
    if smallest < -EXCESS:
        raise ValueError(
            f"error_cov exceeds cov: wanted cov - error_cov positive semidefinite, "
            f"got the scaled eigenvalue {smallest:.3g}"
        )
    return mean, cov, error_cov


def joint_factor(cov: np.ndarray, error_cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T (n, rank) and shares (rank,) with ``C = T T'`` and ``P = T diag(shares) T'``.

    The eigenvalues of the correlation matrix of C above 1e-13 of its largest are kept; shares
    are clipped to [0, 1], those within 1e-14 of one (no information, up to rounding) set to one.
    Small P keep their relative accuracy. T is unique: see `_unique`.
    """
    scale = np.sqrt(np.diag(cov))
    scale = np.where(scale > 0, scale, 1.0)
    # free in sign and among equal eigenvalues; `_unique` takes that out again below
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))
    keep = values > RANK * max(values[-1], 0.0)
    root = np.sqrt(values[keep])
    whiten = vectors[:, keep] / (scale[:, None] * root)
    shares, rotation = np.linalg.eigh(symmetric_part(whiten.T @ error_cov @ whiten))
    # whiten transposed maps back: scale * vectors * root is its pseudo-inverse
    factor = _unique((scale[:, None] * vectors[:, keep] * root) @ rotation, shares)
    return factor, np.where(shares > 1.0 - UNINFORMED, 1.0, np.maximum(shares, 0.0))


def _unique(factor: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """The columns of equal shares by the triangular factor of their sum of squares.

    Eigenvectors are free in sign, and by a rotation where shares repeat; what is cut off or
    integrated along them would depend on that. `shares` ascend.
    """
    apart = np.diff(shares) > REPEATED * np.abs(shares[1:])
    for group in np.split(np.arange(shares.size), np.flatnonzero(apart) + 1):
        columns = factor[:, group]
        lower = square_root(columns @ columns.T)
        full = np.flatnonzero(np.diag(lower))
        if full.size == group.size:
            factor[:, group] = lower[:, full]
    return factor


def symmetric_part(matrix: np.ndarray) -> np.ndarray:
    """``(M + M') / 2``."""
    return 0.5 * (matrix + matrix.T)
