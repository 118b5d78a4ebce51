"""How forecasts from the memory are found: the regressions of a predictor over design paths."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from seedslib.base.semidefinite import LOST, lower_triangle
from seedslib.design.regression import ABSOLUTE, Scatter, regress
from seedslib.designed.predictors import (
    AffineFit,
    Fit,
    Polynomial,
    PolynomialFit,
    monomials,
    standardised,
)

ROUNDING = 4e-15
"""A deviation below this part of that of the state is rounding."""


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
    found = gather(lambda x, u: np.concatenate([x, u]))
    fit = regress(found.mean, found.cov, targets, size)
    wide = np.diagonal(found.cov)[:targets]
    if not (np.diagonal(fit.cov) < LOST * wide).any():
        return fit
    # beside so wide a prior the digits of what is not explained are lost: from itself it has them
    rest = gather(lambda x, u: np.concatenate([x - fit.mean(u), u]))
    more = regress(rest.mean, rest.cov, targets, size)
    if not (np.diagonal(more.cov) > ROUNDING**2 * wide).all():
        return fit  # known exactly
    return AffineFit(fit.gain + more.gain, fit.offset + more.offset, more.cov)


def coefficients_of(predictor: object, dimension: int) -> int:
    """Number of coefficients per target for a memory of this dimension."""
    if isinstance(predictor, Polynomial):
        degree = max(predictor.mean_degree, predictor.cov_degree)
        return math.comb(dimension + degree, degree) - 1
    return dimension


def _polynomial(predictor, gather, n, size):
    found = gather(lambda x, u: u)
    deviation = np.sqrt(np.maximum(np.diagonal(found.cov), 0.0))
    kept = deviation > ABSOLUTE * np.maximum(size, np.abs(found.mean))
    # a constant component gets the scale zero, which makes it and its powers vanish
    scale = np.where(kept, 1.0, 0.0) / np.where(kept, deviation, 1.0)

    def lifted(u, degree):
        return monomials(standardised(u, found.mean, scale), degree)

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
        found.mean, scale, *mean, gain, offset, predictor.mean_degree, predictor.cov_degree
    )
