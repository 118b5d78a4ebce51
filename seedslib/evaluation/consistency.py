"""Whether a filter's own covariances fit its errors: normalised squares and their bounds."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.base.semidefinite import range_root, square_root

CONFIDENCE = 0.95


def mahalanobis(error: np.ndarray, cov: Any) -> tuple[np.ndarray, int] | None:
    """Normalised squares eᵀ P⁺ e, shape (J, N), and their degrees of freedom.

    Parameters
    ----------
    error : ndarray, shape (J, c, N)
    cov : ndarray, shape (J, c, c) or (J, c, c, N) (N may be 1), or None
        NaN where there is no covariance, which gives NaN. A singular one is met by its
        pseudo-inverse.

    Returns
    -------
    squares, freedom, or None without a covariance
    """
    if cov is None:
        return None
    count = error.shape[2]
    cov = cov if cov.ndim == 4 else cov[..., None]
    matrices = np.moveaxis(np.broadcast_to(cov, (*cov.shape[:3], count)), 3, 1)
    vectors = np.moveaxis(error, 2, 1)
    with np.errstate(invalid="ignore", over="ignore"):
        known = np.isfinite(matrices).all(axis=(2, 3)) & np.isfinite(vectors).all(axis=2)
    safe = np.where(known[..., None, None], matrices, np.eye(error.shape[1]))
    vectors = np.where(known[..., None], vectors, 0.0)
    # which ones are singular is told by pivots, not by what a solver happens to divide by
    singular = (np.einsum("...ii->...i", square_root(safe)) == 0.0).any(axis=-1)
    regular = np.where(singular[..., None, None], np.eye(error.shape[1]), safe)
    solved = np.linalg.solve(regular, vectors[..., None])[..., 0]
    squares = np.einsum("jNc,jNc->jN", vectors, solved)
    if singular.any():
        roots = range_root(safe[singular])[0]
        squares[singular] = np.square(np.einsum("brc,bc->br", roots, vectors[singular])).sum(1)
    return np.where(known, squares, np.nan), error.shape[1]


def bounds(freedom: int, count: int) -> tuple[float, float]:
    """Where the mean of `count` independent chi-square numbers lies with probability 0.95."""
    from scipy.special import chdtri

    tail = 0.5 * (1.0 - CONFIDENCE)
    total = freedom * count
    return float(chdtri(total, 1.0 - tail) / count), float(chdtri(total, tail) / count)
