"""Coefficients of a system with delays: their checks, its steps, its start and its instants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_covariance, as_real, as_shape, is_whole
from seedslib.models.kinds import as_steps

MOST_DELAY = 10**7
# LAPACK itself: SciPy's doors to it take six times as long for small matrices
_POTRF, _POTRS = get_lapack_funcs(("potrf", "potrs"))

Coefficient = ArrayLike | Callable[[int], ArrayLike]


class CheckedCoefficient(NamedTuple):
    """A checked array (r, c) or (T, r, c), or a function of k that is checked when used."""

    name: str
    value: np.ndarray | Callable[[int], ArrayLike]
    check: Callable[[str, object], np.ndarray]

    @property
    def varies(self) -> bool:
        """Whether it depends on k."""
        return callable(self.value) or self.value.ndim == 3

    def at(self, k: int) -> np.ndarray:
        """The matrix at instant k."""
        if callable(self.value):
            return self.check(f"{self.name} at k = {k}", _matrix(self.value(k)))
        return self.value[k] if self.value.ndim == 3 else self.value


def coefficient(
    name: str, value: Coefficient, check: Callable[..., np.ndarray], *wanted: object
) -> CheckedCoefficient:
    """A coefficient whose matrices pass ``check(label, matrix, *wanted)``."""

    def checked(label: str, matrix: object) -> np.ndarray:
        return check(label, matrix, *wanted)

    if not callable(value):
        array = as_real(name, _matrix(value))
        if array.ndim == 3:
            if len(array) <= name.startswith("sensor"):
                raise ValueError(f"{name}: wanted entries up to k = 1, got shape {array.shape}")
            value = np.stack([checked(f"{name}[{k}]", entry) for k, entry in enumerate(array)])
        else:
            value = checked(name, array)
        value.flags.writeable = False
    return CheckedCoefficient(name, value, checked)


def _matrix(value: object) -> object:
    # what is no array at all (ragged lists too) goes on to the check that names it
    return value if isinstance(value, (list, tuple)) or np.ndim(value) else np.atleast_2d(value)


def as_noise(name: str, value: object, size: int) -> np.ndarray:
    """Covariance that is positive definite and has a Cholesky factor."""
    cov = as_covariance(name, value, size, definite=True)
    try:
        np.linalg.cholesky(cov)
    except np.linalg.LinAlgError:
        raise ValueError(
            f"{name}: wanted a positive definite matrix, got one that is singular to rounding"
        ) from None
    return cov


def require_finite(what: str, k: int, *arrays: np.ndarray) -> None:
    """Refuse numbers that left the range of floating point at instant k."""
    if not all(np.isfinite(array).all() for array in arrays):
        raise ValueError(
            f"system: wanted {what} in the range of numbers, got an overflow at step {k}"
        )


def divided(cross: np.ndarray, cov: np.ndarray, refusal: str) -> np.ndarray:
    """``cross · cov⁻¹`` by Cholesky's factor.

    Raises
    ------
    ValueError
        `refusal`, where `cov` is not positive definite.
    """
    root, failed = _POTRF(cov, lower=1, clean=0)
    if failed:
        raise ValueError(refusal)
    return _POTRS(root, cross.T, lower=1)[0].T


def as_delays(dynamics: object) -> list[int]:
    """Delays of a mapping from delay to matrix, increasing."""
    if not isinstance(dynamics, Mapping):
        raise TypeError(
            f"dynamics: wanted a mapping of delay to matrix, got {type(dynamics).__name__}"
        )
    if not dynamics:
        raise ValueError("dynamics: wanted at least one delay, got none")
    for d in dynamics:
        if not is_whole(d):
            raise TypeError(f"dynamics: wanted integer delays, got {d!r}")
        if d < 0:
            raise ValueError(f"dynamics: wanted delays >= 0, got {d}")
    if max(dynamics) > MOST_DELAY:
        raise ValueError(f"dynamics: wanted delays up to {MOST_DELAY}, got {max(dynamics)}")
    return sorted(int(d) for d in dynamics)


class InstantStep(NamedTuple):
    """What leads from instant k-1 to k and to the measurement of instant k.

    dynamics: the matrix (n, n) of each delay, in increasing order of delay; noise_input (n, q);
    noise_cov (q, q); state_noise = G Q Gᵀ (n, n); sensor (m, n); sensor_cov (m, m).
    """

    dynamics: dict[int, np.ndarray]
    noise_input: np.ndarray
    noise_cov: np.ndarray
    state_noise: np.ndarray
    sensor: np.ndarray
    sensor_cov: np.ndarray

    def block_row(self, size: int) -> np.ndarray:
        """Matrices of the delays side by side, (n, size): x_k from the stack (x_{k-1}, ...)."""
        n = len(self.state_noise)
        row = np.zeros((n, size))
        for d, block in self.dynamics.items():
            row[:, d * n : (d + 1) * n] = block
        return row

    def stacked(self, blocks: int) -> Augmented:
        """Matrices of the step for the stack of `blocks` instants, newest block first."""
        m, n = self.sensor.shape
        size = blocks * n
        transition = np.eye(size, k=-n)
        transition[:n] = self.block_row(size)
        noise, sensor = np.zeros((size, size)), np.zeros((m, size))
        noise[:n, :n], sensor[:, :n] = self.state_noise, self.sensor
        return Augmented(transition, noise, sensor, self.sensor_cov)


class Augmented(NamedTuple):
    """The same step for the stacked state ``(x_k, x_{k-1}, ..., x_{k-N})`` of size D = (N+1)n.

    transition (D, D), noise (D, D), sensor (m, D), sensor_cov (m, m).
    """

    transition: np.ndarray
    noise: np.ndarray
    sensor: np.ndarray
    sensor_cov: np.ndarray


class StartLaw(NamedTuple):
    """Law of ``(x_0, x_{-1}, ..., x_{-N})``: mean ((N+1)n,); cov0 and past as they are stored."""

    mean: np.ndarray
    cov: np.ndarray
    past: MaybeArray


def start_law(mean0: object, cov0: object, history_cov: object, n: int, reach: int) -> StartLaw:
    """Checked law of the start; cov (n, n) with past (N, n, n), or cov of the whole stack."""
    size = (reach + 1) * n
    mean = np.zeros(size)
    if mean0 is not None:
        given = as_real("mean0", np.atleast_1d(as_real("mean0", mean0)), ndim=1)
        if given.size not in (n, size):
            raise ValueError(f"mean0: wanted shape ({n},) or ({size},), got {given.shape}")
        mean[: given.size] = given
    cov = as_covariance("cov0", _matrix(as_real("cov0", cov0)))
    if cov.shape[0] not in (n, size):
        raise ValueError(f"cov0: wanted shape ({n}, {n}) or ({size}, {size}), got {cov.shape}")
    joint = len(cov) > n
    if history_cov is not None and (joint or reach == 0):
        raise ValueError("history_cov: wanted only beside N > 0 and a cov0 of x_0 alone")
    past = None if joint else np.zeros((reach, n, n))
    if history_cov is not None:
        given = as_real("history_cov", _matrix(as_real("history_cov", history_cov)))
        if given.ndim == 2:
            given = np.broadcast_to(given, (reach, *given.shape))
        for j, block in enumerate(as_shape("history_cov", given, (reach, n, n))):
            past[j] = as_covariance(f"history_cov[{j}]", block)
    for array in (mean, cov, past):
        if array is not None:
            array.flags.writeable = False
    return StartLaw(mean, cov, past)


def as_instants(value: object) -> np.ndarray:
    """Instants 0, 1, ..., K, shape (K+1,), from themselves or from the last one.

    Raises
    ------
    TypeError, ValueError
        Other times.
    """
    times = as_steps(value)
    if not np.array_equal(times, np.arange(len(times))):
        raise ValueError(
            f"times: wanted the instants 0, 1, ..., {len(times) - 1} of a system with delays, got "
            f"{times[0]:g}, {times[1]:g}, ..., {times[-1]:g}"
        )
    return times
