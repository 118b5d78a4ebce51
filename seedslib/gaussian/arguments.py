"""Checks of the mean and covariance of a Gaussian vector, with optional batch axes last."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from seedslib.base.checks import (
    ASYMMETRY,
    as_covariance,
    as_real,
    require_semidefinite,
)


def gaussian_arguments(
    mean: object, cov: object, size: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n, ...) and covariance (n, n) or (n, n, ...), checked; n is `size` where it is known.

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, shapes that do not fit, or a matrix that is no covariance.
    """
    mean, cov = as_real("mean", mean), as_real("cov", cov)
    n = len(mean) if mean.ndim else 0
    if n == 0 or size not in (None, n):
        raise ValueError(f"mean: wanted shape ({size or 'n'}, ...), got {mean.shape}")
    if cov.ndim < 2 or cov.shape[:2] != (n, n):
        raise ValueError(f"mean, cov: wanted cov of shape ({n}, {n}, ...), got {cov.shape}")
    try:
        np.broadcast_shapes(mean.shape[1:], cov.shape[2:])
    except ValueError:
        raise ValueError(
            f"cov: batch axes {cov.shape[2:]} do not fit those of the mean {mean.shape[1:]}"
        ) from None
    swapped = np.swapaxes(cov, 0, 1)
    asymmetry = np.abs(cov - swapped)
    if (asymmetry.max(axis=(0, 1)) > ASYMMETRY * np.abs(cov).max(axis=(0, 1))).any():
        raise ValueError(f"cov: wanted symmetric matrices, got asymmetry {asymmetry.max():.3g}")
    cov = 0.5 * (cov + swapped)
    if cov.size:
        require_semidefinite("cov", np.moveaxis(cov, (0, 1), (-2, -1)))
    return mean, cov


def variance_argument(name: str, value: object) -> np.ndarray:
    """Nonnegative variances of any shape.

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, or negative.
    """
    array = as_real(name, value)
    if (array < 0).any():
        raise ValueError(f"{name}: wanted nonnegative variances, got {array.min():.6g}")
    return array


def estimate_arguments(
    mean: object, cov: object, error_cov: object, size: int | None = None
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
    mean = as_real("mean", mean, (-1 if size is None else size,))
    cov = as_covariance("cov", cov, mean.size)
    error_cov = as_covariance("error_cov", error_cov, mean.size)
    variances = np.diag(cov)
    largest = variances.max(initial=0.0)
    if largest == 0.0:
        smallest = -np.abs(error_cov).max(initial=0.0)
    else:
        scale = np.sqrt(np.maximum(variances, 1e-6 * largest))
        smallest = np.linalg.eigvalsh((cov - error_cov) / np.outer(scale, scale))[0]
    if smallest < -1e-8:
        raise ValueError(
            f"error_cov exceeds cov: wanted cov - error_cov positive semidefinite, "
            f"got the scaled eigenvalue {smallest:.3g}"
        )
    return mean, cov, error_cov


def blockwise(
    work: Callable[[slice], Sequence[np.ndarray]], size: int, step: int
) -> list[np.ndarray]:
    """Arrays that `work` gives for blocks of a batch of `size`, joined along the last axis."""
    blocks = (slice(start, start + step) for start in range(0, max(size, 1), step))
    return [np.concatenate(part, axis=-1) for part in zip(*map(work, blocks), strict=True)]


def in_range(names: str, compute: Callable[..., Any]) -> object:
    """Result of a computation, an array or a tuple of arrays, if all of it is finite.

    Raises
    ------
    ValueError
        The arguments `names` lead out of the range of float64.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        result = compute()
    parts = result if isinstance(result, tuple) else (result,)
    if not all(np.isfinite(part).all() for part in parts):
        raise ValueError(
            f"{names}: wanted arguments for which the result is in the range of float64, "
            "got an overflow"
        )
    return result
