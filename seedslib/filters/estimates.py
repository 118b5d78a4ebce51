"""What filters take and return: estimates, records of measurements, times of states."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_real, as_whole
from seedslib.base.clock import when
from seedslib.models.kinds import AnySystem, in_even_steps, require_even, switches


class Estimates(NamedTuple):
    """Estimates on a grid of times; what a filter does not give is None.

    Attributes
    ----------
    mean : ndarray, shape (K+1, n, *batch)
        Estimated state after each measurement.
    cov : ndarray, shape (K+1, n, n) or (K+1, n, n, *batch), or None
        Covariance of the error that the filter itself claims.
    mode_prob : ndarray, shape (K+1, L, *batch), or None
        Posterior probabilities of the modes.
    loglik : ndarray, shape (K+1, *batch), or None
        Logarithm of the predictive density of each measurement; the sum over time is the
        log-likelihood of the record.
    diverged : ndarray of bool, shape (*batch), or None
        Which paths left the region that the filter was told to believe, or became NaN.
    modes : ndarray of int, shape (K+1, *batch), or None
        Decided modes of a switching system, numbered from 0.
    """

    mean: np.ndarray
    cov: MaybeArray = None
    mode_prob: MaybeArray = None
    loglik: MaybeArray = None
    diverged: MaybeArray = None
    modes: MaybeArray = None

    def interval(self, level: float = 0.95) -> np.ndarray:
        """Intervals of this probability for each component, shape (2, K+1, n, *batch).

        Of a single estimate or forecast, mean (n,), shape (2, n). They are those of a Gaussian
        law with the mean and the variance that the filter claims.

        Raises
        ------
        ValueError
            A level that is not between 0 and 1, a filter that claims no covariance.
        """
        from scipy.special import ndtri

        if not 0 < level < 1:
            raise ValueError(f"level: wanted a number between 0 and 1, got {level}")
        if self.cov is None:
            raise ValueError("interval: wanted covariances, which this filter does not claim")
        width = ndtri(0.5 + 0.5 * level) * np.sqrt(self._variances())
        return np.stack([self.mean - width, self.mean + width])

    def _variances(self) -> np.ndarray:
        """Shape (K+1, n, *batch), or (K+1, n, 1, ...) where they are common to all records."""
        if self.mean.ndim == 1:  # of one time
            return np.diagonal(self.cov)
        variances = np.einsum("kii...->ki...", self.cov)
        return variances.reshape(*variances.shape, *(1,) * (self.mean.ndim - variances.ndim))

    def to_dataframe(self, times: Any, names: Any = None) -> Any:
        """A pandas table, a row for each time and record; pandas must be installed.

        Parameters
        ----------
        times : array_like, shape (K+1,)
        names : sequence of str, optional
            Of the components; ``x1, x2, ...`` by default.

        Returns
        -------
        pandas.DataFrame
            Indexed by time, and by record where there are many, with the mean and the deviation
            of each component, the probability of each mode, the mode and the log-likelihood,
            where the filter gives them.

        Raises
        ------
        ImportError
            pandas is not installed.
        ValueError
            Another number of times or names.
        """
        import pandas

        times, names = self._labels(times, names)
        shape = (len(times), *self.mean.shape[2:])

        def rows(part: np.ndarray) -> np.ndarray:
            return np.broadcast_to(part, shape).reshape(-1)

        index = pandas.Index(times, name="t")
        if len(shape) > 1:
            records = range(int(np.prod(shape[1:])))
            index = pandas.MultiIndex.from_product([times, records], names=["t", "record"])
        columns = {name: rows(self.mean[:, k]) for k, name in enumerate(names)}
        if self.cov is not None:
            deviations = np.sqrt(self._variances())
            columns |= {f"{name}_sd": rows(deviations[:, k]) for k, name in enumerate(names)}
        if self.mode_prob is not None:
            modes = range(self.mode_prob.shape[1])
            columns |= {f"mode{i}": rows(self.mode_prob[:, i]) for i in modes}
        more = {"mode": self.modes, "loglik": self.loglik}
        columns |= {name: rows(part) for name, part in more.items() if part is not None}
        return pandas.DataFrame(columns, index=index)

    def _labels(self, times: Any, names: Any) -> tuple[np.ndarray, list]:
        count, n = self.mean.shape[:2]
        times = np.asarray(times)
        names = [f"x{k + 1}" for k in range(n)] if names is None else list(names)
        for label, value, wanted in (("times", times, count), ("names", names, n)):
            if len(value) != wanted:
                raise ValueError(f"{label}: wanted {wanted}, got {len(value)}")
        return times, names


def as_record(measurements: object, count: int, size: int) -> np.ndarray:
    """Measurements (count, size, *batch), float64 uncopied; NaN is a missing one.

    Raises
    ------
    TypeError, ValueError
        Not real numbers, a wrong shape, or an infinite entry.
    """
    try:
        record = np.asarray(measurements)
    except ValueError:  # a ragged list
        record = None
    masked = isinstance(measurements, np.ma.MaskedArray)
    if masked or record is None or record.dtype != np.float64:
        record = as_real("measurements", measurements, nan=True)
    if record.ndim < 2 or record.shape[:2] != (count, size):
        raise ValueError(
            f"measurements: wanted shape ({count}, {size}, *batch), got {record.shape}"
        )
    with np.errstate(invalid="ignore", over="ignore"):
        suspect = not np.isfinite(record.sum())
    if suspect and np.isinf(record).any():
        where = tuple(int(i) for i in np.argwhere(np.isinf(record))[0])
        raise ValueError(
            f"measurements: wanted finite numbers or NaN, got {record[where]} at index {where}"
        )
    return record


def stays(state: object, t: float) -> bool:
    """Whether a forecast to time t leaves the state as it is: it has no time yet, or that one.

    Parameters
    ----------
    state : NamedTuple
        Of any filter, with a field `time`.
    t : float

    Raises
    ------
    ValueError
        A time before that of the state.
    """
    if state.time is None or t == state.time:
        return True
    if not t > state.time:
        raise ValueError(f"t: wanted a time from {when(state.time)} on, got {when(t)}")
    return False


def first_step(state: object, t: float, system: object) -> float:
    """Length of the first step of a record, of which the one to time t is a later one.

    Parameters
    ----------
    state : NamedTuple
        Of any filter, with fields `time` and `interval`.
    t : float
    system : System

    Raises
    ------
    ValueError
        A step of another length, of a system in discrete time; see `as_grid`.
    """
    step = t - state.time
    if state.interval is None:
        return step
    if step != state.interval and in_even_steps(system):
        steps = np.array([state.interval, step])
        require_even("t", steps, [state.time - state.interval, state.time, t])
    return state.interval


def require_time(state: object) -> None:
    """Refuse to correct a state that was not given a time.

    Raises
    ------
    ValueError
        A state without a time: `predict` gives it one.
    """
    if state.time is None:
        raise ValueError("state: wanted a state with a time, got None; predict to it first")


def as_indicators(
    indicators: Any, system: AnySystem, shape: tuple[int, ...], name: str = "indicators"
) -> np.ndarray | None:
    """Indicators of a switching system, whole numbers in the shape; -1 is missing.

    Raises
    ------
    TypeError, ValueError
        Indicators where the system has none or none where it has; no whole numbers, a wrong
        shape, a value out of range.
    """
    values = getattr(system, "indicators", 0)
    if indicators is None:
        if values:
            raise ValueError(f"{name}: wanted, the system has an indicator; got none")
        return None
    if not values:
        what = "indicator" if switches(system) else "modes"
        raise ValueError(f"{name}: wanted none, the system has no {what}")
    seen = as_whole(name, indicators, shape)
    if seen.size and not (seen.min() >= -1 and seen.max() < values):
        worst = seen.max() if seen.max() >= values else seen.min()
        raise ValueError(f"{name}: wanted 0 to {values - 1}, or -1 for a missing one, got {worst}")
    return seen


def as_seen(
    state: object, system: object, y: object, indicator: object
) -> tuple[np.ndarray, np.ndarray | None]:
    """What a state with a time is corrected by: a measurement (m, *batch), and an indicator.

    Raises
    ------
    TypeError, ValueError
        As `require_time` and `as_indicators`.
    """
    require_time(state)
    y = np.asarray(y, dtype=float)
    return y, as_indicators(indicator, system, y.shape[1:], "indicator")


def as_modes(name: str, value: object, shape: tuple[int, ...], count: int) -> np.ndarray:
    """Modes, whole numbers from 0 to count - 1 in the wanted shape.

    Raises
    ------
    TypeError, ValueError
        No whole numbers, another shape, or numbers out of range.
    """
    if value is None:
        raise ValueError(f"{name}: wanted whole numbers of shape {shape}, got None")
    modes = as_whole(name, value, shape)
    bad = (modes < 0) | (modes >= count)
    if bad.any():
        raise ValueError(f"{name}: wanted numbers from 0 to {count - 1}, got {modes[bad][0]}")
    return modes
