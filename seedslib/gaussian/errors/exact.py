"""Exact mean-square errors of the optimal and of the plug-in estimate of a nonlinear function.

Given the measurements, x is N(xhat, P) with an estimate xhat ~ N(mean, C - P). The optimal
estimate of f(x) is ``E[f(x) | xhat]``, the plug-in estimate is ``f(xhat)`` (Choi, Song, Shin 2019,
sections 2.2 and 2.4). Their errors need no simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp

from seedslib.gaussian.arguments import align, gaussian_arguments, in_range
from seedslib.gaussian.errors.functions import MeanSquareErrors
from seedslib.gaussian.errors.hermite import (
    active,
    marginal,
    plugin_excess,
    polynomial_expansion,
)
from seedslib.gaussian.errors.joint import as_joint_law
from seedslib.gaussian.errors.norms import estimate_errors, norm_variance
from seedslib.gaussian.errors.planes import SwitchedMoments
from seedslib.gaussian.errors.replica import ReplicaErrors
from seedslib.gaussian.means.classes import NoClosedForm
from seedslib.gaussian.means.compile import Compiled
from seedslib.gaussian.means.symbolic import FunctionClass, expectation_function


@dataclass(frozen=True, eq=False)
class _ClosedFunction:
    """Class, dimension of the state, whether scalar, coordinates that f depends on, f in those."""

    kind: FunctionClass
    dimension: int
    scalar: bool
    _coordinates: tuple[int, ...]
    _function: Compiled

    @cached_property
    def _switched(self) -> SwitchedMoments:
        return SwitchedMoments(self._function)


class ExactErrors(_ClosedFunction):
    """Callable ``(mean, cov, error_cov) -> (optimal, plugin)``; made by `mean_square_errors`."""

    def __call__(self, mean: object, cov: object, error_cov: object) -> MeanSquareErrors:
        """Errors at one time.

        Parameters
        ----------
        mean, cov : array_like (n,), (n, n)
            Unconditional mean and central covariance C of the state.
        error_cov : array_like (n, n)
            Covariance P of the error of its estimate, P <= C.

        Returns
        -------
        MeanSquareErrors
            ``optimal`` and ``plugin``: numbers for a scalar f, else matrices (p, p).

        Raises
        ------
        TypeError, ValueError
            Bad mean or covariances, ``error_cov exceeds cov``, an infinite mean.
        """
        law = as_joint_law(mean, cov, error_cov, self.dimension)
        optimal, plugin = (np.zeros((self._function.size,) * 2) for _ in range(2))
        if law[2].any():  # else the state is known, and so is f
            law = marginal(self._coordinates, *law)
            optimal, plugin = in_range("mean, cov, error_cov", lambda: tuple(self._route(*law)))
        if self.scalar:
            return MeanSquareErrors(float(optimal[0, 0]), float(plugin[0, 0]))
        return MeanSquareErrors(optimal, plugin)

    @cached_property
    def _route(self) -> Callable:
        if self.kind is FunctionClass.POLYNOMIAL:
            return self._polynomial
        if self.kind is FunctionClass.PIECEWISE:
            return self._switched.errors
        if self.kind is FunctionClass.NORM:
            return self._norm
        return ReplicaErrors(self._function).errors

    def _polynomial(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        polynomial = self._function.polynomial()
        optimal = polynomial_expansion(polynomial, mean, cov, error_cov).lower()
        return optimal, optimal + plugin_excess(polynomial, mean, cov, error_cov)

    def _norm(
        self, mean: np.ndarray, cov: np.ndarray, error_cov: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        (norm,) = self._function.norms
        centre, spread = norm.law(mean, cov)
        scale = norm.coefficient[0] ** 2
        errors = estimate_errors(centre, spread, norm.law(mean, error_cov)[1])
        return tuple(np.full((1, 1), scale * error) for error in errors)


def mean_square_errors(f: object, variables: Sequence[sp.Symbol]) -> ExactErrors:
    """Exact errors of the optimal and of the plug-in estimate of f(x).

    Polynomials by a sum of squares (equations (3.8), (3.9) of Choi, Song, Shin 2019, for any
    degree); exponentials, sines and Gaussian tilts from two correlated copies of the state;
    polynomials with one switching plane by quadrature split at the kink; one norm by a double
    integral. All are deterministic, and none loses digits because P is small beside C, except
    the norm of a vector that may come near zero (absolute error about 1e-15 of its second moment).

    Parameters
    ----------
    f : expression, list or column Matrix of p expressions
        Real function of `variables`.
    variables : sequence of n Symbols
        Components of the state.

    Returns
    -------
    ExactErrors
        Callable ``(mean (n,), cov C (n, n), error_cov P (n, n)) -> (optimal, plugin)``.

    Raises
    ------
    NoClosedForm
        f, or the product f f', is outside the closed class.
    TypeError, ValueError
        As `expectation_function`.
    """
    return ExactErrors(*_closed(f, variables))


def _closed(f: object, variables: Sequence[sp.Symbol]) -> tuple:
    """What a `_ClosedFunction` is made of."""
    size, coordinates, symbols = active(f, variables)
    advice = "; a quadrature rule of the estimator gives numbers"
    try:
        function = expectation_function(f, symbols)
    except NoClosedForm as error:
        raise NoClosedForm(f"{error}{advice}") from None
    if function.kind is FunctionClass.MIXED:
        raise NoClosedForm(
            f"no exact errors for {f}: it mixes switching planes, norms or exponentials{advice}"
        )
    return function.kind, size, function.scalar, coordinates, function.compiled()


class PosteriorVariance(_ClosedFunction):
    """Callable ``(xhat, P) -> V``; made by `posterior_variance_function`."""

    def __call__(self, mean: object, cov: object) -> np.ndarray:
        """Conditional variance of f(x) for x ~ N(mean, cov).

        Parameters
        ----------
        mean : array_like (n, ...)
            Estimates xhat, batch axes last.
        cov : array_like (n, n) or (n, n, ...)
            Error covariance P.

        Returns
        -------
        ndarray (...) for a scalar f, (p, p, ...) for a vector
        """
        mean, cov = gaussian_arguments(mean, cov, self.dimension)
        batch = np.broadcast_shapes(mean.shape[1:], cov.shape[2:])
        mean = np.broadcast_to(align(mean, 1, len(batch)), (self.dimension, *batch))
        if cov.ndim > 2:
            cov = np.broadcast_to(align(cov, 2, len(batch)), (*cov.shape[:2], *batch))
        law = marginal(self._coordinates, mean, cov)
        value = in_range("mean, cov", lambda: self._route(*law))
        return value[0, 0][()] if self.scalar else value

    @cached_property
    def _route(self) -> Callable:
        if self.kind in (FunctionClass.POLYNOMIAL, FunctionClass.PIECEWISE):
            return lambda mean, cov: self._switched.moments(mean, cov)[0]
        if self.kind is FunctionClass.NORM:
            return self._norm
        return ReplicaErrors(self._function).variance

    def _norm(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        (norm,) = self._function.norms
        centre, spread = norm.law(mean, cov)
        return norm.coefficient[0] ** 2 * norm_variance(centre, spread)[None, None]


def posterior_variance_function(f: object, variables: Sequence[sp.Symbol]) -> PosteriorVariance:
    """Conditional variance of f(x) given the estimate: ``V = E[f f' | xhat] - zhat zhat'``.

    Delivered with each estimate it states its accuracy; its mean over xhat is the optimal
    mean-square error. Nothing is lost when P is small, except for norms (absolute error about
    1e-15 of the squared norm).

    Parameters
    ----------
    f : expression, list or column Matrix of p expressions
        Real function of `variables`.
    variables : sequence of n Symbols
        Components of the state.

    Returns
    -------
    PosteriorVariance
        Callable ``(xhat (n, ...), P (n, n) or (n, n, ...)) -> (...)`` or ``(p, p, ...)``.

    Raises
    ------
    NoClosedForm
        f or the product f f' is outside the closed class.
    TypeError, ValueError
        As `expectation_function`.
    """
    return PosteriorVariance(*_closed(f, variables))
