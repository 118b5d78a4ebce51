"""Checks of the mean and covariance of a Gaussian vector, with optional batch axes last."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from seedslib.base.checks import (
    ASYMMETRY,
    as_covariance,
    as_real,
    require_one_size,
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
    mean = as_real("mean", mean)
    if mean.ndim == 0 or mean.shape[0] == 0:
        raise ValueError(f"mean: wanted shape (n, ...), got {mean.shape}")
    n = mean.shape[0]
    if size not in (None, n):
        raise ValueError(f"mean: wanted {size} components, got shape {mean.shape}")
    array = as_real("cov", cov)
    if size is None:
        require_one_size("mean, cov", mean, array)
    if array.ndim == 2:
        return mean, as_covariance("cov", array, n)
    if array.ndim < 2 or array.shape[:2] != (n, n):
        raise ValueError(f"cov: wanted shape ({n}, {n}, ...), got {array.shape}")
    try:
        np.broadcast_shapes(mean.shape[1:], array.shape[2:])
    except ValueError:
        raise ValueError(
            f"cov: batch axes {array.shape[2:]} do not fit those of the mean {mean.shape[1:]}"
        ) from None
    if array.size == 0:
        return mean, array
    swapped = np.swapaxes(array, 0, 1)
    scale = np.abs(array).max(axis=(0, 1))
    asymmetry = np.abs(array - swapped).max(axis=(0, 1))
    if (asymmetry > ASYMMETRY * scale).any():
        raise ValueError(f"cov: wanted symmetric matrices, got asymmetry {asymmetry.max():.3g}")
    array = 0.5 * (array + swapped)
    require_semidefinite("cov", np.moveaxis(array, (0, 1), (-2, -1)))
    return mean, array


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


def align(array: np.ndarray, axes: int, depth: int) -> np.ndarray:
    """Unit axes put between the first `axes` axes and the batch axes, `depth` of these in all."""
    missing = axes + depth - array.ndim
    return array.reshape((*array.shape[:axes], *(1,) * missing, *array.shape[axes:]))


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
