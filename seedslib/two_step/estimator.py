"""Two-step estimator: the Kalman-Bucy filter, then the exact mean of a function of the state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_real
from seedslib.gaussian import (
    expectation_function,
    mean_square_errors,
    posterior_variance_function,
)
from seedslib.gaussian.arguments import in_range
from seedslib.two_step.linear import LinearDiffusion, LinearMoments, kalman_bucy


class TwoStepPaths(NamedTuple):
    """Along measured paths: optimal estimates, their conditional variances, plug-in estimates.

    Shapes (K+1, ...) for a scalar function; (K+1, p, ...) and (K+1, p, p, ...) for a vector.
    """

    mean: np.ndarray
    variance: np.ndarray
    plugin: np.ndarray


@dataclass(frozen=True, eq=False)
class TwoStepEstimator:
    """Optimal mean-square estimator of a nonlinear function of a linear-Gaussian state.

    Step one is the Kalman-Bucy filter, which gives the distribution N(x̂, P) of the state; step two
    is the mean of the function under that distribution (Choi, Song, Shin 2019, equations (2.1) to
    (2.4)).

    Parameters
    ----------
    system : LinearDiffusion
        With n components of state.
    f : SymPy expression, list or column Matrix of expressions
        The function of the state.
    variables : sequence of n Symbols
        The state in f, in the order of its components.
    estimate_variables : sequence of n Symbols, optional
        Where f depends on the estimate x̂ as well, its symbols: ``f(x, x̂)``, for instance the
        length of the estimation error.

    Raises
    ------
    NoClosedForm
        The function has no closed form.
    TypeError, ValueError
        Unknown symbols in f, or not n variables.
    """

    system: LinearDiffusion
    f: Any
    variables: Sequence[Any]
    estimate_variables: Sequence[Any] | None = None

    def __post_init__(self) -> None:
        n = self.system.state_size
        for name in ("variables", "estimate_variables"):
            symbols = getattr(self, name)
            if symbols is not None and len(symbols) != n:
                raise ValueError(f"{name}: wanted {n} symbols, got {len(symbols)}")
        symbols = (*self.variables, *(self.estimate_variables or ()))
        vars(self).update(
            _mean=expectation_function(self.f, symbols),
            _variance=posterior_variance_function(self.f, symbols),
            _errors=mean_square_errors(self.f, symbols),
        )

    def estimate(self, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
        """Optimal estimate: the mean of f under N(mean, cov).

        Parameters
        ----------
        mean : array_like
            Estimate x̂ of the state, shape (n, ...), batch axes last.
        cov : array_like
            Error covariance P, shape (n, n) or (n, n, ...).

        Returns
        -------
        ndarray
            Shape (...) for a scalar f, (p, ...) for a vector.

        Raises
        ------
        TypeError, ValueError
            Wrong shapes, not finite, not a covariance, or an infinite mean of f.
        """
        return self._mean(*self._joint_dist(mean, cov))

    def variance(self, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
        """Conditional variance of f under N(mean, cov), (...) or (p, p, ...).

        Arguments and errors as `estimate`.
        """
        return self._variance(*self._joint_dist(mean, cov))

    def plugin(self, mean: ArrayLike) -> np.ndarray:
        """Plug-in estimate: f at the estimate of the state, (n, ...) to (...) or (p, ...)."""
        n = self.system.state_size
        point, _ = self._joint_dist(mean, np.zeros((n, n)))
        value = in_range("mean", lambda: self._mean.compiled.value(point))
        return value[0] if self._mean.scalar else value

    def errors(self, times: ArrayLike) -> Any:
        """Exact mean-square errors of the optimal and the plug-in estimate on a grid.

        Parameters
        ----------
        times : array_like
            Increasing nonnegative times, shape (K,).

        Returns
        -------
        MeanSquareErrors
            optimal, plugin: each (K,), or (K, p, p) for a vector f.

        Raises
        ------
        TypeError, ValueError
            An illegal grid, or an infinite mean.
        """
        return self._errors_of(self.system.moments(times))

    def steady_errors(self) -> Any:
        """Steady mean-square errors, optimal and plugin: numbers, or matrices (p, p).

        Raises
        ------
        ValueError
            No steady state: see `LinearDiffusion.steady_moments`.
        """
        errors = self._errors_of(self.system.steady_moments())
        return errors._make(part[0] for part in errors)

    def run(self, times: ArrayLike, increments: ArrayLike) -> TwoStepPaths:
        """Estimates along measured paths; arguments and errors as `kalman_bucy`."""
        first = kalman_bucy(self.system, times, increments)
        mean, cov = np.moveaxis(first.mean, 0, 1), np.moveaxis(first.cov, 0, 2)
        # time is the first batch axis of both: the others of the paths follow
        cov = cov.reshape(*cov.shape, *(1,) * (mean.ndim + 1 - cov.ndim))
        values = self.estimate(mean, cov), self.variance(mean, cov), self.plugin(mean)
        return TwoStepPaths(*(np.moveaxis(v, v.ndim + 1 - mean.ndim, 0) for v in values))

    def _joint_dist(self, mean: ArrayLike, cov: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Distribution of what f takes: given the measurements the estimate is a constant ((2.3),
        (2.4)).
        """
        mean = as_real("mean", mean, (self.system.state_size, ...))
        cov = np.asarray(cov, dtype=float)
        if self.estimate_variables is None:
            return mean, cov
        n = len(mean)
        corner = np.zeros((2 * n, 2 * n, *cov.shape[2:]))
        corner[:n, :n] = cov
        return np.concatenate([mean, mean]), corner

    def _errors_of(self, moments: LinearMoments) -> Any:
        pairs = []
        for mean, cov, error_cov in zip(*moments, strict=True):
            if self.estimate_variables is not None:
                estimate_cov = cov - error_cov
                cov = np.block([[cov, estimate_cov], [estimate_cov, estimate_cov]])
            mean, error_cov = self._joint_dist(mean, error_cov)
            pairs.append(self._errors(mean, cov, error_cov))
        return pairs[0]._make(map(np.stack, zip(*pairs, strict=True)))
