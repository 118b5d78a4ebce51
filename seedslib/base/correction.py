"""The correction of a mean and a covariance by a measurement, written once.

One sequential elimination of the innovation covariance S = L D Lᵀ on lists of components. Its
lines use only + - * / between components, so a component may be an array over paths, modes or
regions, a plain float, or a SymPy expression (which turns the step into printable formulas).
"""

from __future__ import annotations

from contextlib import nullcontext
from functools import reduce
from operator import add, mul
from typing import Any

import numpy as np

from seedslib.base.circle import Periods, nearest
from seedslib.base.semidefinite import ABSOLUTE, INDEFINITE, LOG_2PI, RELATIVE, WIDE, factor

LEVEL = 1e-6
"""An innovation without variance up to this part of what it is a difference of is rounding."""

FAINT = 1e-5
"""The same as a part of a deviation: what `RELATIVE` counts as zero has deviations of 3e-7."""

UNEXPLAINED = 1e-13
"""What the slope and the noise leave unexplained of cov y is rounding up to this part of it."""


def correct(
    mean: np.ndarray,
    cov: np.ndarray,
    y: np.ndarray,
    moments: Any,
    rows: Any = None,
    noise: Any = None,
    periods: Periods = (),
    exact: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Correct a predicted mean and covariance by one measurement.

    With e = y - E y, C = cov(x, y) and S = cov y the result is m + C S⁺ e and P - C S⁺ Cᵀ: the
    best estimate affine in y, and the posterior moments when (x, y) is Gaussian. Equations
    (6.2), (8.2) of the jump-diffusion paper, (6.17) of the switching paper. The covariance
    loses one nonnegative rank-one term per component and stays exactly symmetric.

    Parameters
    ----------
    mean : array_like, shape (n, *batch)
        Predicted mean.
    cov : array_like, shape (n, n, *batch), or None
        Predicted covariance. None where only the mean and the likelihood are wanted.
    y : array_like, shape (m, *batch)
        Measurement. NaN marks a missing component, which is left out exactly.
    moments : Moments
        E y of shape (m, *batch), cov(x, y) of shape (n, m, *batch), cov y of shape
        (m, m, *batch).
    rows : int, optional
        Correct only the leading rows of the state (a partial estimate); all rows otherwise.
    noise : callable, optional
        ``noise() -> (m, m, *batch)``, the covariance of y at a known state. It is asked where a
        variance falls below 1e-8 of itself: there the noise has been rounded off in cov y.
    periods : tuple
        Components of y on a circle, from `as_periods`: the innovation is the shortest way round.
    exact : bool
        Whether an innovation out of the range of cov y is impossible; a fit may leave some out.

    Returns
    -------
    mean : ndarray, shape (rows, *batch)
    cov : ndarray, shape (rows, rows, *batch), or None
        Without batch axes where `cov`, the moments and the missing components have none.
    loglik : ndarray, shape (*batch)
        Logarithm of the Gaussian density of the components of y that were observed.

    Raises
    ------
    ValueError
        A measurement of another size, or an infinite one.

    Notes
    -----
    Batch axes come last, broadcast against each other and may be absent. Arrays of SymPy
    expressions (dtype object) are corrected by the same lines.
    A component of y that the ones before it determine, up to 1e-13 of its variance, is left out:
    the likelihood is the density of the others (-inf where impossible). Items in which a variance
    given the components before falls below -1e-9 of itself, or with a NaN but in `y`, become NaN.
    """
    mean, y, predicted, cross, spread = map(np.asarray, (mean, y, *moments))
    if y.shape[:1] != predicted.shape[:1]:
        raise ValueError(f"y: wanted shape ({len(predicted)}, *batch), got {y.shape}")
    rows = len(mean) if rows is None else rows
    mean, cross = mean[:rows], cross[:rows]
    cov = None if cov is None else np.asarray(cov)[:rows, :rows]
    if object in (mean.dtype, y.dtype, predicted.dtype, cross.dtype, spread.dtype):
        return _correct_symbols(mean, cov, y - predicted, cross, spread)

    gain_batch = joint_shape(cross.shape[2:], spread.shape[2:])
    mean_batch = joint_shape(mean.shape[1:], y.shape[1:], predicted.shape[1:], gain_batch)
    cov_batch = () if cov is None else joint_shape(cov.shape[2:], gain_batch)
    depth = max(len(mean_batch), len(cov_batch))
    mean, y, predicted = (_align(part, 1, depth) for part in (mean, y, predicted))
    cross, spread = _align(cross, 2, depth), _align(spread, 2, depth)
    cov = None if cov is None else _align(cov, 2, depth)

    y = nearest(y, predicted, periods)
    error, missing, whole = y - predicted, 0, cross
    size = np.abs(y) + np.abs(predicted) if exact else None
    present = np.isfinite(y)
    if not present.all():
        if np.isinf(y).any():
            where = tuple(int(i) for i in np.argwhere(np.isinf(y))[0])
            raise ValueError(f"y: wanted finite numbers or NaN, got {y[where]} at index {where}")
        error, cross, spread, missing = _without_missing(present, error, cross, spread)
        size = size[present.reshape(len(present), -1).any(axis=1)] if exact else None
        if missing.any():
            cov_batch = joint_shape(cov_batch, y.shape[1:]) if cov is not None else ()
    new_mean, new_cov, loglik = _correct_numbers(mean, cov, error, cross, spread, missing, size)
    if noise is not None and cov is not None and len(error):
        wide = (np.diagonal(new_cov) < WIDE * np.diagonal(cov)).any(axis=-1)
        if wide.any():
            known = _align(np.asarray(noise(), dtype=float), 2, depth)
            if not present.all():
                known = _without_missing(present, y, whole, known)[2]
            _correct_wide(cov, cross, spread, known, wide, new_cov)
    return (
        new_mean.reshape(rows, *mean_batch),
        None if cov is None else new_cov.reshape(rows, rows, *cov_batch),
        loglik.reshape(mean_batch),
    )


def gaussian_logpdf(y: Any, mean: Any, cov: Any, periods: Periods = ()) -> np.ndarray:
    """Logarithm of the Gaussian density of y (m, *batch), shape (*batch); NaN is left out.

    Parameters
    ----------
    mean, cov : ndarray, shapes (m, *batch) and (m, m, *batch)
    periods : tuple
        Components on a circle, from `as_periods`.
    """
    ones = (1,) * (np.ndim(mean) - 1)
    state, cross = np.zeros((1, *ones)), np.zeros((1, len(mean), *ones))
    return correct(state, None, y, (mean, cross, cov), periods=periods)[2]


def normalized_squares(error: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Squares eᵀ P⁻¹ e, shape (*batch), of errors (m, *batch); components as in `correct`."""
    spread = [list(np.broadcast_to(row, (len(error), *error.shape[1:]))) for row in cov]
    terms, _ = eliminate([], None, list(error), [], spread, _Pivots(np.ndarray.all))
    return reduce(add, terms)


def joint_shape(*shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Broadcast shape; the usual case of equal or empty shapes costs next to nothing."""
    joint = ()
    for shape in shapes:
        if shape != joint and shape != ():
            if joint != ():
                return np.broadcast_shapes(*shapes)
            joint = shape
    return joint


def _align(part: np.ndarray, core: int, depth: int) -> np.ndarray:
    """Put axes of length one between the components and the batch, up to `depth` batch axes."""
    short = depth - (part.ndim - core)
    return part.reshape(part.shape[:core] + (1,) * short + part.shape[core:]) if short else part


def _without_missing(present, error, cross, spread):
    """Moments in which missing components carry no information, and how many remain as dummies.

    A component that no item has is dropped, so that a covariance common to all items stays
    common; one that only some items miss gets a zero innovation and a unit pivot there.
    """
    kept = present.reshape(len(present), -1).any(axis=1)
    present, error = present[kept], error[kept]
    cross, spread = cross[:, kept], spread[kept][:, kept]
    if present.all():
        return error, cross, spread, np.zeros((1,) * (present.ndim - 1), dtype=int)
    identity = np.eye(len(present)).reshape(spread.shape[:2] + (1,) * (present.ndim - 1))
    return (
        np.where(present, error, 0.0),
        np.where(present, cross, 0.0),
        np.where(present & present[:, None], spread, identity),
        len(present) - present.sum(axis=0),
    )


def eliminate(
    mean: np.ndarray,
    cov: np.ndarray,
    error: np.ndarray,
    cross: np.ndarray,
    spread: np.ndarray,
    reciprocal: bool,
) -> tuple[np.ndarray, ...]:
    """Eliminate y component by component; the lists are updated in place.

    `cov` and `spread` are read and written on and below the diagonal only. `reciprocal(pivot,
    variance)` gives 1 / pivot and the pivot it stands for. Returns the terms of eᵀ S⁻¹ e and the
    pivots.
    """
    squares, pivots = [], []
    variances = [spread[j][j] for j in range(len(error))]
    for j, e in enumerate(error):
        inverse, pivot = reciprocal(spread[j][j], variances[j])
        pivots.append(pivot)
        scaled = e * inverse
        squares.append(e * scaled)
        for k, row in enumerate(cross):
            mean[k] = mean[k] + row[j] * scaled
        if cov is not None:
            for k, row in enumerate(cross):
                gain = row[j] * inverse
                for q in range(k + 1):
                    cov[k][q] = cov[k][q] - gain * cross[q][j]
        for i in range(j + 1, len(error)):
            factor = spread[i][j] * inverse
            error[i] = error[i] - factor * e
            for row in cross:
                row[i] = row[i] - factor * row[j]
            for q in range(j + 1, i + 1):
                spread[i][q] = spread[i][q] - factor * spread[q][j]
    return squares, pivots


class _Pivots:
    """Reciprocals of the pivots of `eliminate`; those of redundant components are zero."""

    def __init__(self, everywhere: Any) -> None:
        self.everywhere, self.count = everywhere, 0
        self.redundant: dict[int, Any] = {}  # by component: where it is left out, and its variance

    def __call__(self, pivot: Any, variance: Any) -> tuple[Any, Any]:
        j, self.count = self.count, self.count + 1
        # the first pivot is its variance
        regular = pivot > (ABSOLUTE if pivot is variance else RELATIVE * variance + ABSOLUTE)
        if self.everywhere(regular):
            return 1.0 / pivot, pivot
        self.redundant[j] = np.logical_not(regular), variance
        pivot_or_one = np.where(regular, pivot, 1.0)
        broken = ~(pivot >= -(INDEFINITE * np.abs(variance) + ABSOLUTE))
        return np.where(broken, np.nan, regular / pivot_or_one), pivot_or_one


def _correct_symbols(mean, cov, error, cross, spread):
    import sympy

    lists = [None if part is None else part.tolist() for part in (mean, cov, error, cross, spread)]
    squares, pivots = eliminate(*lists, lambda pivot, variance: (1 / pivot, pivot))
    logs = [sympy.log(2 * sympy.pi * pivot) for pivot in pivots]
    return np.array(lists[0], dtype=object), _mirror(lists[1], (), object), -sum(squares + logs) / 2


def _correct_numbers(mean, cov, error, cross, spread, missing, size):
    """All parts with the same number of batch axes; `missing` counts dummy components.

    An innovation of a redundant component above the rounding of numbers of a given size is
    impossible.
    """
    gain_batch = joint_shape(cross.shape[2:], spread.shape[2:])
    mean_batch = joint_shape(mean.shape[1:], error.shape[1:], gain_batch)
    cov_batch = () if cov is None else joint_shape(cov.shape[2:], gain_batch)
    parts = (mean, cov, error, cross, spread)
    if mean_batch:
        lists = [
            part if part is None else list(part) if core == 1 else [list(row) for row in part]
            for part, core in zip(parts, (1, 2, 1, 2, 2), strict=True)
        ]
    else:  # Python floats: several times faster than arrays without axes
        lists = [part if part is None else part.tolist() for part in parts]
    reciprocal = _Pivots(np.ndarray.all if mean_batch else bool)
    terms, pivots = eliminate(*lists, reciprocal)

    new_mean = np.empty((len(mean), *mean_batch))
    for k, component in enumerate(lists[0]):
        new_mean[k] = component
    new_cov = _mirror(lists[1], cov_batch, float)
    loglik = np.empty(mean_batch)
    with np.errstate(over="ignore") if mean_batch else nullcontext():  # one logarithm for all
        product = reduce(mul, pivots, 1.0)
    sound = np.all((product > ABSOLUTE) & (product < np.inf))
    terms += [np.log(product)] if sound else [np.log(p) for p in pivots]
    count = len(pivots) - missing
    for j, (left_out, variance) in reciprocal.redundant.items():
        count = count - left_out
        if size is not None:
            least = LEVEL * (size[j] + np.abs(mean).max(axis=0)) + FAINT * np.sqrt(np.abs(variance))
            terms.append(np.where(left_out & (np.abs(lists[2][j]) > least), np.inf, 0.0))
    terms.append(count * LOG_2PI)
    np.multiply(-0.5, reduce(add, terms), out=loglik)
    return new_mean, new_cov, loglik


def _correct_wide(
    cov: np.ndarray,
    cross: np.ndarray,
    spread: np.ndarray,
    noise: Any,
    wide: Any,
    new_cov: np.ndarray,
) -> None:
    """Write corrected covariances of priors that are so wide that P - C S⁻¹ Cᵀ has no digits.

    There the noise R is rounded off in S, and is needed apart. With P = L Lᵀ and C = L Gᵀ the
    triangle of (R½, G; 0, L) has a root of the corrected covariance in its corner: nothing is
    subtracted from a variance. Where cov y is more than slope and noise, it is left as it is.
    """
    batch = new_cov.shape[2:]
    wide = np.broadcast_to(wide, batch)
    cov, cross, spread, noise = (
        np.broadcast_to(part, part.shape[:2] + batch)[..., wide]
        for part in (cov, cross, spread, noise)
    )
    n, m = cross.shape[:2]
    root, slope = factor(cov), np.zeros_like(cross)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for j, row in enumerate(root):  # L Gᵀ = C, a row of zeros where L has one
            rest = cross[j] - (row[:j, None] * slope[:j]).sum(axis=0)
            slope[j] = np.where(row[j] > 0, rest, 0.0) / np.where(row[j] > 0, row[j], 1.0)
        rest = spread - noise - np.einsum("ki...,kj...->ij...", slope, slope)
        unit = np.sqrt(np.einsum("ii...->i...", spread))
        exact = (np.abs(rest) <= UNEXPLAINED * unit[:, None] * unit[None, :]).all(axis=(0, 1))
    exact &= ~(noise == 0.0).all(axis=(0, 1)) & np.isfinite(root).all(axis=(0, 1))
    rows = np.zeros((m + n, m + n, np.count_nonzero(exact)))
    rows[:m, :m], rows[:m, m:] = factor(noise)[..., exact], np.swapaxes(slope, 0, 1)[..., exact]
    rows[m:, m:] = root[..., exact]
    corner = np.linalg.qr(rows.transpose(2, 1, 0), mode="r")[:, m:, m:]
    wide = wide.copy()
    wide[wide] = exact
    new_cov[:, :, wide] = np.einsum("bki,bkj->ijb", corner, corner)


def _mirror(lower: list | None, batch: tuple[int, ...], dtype: type) -> np.ndarray | None:
    """Full symmetric array from the component lists on and below the diagonal."""
    if lower is None:
        return None
    full = np.empty((len(lower), len(lower), *batch), dtype=dtype)
    for k, row in enumerate(lower):
        for q in range(k + 1):
            full[k, q] = full[q, k] = row[q]
    return full
