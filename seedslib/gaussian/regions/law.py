"""Laws in the plane and beyond, batch axes last: checks, and the cases that a route takes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_real
from seedslib.gaussian.regions.twofold import binary_scale, determinant

# A determinant below this part of the product of the variances is what rounding makes of zero.
SINGULAR = 4.0 * np.finfo(float).eps
_ASYMMETRY = 1e-10
_INDEFINITE = 1e-10


class Cases(NamedTuple):
    """Laws in the plane beside simple counter-clockwise polygons, one flat batch of size B.

    Means (2, B) and covariances (2, 2, B); vertices (V, B), rays (2, 2, B) or None and convexity
    (B,) as in `geometry.Outline`.
    """

    mean: np.ndarray
    cov: np.ndarray
    x: np.ndarray
    y: np.ndarray
    rays: MaybeArray
    convex: np.ndarray

    def take(self, index: slice | np.ndarray) -> Cases:
        """The cases at some places of the batch."""
        return Cases(*(None if part is None else part[..., index] for part in self))


class FlatMoments(NamedTuple):
    """Logarithm of the mass (B,), mean (2, B) and covariance (2, 2, B) of the conditioned law."""

    log_mass: np.ndarray
    mean: np.ndarray
    cov: np.ndarray


def as_law(
    mean: object, cov: object, least: int, most: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n, ...) and exactly symmetric covariance (n, n, ...) with ``least <= n <= most``.

    Raises
    ------
    TypeError
        Not made of real numbers.
    ValueError
        Wrong shapes, entries that are not finite, asymmetry beyond 1e-10, a negative variance,
        or a pair of components whose determinant is below -1e-10 of the product of variances.
    """
    mean, cov = as_real("mean", mean), as_real("cov", cov)
    size = mean.shape[0] if mean.ndim else 0
    if size < least or (most is not None and size > most):
        wanted = f"shape ({most}, ...)" if least == most else f"at least {least} components"
        raise ValueError(f"mean: wanted {wanted}, got shape {mean.shape}")
    if cov.shape[:2] != (size, size):
        raise ValueError(f"cov: wanted shape ({size}, {size}, ...), got {cov.shape}")
    for i in range(size):
        if (cov[i, i] < 0.0).any():
            raise ValueError(
                f"cov: wanted nonnegative variances, got {cov[i, i].min():g} at component {i}"
            )
    cov = cov.copy()
    for i in range(size):
        for j in range(i):
            bound = np.sqrt(cov[i, i]) * np.sqrt(cov[j, j])
            if (np.abs(cov[i, j] - cov[j, i]) > _ASYMMETRY * bound).any():
                raise ValueError(f"cov: wanted a symmetric matrix, entries ({i}, {j}) differ")
            cov[i, j] = cov[j, i] = 0.5 * (cov[i, j] + cov[j, i])
            if (np.abs(cov[i, j]) > (1.0 + 0.5 * _INDEFINITE) * bound).any():
                raise ValueError(
                    "cov: wanted a positive semidefinite matrix, got a covariance larger than "
                    f"the two standard deviations allow at ({i}, {j})"
                )
    return mean, cov


def scaled(cov: np.ndarray) -> tuple[np.ndarray, ...]:
    """Leading two components in units that are powers of two: s, t, and the entries a, b, c.

    The scaling is exact, and products of the entries cannot over- or underflow.
    """
    s, t = (binary_scale(np.sqrt(cov[i, i])) for i in range(2))
    return s, t, cov[0, 0] / s / s, cov[0, 1] / s / t, cov[1, 1] / t / t


def is_regular(cov: np.ndarray) -> np.ndarray:
    """Whether double precision can tell the law of the leading two components from a line's."""
    _, _, a, b, c = scaled(cov)
    return determinant(a, b, b, c) > SINGULAR * a * c
