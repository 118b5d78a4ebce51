"""Linear regression from moments: what a design fits before each step.

Samples are gathered in bundles of paths. Each is reduced to its count, mean and centred sum of
products; they are merged in their order, so the result does not depend on threads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from seedslib.base.linalg import lower_triangle
from seedslib.designed.predictors import (
    AffineFit,
    Fit,
    Polynomial,
    PolynomialFit,
    monomials,
    standardised,
)

RELATIVE = 1e-10
"""Eigenvalues of the correlation matrix at or below this fraction of the largest count as zero."""

ABSOLUTE = 1e-10
"""A regressor whose standard deviation is at or below this fraction of its size is constant."""

DOMINATED = 0.35
"""A root-mean-square error whose standard error is more than this part of it (0.5 where a single
path makes up the mean) is no statistic."""

INDEFINITE = 1e-10
"""A residual covariance with an eigenvalue below minus this fraction of its trace is no rounding
error."""


class Scatter(NamedTuple):
    """Sample moments: count, mean (p,), centred sum of products (p, p)."""

    count: int
    mean: np.ndarray
    products: np.ndarray

    @property
    def cov(self) -> np.ndarray:
        """Covariance with division by the count, (p, p)."""
        return self.products / self.count


def scatter(rows: np.ndarray) -> Scatter:
    """Moments of the columns of an array (p, N), in two passes; N may be zero."""
    count = rows.shape[1]
    if count == 0:
        return Scatter(0, np.zeros(len(rows)), np.zeros((len(rows), len(rows))))
    mean = rows.mean(axis=1)
    centred = rows - mean[:, None]
    # the mean of the centred rows is a rounding error: Neely's correction takes it out
    shift = centred.mean(axis=1)
    products = np.dot(centred, centred.T)  # `@` would keep the other threads waiting
    return Scatter(count, mean + shift, products - count * np.outer(shift, shift))


def combine(parts: Iterable[Scatter]) -> Scatter:
    """Moments of all samples from those of the bundles, in their order (Chan's update)."""
    total = None
    for part in parts:
        if total is None or total.count == 0:
            total = part
        elif part.count:
            count = total.count + part.count
            shift = part.mean - total.mean
            share = part.count / count
            total = Scatter(
                count,
                total.mean + share * shift,
                total.products + part.products + total.count * share * np.outer(shift, shift),
            )
    return total


def root_mean_squares(moments: Scatter, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Root mean squares from the moments of samples whose first `n` rows are squares.

    Returns
    -------
    rms, error : ndarray, shape (n,)
        The roots and their standard errors: those of the mean squares by twice the roots.
    deviation : ndarray, shape (p,)
        Standard deviations of all rows.
    """
    deviation = np.sqrt(np.maximum(np.diagonal(moments.cov), 0.0))
    rms, error = np.sqrt(moments.mean[:n]), deviation[:n] / math.sqrt(moments.count)
    return rms, np.divide(error, 2.0 * rms, out=np.zeros(n), where=rms > 0), deviation


def inverse_root(cov: np.ndarray, size: np.ndarray | None = None) -> np.ndarray:
    """W (d, rank) with W Wᵀ a generalised inverse of a covariance.

    The range is decided in standardised coordinates: components whose standard deviation is at
    or below 1e-10 times their `size` are dropped, then eigenvalues of the correlation matrix at
    or below 1e-10 of the largest. Units therefore do not matter, and a constant component (whose
    variance is a rounding error) does not become a regressor.

    Parameters
    ----------
    cov : ndarray, shape (d, d)
    size : ndarray, shape (d,), optional
        Magnitudes of the components; only exact zeros are dropped without it.
    """
    deviation = np.sqrt(np.maximum(np.diagonal(cov), 0.0))
    varying = np.flatnonzero(deviation > (0.0 if size is None else ABSOLUTE * size))
    if varying.size == 0:
        return np.zeros((len(cov), 0))
    scale = deviation[varying]
    # only W Wᵀ is used, in sums of squares too: another basis turns W by a rotation
    values, vectors = np.linalg.eigh(cov[np.ix_(varying, varying)] / np.outer(scale, scale))
    good = values > RELATIVE * values[-1]
    root = np.zeros((len(cov), np.count_nonzero(good)))
    root[varying] = vectors[:, good] / np.sqrt(values[good]) / scale[:, None]
    return root


def regress(
    mean: np.ndarray, cov: np.ndarray, targets: int, size: np.ndarray | None = None
) -> AffineFit:
    """Best affine forecast of the first `targets` components from the others, (6.3).

    Parameters
    ----------
    mean, cov : ndarray, shapes (n + d,) and (n + d, n + d)
        Moments of targets and regressors together.
    targets : int
    size : ndarray, shape (d,), optional
        Magnitudes of the regressors, see `inverse_root`. By default their root mean squares.

    Raises
    ------
    ValueError
        Moments that are not finite, or that are no moments (a residual covariance that is
        clearly indefinite).
    """
    if not (np.isfinite(mean).all() and np.isfinite(cov).all()):
        raise ValueError("moments: wanted finite numbers; the paths left the range of floats")
    n = targets
    own = np.sqrt(np.diagonal(cov)[n:] + mean[n:] ** 2)
    root = inverse_root(cov[n:, n:], own if size is None else np.maximum(own, size))
    explained = cov[:n, n:] @ root
    gain = explained @ root.T
    residual = cov[:n, :n] - explained @ explained.T
    return AffineFit(gain, mean[:n] - gain @ mean[n:], semidefinite(residual, cov[:n, :n]))


def semidefinite(residual: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Residual covariance, exactly symmetric, without the negative eigenvalues of rounding."""
    residual = 0.5 * (residual + residual.T)
    # a function of the matrix: the same for every basis of its eigenvectors
    values, vectors = np.linalg.eigh(residual)
    if values[0] >= 0.0:
        return residual
    if values[0] < -INDEFINITE * np.trace(total):
        raise ValueError(
            f"moments: wanted a residual covariance that is positive semidefinite, got "
            f"eigenvalue {values[0]:.3g}"
        )
    clipped = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return 0.5 * (clipped + clipped.T)


def fit_forecast(
    predictor: object, gather: Callable[..., Scatter], targets: int, size: np.ndarray
) -> Fit:
    """Fit the forecast of the state from the memory.

    Parameters
    ----------
    predictor : Affine, Polynomial or Continuous
    gather : callable
        ``gather(rows) -> Scatter`` of ``rows(x, u)`` over all design paths.
    targets : int
        Number of components of x.
    size : ndarray, shape (d,)
        Magnitudes of the memory's components, see `regression.inverse_root`.

    Returns
    -------
    AffineFit or PolynomialFit
        The second of a `Polynomial`, which takes three passes over the paths.
    """
    if isinstance(predictor, Polynomial):
        return _polynomial(predictor, gather, targets, size)
    return fit_affine(gather, targets, size)


def fit_affine(gather: Callable[..., Scatter], targets: int, size: np.ndarray) -> AffineFit:
    """Affine forecast of the state from the memory; arguments as `fit_forecast`."""
    moments = gather(lambda x, u: np.concatenate([x, u]))
    return regress(moments.mean, moments.cov, targets, size)


def coefficients_of(predictor: object, dimension: int) -> int:
    """Number of coefficients per target for a memory of this dimension."""
    if isinstance(predictor, Polynomial):
        degree = max(predictor.mean_degree, predictor.cov_degree)
        return math.comb(dimension + degree, degree) - 1
    return dimension


def _polynomial(predictor, gather, n, size):
    memory = gather(lambda x, u: u)
    deviation = np.sqrt(np.maximum(np.diagonal(memory.cov), 0.0))
    varying = deviation > ABSOLUTE * np.maximum(size, np.abs(memory.mean))
    # a constant component gets the scale zero, which makes it and its powers vanish
    scale = np.where(varying, 1.0, 0.0) / np.where(varying, deviation, 1.0)

    def lifted(u, degree):
        return monomials(standardised(u, memory.mean, scale), degree)

    first = gather(lambda x, u: np.concatenate([x, lifted(u, predictor.mean_degree)]))
    mean = regress(first.mean, first.cov, n)
    rows, columns = lower_triangle(n)

    def products(x, u):
        error = x - mean.mean(lifted(u, predictor.mean_degree))
        return np.concatenate([error[rows] * error[columns], lifted(u, predictor.cov_degree)])

    if predictor.cov_degree == 0:
        gain, offset = np.zeros((len(rows), 0)), mean.cov[rows, columns]
    else:
        second = gather(products)
        gain, offset, _ = regress(second.mean, second.cov, len(rows))
    return PolynomialFit(
        memory.mean, scale, *mean, gain, offset, predictor.mean_degree, predictor.cov_degree
    )
