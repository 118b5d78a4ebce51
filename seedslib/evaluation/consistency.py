"""Whether a filter's own covariances fit its errors: normalised squares"""

from __future__ import annotations

import numpy as np

from seedslib.base.linalg import mahalanobis


def error_squares(error: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Normalised squares eᵀ P⁺ e, shape (J, N).

    Parameters
    ----------
    error : ndarray, shape (J, c, N)
    cov : ndarray, shape (J, c, c) or (J, c, c, N) (N may be 1)
        NaN where there is no covariance, which gives NaN. Of a singular one the components are
        left out that others determine.
    """
    cov = cov if cov.ndim == 4 else cov[..., None]
    error, cov = np.swapaxes(error, 0, 1), np.moveaxis(cov, 0, 2)
    with np.errstate(invalid="ignore", over="ignore"):
        known = np.isfinite(cov).all(axis=(0, 1)) & np.isfinite(error).all(axis=0)
    return np.where(known, mahalanobis(np.where(known, error, 0.0), cov), np.nan)


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
    return np.where(gap.all(axis=0), np.nan, error_squares(error[None], cov[None])[0])
