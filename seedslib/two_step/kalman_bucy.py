"""Kalman-Bucy filter: the exact conditional law of a linear diffusion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_covariance, as_real, as_shape, as_times, as_vectors
from seedslib.filters.base import Estimates
from seedslib.models.kinds import as_system
from seedslib.models.propagation import Pair, bounded, distinct_steps, solve, stepped
from seedslib.two_step.kalman_bucy_design import KalmanBucyDesign, LinearMoments, make_design
from seedslib.two_step.linear import LinearDiffusion, PlantMatrices
from seedslib.two_step.riccati import information_rate, riccati_step
from seedslib.two_step.smoothing import smoothed_errors, smoothed_means
from seedslib.two_step.steady import steady_errors, steady_law


@dataclass(frozen=True)
class KalmanBucyFilter:
    """Kalman-Bucy filter of a linear diffusion (Choi, Song, Shin 2019, equation (2.1)).

    Given the measurements up to t the state is Gaussian with mean x̂ and covariance P, and P does
    not depend on the data. Constant coefficients are propagated exactly; coefficients that depend
    on time are integrated with DOP853 at relative tolerance 1e-11.

    Parameters
    ----------
    system : LinearDiffusion
    """

    system: LinearDiffusion

    def __post_init__(self) -> None:
        as_system("system", self.system, "LinearDiffusion")

    def moments(self, times: ArrayLike, lead: float = 0.0) -> LinearMoments:
        """Mean, prior covariance and error covariance on a grid (equations (2.1), (3.10)).

        Parameters
        ----------
        times : array_like
            Increasing nonnegative times, shape (K,). Measurements start at time 0.
        lead : float
            How far ahead of the last measurement the state is predicted: the moments are those
            of x(t + lead) and of its estimate from the measurements up to t.

        Returns
        -------
        LinearMoments

        Raises
        ------
        TypeError, ValueError
            An illegal grid or lead.
        """
        times = as_times("times", times)
        lead = float(as_real("lead", lead, ndim=0))
        if lead < 0:
            raise ValueError(f"lead: wanted a nonnegative time, got {lead:g}")
        known = self._constant_moments(times) if self.system.constant else self._moments(times)
        if lead == 0.0:
            return known
        moved = [self.system.transition(t, t + lead) for t in times]
        move = np.stack([pair[0] for pair in moved])
        noise = np.stack([pair[1] for pair in moved])
        ahead = (move @ c @ move.mT + noise for c in (known.cov, known.error_cov))
        return LinearMoments(np.einsum("kij,kj->ki", move, known.mean), *ahead)

    def predict(self, mean: ArrayLike, cov: ArrayLike, start: float, stop: float) -> Pair:
        """Law of the state at `stop` from its law at `start`, without measurements between.

        Parameters
        ----------
        mean : array_like
            Shape (n, ...), batch axes last.
        cov : array_like
            Shape (n, n).
        start, stop : float

        Returns
        -------
        mean, cov : ndarray
            Shapes (n, ...) and (n, n).

        Raises
        ------
        TypeError, ValueError
            Wrong shapes, or not 0 <= start <= stop.
        """
        mean = as_vectors("mean", mean, self.system.state_size)
        cov = as_covariance("cov", cov, self.system.state_size)
        move, noise = self.system.transition(start, stop)
        return np.tensordot(move, mean, 1), move @ cov @ move.T + noise

    def steady_error_cov(self) -> np.ndarray:
        """Steady error covariance P of constant coefficients, shape (n, n).

        The stabilising solution of the algebraic Riccati equation: the limit from a positive
        definite start, and from any start where noise reaches every unstable mode.

        Raises
        ------
        ValueError
            Coefficients that depend on time; (F, H) not detectable; an undamped mode that no
            noise reaches, whose error dies out too slowly for a stabilising solution; or an
            equation too ill-conditioned to be solved.
        """
        return steady_errors(self._steady_matrices("steady_error_cov"))

    def steady_moments(self, components: ArrayLike | None = None) -> LinearMoments:
        """Steady mean (zero), prior covariance and error covariance, arrays (1, ...).

        Parameters
        ----------
        components : array_like of bool, shape (n,), optional
            Which components are wanted, all by default. Where the state has no steady law, only
            they and what moves them have moments; the others are zero, and may grow.

        Raises
        ------
        ValueError
            As `steady_error_cov`; also when the drift of the wanted components is not Hurwitz, so
            that their covariance has no limit.
        """
        return LinearMoments(*steady_law(self._steady_matrices("steady_moments"), components))

    def run(self, times: ArrayLike, increments: ArrayLike) -> Estimates:
        """Estimates along measured paths.

        Over a step of length h the measured increment Δy is taken as the constant rate Δy/h; for
        that rate, and coefficients frozen at the middle of the step, the estimate is exact. The
        error of the discretisation is of first order in h along a path.

        Parameters
        ----------
        times : array_like
            Grid, shape (K+1,). The measurement begins at its first time.
        increments : array_like
            Increments of the measurement over the steps, shape (K, m, ...), batch axes last. NaN
            marks a component that was not measured over a step, in all paths of the batch alike.

        Returns
        -------
        Estimates
            mean (K+1, n, ...), and cov (K+1, n, n): the error covariance of these measurements.

        Raises
        ------
        TypeError, ValueError
            Illegal arrays; gaps that differ between paths; a step longer than the time constant
            of the filter, over which the increments do not carry what the covariance promises.
        """
        mean, design, _, batch = self._filtered(times, increments)
        return Estimates(mean.reshape(*mean.shape[:2], *batch), design.cov)

    def smooth(
        self, times: ArrayLike, increments: ArrayLike, *, lag: int | None = None
    ) -> Estimates:
        """Estimates from what was measured later as well; arguments, discretisation as `run`.

        Parameters
        ----------
        times, increments : array_like
        lag : int, optional
            Use the increments of so many later steps only; all of them by default.

        Returns
        -------
        Estimates
        """
        mean, design, flat, batch = self._filtered(times, increments)
        seen = self._seen(flat)
        found, cov = smoothed_means(self.system, design, mean, np.nan_to_num(flat), seen, lag)
        return Estimates(found.reshape(*mean.shape[:2], *batch), cov)

    def smoothed_moments(self, times: ArrayLike, *, lag: int | None = None) -> LinearMoments:
        """As `moments`, of the estimate at each time from measurements up to a later one.

        Parameters
        ----------
        times : array_like
        lag : int, optional
            Measured until so many times later, or the last one; to the last by default.
        """
        known = self.moments(times)
        later = smoothed_errors(self.system, as_times("times", times), known.error_cov, lag)
        return known._replace(error_cov=later)

    def _filtered(self, times, increments):
        """Means (K+1, n, paths), design, increments (K, m, paths) and the axes of the paths."""
        times = as_times("times", times)
        increments = as_real("increments", increments, nan=True)
        wanted = (times.size - 1, self.system.measurement_size, *increments.shape[2:])
        increments = as_shape("increments", increments, wanted, nan=True)
        flat = increments.reshape(*wanted[:2], math.prod(wanted[2:]))
        design = self.design(times, self._seen(flat))
        mean = np.empty((times.size, self.system.state_size, flat.shape[2]))
        mean[0] = design.start[:, None]
        for k, step in enumerate(np.nan_to_num(flat)):
            mean[k + 1] = design.transition[k] @ mean[k] + design.gain[k] @ step
        return mean, design, flat, wanted[2:]

    def design(self, times: ArrayLike, seen: ArrayLike | None = None) -> KalmanBucyDesign:
        """Everything that does not depend on the data: ``x̂ <- transition x̂ + gain Δy``.

        Parameters
        ----------
        times : array_like
            Grid, shape (K+1,). The measurement begins at its first time.
        seen : array_like of bool, optional
            Which components are measured over each step, shape (K, m); all by default.

        Returns
        -------
        KalmanBucyDesign

        Raises
        ------
        TypeError, ValueError
            As `run`.
        """
        return make_design(self.system, as_times("times", times), seen)

    def _seen(self, increments: np.ndarray) -> np.ndarray:
        missing = np.isnan(increments)
        some = missing.any(axis=2)
        partly = some & ~missing.all(axis=2)
        if partly.any():
            k, i = np.argwhere(partly)[0]
            raise ValueError(
                f"increments: wanted gaps (NaN) common to all paths of a batch, got component {i} "
                f"of step {k} missing in some paths only; run those paths by themselves"
            )
        return ~some

    def _steady_matrices(self, verb: str) -> PlantMatrices:
        if not self.system.constant:
            raise ValueError(f"{verb}: wanted constant coefficients, got functions of time")
        return self.system.matrices(0.0)

    def _constant_moments(self, times: np.ndarray) -> LinearMoments:
        system = self.system
        known = system.matrices(0.0)
        information = information_rate(known, np.ones(system.measurement_size, bool))
        grid = times if times[0] == 0 else np.concatenate([[0.0], times])
        lengths, index = distinct_steps(grid)
        moves = [stepped(known.drift, known.diffusion, h) for h in lengths]
        riccati = [riccati_step(known.drift, information, known.diffusion, h) for h in lengths]
        mean = np.empty((grid.size, system.state_size))
        cov, error_cov = np.empty((2, grid.size, system.state_size, system.state_size))
        mean[0], cov[0], error_cov[0] = system.mean0, system.cov0, system.cov0
        with np.errstate(over="ignore", invalid="ignore"):
            for k, j in enumerate(index):
                move, noise = moves[j]
                mean[k + 1] = move @ mean[k]
                cov[k + 1] = move @ cov[k] @ move.T + noise
                error_cov[k + 1] = riccati[j].apply(error_cov[k])
        bounded(grid[-1], mean, cov, error_cov)
        skipped = grid.size - times.size
        return LinearMoments(mean[skipped:], cov[skipped:], error_cov[skipped:])

    def _moments(self, times: np.ndarray) -> LinearMoments:
        system, n = self.system, self.system.state_size
        full = np.ones(system.measurement_size, bool)

        def slope(t: float, y: np.ndarray) -> np.ndarray:
            known = system.matrices(t)
            mean, (cov, error_cov) = y[:n], y[n:].reshape(2, n, n)
            gained = error_cov @ information_rate(known, full) @ error_cov
            free = [known.drift @ c + c @ known.drift.T for c in (cov, error_cov)]
            rates = np.stack([free[0], free[1] - gained]) + known.diffusion
            return np.concatenate([known.drift @ mean, rates.ravel()])

        start = np.concatenate([system.mean0, system.cov0.ravel(), system.cov0.ravel()])
        late = times[-1] > 0.0
        values = solve(slope, 0.0, times[-1], start, times) if late else start[:, None]
        covs = values[n:].T.reshape(-1, 2, n, n)
        covs = 0.5 * (covs + covs.mT)
        return LinearMoments(values[:n].T.copy(), covs[:, 0], covs[:, 1])
