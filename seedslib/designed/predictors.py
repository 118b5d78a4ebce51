"""How a finite-order filter forecasts the state from its memory; `design` fits it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np

from seedslib.base.checks import as_count
from seedslib.base.linalg import symmetric

CLIP = 3.5
"""Standardised memory components are cut to this range before they are raised to powers."""

FLOOR = 0.05
"""Smallest eigenvalue of a conditional covariance, in units of the mean one."""


@dataclass(frozen=True)
class Affine:
    """Forecast affine in the memory, with a constant covariance: (6.2), (6.3)."""


@dataclass(frozen=True)
class Polynomial:
    """Forecast by polynomials in the standardised, clipped memory; not in the paper.

    The mean is a least-squares polynomial of total degree `mean_degree` with cross terms, the
    covariance a least-squares polynomial of degree `cov_degree` fitted to the products of the
    residuals. Measured in the mean residual covariance, its eigenvalues are not let below 0.05.
    Forecasts between measurements stay affine.

    Parameters
    ----------
    mean_degree : int
        At least 1.
    cov_degree : int
        At least 0 (a constant covariance).

    Raises
    ------
    TypeError, ValueError
        Degrees that are not whole numbers, or too small.
    """

    mean_degree: int = 3
    cov_degree: int = 2

    def __post_init__(self) -> None:
        for name, least in (("mean_degree", 1), ("cov_degree", 0)):
            object.__setattr__(self, name, as_count(name, getattr(self, name), least))


@dataclass(frozen=True)
class Continuous:
    """Small order with a continuous forecast (FMP): between measurements the estimate moves.

    dZ/dt = E b(t, X) for X normal with the mean Gamma_t Z + kappa_t and the covariance T_t that
    are fitted at every integration step; b is the mean velocity, jumps included. Euler's method
    at the step of the simulation. Wants `Memory(1)`.
    """


class AffineFit(NamedTuple):
    """Forecast affine in the memory: mean = gain u + offset, with a constant covariance.

    Attributes
    ----------
    gain : ndarray, shape (n, d)
        Gamma of the paper, (6.3).
    offset : ndarray, shape (n,)
        kappa.
    cov : ndarray, shape (n, n)
        T, the covariance of what the memory does not explain.
    """

    gain: np.ndarray
    offset: np.ndarray
    cov: np.ndarray

    def mean(self, u: np.ndarray) -> np.ndarray:
        """Forecast (n, *batch) from the memory (d, *batch)."""
        return affine(self.gain, self.offset, u)

    def forecast(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forecast (n, *batch) and its covariance (n, n)."""
        return self.mean(u), self.cov


def affine(gain: np.ndarray, offset: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Gain times u plus offset for u of shape (d, *batch)."""
    product = gain @ u if u.ndim < 3 else np.tensordot(gain, u, 1)
    return product + offset.reshape(-1, *(1,) * (u.ndim - 1))


class PolynomialFit(NamedTuple):
    """A fitted `Polynomial`.

    Attributes
    ----------
    centre, scale : ndarray, shape (d,)
        The memory is standardised as (u - centre) scale and clipped to 3.5.
    gain, offset : ndarray, shapes (n, monomials) and (n,)
        Mean of the state.
    residual : ndarray, shape (n, n)
        Mean of the conditional covariance.
    cov_gain, cov_offset : ndarray
        Entries of the covariance on and below the diagonal, row by row.
    mean_degree, cov_degree : int
    """

    centre: np.ndarray
    scale: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    residual: np.ndarray
    cov_gain: np.ndarray
    cov_offset: np.ndarray
    mean_degree: int
    cov_degree: int

    @property
    def cov(self) -> np.ndarray:
        """Mean of the conditional covariance, as that of an `AffineFit`."""
        return self.residual

    def mean(self, u: np.ndarray) -> np.ndarray:
        """Forecast (n, *batch) from the memory (d, *batch)."""
        point = standardised(u.reshape(len(u), -1), self.centre, self.scale)
        flat = affine(self.gain, self.offset, monomials(point, self.mean_degree))
        return flat.reshape(-1, *u.shape[1:])

    def forecast(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forecast (n, *batch) and its covariance (n, n, *batch) from the memory (d, *batch).

        The covariance has no batch axes where `cov_degree` is zero.
        """
        flat = u.reshape(len(u), -1)
        point = standardised(flat, self.centre, self.scale)
        powers = monomials(point, max(self.mean_degree, self.cov_degree))
        mean = affine(self.gain, self.offset, powers[: self.gain.shape[1]])
        mean = mean.reshape(-1, *u.shape[1:])
        if self.cov_degree == 0:
            return mean, self.residual
        lower = affine(self.cov_gain, self.cov_offset, powers[: self.cov_gain.shape[1]])
        cov = bounded_below(symmetric(lower, len(self.residual)), self.residual)
        return mean, cov.reshape(*cov.shape[:2], *u.shape[1:])


def standardised(u: np.ndarray, centre: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Memory (d, N) centred, scaled and clipped."""
    return np.clip((u - centre[:, None]) * scale[:, None], -CLIP, CLIP)


@lru_cache(maxsize=64)
def monomial_recipe(size: int, degree: int) -> tuple[tuple[int, int | None], ...]:
    """For each monomial of degree 1 to `degree` its factor and the monomial it multiplies.

    Lower degrees come first, so the monomials of a lower degree are the first ones.
    """
    index: dict[tuple[int, ...], int] = {}
    recipe = []
    for total in range(1, degree + 1):
        for powers in combinations_with_replacement(range(size), total):
            index[powers] = len(recipe)
            recipe.append((powers[-1], index.get(powers[:-1])))
    return tuple(recipe)


def monomials(point: np.ndarray, degree: int) -> np.ndarray:
    """All products of up to `degree` components of (d, N), without the constant: (P, N)."""
    recipe = monomial_recipe(len(point), degree)
    result = np.empty((len(recipe), point.shape[1]))
    for k, (factor, lower) in enumerate(recipe):
        if lower is None:
            result[k] = point[factor]
        else:
            np.multiply(point[factor], result[lower], out=result[k])
    return result


def bounded_below(cov: np.ndarray, mean_cov: np.ndarray) -> np.ndarray:
    """Covariances (n, n, N) with eigenvalues, relative to their mean one, of at least 0.05.

    L Π(L⁻¹ T L⁻ᵀ) Lᵀ with L Lᵀ the mean covariance and Π the cut of eigenvalues from below. A
    singular mean covariance is met on its range.
    """
    root, back = range_roots(mean_cov)
    relative = np.einsum("ia,ijN,jb->Nab", back, cov, back, optimize=True)
    # a function of the matrix, A f(d) Aᵀ: the same for every basis A of its eigenvectors
    inner, axes = np.linalg.eigh(relative)
    factor = np.einsum("ia,Nab->Nib", root, axes) * np.sqrt(np.maximum(inner, FLOOR))[:, None, :]
    return np.moveaxis(factor @ np.swapaxes(factor, 1, 2), 0, -1)


def range_roots(mean_cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """L and L⁻ᵀ, (n, rank), on the range of a covariance L Lᵀ."""
    # another basis turns L and L⁻ᵀ by one rotation, which `bounded_below` undoes
    values, vectors = np.linalg.eigh(mean_cov)
    positive = values > 1e-13 * max(values[-1], 0.0)
    lengths = np.sqrt(values[positive])
    return vectors[:, positive] * lengths, vectors[:, positive] / lengths


Fit = AffineFit | PolynomialFit
