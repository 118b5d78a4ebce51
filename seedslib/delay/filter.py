"""Optimal filter of a linear system with state delays, computed without its augmented matrices.

The gains do not depend on the data, so a covariance recursion runs once and the means of any
number of paths follow. Four recursions give the same gains: `structured` (the default), `array`
(square roots, for ill-conditioned problems), `chandrasekhar` (fast, for constant coefficients)
and `augmented` (the dense Kalman filter of the stacked state, as a reference).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from seedslib.base.blocks import BLOCK, in_blocks
from seedslib.base.checks import as_count, as_real
from seedslib.delay.coefficients import as_instants, require_finite
from seedslib.delay.gains import DelayGains, advanced
from seedslib.delay.means import (
    as_flags,
    as_records,
    filter_records,
    log_density,
    patterns_of_gaps,
    predicted_mean,
    start_mean,
)
from seedslib.delay.recursions import RECURSIONS, DelayState, gains_up_to
from seedslib.delay.structure import StructureGains
from seedslib.delay.system import DelaySystem
from seedslib.filters.base import Estimates, Filter, stays
from seedslib.models.kinds import as_system


@dataclass(frozen=True, eq=False)
class DelayKalmanFilter(Filter):
    """Minimum-variance filter and fixed-lag smoother of a `DelaySystem`.

    The estimates are conditional means for Gaussian noises and the best linear ones otherwise.
    This is the filter that the paper's construction becomes when each innovation is taken
    against the corrected prediction, and the same as the Kalman filter of the stacked state.

    Parameters
    ----------
    system : DelaySystem
    method : {"structured", "array", "chandrasekhar", "augmented"}
        Covariance recursion. Cost of a step for a state of n components and largest delay N:
        n²N²m, n³N³, n²Nm and n³N³. `chandrasekhar` asks for constant coefficients and an
        independent history of one covariance. It keeps nine digits relative to the innovation
        covariance, or goes over to `structured`, as it does where a measurement is missing.

    Raises
    ------
    TypeError, ValueError
        Not a `DelaySystem`, an unknown method, or a system that the method cannot treat.
    """

    system: DelaySystem
    method: str = "structured"
    _memo: dict[Any, Any] = field(default_factory=dict, init=False, repr=False)
    _shown = ("method",)

    def __post_init__(self) -> None:
        as_system("system", self.system, "DelaySystem")
        if not isinstance(self.method, str) or self.method not in RECURSIONS:
            raise ValueError(f"method: wanted one of {list(RECURSIONS)}, got {self.method!r}")
        RECURSIONS[self.method].start(self.system)

    def gains(self, steps: int, missing: ArrayLike | None = None) -> DelayGains:
        """Gains and covariances up to instant K = `steps`.

        Parameters
        ----------
        steps : int
        missing : array_like of bool, optional
            Which components are missing, shape (K+1, m); row 0 is not looked at.

        Returns
        -------
        DelayGains

        Raises
        ------
        TypeError, ValueError
            An illegal argument, or an innovation covariance that is not positive definite.
        """
        steps = as_count("steps", steps)
        if missing is not None:
            missing = as_flags(missing, (steps + 1, self.system.measurement_size))
            missing = None if not missing[1:].any() else missing
        if missing is None:
            return self._complete_gains(steps)
        return gains_up_to(self.system, self.method, steps, missing)

    def innovation_gains(self, steps: int) -> StructureGains:
        """Gains of the innovations form (R1), with all measurements present.

        ``x̄_k = sum_d A_d x̂_{k-1-d} + sum_j L_{k,j} e_{k-j}``, ``e_k = y_k - C x̄_k``,
        ``x̂_k = x̄_k + K_k e_k``, where by (R2) ``L_{k,j} = sum_{d>=j} A_d K_{k-j}^{[d+1-j]}``.

        Returns
        -------
        StructureGains
            With `corrected` True; gain (K+1, n, m), past (K+1, N, n, m).

        Raises
        ------
        TypeError, ValueError
            As `gains`.
        """
        table, system = self.gains(steps), self.system
        past = np.zeros((steps + 1, system.max_delay, system.state_size, system.measurement_size))
        for k in range(2, steps + 1):
            for d, a in system.step(k).dynamics.items():
                for j in range(1, min(d, k - 1) + 1):
                    past[k, j - 1] += a @ table.gain[k - j, d + 1 - j]
        return StructureGains(table.gain[:, 0], past, corrected=True)

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> DelayState:
        """The filter at k = 0, before any measurement; `batch` axes stand for paths.

        Raises
        ------
        TypeError, ValueError
            `batch` is not a tuple of positive integers.
        """
        system, mean = self.system, start_mean(self.system, batch)
        cov = system.cov0[: system.state_size, : system.state_size]
        recursion = RECURSIONS[self.method].start(system)
        return DelayState(0.0, mean, cov, np.zeros(mean.shape[2:]), recursion)

    def predict(self, state: DelayState, t: float) -> DelayState:
        """Forecast to instant t; at instants between nothing is measured.

        Raises
        ------
        ValueError
            A time before that of the state or between instants; the fast recursion broke down
            (`run` then changes over).
        """
        if not stays(state, t) and t != int(t):
            raise ValueError(f"t: wanted an instant, a whole number, got {t:g}")
        engine, system = RECURSIONS[self.method], self.system
        for k in range(int(state.time) + 1, int(t) + 1):
            before = state.recursion
            if state.ahead is not None:  # the instant that is left was not measured
                lost = np.ones(system.measurement_size, dtype=bool)
                before, _ = advanced(engine, system, before.copy(), lost, k - 1)
            ahead = advanced(engine, system, before.copy(), None, k)
            mean, nothing = predicted_mean(system, k, state.mean), np.zeros(state.loglik.shape)
            state = DelayState(float(k), mean, ahead[1].predicted, nothing, before, ahead)
        return state

    def correct(self, state: DelayState, y: ArrayLike) -> DelayState:
        """Correct a forecast by the measurement of its instant.

        Parameters
        ----------
        state : DelayState
            Left as it is.
        y : array_like, shape (m, *batch)
            NaN marks a missing component, which must be missing in the whole batch; at k = 0
            nothing is measured.

        Raises
        ------
        TypeError, ValueError
            A state after a correction, a wrong shape, an infinite value, a measurement at k = 0,
            components missing in some paths only (`run` takes those), or the fast recursion
            broke down (`run` then changes over).
        """
        system, batch, k = self.system, state.mean.shape[2:], int(state.time)
        y = as_real("y", y, nan=True)
        if y.shape != (system.measurement_size, *batch):
            raise ValueError(f"y: wanted shape {(system.measurement_size, *batch)}, got {y.shape}")
        flat = y.reshape(len(y), -1)
        missing = np.isnan(flat).all(axis=1)
        if (np.isnan(flat) != missing[:, None]).any():
            raise ValueError("y: wanted the same missing components in all paths of a batch")
        if k == 0 and missing.all():
            return state
        if state.ahead is None:
            raise ValueError("state: wanted a forecast, got a state without; call predict first")
        recursion, now = state.ahead
        if missing.any():
            engine = RECURSIONS[self.method]
            recursion, now = advanced(engine, system, state.recursion.copy(), missing, k)
        with np.errstate(over="ignore", invalid="ignore"):
            error = y - np.tensordot(system.step(k).sensor, state.mean[0], 1)
            error[missing] = 0.0
            mean = state.mean + np.tensordot(now.gain, error, 1)
        require_finite("estimates", k, mean[0], error)
        loglik = log_density(error.reshape(flat.shape), now.innovation_cov, missing).reshape(batch)
        return DelayState(state.time, mean, now.cov, loglik, recursion)

    def report(self, state: DelayState) -> Estimates:
        """Mean and covariance of x_k, block 0."""
        return Estimates(state.mean[0], state.cov, None, state.loglik)

    def run(
        self, times: ArrayLike, measurements: ArrayLike, *, lag: int = 0, workers: int = 1
    ) -> Estimates:
        """Filter (or smooth with a fixed lag) whole records.

        Parameters
        ----------
        times : int or array_like
            Last instant K, or the instants 0, 1, ..., K, shape (K+1,).
        measurements : array_like, shape (K+1, m, *batch)
            Entry k is y_k; entry 0 is NaN, nothing being measured at k = 0. NaN elsewhere marks
            a missing component, which is left out exactly.
        lag : int
            Estimate x_k from the measurements up to ``min(k + lag, K)``, 0 <= lag <= N.
        workers : int
            Threads over blocks of paths; the numbers do not depend on it.

        Returns
        -------
        Estimates
            mean (K+1, n, *batch); cov (K+1, n, n), or (K+1, n, n, *batch) when the missing
            components differ from path to path; loglik (K+1, *batch), which does not depend on
            the lag.

        Raises
        ------
        TypeError, ValueError
            Other times, a wrong shape, an infinite value, a measurement at k = 0, an illegal lag.

        Notes
        -----
        Paths are grouped by their pattern of missing components: the covariance recursion runs
        once for each pattern that occurs. Complete records share one table, which is kept for
        the next call.
        """
        lag, count = as_count("lag", lag, 0, self.system.max_delay), len(as_instants(times))
        y, batch = as_records(measurements, self.system.measurement_size, count)
        mean = np.empty((count, self.system.state_size, y.shape[2]))
        loglik = np.empty((count, y.shape[2]))
        groups, jobs, covs = list(patterns_of_gaps(np.isnan(y))), [], []
        for missing, members in groups:
            table = self.gains(count - 1, missing)
            pieces = np.array_split(members, -(-len(members) // BLOCK))
            jobs += [(table, part) for part in pieces]
            covs.append(table.lagged_cov(lag))

        def work(first: int, last: int, _: object) -> None:
            for table, part in jobs[first:last]:
                mean[..., part], loglik[..., part] = filter_records(
                    self.system, table, y[..., part], lag
                )[:2]

        in_blocks(work, len(jobs), 0, workers=workers, block=1)
        cov = covs[0]
        if len(groups) > 1:
            cov = np.empty((*cov.shape, y.shape[2]))
            for (_, members), one in zip(groups, covs, strict=True):
                cov[..., members] = one[..., None]
            cov = cov.reshape(*cov.shape[:3], *batch)
        return Estimates(
            mean.reshape(*mean.shape[:2], *batch), cov, loglik=loglik.reshape(count, *batch)
        )

    def innovations(self, measurements: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Innovations e_k, shape (K+1, m, *batch), and eᵀ S⁻¹ e, shape (K+1, *batch).

        Both are zero where nothing was measured. The second has mean m at each instant when the
        model is right.

        Raises
        ------
        TypeError, ValueError
            As `run`.
        """
        y, batch = as_records(measurements, self.system.measurement_size)
        errors, squares = np.empty(y.shape), np.empty((len(y), y.shape[2]))
        for missing, members in patterns_of_gaps(np.isnan(y)):
            table = self.gains(len(y) - 1, missing)
            _, _, error = filter_records(self.system, table, y[..., members], 0)
            errors[..., members] = error
            for k, e in enumerate(error):
                low = np.linalg.cholesky(table.innovation_cov[k])
                squares[k, members] = (solve_triangular(low, e, lower=True) ** 2).sum(axis=0)
        return errors.reshape(*y.shape[:2], *batch), squares.reshape(len(y), *batch)

    def _complete_gains(self, steps: int) -> DelayGains:
        known = self._memo.get("complete")
        if known is None or len(known.cov) <= steps:
            known = self._memo["complete"] = gains_up_to(self.system, self.method, steps, None)
            for array in known[:-1]:
                array.flags.writeable = False
        return DelayGains(*(array[: steps + 1] for array in known[:-1]), known.method)
