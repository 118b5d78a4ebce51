"""Covariances after a measurement that tells almost everything.

Where a sensor is a million times sharper than the forecast, subtracting what was learned cancels
all digits of what is left. The left-over covariance is then built as a sum of squares instead
(Joseph's form on factors), which can lose digits but not its sign.
"""

from __future__ import annotations

import numpy as np

_SHARP = 1e-6  # ratio of the noise to the predicted volume of a measurement


def gram(root: np.ndarray) -> np.ndarray:
    """``root root'`` for components (n, p, *batch), exactly symmetric."""
    full = np.einsum("ip...,jp...->ij...", root, root)
    return 0.5 * (full + np.swapaxes(full, 0, 1))


def sharpened(
    cov: np.ndarray, root: np.ndarray, sensor: np.ndarray, noise: np.ndarray,
    innovation: np.ndarray, y: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Corrected covariances, rebuilt where the plain correction cancels.

    Parameters
    ----------
    cov : ndarray, shape (k, k, B, 1 or N)
        Corrected covariances.
    root : ndarray, shape (k, k, B, 1 or N)
        Factors of the predicted covariances.
    sensor, noise : ndarray, shapes (m, k, B, 1 or N) and (m, q, B, 1 or N)
    innovation : ndarray, shape (m, m, B, 1 or N)
        Predicted covariances of the measurement.
    y : ndarray, shape (m, N)
        NaN marks what is missing.
    """
    sharp = _determinant(gram(noise)) < _SHARP * _determinant(innovation)
    if not sharp.any():
        return cov
    batch = cov.shape[2:]
    branch, dataset = np.nonzero(np.broadcast_to(sharp, batch))
    root, sensor, noise = (  # the chosen matrices, items first
        np.moveaxis(np.broadcast_to(part, part.shape[:2] + batch)[:, :, branch, dataset], -1, 0)
        for part in (root, sensor, noise)
    )
    if batch[1] > 1:
        shown = np.isfinite(y[:, dataset]).T
    else:  # common to all data sets, which then miss the same components
        shown = np.repeat(np.isfinite(y[:, :1]).T, branch.size, axis=0)
    sensor, noise = (np.where(shown[:, :, None], part, 0.0) for part in (sensor, noise))
    seen = sensor @ root
    spread = seen @ np.swapaxes(seen, 1, 2) + noise @ np.swapaxes(noise, 1, 2)
    spread += np.where(shown, 0.0, 1.0)[:, :, None] * np.eye(len(y))
    gain = np.swapaxes(np.linalg.solve(spread, seen @ np.swapaxes(root, 1, 2)), 1, 2)
    rest = np.concatenate([root - gain @ seen, gain @ noise], axis=2)
    rebuilt = gram(np.moveaxis(rest, 0, -1))
    sound = np.isfinite(rebuilt).all(axis=(0, 1))
    cov = cov.copy()
    cov[:, :, branch[sound], dataset[sound]] = rebuilt[:, :, sound]
    return cov


def _determinant(matrix: np.ndarray) -> np.ndarray:
    if len(matrix) == 1:
        return matrix[0, 0]
    return np.linalg.det(np.moveaxis(matrix, (0, 1), (-2, -1)))
