"""The moments of a Gaussian law over a region: one result type for every region."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_real
from seedslib.gaussian.arguments import align


@dataclass(frozen=True, eq=False)
class RegionMoments:
    """Mass of a Gaussian law in a region, and mean and covariance of the law conditioned on it.

    The conditional form neither underflows nor cancels; the integrals of Kolessa's formula (1)
    are derived from it. Scalar case (`interval`): all three arrays have the batch shape.
    Vector case: components first, batch axes last. Where the mass is zero, `log_mass` is
    ``-inf``, `mean` and `cov` are NaN, and `first` and `second` are zero.

    Parameters
    ----------
    log_mass : ndarray, shape (...)
        ``ln P``, the logarithm of the probability of the region.
    mean : ndarray, shape (...) or (k, ...)
        Mean of the conditioned law.
    cov : ndarray, shape (...) or (k, k, ...)
        Variance or covariance of the conditioned law.
    about : float or ndarray
        Reference point of `second`, broadcastable to `mean`.
    """

    log_mass: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    about: float | np.ndarray = 0.0

    @property
    def mass(self) -> np.ndarray:
        """The integral P of formula (1), shape (...); zero below about ``exp(-745)``."""
        return np.exp(self.log_mass)

    @property
    def first(self) -> np.ndarray:
        """The integral S of ``x`` times the density, formula (1), shaped as `mean`."""
        return np.where(self.log_mass > -np.inf, self.mass * self.mean, 0.0)

    @property
    def second(self) -> np.ndarray:
        """The integral Q of ``(x - about)(x - about)'`` times the density, shaped as `cov`."""
        shift = self.mean - self.about
        square = shift * shift if self.scalar else shift[:, None] * shift[None, :]
        return np.where(self.log_mass > -np.inf, self.mass * (self.cov + square), 0.0)

    @property
    def scalar(self) -> bool:
        """Whether the region is one-dimensional and the arrays carry no component axes."""
        return self.mean.ndim == self.log_mass.ndim

    def referred_to(self, about: ArrayLike) -> RegionMoments:
        """The same moments with `second` taken about another reference point.

        Parameters
        ----------
        about : float or array_like
            Scalar case: broadcastable to `mean`. Vector case: shape (k, ...), the batch axes
            broadcastable to those of `mean`.

        Raises
        ------
        TypeError, ValueError
            Not real, not finite, or a shape that does not fit.
        """
        point = as_real("about", about)
        if not self.scalar and point.ndim:
            point = align(point, 1, self.log_mass.ndim)
        if not self.scalar and point.shape[:1] != self.mean.shape[:1]:
            raise ValueError(f"about: wanted shape ({len(self.mean)}, ...), got {np.shape(about)}")
        try:
            np.broadcast_to(point, self.mean.shape)
        except ValueError as error:
            raise ValueError(
                f"about: wanted a shape that fits means of shape {self.mean.shape}, "
                f"got {np.shape(about)}"
            ) from error
        return replace(self, about=point)
