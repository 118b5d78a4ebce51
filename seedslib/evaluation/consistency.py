"""Whether a filter's own covariances fit its errors: normalised squares"""

from __future__ import annotations

import numpy as np

from seedslib.base.semidefinite import range_root, square_root


def mahalanobis(error: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Normalised squares eᵀ P⁺ e, shape (J, N).

    Parameters
    ----------
    error : ndarray, shape (J, c, N)
    cov : ndarray, shape (J, c, c) or (J, c, c, N) (N may be 1)
        NaN where there is no covariance, which gives NaN. A singular one is met by its
        pseudo-inverse.
    """
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
    return np.where(known, squares, np.nan)


def innovation_squares(error: np.ndarray, gap: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Normalised squares of what was measured, shape (N,); NaN where nothing was.

    Parameters
    ----------
    error : ndarray, shape (m, N)
        Measurement minus its expectation.
    gap : ndarray of bool, shape (m, N)
        Components that are missing: the square is that of the others.
    cov : ndarray, shape (m, m) or (m, m, N)
    """
    if gap.any():  # uncorrelated with the others, a missing component adds nothing
        error, cov = np.where(gap, 0.0, error), cov.reshape(*cov.shape[:2], -1)
        cov = np.where(gap | gap[:, None], np.eye(len(error))[..., None], cov)
    return np.where(gap.all(axis=0), np.nan, mahalanobis(error[None], cov[None])[0])
