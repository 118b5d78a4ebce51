"""Triangular roots of covariances: P = S Sᵀ is carried as S, and never formed."""

from __future__ import annotations

import numpy as np

from seedslib.base.arrays import align


def triangle(*blocks: np.ndarray) -> np.ndarray:
    """Lower triangular L with L Lᵀ = A Aᵀ and no negative number on its diagonal.

    By Householder reflections of Aᵀ: A Aᵀ is not formed. Small columns of A keep their digits
    beside large ones where they come last.

    Parameters
    ----------
    *blocks : ndarray, shapes (n, k, *batch)
        Columns of A side by side, at least n together; their batch axes broadcast.

    Returns
    -------
    L : ndarray, shape (n, n, *batch)
    """
    depth = max(block.ndim for block in blocks) - 2
    blocks = tuple(align(block, 2, depth) for block in blocks)
    batch = np.broadcast_shapes(*(block.shape[2:] for block in blocks))
    parts = [np.broadcast_to(block, block.shape[:2] + batch) for block in blocks]
    rows = np.moveaxis(np.concatenate(parts, axis=1), (0, 1), (-1, -2))
    upper = np.linalg.qr(rows, mode="r")
    signs = np.where(np.diagonal(upper, axis1=-2, axis2=-1) < 0, -1.0, 1.0)
    return np.moveaxis(upper * signs[..., None], (-1, -2), (0, 1))


def correct_root(
    root: np.ndarray, slope_root: np.ndarray, noise_root: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Root of a covariance given a measurement, in the array form of Kaminski, Bryson, Schmidt.

    The triangle of (H L, R½; L, 0) is (S½, 0; G, L'): nothing is subtracted from a variance.

    Parameters
    ----------
    root : ndarray, shape (n, n, *batch)
        L, where P = L Lᵀ.
    slope_root : ndarray, shape (m, n, *batch)
        H L.
    noise_root : ndarray, shape (m, m, *batch)
        R½.

    Returns
    -------
    innovation_root : ndarray, shape (m, m, *batch)
        S½, of S = H P Hᵀ + R.
    gain_root : ndarray, shape (n, m, *batch)
        G = P Hᵀ (S½)⁻ᵀ: the gain is G (S½)⁻¹.
    root : ndarray, shape (n, n, *batch)
        L', of P - G Gᵀ.
    """
    n, m = len(root), len(noise_root)
    depth = max(root.ndim, slope_root.ndim, noise_root.ndim) - 2
    root, slope_root, noise_root = (align(M, 2, depth) for M in (root, slope_root, noise_root))
    batch = np.broadcast_shapes(root.shape[2:], slope_root.shape[2:], noise_root.shape[2:])
    rows = np.zeros((m + n, n + m, *batch))
    # the noise last: its digits would be lost in those of a wide prior
    rows[:m, :n], rows[:m, n:], rows[m:, :n] = slope_root, noise_root, root
    lower = triangle(rows)
    return lower[:m, :m], lower[m:, :m], lower[m:, m:]


def square(root: np.ndarray) -> np.ndarray:
    """The covariance L Lᵀ (n, n, *batch) of a root, exactly symmetric."""
    return np.einsum("ik...,jk...->ij...", root, root)
