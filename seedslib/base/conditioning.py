"""Gaussian moments given a measurement: the update of every filter, and its density.

Missing components, components that others determine, circles and priors much wider than the noise
are met here, once; `seedslib.base.linalg.eliminate` does the arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from operator import add, mul
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import align, batch_shape
from seedslib.base.circle import Periods, nearest
from seedslib.base.linalg import (
    ABSOLUTE,
    Reciprocals,
    cholesky,
    eliminate,
    solve_psd,
    variances,
    whole_is_quicker,
)
from seedslib.base.roots import correct_root, square

LOG_2PI = math.log(2.0 * math.pi)

WIDE = 1e-8
"""A variance that falls below this fraction of itself has lost half of its digits."""

LEVEL = 1e-6
"""An innovation without variance up to this fraction of what it is a difference of is rounding."""

FAINT = 1e-5
"""The same as a fraction of a deviation: what `RELATIVE` counts as zero has deviations of 3e-7."""

UNEXPLAINED = 1e-13
"""What slope and noise leave unexplained of cov y is rounding up to this fraction of it."""


def update(
    mean: ArrayLike,
    cov: ArrayLike | None,
    y: ArrayLike,
    moments: tuple[ArrayLike, ArrayLike, ArrayLike],
    *,
    noise: Callable[[], np.ndarray] | None = None,
    periods: Periods = (),
    exact: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and covariance given a measurement, and the logarithm of its density.

    With the innovation e = y - E y, C = cov(x, y) and S = cov y they are m + C S⁻¹ e and
    P - C S⁻¹ Cᵀ: the best estimate that is affine in y, and the posterior moments where (x, y) is
    Gaussian. Equations (6.2), (8.2) of the jump-diffusion paper, (6.17) of the switching paper.
    The covariance loses one nonnegative rank-one term per component and stays exactly symmetric.

    Parameters
    ----------
    mean : array_like, shape (n, *batch)
    cov : array_like, shape (n, n, *batch), or None
        None where only the mean and the density are wanted.
    y : array_like, shape (m, *batch)
        Measurement. NaN marks a missing component, which is left out exactly.
    moments : Moments
        E y of shape (m, *batch), cov(x, y) of shape (n, m, *batch), cov y of shape
        (m, m, *batch).
    noise : callable, optional
        ``noise() -> (m, m, *batch)``, the covariance of y given the state. It is asked for where
        a variance falls below 1e-8 of itself: there rounding has taken the noise out of cov y.
    periods : tuple
        Components of y on a circle, from `as_periods`: the innovation is the shortest way round.
    exact : bool
        Whether the moments are those of the model, so that an innovation out of the range of
        cov y has density zero; fitted moments may leave some variance out.

    Returns
    -------
    mean : ndarray, shape (n, *batch)
    cov : ndarray, shape (n, n, *batch), or None
        Without batch axes where `cov`, the moments and the missing components have none.
    loglik : ndarray, shape (*batch)
        Logarithm of the Gaussian density of the components of y that were observed.

    Raises
    ------
    ValueError
        A measurement of another size, or an infinite one.

    Notes
    -----
    Batch axes come last, broadcast against each other and may be absent.
    A component of y that the ones before it determine, up to 1e-13 of its variance, is left out:
    the likelihood is the density of the others (-inf where impossible). Items in which a variance
    given the components before falls below -1e-9 of itself, or with a NaN but in `y`, become NaN.
    """
    mean, y, expected, cross, innovation_cov = map(np.asarray, (mean, y, *moments))
    cov = None if cov is None else np.asarray(cov)
    if len(y) != len(expected):
        raise ValueError(f"y: wanted shape ({len(expected)}, *batch), got {y.shape}")
    gain_batch = batch_shape(cross.shape[2:], innovation_cov.shape[2:])
    batch = batch_shape(mean.shape[1:], y.shape[1:], expected.shape[1:], gain_batch)
    cov_batch = () if cov is None else batch_shape(cov.shape[2:], gain_batch)
    depth = max(len(batch), len(cov_batch))
    if depth:
        mean, y, expected = (align(part, 1, depth) for part in (mean, y, expected))
        cross, innovation_cov = align(cross, 2, depth), align(innovation_cov, 2, depth)
        cov = None if cov is None else align(cov, 2, depth)

    y = nearest(y, expected, periods)
    innovation, missing, observed = y - expected, 0, observed_in(y)
    if not observed.all():
        # a component that no item has is dropped: a covariance common to all items stays common
        some = observed.reshape(len(y), -1).any(axis=1)
        y, expected, innovation, cross = y[some], expected[some], innovation[some], cross[:, some]
        innovation_cov, some = _without_missing(innovation_cov, observed), observed[some]
        if not some.all():
            innovation, cross = np.where(some, innovation, 0.0), np.where(some, cross, 0.0)
            missing = len(some) - some.sum(axis=0)
            cov_batch = batch_shape(cov_batch, observed.shape[1:])

    whole = cov is not None and whole_is_quicker(batch, len(cov))
    given = mean, None if whole else cov, innovation, cross, innovation_cov
    lists = [None if part is None else _components(part, depth) for part in given]
    if whole:
        lists[0], lists[3] = [mean], [list(cross.swapaxes(0, 1))]
    reciprocals = Reciprocals(depth > 0)
    terms, pivots = eliminate(*lists, reciprocals)
    full, cov_full = ((1,) * (depth - len(axes)) + axes for axes in (batch, cov_batch))
    new_mean = np.empty((len(mean), *full))
    if whole:
        new_mean[...] = lists[0][0]
        new_cov = _corrected(cov, lists[3][0], reciprocals.inverses, cov_full)
    else:
        for k, component in enumerate(lists[0]):
            new_mean[k] = component
        new_cov = None if cov is None else _filled(lists[1], cov_full)

    terms.append(_log_product(pivots))
    count = len(pivots) - missing
    for j, (left_out, variance) in reciprocals.redundant.items():
        count = count - left_out
        if exact:  # what is left of the innovation must be rounding of the numbers it is made of
            size = np.abs(y[j]) + np.abs(expected[j]) + np.abs(mean).max(axis=0)
            least = LEVEL * size + FAINT * np.sqrt(np.abs(variance))
            terms.append(np.where(left_out & (np.abs(lists[2][j]) > least), np.inf, 0.0))
    terms.append(count * LOG_2PI)
    loglik = np.empty(full)
    loglik[...] = -0.5 * reduce(add, terms)

    if noise is not None and cov is not None and len(innovation):
        narrow = (variances(new_cov) < WIDE * variances(cov)).any(axis=0)
        if np.any(narrow):
            R = align(np.asarray(noise(), dtype=float), 2, depth)
            R = R if observed.all() else _without_missing(R, observed)
            _update_by_roots(new_cov, narrow, cov, cross, innovation_cov, R)
    if depth:
        new_mean, loglik = new_mean.reshape(len(mean), *batch), loglik.reshape(batch)
        new_cov = None if cov is None else new_cov.reshape(cov.shape[:2] + cov_batch)
    return new_mean, new_cov, loglik


def kalman_gain(cross: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Gain C S⁻¹, shape (n, m, *batch): what each component of an innovation moves.

    Components of y that others determine have none; see `solve_psd`.

    Parameters
    ----------
    cross : ndarray, shape (n, m, *batch)
        cov(x, y).
    cov : ndarray, shape (m, m, *batch)
        cov y.
    """
    return solve_psd(cov, cross.swapaxes(0, 1)).swapaxes(0, 1)


def gaussian_logpdf(
    y: ArrayLike, mean: ArrayLike, cov: ArrayLike, periods: Periods = ()
) -> np.ndarray:
    """Logarithm of the Gaussian density, shape (*batch); NaN components of y are left out.

    Parameters
    ----------
    y, mean : array_like, shape (m, *batch)
    cov : array_like, shape (m, m, *batch)
    periods : tuple
        Components on a circle, from `as_periods`.
    """
    # a state without components: nothing is corrected, and the density remains
    moments = mean, np.empty((0, len(mean))), cov
    return update(np.empty(0), None, y, moments, periods=periods)[2]


def observed_in(y: np.ndarray) -> np.ndarray:
    """Where a measurement (m, *batch) has a number: NaN is missing.

    Raises
    ------
    ValueError
        An infinite one.
    """
    observed = np.isfinite(y)
    if not observed.all() and np.isinf(y).any():
        where = tuple(int(i) for i in np.argwhere(np.isinf(y))[0])
        raise ValueError(f"y: wanted finite numbers or NaN, got {y[where]} at index {where}")
    return observed


def _components(array: np.ndarray, depth: int) -> list:
    """Components of a vector or a matrix with `depth` batch axes.

    Without any they are floats, which are several times faster than arrays without axes.
    """
    if not depth:
        return array.tolist()
    return list(array) if array.ndim == 1 + depth else [list(row) for row in array]


def _filled(lower: list[list[Any]], batch: tuple[int, ...]) -> np.ndarray:
    """Symmetric array of the component lists on and below the diagonal."""
    full = np.empty((len(lower), len(lower), *batch))
    for k, row in enumerate(lower):
        for q in range(k + 1):
            full[k, q] = full[q, k] = row[q]
    return full


def _corrected(
    cov: np.ndarray, columns: list[np.ndarray], inverses: list[Any], batch: tuple[int, ...]
) -> np.ndarray:
    """P - C S⁻¹ Cᵀ at once, of what `eliminate` makes of C and of the pivots of S."""
    full = np.empty((*cov.shape[:2], *batch))
    full[...] = cov
    for column, inverse in zip(columns, inverses, strict=True):
        full -= (column * inverse)[:, None] * column
    for k in range(1, len(cov)):
        full[:k, k] = full[k, :k]
    return full


def _without_missing(cov: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """Covariance of the components of y that some item has; those an item misses have variance one.

    Uncorrelated with all others and with an innovation of zero, they change nothing.
    """
    some = observed.reshape(len(observed), -1).any(axis=1)
    observed, cov = observed[some], cov[some][:, some]
    if observed.all():
        return cov
    identity = align(np.eye(len(observed)), 2, observed.ndim - 1)
    return np.where(observed & observed[:, None], cov, identity)


def _log_product(pivots: list[Any]) -> Any:
    """Logarithm of the determinant: one of the product of the pivots where that is a number."""
    if len(pivots) == 1:
        return np.log(pivots[0])
    with np.errstate(over="ignore"):
        product = reduce(mul, pivots, 1.0)
    if np.all((product > ABSOLUTE) & (product < np.inf)):
        return np.log(product)
    return reduce(add, [np.log(pivot) for pivot in pivots])


def _update_by_roots(
    new_cov: np.ndarray,
    narrow: np.ndarray,
    cov: np.ndarray,
    cross: np.ndarray,
    innovation_cov: np.ndarray,
    noise: np.ndarray,
) -> None:
    """Write corrected covariances of priors that are so wide that P - C S⁻¹ Cᵀ has no digits.

    There the noise R is rounded off in S, and is needed apart: with P = L Lᵀ and C = L Gᵀ the root
    is corrected by `correct_root`. Where cov y is more than slope and noise, it is left as it is.
    """
    batch = new_cov.shape[2:]
    narrow = np.broadcast_to(narrow, batch)
    cov, cross, innovation_cov, noise = (
        np.broadcast_to(part, part.shape[:2] + batch)[..., narrow]
        for part in (cov, cross, innovation_cov, noise)
    )
    root, slope = cholesky(cov), np.zeros_like(cross)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for j, row in enumerate(root):  # L Gᵀ = C, a row of zeros where L has one
            rest = cross[j] - (row[:j, None] * slope[:j]).sum(axis=0)
            slope[j] = np.where(row[j] > 0, rest, 0.0) / np.where(row[j] > 0, row[j], 1.0)
        rest = innovation_cov - noise - np.einsum("ki...,kj...->ij...", slope, slope)
        unit = np.sqrt(variances(innovation_cov))
        exact = (np.abs(rest) <= UNEXPLAINED * unit[:, None] * unit[None, :]).all(axis=(0, 1))
    exact &= ~(noise == 0.0).all(axis=(0, 1)) & np.isfinite(root).all(axis=(0, 1))
    parts = root, np.swapaxes(slope, 0, 1), cholesky(noise)
    _, _, root, _ = correct_root(*(part[..., exact] for part in parts))
    narrow = narrow.copy()
    narrow[narrow] = exact
    new_cov[:, :, narrow] = square(root)
