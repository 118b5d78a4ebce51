"""What is known of a state exactly: linear equations that an estimate is made to satisfy."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import align
from seedslib.base.checks import as_real, brief
from seedslib.base.conditioning import kalman_gain, update
from seedslib.base.linalg import RELATIVE, symmetrized, variances

GONE = 1e-20
"""A variance that falls below this fraction of itself is the square of rounding."""


def constrain(
    mean: ArrayLike, cov: ArrayLike, D: ArrayLike, d: ArrayLike
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of a Gaussian state given that D x = d exactly.

    They are m + P Dᵀ (D P Dᵀ)⁺ (d - D m) and P - P Dᵀ (D P Dᵀ)⁺ D P: of all states that satisfy
    the equations the mean is the one nearest to m in the distance that P⁻¹ defines (Simon and Chia
    2002). A measurement of D x without noise says the same. Inequalities are not treated.

    Parameters
    ----------
    mean : array_like, shape (n, *batch)
    cov : array_like, shape (n, n) or (n, n, *batch)
        May be singular: what it knows already is not changed.
    D : array_like, shape (c, n) or (c, n, *batch)
        Rows may be redundant. Axes of runs belong to constraints that were linearized at the
        estimate of each run.
    d : array_like, shape (c,) or (c, *batch)

    Returns
    -------
    mean : ndarray, shape (n, *batch)
    cov : ndarray, shape (n, n, *batch)
        Without batch axes where `cov` and `D` have none, of length one where theirs are fewer.

    Raises
    ------
    TypeError, ValueError
        Shapes that do not fit; what is no number, NaN and infinity included; a `cov` that is not
        positive semidefinite; a `d` that D x cannot be: redundant rows that disagree, or another
        value of what `cov` knows exactly, by more than a millionth of these numbers and a
        hundred-thousandth of the deviations.

    Notes
    -----
    A filter that carries means and covariances goes on from a constrained estimate with
    ``state._replace(mean=mean, cov=cov)``. Its dynamics need not respect the constraint, so it is
    to be applied after every correction. To constrain the estimates of a whole run afterwards,
    move the axis of times to the end:
    ``constrain(np.moveaxis(run.mean, 0, -1), np.moveaxis(run.cov, 0, -1), D, d)``.
    """
    mean = as_real("mean", mean, (None, ...))
    n = len(mean)
    cov, D = as_real("cov", cov, (n, n, ...)), as_real("D", D, (None, n, ...))
    d = as_real("d", d, (len(D), ...))
    parts = {"mean": mean.shape[1:], "cov": cov.shape[2:], "D": D.shape[2:], "d": d.shape[1:]}
    try:
        depth = len(np.broadcast_shapes(*parts.values()))
    except ValueError:
        raise ValueError(f"mean, cov, D, d: wanted axes of the same runs, got {parts}") from None
    mean, d = align(mean, 1, depth), align(d, 1, depth)
    own = depth if max(cov.ndim, D.ndim) > 2 else 0
    cov, D = align(cov, 2, own), align(D, 2, own)

    cross = np.einsum("ij...,cj...->ic...", cov, D)
    of_rows = np.einsum("ci...,ie...->ce...", D, cross)
    # a row that is known has a variance of zero, of which rounding has left something
    deviations = np.einsum("ci...,i...->c...", np.abs(D), np.sqrt(np.abs(variances(cov))))
    known = np.abs(variances(of_rows)) <= RELATIVE * deviations**2
    of_rows = np.where(known | known[:, None], 0.0, of_rows)
    moments = np.einsum("ci...,i...->c...", D, mean), np.where(known, 0.0, cross), of_rows
    # the same gain as in `update`; of (I - K D) P (I - K D)ᵀ no variance is negative
    gain = kalman_gain(moments[1], of_rows)
    rest = align(np.eye(n), 2, own) - np.einsum("ic...,cj...->ij...", gain, D)
    mean, _, loglik = update(mean, None, d, moments, exact=True)
    if np.isnan(loglik).any():
        raise ValueError("cov: wanted positive semidefinite matrices, got others")
    if (loglik == -np.inf).any():
        raise ValueError(
            f"d: wanted values that D x can have, got {brief(d.tolist())}, which contradicts what "
            "`cov` knows exactly or, in redundant rows, itself"
        )
    corrected = np.einsum("ij...,jk...,lk...->il...", rest, cov, rest)
    gone = np.abs(variances(corrected)) <= GONE * np.abs(variances(cov))
    return mean, np.where(gone | gone[:, None], 0.0, symmetrized(corrected))
