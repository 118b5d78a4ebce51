"""The part of the two-step estimator that is computed before any data, and its online use."""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial, prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_count, as_shape, as_vectors
from seedslib.base.semidefinite import square_root
from seedslib.gaussian.arguments import in_range
from seedslib.gaussian.polynomial import Coefficients, derivative, heat
from seedslib.two_step.kalman_bucy_design import KalmanBucyDesign
from seedslib.two_step.laws import FunctionLaw


@dataclass(frozen=True, eq=False)
class TwoStepTable:
    """Precomputed two-step estimator on a grid; made by `TwoStepEstimator.table`.

    One step online is ``mean = table.update(k, mean, increment)`` and then
    ``table.estimate(k + 1, mean)``.

    Attributes
    ----------
    design : KalmanBucyDesign
        Transitions and gains of the first step.
    move : ndarray
        Transition over the lead, shape (K+1, n, n).
    cov : ndarray
        Covariances of the predicted state, shape (K+1, n, n).
    exponents : ndarray or None
        For a polynomial: exponents of x̂, shape (M, n).
    mean_coefficients, variance_coefficients : ndarray or None
        For a polynomial: shapes (K+1, p, M) and (K+1, p, p, M).
    """

    design: KalmanBucyDesign
    move: np.ndarray
    cov: np.ndarray
    exponents: MaybeArray
    mean_coefficients: MaybeArray
    variance_coefficients: MaybeArray
    _law: FunctionLaw

    @property
    def start(self) -> np.ndarray:
        """Estimate of the state at the first time, shape (n,)."""
        return self.design.start

    def update(self, k: int, mean: ArrayLike, increment: ArrayLike) -> np.ndarray:
        """Estimate of the state at time k + 1 from that at time k.

        Parameters
        ----------
        k : int
            Step, ``0 <= k < K``.
        mean : array_like
            Estimate at time k, shape (n, ...).
        increment : array_like
            Increment of the measurement over the step, shape (m, ...).

        Returns
        -------
        ndarray
            Shape (n, ...).

        Raises
        ------
        TypeError, ValueError
            No such step, wrong shapes, or not finite.
        """
        k = as_count("k", k, 0, len(self.design.gain) - 1)
        gain = self.design.gain[k]
        mean = as_vectors("mean", mean, gain.shape[0])
        increment = as_shape("increment", increment, (gain.shape[1], *mean.shape[1:]))
        return np.tensordot(self.design.transition[k], mean, 1) + np.tensordot(gain, increment, 1)

    def estimate(self, k: int, mean: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Optimal estimate of f and its conditional variance at time k.

        Parameters
        ----------
        k : int
            Time, ``0 <= k <= K``.
        mean : array_like
            Estimate of the state at time k, shape (n, ...).

        Returns
        -------
        estimate, variance : ndarray
            Shapes (...) and (...), or (p, ...) and (p, p, ...) for a vector f.

        Raises
        ------
        TypeError, ValueError
            No such time, wrong shape, or not finite.
        """
        k = as_count("k", k, 0, len(self.cov) - 1)
        mean = as_vectors("mean", mean, self.cov.shape[1])
        mean = np.tensordot(self.move[k], mean, 1)
        if self.exponents is None:
            return self._law.mean(mean, self.cov[k]), self._law.variance(mean, self.cov[k])
        tables = self.mean_coefficients[k], self.variance_coefficients[k]

        def both() -> tuple[np.ndarray, ...]:
            monomials = _monomials(self.exponents, mean)
            return tuple(np.tensordot(table, monomials, 1) for table in tables)

        value, variance = in_range("mean", both)
        return (value[0], variance[0, 0]) if self._law.scalar else (value, variance)


def make_table(
    law: FunctionLaw, design: KalmanBucyDesign, ahead: list[tuple[np.ndarray, np.ndarray]]
) -> TwoStepTable:
    """Table of a law along a designed filter.

    Parameters
    ----------
    law : FunctionLaw
    design : KalmanBucyDesign
    ahead : list of (move, cov)
        For each time the transition over the lead and the covariance at its end.
    """
    move, cov = (np.stack(values) for values in zip(*ahead, strict=True))
    if law.polynomial is None:
        return TwoStepTable(design, move, cov, None, None, None, law)
    size = len(next(iter(law.polynomial.values())))
    means = [heat(law.polynomial, c) for c in cov]
    spreads = [variance_polynomial(g, c) for g, c in zip(means, cov, strict=True)]
    known = sorted({alpha for table in (*means, *spreads) for alpha in table})
    place = {alpha: i for i, alpha in enumerate(known)}
    first = np.zeros((len(cov), size, len(known)))
    second = np.zeros((len(cov), size, size, len(known)))
    for k, (mean, spread) in enumerate(zip(means, spreads, strict=True)):
        for alpha, coefficient in mean.items():
            first[k, :, place[alpha]] = coefficient
        for alpha, coefficient in spread.items():
            second[k, :, :, place[alpha]] = coefficient
    return TwoStepTable(design, move, cov, np.array(known), first, second, law)


def variance_polynomial(mean: Coefficients, cov: np.ndarray) -> dict[Any, Any]:
    """Conditional variance of a polynomial as a polynomial of the estimate.

    With L Lᵀ = P and the derivatives D along the columns of L of the conditional mean g, it is
    the sum of ``D^β g (D^β g)ᵀ / β!`` over the multi-indices β other than zero: no subtraction.

    Parameters
    ----------
    mean : dict
        Coefficients (p,) of g.
    cov : ndarray
        P, shape (n, n).

    Returns
    -------
    dict
        From multi-index to coefficient (p, p).
    """
    n = len(cov)
    factor = square_root(cov)
    total: dict = {}
    level = {(0,) * n: mean}
    while level:
        # Each multi-index is reached once, by raising its last positive entry or a later one.
        raised: dict = {}
        for beta, polynomial in level.items():
            last = max((i for i, b in enumerate(beta) if b), default=0)
            for axis in range(last, n):
                image = _along(polynomial, factor[:, axis])
                if image:
                    raised[(*beta[:axis], beta[axis] + 1, *beta[axis + 1 :])] = image
        for beta, polynomial in raised.items():
            weight = 1.0 / prod(factorial(b) for b in beta)
            for alpha, a in polynomial.items():
                for gamma, c in polynomial.items():
                    key = tuple(i + j for i, j in zip(alpha, gamma, strict=True))
                    total[key] = total.get(key, 0) + weight * np.outer(a, c)
        level = raised
    return total


def _along(polynomial: Coefficients, direction: np.ndarray) -> Coefficients:
    """Derivative of a polynomial along a direction; empty where the direction is zero."""
    image: Coefficients = {}
    for axis in np.flatnonzero(direction):
        for alpha, coefficient in derivative(polynomial, axis).items():
            image[alpha] = image.get(alpha, 0) + direction[axis] * coefficient
    return image


def _monomials(exponents: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Monomials, shape (M, ...), of points (n, ...)."""
    powers = [np.ones_like(point)]
    for _ in range(int(exponents.max(initial=0))):
        powers.append(powers[-1] * point)
    table = np.stack(powers)
    return np.prod([table[e, i] for i, e in enumerate(exponents.T)], axis=0)
