"""Linear to quartic forms: optimal estimates by matrices.

Equations (3.1), (3.2) and theorem 2 of Choi, Song, Shin (2019). Matrices of
quadratic forms are replaced by their symmetric parts, which the printed cubic and quartic rows
need. Means may carry batch axes, last.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_real
from seedslib.gaussian.arguments import gaussian_arguments
from seedslib.gaussian.means import inner_product, times


def linear_mean(A: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
    """``E A x = A m``, shape (p, ...).

    Parameters
    ----------
    A : array_like (p, n)
        Any matrix.
    mean, cov : array_like (n, ...), (n, n) or (n, n, ...)
        Mean and covariance of x.

    Raises
    ------
    TypeError, ValueError
        Bad matrix, mean or covariance.
    """
    mean, _ = gaussian_arguments(mean, cov)
    return np.tensordot(as_real("A", A, (-1, len(mean))), mean, axes=1)


def quadratic_mean(A: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
    """``E x'Ax = tr AP + m'Am``, shape (...).

    Parameters
    ----------
    A : array_like (n, n)
        Its symmetric part counts.
    mean, cov : array_like (n, ...), (n, n) or (n, n, ...)
        Mean and covariance of x.

    Raises
    ------
    TypeError, ValueError
        Bad matrix, mean or covariance.
    """
    mean, cov = gaussian_arguments(mean, cov)
    A = _symmetric("A", A, len(mean))
    return _trace(A, cov) + inner_product(mean, times(A, mean))


def cubic_mean(A: ArrayLike, B: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
    """``E Ax x'Bx = 2 APBm + Am (m'Bm + tr BP)``, shape (p, ...).

    Parameters
    ----------
    A : array_like (p, n)
        Any matrix.
    B : array_like (n, n)
        Its symmetric part counts.
    mean, cov : array_like (n, ...), (n, n) or (n, n, ...)
        Mean and covariance of x.

    Raises
    ------
    TypeError, ValueError
        Bad matrix, mean or covariance.
    """
    mean, cov = gaussian_arguments(mean, cov)
    A, B = as_real("A", A, (-1, len(mean))), _symmetric("B", B, len(mean))
    bm = times(B, mean)
    return times(A, 2 * times(cov, bm) + mean * (inner_product(mean, bm) + _trace(B, cov)))


def quartic_mean(A: ArrayLike, B: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
    """``E x'Ax x'Bx = 2 tr APBP + 4 m'APBm + (tr AP + m'Am)(tr BP + m'Bm)``, shape (...).

    Parameters
    ----------
    A, B : array_like (n, n)
        Their symmetric parts count.
    mean, cov : array_like (n, ...), (n, n) or (n, n, ...)
        Mean and covariance of x.

    Raises
    ------
    TypeError, ValueError
        Bad matrix, mean or covariance.
    """
    mean, cov = gaussian_arguments(mean, cov)
    A, B = _symmetric("A", A, len(mean)), _symmetric("B", B, len(mean))
    am, bm = times(A, mean), times(B, mean)
    crossed = np.einsum("ij,jk...,kl,li...->...", A, cov, B, cov)
    ends = (_trace(A, cov) + inner_product(mean, am)) * (_trace(B, cov) + inner_product(mean, bm))
    return 2 * crossed + 4 * inner_product(am, times(cov, bm)) + ends


def _trace(A: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """``tr A P`` for P (n, n) or (n, n, ...)."""
    return np.einsum("ij,ji...->...", A, cov)


def _symmetric(name: str, value: ArrayLike, size: int) -> np.ndarray:
    matrix = as_real(name, value, (size, size))
    return 0.5 * (matrix + matrix.T)
