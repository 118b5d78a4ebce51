"""Two-step estimator: the Kalman-Bucy filter, then the exact mean of a function of the state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_real, as_times, as_vectors
from seedslib.gaussian.arguments import gaussian_arguments, in_range
from seedslib.gaussian.functions import MeanSquareErrors
from seedslib.gaussian.quadrature import Rule
from seedslib.two_step.kalman_bucy import KalmanBucyFilter
from seedslib.two_step.kalman_bucy_design import LinearMoments
from seedslib.two_step.laws import (
    TwoStepPaths,
    along,
    checked_symbols,
    closed_law,
    quadrature_law,
    used_symbols,
    with_estimate,
)
from seedslib.two_step.linear import LinearDiffusion
from seedslib.two_step.table import TwoStepTable, make_table


@dataclass(frozen=True, eq=False)
class TwoStepEstimator:
    """Optimal mean-square estimator of a nonlinear function of a linear-Gaussian state.

    Step one is the Kalman-Bucy filter, which gives the law N(x̂, P) of the state; step two is the
    mean of the function under that law (Choi, Song, Shin 2019, equations (2.1) to (2.4)).

    Parameters
    ----------
    system : LinearDiffusion
        With n components of state.
    f : SymPy expression, list or column Matrix of expressions, or callable
        The function of the state. A callable takes points (n, N), returns (N,) or (p, N), and
        needs `quadrature`.
    variables : sequence of n Symbols
        The state in f, in the order of its components.
    estimate_variables : sequence of n Symbols, optional
        Where f depends on the estimate x̂ as well, its symbols: ``f(x, x̂)``, for instance the
        length of the estimation error.
    quadrature : Rule, optional
        Use this rule instead of closed forms (see `seedslib.gaussian.quadrature`). Means,
        variances and errors are then approximate.
    lead : float
        Estimate f at time t + lead from the measurements up to t.

    Attributes
    ----------
    filter : KalmanBucyFilter
        The first step.

    Raises
    ------
    NoClosedForm
        The function has no closed form and no quadrature was asked for.
    TypeError, ValueError
        Unknown symbols in f, not n variables, or a rule for another dimension.
    """

    system: LinearDiffusion
    f: Any
    variables: Sequence[Any] | None = field(default=None, kw_only=True)
    estimate_variables: Sequence[Any] | None = field(default=None, kw_only=True)
    quadrature: Rule | None = field(default=None, kw_only=True)
    lead: float = field(default=0.0, kw_only=True)
    filter: KalmanBucyFilter = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "filter", KalmanBucyFilter(self.system))
        lead = float(as_real("lead", self.lead, ndim=0))
        if lead < 0:
            raise ValueError(f"lead: wanted a nonnegative time, got {lead:g}")
        object.__setattr__(self, "lead", lead)
        groups = {"variables": self.variables}
        if self.estimate_variables is not None:
            groups["estimate_variables"] = self.estimate_variables
        n = self.system.state_size
        symbols = checked_symbols(self.f, groups, n, self.quadrature)
        if not isinstance(self.quadrature, Rule | None):
            got = type(self.quadrature).__name__
            raise TypeError(
                f"quadrature: wanted a Rule, for instance gauss_hermite(n, 20), got {got}"
            )
        if self.quadrature is not None:
            size = n * (1 if self.estimate_variables is None else 2)
            if len(self.quadrature.points) != size:
                raise ValueError(
                    f"quadrature: wanted a rule in {size} dimensions, "
                    f"got one in {len(self.quadrature.points)}"
                )
            law = quadrature_law(self.f, symbols, self.quadrature)
        else:
            law = closed_law(self.f, symbols)
        law = law if self.estimate_variables is None else with_estimate(law)
        object.__setattr__(self, "_law", law)
        object.__setattr__(self, "_used", used_symbols(self.f, symbols, n))

    @property
    def kind(self) -> str:
        """Class of functions whose formulas are used; ``quadrature`` if asked for."""
        return self._law.kind

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
        return self._law.mean(*self._checked(mean, cov))

    def variance(self, mean: ArrayLike, cov: ArrayLike) -> np.ndarray:
        """Conditional variance of f under N(mean, cov), (...) or (p, p, ...).

        Arguments and errors as `estimate`.
        """
        return self._law.variance(*self._checked(mean, cov))

    def plugin(self, mean: ArrayLike) -> np.ndarray:
        """Plug-in estimate: f at the estimate of the state.

        Parameters
        ----------
        mean : array_like
            Shape (n, ...).

        Returns
        -------
        ndarray
            Shape (...) or (p, ...).

        Raises
        ------
        TypeError, ValueError
            Wrong shape, or not finite.
        """
        mean = as_vectors("mean", mean, self.system.state_size)
        return in_range("mean", lambda: self._law.plugin(mean))

    def errors(self, times: ArrayLike) -> MeanSquareErrors:
        """Exact mean-square errors of the optimal and the plug-in estimate on a grid.

        Parameters
        ----------
        times : array_like
            Increasing nonnegative times, shape (K,).

        Returns
        -------
        MeanSquareErrors
            Each (K,), or (K, p, p) for a vector f.

        Raises
        ------
        TypeError, ValueError
            An illegal grid, or an infinite mean.
        """
        return self._errors(self.filter.moments(times, self.lead))

    def mse_optimal(self, times: ArrayLike) -> np.ndarray:
        """Exact mean-square error of the optimal estimate; see `errors`."""
        return self.errors(times).optimal

    def mse_plugin(self, times: ArrayLike) -> np.ndarray:
        """Exact mean-square error of the plug-in estimate; see `errors`."""
        return self.errors(times).plugin

    def steady_errors(self) -> MeanSquareErrors:
        """Steady mean-square errors: numbers, or matrices (p, p).

        Components that the function neither uses nor depends on need no steady law.

        Raises
        ------
        ValueError
            No steady state: see `KalmanBucyFilter.steady_moments`.
        """
        steady = self.filter.steady_moments(self._used)
        if self.lead:
            ahead = self._ahead(steady.error_cov[0], 0.0)[1]
            there = steady.cov[0].diagonal() != 0.0  # the others have no steady law
            ahead = np.where(there & there[:, None], ahead, 0.0)
            steady = LinearMoments(*steady[:2], ahead[None])
        optimal, plugin = self._errors(steady)
        return MeanSquareErrors(optimal[0], plugin[0])

    def run(self, times: ArrayLike, increments: ArrayLike) -> TwoStepPaths:
        """Estimates along measured paths.

        Parameters
        ----------
        times, increments : array_like
            As `KalmanBucyFilter.run`: (K+1,) and (K, m, ...), NaN where nothing was measured.

        Returns
        -------
        TwoStepPaths

        Raises
        ------
        TypeError, ValueError
            As `KalmanBucyFilter.run`.
        """
        times = as_times("times", times)
        paths = self.filter.run(times, increments)
        mean, cov = np.moveaxis(paths.mean, 0, 1), np.moveaxis(paths.cov, 0, -1)
        if self.lead:
            moved = [self._ahead(c, t) for c, t in zip(paths.cov, times, strict=True)]
            mean = np.einsum("kij,jk...->ik...", np.stack([m for m, _ in moved]), mean)
            cov = np.stack([c for _, c in moved], axis=-1)
        return along(self._law, mean, cov)

    def smooth(
        self, times: ArrayLike, increments: ArrayLike, *, lag: int | None = None
    ) -> TwoStepPaths:
        """Estimates from later measurements as well; see `KalmanBucyFilter.smooth`."""
        self._want_no_lead()
        paths = self.filter.smooth(times, increments, lag=lag)
        return along(self._law, np.moveaxis(paths.mean, 0, 1), np.moveaxis(paths.cov, 0, -1))

    def smoothed_errors(self, times: ArrayLike, *, lag: int | None = None) -> MeanSquareErrors:
        """Exact errors of both smoothed estimates; see `KalmanBucyFilter.smoothed_moments`."""
        self._want_no_lead()
        return self._errors(self.filter.smoothed_moments(times, lag=lag))

    def table(self, times: ArrayLike) -> TwoStepTable:
        """Everything that can be computed before the data, for use online (section 2.5).

        Parameters
        ----------
        times : array_like
            Grid, shape (K+1,).

        Returns
        -------
        TwoStepTable
            For a polynomial f its estimate and variance are polynomials of x̂ whose coefficients
            are tabulated; for other functions the covariances are.

        Raises
        ------
        TypeError, ValueError
            As `KalmanBucyFilter.design`.
        """
        design = self.filter.design(times)
        moved = [self._ahead(c, t) for c, t in zip(design.cov, design.times, strict=True)]
        return make_table(self._law, design, moved)

    def _ahead(self, cov: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Transition over the lead from time t, and the covariance at its end."""
        move, noise = self.system.transition(t, t + self.lead)
        return move, move @ cov @ move.T + noise

    def _want_no_lead(self) -> None:
        if self.lead:
            raise ValueError(f"lead: wanted 0 of a smoothed estimate, got {self.lead:g}")

    def _errors(self, moments: LinearMoments) -> MeanSquareErrors:
        pairs = [self._law.errors(*law) for law in zip(*moments, strict=True)]
        return MeanSquareErrors(*(np.stack(values) for values in zip(*pairs, strict=True)))

    def _checked(self, mean: ArrayLike, cov: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        return gaussian_arguments(as_vectors("mean", mean, self.system.state_size), cov)
