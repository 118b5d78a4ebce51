"""Triangular roots of covariances: P = S Sᵀ is carried as S, and never formed."""

from __future__ import annotations

import numpy as np

from seedslib.base.arrays import align
from seedslib.base.linalg import RELATIVE, variances


def triangle(*blocks: np.ndarray) -> np.ndarray:
    """Lower triangular L with L Lᵀ = A Aᵀ and no negative number on its diagonal.

    By Householder reflections of Aᵀ: A Aᵀ is not formed.

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
    # no -0.0, whose sign the next factorization would look at
    return np.moveaxis(upper * signs[..., None] + 0.0, (-1, -2), (0, 1))


def correct_root(
    root: np.ndarray,
    slope_root: np.ndarray,
    noise_root: np.ndarray,
    observed: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Root of a covariance given a measurement, in the array form of Kaminski, Bryson, Schmidt.

    The triangle of (R½, H L; 0, L) is (S½, 0; G, L'): nothing is subtracted from a variance. A
    component that is missing, or that those before it determine, is replaced by an independent
    number of variance one, which changes nothing.

    Parameters
    ----------
    root : ndarray, shape (n, k, *batch)
        L, where P = L Lᵀ; triangular or not.
    slope_root : ndarray, shape (m, k, *batch)
        H L.
    noise_root : ndarray, shape (m, q, *batch)
        R½, triangular or not.
    observed : ndarray of bool, shape (m, *batch), optional
        Components that are not missing; all of them by default.

    Returns
    -------
    innovation_root : ndarray, shape (m, m, *batch)
        S½, of S = H P Hᵀ + R.
    gain_root : ndarray, shape (n, m, *batch)
        G = P Hᵀ (S½)⁻ᵀ: the gain is G (S½)⁻¹.
    root : ndarray, shape (n, n, *batch)
        L', of P - G Gᵀ.
    used : ndarray of bool, shape (m, *batch)
        Components that are neither missing nor determined, up to 1e-13 of their deviation.
    """
    (n, k), (m, q) = root.shape[:2], noise_root.shape[:2]
    observed = np.ones(m, dtype=bool) if observed is None else observed
    depth = max(root.ndim - 2, slope_root.ndim - 2, noise_root.ndim - 2, observed.ndim - 1)
    root, slope_root, noise_root = (align(M, 2, depth) for M in (root, slope_root, noise_root))
    used, identity = align(observed, 1, depth), align(np.eye(m), 2, depth)
    shapes = root.shape[2:], slope_root.shape[2:], noise_root.shape[2:], used.shape[1:]
    rows = np.zeros((m + n, k + q + m, *np.broadcast_shapes(*shapes)))
    rows[m:, m + q :] = root
    for _ in range(m + 1):
        rows[:m, :m] = np.where(used[:, None], 0.0, identity)
        rows[:m, m : m + q] = np.where(used[:, None], noise_root, 0.0)
        rows[:m, m + q :] = np.where(used[:, None], slope_root, 0.0)
        lower = triangle(rows)
        S = lower[:m, :m]
        determined = variances(S) <= RELATIVE * np.sqrt((S * S).sum(axis=1))
        if not determined.any():
            break
        used = used & ~(determined & (determined.cumsum(axis=0) == 1))  # the first of them
    return S, lower[m:, :m], lower[m:, m:], used


def square(root: np.ndarray) -> np.ndarray:
    """The covariance L Lᵀ (n, n, *batch) of a root, exactly symmetric."""
    return np.einsum("ik...,jk...->ij...", root, root)
