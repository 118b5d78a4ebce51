"""Mean length of a Gaussian vector, in any dimension and for any covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from seedslib.gaussian.arguments import gaussian_arguments

STEP = 0.125
REACH = 19.0
BLOCK = 256


def _rule() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of the trapezoidal rule in v, where the integration variable is sinh v."""
    v = STEP * np.arange(round(REACH / STEP) + 1)
    weight = STEP * np.cosh(v)
    weight[0] *= 0.5
    return np.sinh(v) ** 2, weight * 2 / np.sqrt(np.pi)


NODES, WEIGHTS = _rule()


def norm_mean(mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
    """Mean of the Euclidean norm of x ~ N(mean, cov).

    In the eigenvectors of the covariance, with eigenvalues λ and mean b, the mean is

        2/√π ∫₀^∞ ψ(s²) Σᵢ [λᵢ/(1+2λᵢs²) + bᵢ²/(1+2λᵢs²)²] ds,
        ψ(t) = ∏ᵢ (1+2λᵢt)^(-1/2) exp(-t bᵢ²/(1+2λᵢt)).

    The substitution s = c sinh v makes the integrand analytic and bounded in a strip whose width
    does not depend on the eigenvalues, so 153 nodes of the trapezoidal rule give full precision
    for every covariance, singular ones included. For two and three dimensions and zero mean
    compare equations (2.6) and (3.3) of Choi, Song, Shin (2019).

    Parameters
    ----------
    mean : array_like
        Shape (n, ...), batch axes last.
    cov : array_like
        Positive semidefinite, shape (n, n), or (n, n, ...) with batch axes that broadcast.

    Returns
    -------
    ndarray
        Shape (...); a scalar without batch axes. Relative error about 2e-15.

    Raises
    ------
    TypeError, ValueError
        Not real, not finite, shapes that do not fit, or not a covariance.
    """
    mean, cov = gaussian_arguments(mean, cov)
    if cov.ndim == 2:
        # any basis will do: of equal eigenvalues only the length of the mean in their space counts
        spread, vectors = np.linalg.eigh(cov)
        centre = np.tensordot(vectors.T, mean, 1)
        spread = np.broadcast_to(spread.reshape(-1, *[1] * (mean.ndim - 1)), mean.shape)
    else:
        values, vectors = np.linalg.eigh(np.moveaxis(cov, (0, 1), (-2, -1)))
        spread = np.moveaxis(values, -1, 0)
        spread = spread.reshape(len(spread), *[1] * (mean.ndim - spread.ndim), *spread.shape[1:])
        centre = np.einsum("...ij,i...->j...", vectors, mean)
        spread, centre = np.broadcast_arrays(spread, centre)
    return _norm_mean(np.maximum(spread, 0.0), centre)[()]


def _norm_mean(spread: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Mean norm from eigenvalues and mean in the eigenvectors, both (n, ...)."""
    scale = np.hypot(np.sqrt(2 * spread.max(axis=0)), _length(centre))
    n, shape = centre.shape[0], scale.shape
    unit = np.where(scale > 0, scale, 1.0).reshape(-1)
    spread = (spread.reshape(n, -1) / unit) / unit
    square = (centre.reshape(n, -1) / unit) ** 2
    result = np.empty(unit.size)
    for start in range(0, unit.size, BLOCK):
        block = slice(start, start + BLOCK)
        exponent = sums = 0.0
        for λ, bb in zip(spread[:, block], square[:, block], strict=True):
            stretch = 1.0 + 2.0 * np.multiply.outer(NODES, λ)
            moved = bb / stretch
            exponent = exponent + 0.5 * np.log(stretch) + NODES[:, None] * moved
            sums = sums + (λ + moved) / stretch
        result[block] = WEIGHTS @ (np.exp(-exponent) * sums)
    return scale * result.reshape(shape)


def _length(vector: np.ndarray) -> np.ndarray:
    largest = np.abs(vector).max(axis=0)
    safe = np.where(largest > 0, largest, 1.0)
    return largest * np.sqrt(np.square(vector / safe).sum(axis=0))
