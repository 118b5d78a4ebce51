"""The correction of a mean and a covariance by a measurement, written once.

One sequential elimination of the innovation covariance S = L D Lᵀ on lists of components. Its
lines use only + - * / between components, so a component may be an array over paths, modes or
regions, a plain float, or a SymPy expression (which turns the step into printable formulas).
"""

from __future__ import annotations

from functools import reduce
from operator import add
from typing import Any

import numpy as np

from seedslib.base.circle import Periods, nearest
from seedslib.base.diffuse import correct_diffuse, narrowed
from seedslib.base.semidefinite import ABSOLUTE, LOG_2PI, RELATIVE, factor, logs, pseudo_correct

__all__ = ["correct", "eliminate", "factor", "joint_shape"]


def correct(
    mean: np.ndarray, cov: np.ndarray, y: np.ndarray, moments: Any, rows: Any = None,
    noise: Any = None, periods: Periods = (), exact: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
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
    TypeError
        An argument that is not numeric.
    ValueError
        Shapes that do not fit, or an infinite measurement.

    Notes
    -----
    Batch axes come last, broadcast against each other and may be absent. Arrays of SymPy
    expressions (dtype object) are corrected by the same lines.
    A singular S is met by its Moore-Penrose inverse, on the items concerned. Its rank is decided
    on the matrix scaled to unit diagonal: variances below the normal numbers and eigenvalues up
    to 1e-13 are zero; the likelihood is then the density on the range of S (-inf where impossible).
    Items whose scaled S has an eigenvalue below -1e-9, or with a NaN but in `y`, become NaN.
    """
    mean, y = _numbers("mean", mean), _numbers("y", y)
    cov = None if cov is None else _numbers("cov", cov)
    predicted, cross, spread = (
        _numbers(f"moments.{name}", part)
        for name, part in zip(("mean", "cross", "cov"), moments, strict=True)
    )
    rows = _check(mean, cov, y, predicted, cross, spread, rows)
    mean, cross = mean[:rows], cross[:rows]
    cov = None if cov is None else cov[:rows, :rows]
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
    error, missing = y - predicted, 0
    present = np.isfinite(y)
    if not present.all():
        if np.isinf(y).any():
            where = tuple(int(i) for i in np.argwhere(np.isinf(y))[0])
            raise ValueError(f"y: wanted finite numbers or NaN, got {y[where]} at index {where}")
        cross_before = cross
        error, cross, spread, missing = _without_missing(present, error, cross, spread)
        if missing.any():
            cov_batch = joint_shape(cov_batch, y.shape[1:]) if cov is not None else ()
    told = (y, predicted, present) if exact else None
    new_mean, new_cov, loglik = _correct_numbers(mean, cov, error, cross, spread, missing, told)
    apart_known = noise is not None and cov is not None and len(error)
    if apart_known and (suspect := narrowed(cov, new_cov)).any():
        apart = _align(np.asarray(noise(), dtype=float), 2, depth)
        if not present.all():
            apart = _without_missing(present, y, cross_before, apart)[2]
        correct_diffuse(cov, cross, spread, apart, suspect, new_cov)
    return (
        new_mean.reshape(rows, *mean_batch),
        None if cov is None else new_cov.reshape(rows, rows, *cov_batch),
        loglik.reshape(mean_batch),
    )


def joint_shape(*shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Broadcast shape; the usual case of equal or empty shapes costs next to nothing."""
    joint = ()
    for shape in shapes:
        if shape != joint and shape != ():
            if joint != ():
                return np.broadcast_shapes(*shapes)
            joint = shape
    return joint


def _numbers(name: str, value: object) -> np.ndarray:
    array = value
    if type(value) is not np.ndarray:
        try:
            array = np.asarray(value)
        except ValueError:
            raise TypeError(f"{name}: wanted an array, got a ragged list") from None
    foreign = array.dtype.kind == "O" and not all(hasattr(v, "__truediv__") for v in array.flat)
    if foreign or array.dtype.kind not in "fiuO":
        raise TypeError(f"{name}: wanted real numbers, got an array of dtype {array.dtype}")
    return array


def _check(mean, cov, y, predicted, cross, spread, rows) -> int:
    """Number of rows to correct, after every shape has been looked at."""
    if mean.ndim < 1 or mean.shape[0] < 1:
        raise ValueError(f"mean: wanted shape (n, *batch), got {mean.shape}")
    if y.ndim < 1:
        raise ValueError(f"y: wanted shape (m, *batch), got {y.shape}")
    n, m = len(mean), len(y)
    if rows is None:
        rows = n
    elif isinstance(rows, bool) or rows != int(rows) or not 1 <= rows <= n:
        raise ValueError(f"rows: wanted a whole number from 1 to {n}, got {rows}")
    if predicted.ndim and m != len(predicted) == len(spread):
        raise ValueError(f"y: wanted shape ({len(predicted)}, *batch), got {y.shape}")
    for name, part, wanted in (
        ("cov", cov, (n, n)),
        ("moments.mean", predicted, (m,)),
        ("moments.cross", cross, (n, m)),
        ("moments.cov", spread, (m, m)),
    ):
        if part is not None and part.shape[: len(wanted)] != wanted:
            shape = ", ".join(map(str, wanted))
            raise ValueError(f"{name}: wanted shape ({shape}, *batch), got {part.shape}")
    return int(rows)


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
    mean: np.ndarray, cov: np.ndarray, error: np.ndarray, cross: np.ndarray, spread: np.ndarray,
    reciprocal: bool,
) -> tuple[np.ndarray, ...]:  # fmt: skip
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


def _correct_symbols(mean, cov, error, cross, spread):
    import sympy

    lists = [None if part is None else part.tolist() for part in (mean, cov, error, cross, spread)]
    squares, pivots = eliminate(*lists, lambda pivot, variance: (1 / pivot, pivot))
    logs = [sympy.log(2 * sympy.pi * pivot) for pivot in pivots]
    return np.array(lists[0], dtype=object), _mirror(lists[1], (), object), -sum(squares + logs) / 2


def _sizes(y, predicted, present):
    """Magnitudes that innovations are rounded to, of the components that some item has."""
    found = np.abs(np.where(present, y, 0.0)) + np.abs(predicted)
    return found[present.reshape(len(present), -1).any(axis=1)]


def _correct_numbers(mean, cov, error, cross, spread, missing, told):
    """All parts with the same number of batch axes; `missing` counts dummy components."""
    gain_batch = joint_shape(cross.shape[2:], spread.shape[2:])
    mean_batch = joint_shape(mean.shape[1:], error.shape[1:], gain_batch)
    cov_batch = () if cov is None else joint_shape(cov.shape[2:], gain_batch)
    flagged = []
    everywhere = np.ndarray.all if mean_batch else bool

    def reciprocal(pivot, variance):
        # the first pivot is its variance
        regular = pivot > (ABSOLUTE if pivot is variance else RELATIVE * variance + ABSOLUTE)
        if not everywhere(regular):
            flagged.append(np.logical_not(regular))
            pivot = np.where(regular, pivot, 1.0)
        return 1.0 / pivot, pivot

    parts = (mean, cov, error, cross, spread)
    if mean_batch:
        lists = [
            part if part is None else list(part) if core == 1 else [list(row) for row in part]
            for part, core in zip(parts, (1, 2, 1, 2, 2), strict=True)
        ]
    else:  # Python floats: several times faster than arrays without axes
        lists = [part if part is None else part.tolist() for part in parts]
    terms, pivots = eliminate(*lists, reciprocal)

    new_mean = np.empty((len(mean), *mean_batch))
    for k, component in enumerate(lists[0]):
        new_mean[k] = component
    new_cov = _mirror(lists[1], cov_batch, float)
    loglik = np.empty(mean_batch)
    terms += logs(pivots, everywhere)
    terms.append((len(pivots) - missing) * LOG_2PI)
    np.multiply(-0.5, reduce(add, terms), out=loglik)
    if flagged:
        bad = np.any(np.broadcast_arrays(*flagged), axis=0)
        bad = np.broadcast_to(bad, gain_batch)
        sizes = _sizes(*told) if told else None
        pseudo_correct(parts, bad, missing, sizes, new_mean, new_cov, loglik)
    return new_mean, new_cov, loglik


def _mirror(lower: list | None, batch: tuple[int, ...], dtype: type) -> np.ndarray | None:
    """Full symmetric array from the component lists on and below the diagonal."""
    if lower is None:
        return None
    full = np.empty((len(lower), len(lower), *batch), dtype=dtype)
    for k, row in enumerate(lower):
        for q in range(k + 1):
            full[k, q] = full[q, k] = row[q]
    return full
