"""The filter of the paper exactly as printed, equations (5)-(29): a museum piece.

It is not optimal, and the matrix it computes as the covariance of its error is not that
covariance. Nothing is repaired here. For estimation use `DelayKalmanFilter`; for the true error
covariance of these gains use `seedslib.delay.error_covariance`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_count, as_shape
from seedslib.base.clock import when
from seedslib.delay.analysis import apply_gains
from seedslib.delay.coefficients import as_instants, divided, require_finite
from seedslib.delay.means import predicted_mean, start_mean
from seedslib.delay.structure import StructureGains
from seedslib.delay.system import DelaySystem
from seedslib.filters.base import Estimates, Filter, stays
from seedslib.models.kinds import as_system


class PrintedGains(NamedTuple):
    """Result of the printed recursion.

    gains: K_k and L_{k,j} of (20) and (21), for structure (6); claimed (K+1, n, n): the matrix
    P_k of (22); expanded (K+1, n, n): the same quadratic form written out, (12).
    """

    gains: StructureGains
    claimed: np.ndarray
    expanded: np.ndarray


class PrintedState(NamedTuple):
    """The filter at instant k = `time`.

    mean (N+1, n, *batch): block s is the estimate of x_{k-s}; cov (n, n): the matrix that the
    paper calls its covariance; innovations (N, m, *batch): ν_k or, of a forecast, ν_{k-1} first.
    """

    time: float
    mean: np.ndarray
    cov: np.ndarray
    innovations: np.ndarray
    corrected: bool


@dataclass(frozen=True, eq=False)
class PrintedDelayFilter(Filter):
    """Literal filter (5)-(29) for ``x_k = A x_{k-1} + Ā x_{k-1-N} + G w_{k-1}``.

    Where the paper is silent: a measurement of an instant k <= 0 does not exist and its term is
    absent; lags that the start values (25), (28) do not give are zero (they never enter).

    Parameters
    ----------
    system : DelaySystem
        With no delay but 0 and N, and a history that is independent from instant to instant with
        mean zero, as (2) supposes.

    Raises
    ------
    TypeError, ValueError
        Not a `DelaySystem`, other delays, or another history.
    """

    system: DelaySystem
    _memo: dict[Any, Any] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        system = as_system("system", self.system, "DelaySystem")
        reach, n = system.max_delay, system.state_size
        if not set(system.delays) <= {0, reach}:
            raise ValueError(f"system: wanted the delays 0 and {reach} only, got {system.delays}")
        if system.start_blocks() is None or system.mean0[n:].any():
            raise ValueError("system: wanted an independent history of mean zero, see (2)")

    def gains(self, steps: int) -> PrintedGains:
        """Gains and the claimed matrix up to instant K = `steps`.

        Raises
        ------
        TypeError, ValueError
            `steps` is not a positive integer or beyond the horizon; the printed recursion meets
            an indefinite innovation matrix.
        """
        steps, system = as_count("steps", steps), self.system
        reach, n, m = system.max_delay, system.state_size, system.measurement_size
        gain, past = np.zeros((steps + 1, n, m)), np.zeros((steps + 1, reach, n, m))
        claimed, expanded = np.empty((2, steps + 1, n, n))
        claimed[0] = expanded[0] = system.cov0[:n, :n]
        for k, now in enumerate(self._instants(steps), start=1):
            gain[k], past[k, : len(now.past)] = now.gain, now.past
            claimed[k], expanded[k] = now.claimed, now.expanded
        return PrintedGains(StructureGains(gain, past), claimed, expanded)

    def _instants(self, steps: int) -> list[_Instant]:
        """Instants 1 to `steps` of the printed recursion, which are kept for the next call."""
        system, reach = self.system, self.system.max_delay
        known, lags = self._memo.get("known") or ([], _start_lags(system))
        for k in range(len(known) + 1, steps + 1):
            before = [known[k - 1 - j].own for j in range(1, min(reach, k - 1) + 1)]
            with np.errstate(over="ignore", invalid="ignore"):
                now = _instant([_coefficients(system, k), *before], reach, lags)
            require_finite("the printed matrices", k, now.gain, now.claimed, now.lags)
            known, lags = [*known, now._replace(lags=None)], now.lags
        self._memo["known"] = known, lags
        return known[:steps]

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> PrintedState:
        """The filter at k = 0, before any measurement; see `Filter`.

        Raises
        ------
        TypeError, ValueError
            `batch` is not a tuple of positive integers.
        """
        n, mean = self.system.state_size, start_mean(self.system, batch)
        none = np.zeros((0, self.system.measurement_size, *mean.shape[2:]))
        return PrintedState(0.0, mean, self.system.cov0[:n, :n], none, True)

    def predict(self, state: PrintedState, t: float) -> PrintedState:
        """Prediction x̂'_k of the next instant, with the matrix (9) as its covariance.

        Raises
        ------
        ValueError
            Another time, or a state that was not corrected: every instant is measured.
        """
        if stays(state, t):
            return state
        if t != state.time + 1 or not state.corrected:
            raise ValueError(
                f"t: wanted the instant after a measured one, as the filter needs them all; got "
                f"{when(t)} after {when(state.time)}"
            )
        mean = predicted_mean(self.system, int(t), state.mean)
        cov = self._instants(int(t))[-1].predicted
        return PrintedState(float(t), mean, cov, state.innovations, False)

    def correct(self, state: PrintedState, y: ArrayLike) -> PrintedState:
        """Correct a prediction by y, (m, *batch), and by the innovations before it, (5) and (6).

        At k = 0 nothing is measured, and y is NaN.

        Raises
        ------
        TypeError, ValueError
            A wrong shape, a missing or infinite value, a measurement at k = 0, a state after a
            correction.
        """
        wanted = self.system.measurement_size, *state.mean.shape[2:]
        k, y = int(state.time), as_shape("y", y, wanted, nan=state.time == 0)
        if k == 0 and np.isnan(y).all():
            return state
        if state.corrected:
            raise ValueError("state: wanted a forecast, got a state without; call predict first")
        now, mean = self._instants(k)[-1], state.mean[0]
        new = y - np.tensordot(self.system.step(k).sensor, mean, 1)
        for gain, old in zip(now.past, state.innovations, strict=True):
            mean = mean + np.tensordot(gain, old, 1)
        mean = mean + np.tensordot(now.gain, new, 1)
        require_finite("estimates", k, mean, new)
        kept = np.concatenate([new[None], state.innovations])[: self.system.max_delay]
        mean = np.concatenate([mean[None], state.mean[1:]])
        return PrintedState(state.time, mean, now.claimed, kept, True)

    def report(self, state: PrintedState) -> Estimates:
        """Mean of x_k, and the matrix that the paper takes for the covariance of its error."""
        return Estimates(state.mean[0], state.cov)

    def run(self, times: ArrayLike, measurements: ArrayLike) -> Estimates:
        """Estimates by (5) and (6), with the matrices P_k of (22) as their covariances.

        Parameters
        ----------
        times : int or array_like
            Last instant K, or the instants 0, 1, ..., K, shape (K+1,).
        measurements : array_like, shape (K+1, m, *batch)
            Entry 0 is NaN; nothing else may be missing.

        Raises
        ------
        TypeError, ValueError
            Other times; as `gains` and `apply_gains`.
        """
        printed = self.gains(len(as_instants(times)) - 1)
        return Estimates(apply_gains(self.system, printed.gains, measurements), printed.claimed)


class _Matrices(NamedTuple):
    # A, Ā, G Q Gᵀ at k-1; C, R at k
    near: np.ndarray
    far: np.ndarray
    noise: np.ndarray
    sensor: np.ndarray
    sensor_cov: np.ndarray


class _Instant(NamedTuple):
    own: _Matrices
    predicted: np.ndarray
    gain: np.ndarray
    past: np.ndarray
    claimed: np.ndarray
    expanded: np.ndarray
    lags: MaybeArray


def _coefficients(system: DelaySystem, k: int) -> _Matrices:
    # with N = 0 there is one matrix only, and it counts as A
    step, zero = system.step(k), np.zeros((system.state_size, system.state_size))
    far = step.dynamics[system.max_delay] if system.max_delay else zero
    near = step.dynamics.get(0, zero)
    return _Matrices(near, far, step.state_noise, step.sensor, step.sensor_cov)


def _start_lags(system: DelaySystem) -> np.ndarray:
    """(23), (25), (28): P_{0,j,i} = X_j δ_ij, an array (2N+1, 2N+1, n, n)."""
    reach, n = system.max_delay, system.state_size
    lags = np.zeros((2 * reach + 1, 2 * reach + 1, n, n))
    same = np.arange(reach + 1)
    lags[same, same] = system.start_blocks()
    return lags


def _instant(recent: list[_Matrices], reach: int, lags: np.ndarray) -> _Instant:
    """(9)-(11), then (21), (20), (22), (24), (26), (27), (29); the newest matrices first."""
    used = len(recent) - 1
    near, far, noise, sensor, sensor_cov = (np.stack(entry) for entry in zip(*recent, strict=True))
    # half[j] = A_{k-1-j} P_{j,·} + Ā_{k-1-j} P_{N+j,·}, the left factor of (9)-(11) and (24)
    top, bottom = lags[: used + 1], lags[reach : reach + used + 1]
    half = near[:, None] @ top + far[:, None] @ bottom
    right = half[:, : used + 1] @ near.swapaxes(1, 2)
    right = right + half[:, reach : reach + used + 1] @ far.swapaxes(1, 2)
    same = np.arange(used + 1)
    right[same, same] += noise  # (9), (10), (11): P'_{k,j,i} = right[j, i]

    inner = sensor @ right[same, same] @ sensor.swapaxes(1, 2) + sensor_cov
    cross = right[0] @ sensor.swapaxes(1, 2)  # P'_{k,j} C_{k-j}^T
    past = np.zeros_like(cross[1:])
    for j in range(used):
        past[j] = _over(cross[j + 1], inner[j + 1])  # (21)
    told = (cross[1:] @ past.swapaxes(1, 2)).sum(axis=0)
    left = right[0, 0] - told.T
    gain = _over(left @ sensor[0].T, inner[0])  # (20)
    keep = np.eye(len(gain)) - gain @ sensor[0]

    seen = past @ sensor[1:]  # L_{k,j} C_{k-j}
    doubled = seen[:, None] @ right[1:, 1:] @ seen.swapaxes(1, 2)
    apart = ~np.eye(used, dtype=bool)
    claimed = keep @ (right[0, 0] - told) + doubled[apart].sum(axis=0)  # (22)
    mixed = keep @ told
    expanded = keep @ right[0, 0] @ keep.T + gain @ sensor_cov[0] @ gain.T - mixed - mixed.T  # (12)
    expanded += (past @ sensor_cov[1:] @ past.swapaxes(1, 2)).sum(axis=0)
    expanded += doubled.sum(axis=(0, 1))

    moved = np.zeros_like(lags)
    moved[1:, 1:] = lags[:-1, :-1]  # (27)
    row = keep @ half[0] - (seen[:, None] @ half[1:]).sum(axis=0)
    moved[0, 1:] = row[:-1]  # (24)
    moved[1:, 0] = row[:-1].swapaxes(1, 2)
    moved[0, 0] = claimed  # (29)
    return _Instant(recent[0], right[0, 0], gain, past, claimed, expanded, moved)


def _over(cross: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """``cross · inner⁻¹`` by Cholesky, the factors S of (13), (14)."""
    return divided(
        cross, inner, "the printed recursion met an innovation matrix that is not positive definite"
    )
