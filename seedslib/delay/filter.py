"""Optimal filter of a linear system with state delays, computed without its augmented matrices.

The gains do not depend on the data, so a covariance recursion runs once and the means of any
number of paths follow. Four recursions give the same gains: `structured` (the default), `array`
(square roots, for ill-conditioned problems), `chandrasekhar` (fast, for constant coefficients)
and `augmented` (the dense Kalman filter of the stacked state, as a reference).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from seedslib.base.blocks import as_count
from seedslib.base.checks import as_real
from seedslib.delay import (
    array as _delay_array,
)
from seedslib.delay import (
    chandrasekhar as _delay_chandrasekhar,
)
from seedslib.delay import (
    dense as _delay_dense,
)
from seedslib.delay import (
    structured as _delay_structured,
)
from seedslib.delay.gains import DelayGains, advanced, empty_gains
from seedslib.delay.means import (
    as_flags,
    as_lag,
    as_records,
    filter_records,
    log_density,
    move_mean,
    patterns,
)
from seedslib.delay.structure import StructureGains
from seedslib.delay.system import DelaySystem
from seedslib.filters.estimates import Estimates

RECURSIONS: dict[str, ModuleType] = {
    "structured": _delay_structured,
    "array": _delay_array,
    "chandrasekhar": _delay_chandrasekhar,
    "augmented": _delay_dense,
}
BLOCK = 8192


class DelayState(NamedTuple):
    """The filter after instant k.

    mean (N+1, n, *batch): block s is the estimate of x_{k-s} from the measurements up to k; cov
    (n, n): covariance of its block 0; loglik (*batch): log density of the last measurement;
    recursion: the covariance recursion's own state.
    """

    k: int
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray
    recursion: object


@dataclass(frozen=True, eq=False)
class DelayKalmanFilter:
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
    _memo: dict = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.system, DelaySystem):
            raise TypeError(f"system: wanted a DelaySystem, got {type(self.system).__name__}")
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
            missing = as_flags(missing, (steps + 1, self.system.m))
            missing = None if not missing[1:].any() else missing
        if missing is None:
            return self._complete_gains(steps)
        return self._tabulate(steps, missing)

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
        past = np.zeros((steps + 1, system.max_delay, system.n, system.m))
        for k in range(2, steps + 1):
            for d, a in zip(system.delays, system.step(k).dynamics, strict=True):
                for j in range(1, min(d, k - 1) + 1):
                    past[k, j - 1] += a @ table.gain[k - j, d + 1 - j]
        return StructureGains(table.gain[:, 0], past, corrected=True)

    def initial(self, batch: tuple[int, ...] = ()) -> DelayState:
        """The filter at k = 0, before any measurement; `batch` axes stand for paths.

        Raises
        ------
        TypeError, ValueError
            `batch` is not a tuple of positive integers.
        """
        if not isinstance(batch, tuple):
            raise TypeError(f"batch: wanted a tuple of whole numbers, got {batch!r}")
        batch = tuple(as_count("batch", size) for size in batch)
        system = self.system
        mean = system.mean0.reshape(-1, system.n, *(1,) * len(batch))
        mean = np.broadcast_to(mean, (*mean.shape[:2], *batch)).copy()
        cov = system.cov0[: system.n, : system.n]
        recursion = RECURSIONS[self.method].start(system)
        return DelayState(0, mean, cov, np.zeros(batch), recursion)

    def step(self, state: DelayState, y: ArrayLike) -> DelayState:
        """Predict to the next instant and correct by its measurement.

        Parameters
        ----------
        state : DelayState
            Left as it is.
        y : array_like, shape (m, *batch)
            NaN marks a missing component, which must be missing in the whole batch.

        Returns
        -------
        DelayState

        Raises
        ------
        TypeError, ValueError
            A wrong shape, an infinite value, components missing in some paths only (`run` takes
            those), or the fast recursion broke down (`run` then changes over).
        """
        system, batch = self.system, state.mean.shape[2:]
        y = as_real("y", y, nan=True)
        if y.shape != (system.m, *batch):
            raise ValueError(f"y: wanted shape {(system.m, *batch)}, got {y.shape}")
        flat = np.isnan(y).reshape(system.m, -1)
        missing = flat.all(axis=1)
        if (flat != missing[:, None]).any():
            raise ValueError("y: wanted the same missing components in all paths of a batch")
        engine, before = RECURSIONS[self.method], state.recursion.copy()
        recursion, now = advanced(engine, system, before, missing, state.k + 1)
        blocks = len(state.mean)
        slots = np.arange(blocks)
        ring = state.mean.reshape(*state.mean.shape[:2], -1)[(state.k - slots) % blocks]
        error = move_mean(system, state.k + 1, ring, now, y.reshape(system.m, -1))
        mean = ring[(state.k + 1 - slots) % blocks].reshape(state.mean.shape)
        loglik = log_density(error, now.innovation_cov, missing).reshape(batch)
        return DelayState(state.k + 1, mean, now.cov, loglik, recursion)

    def run(self, measurements: ArrayLike, *, lag: int = 0) -> Estimates:
        """Filter (or smooth with a fixed lag) whole records.

        Parameters
        ----------
        measurements : array_like, shape (K+1, m, *batch)
            Entry k is y_k; entry 0 is NaN, nothing being measured at k = 0. NaN elsewhere marks
            a missing component, which is left out exactly.
        lag : int
            Estimate x_k from the measurements up to ``min(k + lag, K)``, 0 <= lag <= N.

        Returns
        -------
        Estimates
            mean (K+1, n, *batch); cov (K+1, n, n), or (K+1, n, n, *batch) when the missing
            components differ from path to path; loglik (K+1, *batch), which does not depend on
            the lag.

        Raises
        ------
        TypeError, ValueError
            A wrong shape, an infinite value, a measurement at k = 0, an illegal lag.

        Notes
        -----
        Paths are grouped by their pattern of missing components: the covariance recursion runs
        once for each pattern that occurs. Complete records share one table, which is kept for
        the next call.
        """
        lag = as_lag(lag, self.system.max_delay)
        y, batch = as_records(measurements, self.system.m)
        mean = np.empty((len(y), self.system.n, y.shape[2]))
        loglik = np.empty((len(y), y.shape[2]))
        groups = list(patterns(np.isnan(y)))
        covs = []
        for missing, members in groups:
            table = self.gains(len(y) - 1, missing)
            for part in np.array_split(members, -(-len(members) // BLOCK)):
                mean[..., part], loglik[..., part] = filter_records(
                    self.system, table, y[..., part], lag
                )[:2]
            covs.append(table.lagged_cov(lag))
        cov = covs[0]
        if len(groups) > 1:
            cov = np.empty((*cov.shape, y.shape[2]))
            for (_, members), one in zip(groups, covs, strict=True):
                cov[..., members] = one[..., None]
            cov = cov.reshape(*cov.shape[:3], *batch)
        return Estimates(
            mean.reshape(*mean.shape[:2], *batch), cov, loglik=loglik.reshape(len(y), *batch)
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
        y, batch = as_records(measurements, self.system.m)
        errors, squares = np.empty(y.shape), np.empty((len(y), y.shape[2]))
        for missing, members in patterns(np.isnan(y)):
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
            known = self._memo["complete"] = self._tabulate(steps, None)
            for array in known[:-1]:
                array.flags.writeable = False
        return DelayGains(*(array[: steps + 1] for array in known[:-1]), known.method)

    def _tabulate(self, steps: int, missing: np.ndarray | None) -> DelayGains:
        try:
            return _table(self.system, steps, missing, self.method, self.method)
        except _delay_chandrasekhar.BreakdownError as why:
            return _table(self.system, steps, missing, "structured", f"structured, because {why}")


def _table(
    system: DelaySystem, steps: int, missing: np.ndarray | None, recursion: str, label: str
) -> DelayGains:
    engine = RECURSIONS[recursion]
    n = system.n
    table = empty_gains(steps, system.max_delay + 1, system.cov0[:n, :n], system.m, label)
    state = engine.start(system)
    for k in range(1, steps + 1):
        state, now = advanced(engine, system, state, None if missing is None else missing[k], k)
        table.gain[k], table.innovation_cov[k], table.predicted[k], table.cov[k] = now
    return table
