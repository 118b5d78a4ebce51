"""Positive semidefinite matrices in batches: elimination, factors, solutions, repair.

Rows and columns come first, batch axes last, and every item of a batch is treated as if it were
alone. Matrices are small and batches large, so the algorithms are written by components: a
component is an array over the batch, a float, a SymPy expression or a node of a recorded program.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import lru_cache, reduce
from operator import add
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import align

RELATIVE = 1e-13
"""A pivot at or below this fraction of its variance counts as zero: a redundant component."""

ABSOLUTE = sys.float_info.min
"""A variance at or below this counts as zero: smaller numbers have lost digits."""

INDEFINITE = 1e-9
"""A pivot below minus this fraction of its variance is no rounding error: no covariance."""

FEW = 1000
"""Items of a batch of which a matrix stays in the processor's cache."""

NEGATIVE = 1e-12
"""An eigenvalue below minus this, in units of the deviations, is raised to it and reported."""

ROUNDING = 1e-15
"""A negative eigenvalue above minus this fraction of the largest is left alone: it is zero."""


@lru_cache(maxsize=64)
def lower_triangle(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the entries on and below the diagonal, row by row."""
    return np.tril_indices(n)


@lru_cache(maxsize=64)
def _places(n: int) -> np.ndarray:
    """Place of each entry of a symmetric (n, n) matrix in the order of `lower_triangle`."""
    rows, columns = lower_triangle(n)
    places = np.empty((n, n), dtype=int)
    places[rows, columns] = places[columns, rows] = np.arange(len(rows))
    return places


def symmetric(lower: ArrayLike, n: int) -> np.ndarray:
    """Symmetric matrix (n, n, *batch) of its entries in the order of `lower_triangle`."""
    return np.asarray(lower)[_places(n)]


def symmetrized(P: np.ndarray) -> np.ndarray:
    """``(P + Pᵀ) / 2`` of (n, n, *batch): what rounding has made unequal is equal again."""
    return 0.5 * (P + P.swapaxes(0, 1))


def variances(P: np.ndarray) -> np.ndarray:
    """Diagonal (n, *batch) of matrices (n, n, *batch)."""
    return np.einsum("ii...->i...", P)


def eliminate(
    mean: list[Any],
    cov: list[list[Any]] | None,
    innovation: list[Any],
    cross: list[list[Any]],
    innovation_cov: list[list[Any]],
    reciprocal: Callable[[Any, Any], tuple[Any, Any]],
) -> tuple[list[Any], list[Any]]:
    """Condition on an innovation one component after the other: S = L D Lᵀ on lists of components.

    Only + - * / are used, so the same lines serve arrays, floats, SymPy and recorded programs.
    All lists are updated in place. Afterwards `mean` and `cov` are conditional, ``innovation``
    is L⁻¹ e, and ``innovation_cov[i][j]`` below the diagonal is the entry of L D.

    Parameters
    ----------
    mean : list of n components
        The state; an empty list where only the innovation matters.
    cov : list of n rows, or None
        Entries on and below the diagonal are read and written.
    innovation : list of m components
    cross : list of n rows of m components
        Covariance of the state with the innovation.
    innovation_cov : list of m rows
        S, read and written on and below the diagonal.
    reciprocal : callable
        ``reciprocal(pivot, variance) -> (1 / pivot, pivot)``, or what is to stand for them where
        the pivot is zero beside the variance of the component.

    Returns
    -------
    squares : list of m components
        Their sum is eᵀ S⁻¹ e.
    pivots : list of m components
        Their product is the determinant of S.
    """
    squares, pivots = [], []
    scale = [innovation_cov[j][j] for j in range(len(innovation))]
    for j, e in enumerate(innovation):
        inverse, pivot = reciprocal(innovation_cov[j][j], scale[j])
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
        for i in range(j + 1, len(innovation)):
            factor = innovation_cov[i][j] * inverse
            innovation[i] = innovation[i] - factor * e
            for row in cross:
                row[i] = row[i] - factor * row[j]
            for q in range(j + 1, i + 1):
                innovation_cov[i][q] = innovation_cov[i][q] - factor * innovation_cov[q][j]
    return squares, pivots


class Reciprocals:
    """Reciprocals of the pivots of `eliminate`: zero of a redundant component, NaN of a broken one.

    Attributes
    ----------
    inverses : list
        Those of the pivots so far.
    redundant : dict
        Components that are redundant somewhere: where, and their variances.
    """

    def __init__(self, batched: bool) -> None:
        self.everywhere: Callable[[Any], bool] = np.ndarray.all if batched else bool
        self.inverses: list[Any] = []
        self.redundant: dict[int, tuple[Any, Any]] = {}

    def __call__(self, pivot: Any, variance: Any) -> tuple[Any, Any]:
        # the first pivot is its variance, so no difference of variances has lost its digits
        regular = pivot > (ABSOLUTE if pivot is variance else RELATIVE * variance + ABSOLUTE)
        if self.everywhere(regular):
            inverse = 1.0 / pivot
        else:
            self.redundant[len(self.inverses)] = np.logical_not(regular), variance
            broken = ~(pivot >= -(INDEFINITE * np.abs(variance) + ABSOLUTE))
            pivot = np.where(regular, pivot, 1.0)
            inverse = np.where(broken, np.nan, regular / pivot)
        self.inverses.append(inverse)
        return inverse, pivot


def solve_psd(S: np.ndarray, B: np.ndarray) -> np.ndarray:
    """X with S X = B for positive semidefinite S.

    A component of S that those before it determine, up to 1e-13 of its variance, is left out: its
    row of X is zero. NaN where S is indefinite.

    Parameters
    ----------
    S : ndarray, shape (m, m, *batch)
    B : ndarray, shape (m, k, *batch)

    Returns
    -------
    X : ndarray, shape (m, k, *batch)
    """
    depth = max(S.ndim, B.ndim) - 2
    S, B = align(S, 2, depth), align(B, 2, depth)
    factor = [list(row) for row in S] if depth else S.tolist()
    # Bᵀ S⁻¹ is what unit innovations of covariance S add to a vector with cross-covariance Bᵀ;
    # of few items all columns of B are one component
    width = B.shape[1] if B[0, 0].size <= FEW else 1
    cross = [list(B[:, q : q + width, None]) for q in range(0, B.shape[1], width)]
    units, sums = list(align(np.eye(len(S)), 2, depth)[:, None]), [0.0] * len(cross)
    eliminate(sums, None, units, cross, factor, Reciprocals(depth > 0))
    return np.concatenate(sums).swapaxes(0, 1)


def mahalanobis(error: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Squared Mahalanobis distance eᵀ P⁻¹ e, shape (*batch); redundant components add nothing.

    Parameters
    ----------
    error : ndarray, shape (n, *batch)
    cov : ndarray, shape (n, n, *batch)
        Axes of its batch may have length one.
    """
    rows = [list(np.broadcast_to(row, error.shape)) for row in cov]
    squares, _ = eliminate([], None, list(error), [], rows, Reciprocals(error.ndim > 1))
    return reduce(add, squares)


def whole_is_quicker(batch: tuple[int, ...], n: int) -> bool:
    """Whether matrices (n, n, *batch) are better taken whole than as lists of their components."""
    return batch != () and math.prod(batch) < n * n


def cholesky(P: ArrayLike, scale: np.ndarray | None = None) -> np.ndarray:
    """Lower triangular L with L Lᵀ = P and no negative number on its diagonal.

    It is unique, so what is drawn or integrated along its columns does not depend on the processor.
    A pivot at or below 1e-13 of its variance counts as zero and gives a zero column. Components
    without variance that covary with others, as no covariance allows, get the least variances
    that make P semidefinite: what is known exactly and just begins to be driven through others
    has its covariance with them first, in the stages of a Runge-Kutta step.

    Parameters
    ----------
    P : array_like, shape (n, n, *batch)
    scale : ndarray, shape (n, *batch), optional
        Variances that rounding is judged by, such as those before a correction; by default the
        diagonal.

    Returns
    -------
    L : ndarray, shape (n, n, *batch)
        NaN where P is indefinite: a pivot below -1e-9 of its scale.
    """
    P = np.asarray(P, dtype=float)
    n = len(P)
    L = np.zeros_like(P)
    # lists of components are faster than slices, but for many of them and few items
    if few := whole_is_quicker(P.shape[2:], n):
        rest = P.copy()
    else:
        rest = P.tolist() if P.ndim == 2 else [[P[k, q] for q in range(k + 1)] for k in range(n)]
    for j in range(n):
        pivot, variance = rest[j][j], np.abs(P[j, j])
        regular = pivot > RELATIVE * variance + ABSOLUTE
        if np.all(regular):
            root = np.sqrt(pivot)
            inverse = 1.0 / root
        else:
            if scale is None:
                if (raised := _with_least_variances(P)) is not None:
                    return cholesky(raised, np.abs(variances(raised)))
                scale = np.abs(variances(P))
            broken = ~(pivot >= -INDEFINITE * scale[j])
            root = np.where(broken, np.nan, np.sqrt(np.where(regular, pivot, 0.0)))
            inverse = np.where(broken, np.nan, regular / np.where(regular, root, 1.0))
        L[j, j] = root
        if few:
            below = L[j + 1 :, j]
            np.multiply(rest[j + 1 :, j], inverse, out=below)
            rest[j + 1 :, j + 1 :] -= below[:, None] * below
            continue
        column = [None] * (j + 1) + [rest[k][j] * inverse for k in range(j + 1, n)]
        for k in range(j + 1, n):
            L[k, j] = column[k]
            for q in range(j + 1, k + 1):
                rest[k][q] = rest[k][q] - column[k] * column[q]
    return L


def _with_least_variances(P: np.ndarray) -> np.ndarray | None:
    """The same with Cᵀ R⁻¹ C among components of variance zero; None where nothing covaries.

    C are their covariances with the others, and R is the covariance of those.
    """
    zero = np.abs(variances(P)) <= ABSOLUTE
    cross = np.where(~zero[:, None] & zero, P, 0.0)
    if not np.any(cross):
        return None
    rest = np.where(zero[:, None] | zero, 0.0, P)
    least = np.einsum("ki...,kj...->ij...", cross, solve_psd(rest, cross))
    return np.where(zero[:, None] & zero, least, P)


def without_rounding(cov: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Corrected covariances without what rounding has left of directions that are known exactly.

    Items whose factor meets no zero pivot are returned as they are, and so are those that are
    clearly indefinite.

    Parameters
    ----------
    cov : ndarray, shape (n, n, *batch)
    before : ndarray, shape (n, n, *batch) or (n, n)
        Those before the correction, whose variances rounding is judged by.
    """
    L = cholesky(cov, align(variances(before), 1, cov.ndim - 2))
    zero = (variances(L) == 0).any(axis=0)
    if not zero.any():
        return cov
    return np.where(zero, np.einsum("ij...,kj...->ik...", L, L), cov)


def nearest_psd(P: np.ndarray, squares: np.ndarray | None = None) -> tuple[np.ndarray, int]:
    """Nearest covariances without negative eigenvalues, in units of the deviations.

    An eigenvalue below -1e-12 is raised to 1e-12 and counts; what rounding leaves between that and
    zero becomes zero. Semidefinite covariances are returned as they are, and so is what holds a
    NaN.

    Parameters
    ----------
    P : ndarray, shape (n, n, *batch)
    squares : ndarray, shape (n, *batch), optional
        Squares of the deviations that are the units, by default the diagonal; of a posterior those
        of the prior.

    Returns
    -------
    P : ndarray, shape (n, n, *batch)
    count : int
        Items in which an eigenvalue was raised.
    """
    suspect = ~(variances(cholesky(P)) > 0).all(axis=0)
    suspect &= np.isfinite(P).all(axis=(0, 1))
    if not suspect.any():
        return P, 0
    squares = np.abs(variances(P) if squares is None else squares)
    unit = np.sqrt(squares[:, suspect]).T
    unit = np.where(unit > 0, unit, 1.0)
    unit = unit[:, :, None] * unit[:, None, :]
    items = np.moveaxis(P[:, :, suspect], -1, 0) / unit
    # a function of the matrix, V f(d) Vᵀ: where eigenvalues repeat, the basis V of their space is
    # free, and every one gives the same covariance
    values, vectors = np.linalg.eigh(0.5 * (items + np.swapaxes(items, 1, 2)))
    below = values[:, 0] < -ROUNDING * values[:, -1]
    if not below.any():
        return P, 0
    negative = values < -NEGATIVE
    raised = np.where(negative, NEGATIVE, np.maximum(values, 0.0))
    rebuilt = (vectors * raised[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    rebuilt = np.where(below[:, None, None], rebuilt, items) * unit
    result = P.copy()
    result[:, :, suspect] = np.moveaxis(rebuilt, 0, -1)
    return result, int(np.count_nonzero(negative.any(axis=1)))
