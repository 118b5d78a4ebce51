"""What a filter is: its verbs, the one loop over a record that all share, and its estimates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray, Seed, align
from seedslib.base.blocks import BLOCK, in_blocks
from seedslib.base.checks import as_real, as_whole, optional
from seedslib.base.clock import when
from seedslib.base.objects import Pickled, changed
from seedslib.base.values import Inputs, InputTrajectory, Values, as_trajectory
from seedslib.filters.program import Program
from seedslib.filters.single import Single
from seedslib.filters.weights import most_probable
from seedslib.models.kinds import (
    AnySystem,
    as_grid,
    in_even_steps,
    require_even,
    switches,
)

if TYPE_CHECKING:
    from typing import Self

State = TypeVar("State", bound=Any)


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
        Records whose estimates left the bound of the filter, became NaN, or met a measurement that
        is impossible.
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
        distribution with the mean and the variance that the filter claims.

        Raises
        ------
        ValueError
            A level that is not between 0 and 1, a filter that claims no covariance.
        """
        from scipy.special import ndtri

        if isinstance(level, str) or not 0 < level < 1:
            raise ValueError(f"level: wanted a number between 0 and 1, got {level!r}")
        if self.cov is None:
            raise ValueError("interval: wanted covariances, which this filter does not claim")
        width = ndtri(0.5 + 0.5 * level) * np.sqrt(self._variances())
        return np.stack([self.mean - width, self.mean + width])

    def _variances(self) -> np.ndarray:
        """Shape (K+1, n, *batch), or (K+1, n, 1, ...) where they are common to all records."""
        if self.mean.ndim == 1:  # of one time
            return np.diagonal(self.cov)
        return align(np.einsum("kii...->ki...", self.cov), 2, self.mean.ndim - 2)

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
        with optional("tables"):
            import pandas

        (count, n), times = self.mean.shape[:2], np.asarray(times)
        names = [f"x{k + 1}" for k in range(n)] if names is None else list(names)
        for label, value, wanted in (("times", times, count), ("names", names, n)):
            if len(value) != wanted:
                raise ValueError(f"{label}: wanted {wanted}, got {len(value)}")
        shape = (count, *self.mean.shape[2:])

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


def as_record(measurements: object, count: int, size: int) -> np.ndarray:
    """Measurements (count, size, *batch), finite; NaN is a missing one.

    Raises
    ------
    TypeError, ValueError
        Not real numbers, a wrong shape, or an infinite entry.
    """
    return as_real("measurements", measurements, (count, size, ...), nan=True)


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


def as_modes(
    name: str, value: object, shape: tuple[int, ...], count: int, least: int = 0
) -> np.ndarray:
    """Whole numbers from `least` to count - 1 in the wanted shape.

    Raises
    ------
    TypeError, ValueError
        No whole numbers, another shape, or numbers out of range.
    """
    if value is None:
        raise ValueError(f"{name}: wanted whole numbers of shape {shape}, got None")
    numbers = as_whole(name, value, shape)
    bad = (numbers < least) | (numbers >= count)
    if bad.any():
        raise ValueError(f"{name}: wanted {least} to {count - 1}, got {numbers[bad][0]}")
    return numbers


def as_indicators(
    indicators: ArrayLike | None,
    system: AnySystem,
    shape: tuple[int, ...],
    name: str = "indicators",
) -> np.ndarray | None:
    """Indicators of a switching system, whole numbers in the shape; -1 is missing.

    Raises
    ------
    TypeError, ValueError
        Indicators where the system has none or none where it has; no whole numbers, a wrong
        shape, a value out of range.
    """
    values = getattr(system, "indicators", 0)
    if indicators is not None and not values:
        what = "indicator" if switches(system) else "modes"
        raise ValueError(f"{name}: wanted none, the system has no {what}")
    return as_modes(name, indicators, shape, values, least=-1) if values else None


def require_time(state: object) -> None:
    """Refuse to correct a state that was not given a time.

    Raises
    ------
    ValueError
        A state without a time: `predict` gives it one.
    """
    if state.time is None:
        raise ValueError("state: wanted a state with a time, got None; predict to it first")


class Record(NamedTuple):
    """Checked records on one batch axis, or a single one without any."""

    times: np.ndarray  # (K+1,)
    y: np.ndarray  # (K+1, m, *records)
    indicators: MaybeArray  # (K+1, *records)
    modes: MaybeArray  # (K+1, *records)
    inputs: InputTrajectory

    def of(self, own: slice) -> Record:
        """Some of the records."""
        if self.y.ndim == 2:
            return self
        parts = (None if part is None else part[..., own] for part in self[1:4])
        return Record(self.times, *parts, self.inputs.of(own))


def walk(
    filter: Any, record: Record, seed: object = None, predict: Callable[..., Any] | None = None
) -> Iterator[Any]:
    """The states of a filter after each measurement of a record.

    Parameters
    ----------
    filter : Filter
    record : Record
    seed : object
        Of a filter that draws.
    predict : callable, optional
        ``predict(state, t, inputs=...)`` in place of the filter's own.
    """
    predict = filter.predict if predict is None else predict
    first = {} if record.modes is None else {"mode": record.modes[0]}
    start, own = filter, record.inputs.constant
    if own and getattr(filter.system, "first", None) is not None:  # a first state of each record
        start = filter.bind(own)
    state = start.initial(record.y.shape[2:], seed, **first)
    for k, t in enumerate(record.times):
        mode = () if record.modes is None else (record.modes[k],)
        indicator = () if record.indicators is None else (record.indicators[k],)
        # inputs of a time act in the dynamics from there on, and in the sensor at that time
        state = predict(state, t, *mode, inputs=record.inputs.at(max(k - 1, 0)))
        state = filter.correct(state, record.y[k], *indicator, inputs=record.inputs.at(k))
        yield state


def stacked(reports: Iterable[Estimates], count: int) -> Estimates:
    """Estimates of a block of records, from those of each of its times.

    A record has diverged where a time says so, an estimate is no number, or a measurement was
    impossible.
    """
    columns: dict[str, np.ndarray] = {}
    diverged: Any = False
    for k, report in enumerate(reports):
        for name, part in zip(Estimates._fields, report, strict=True):
            if part is None:
                continue
            if name == "diverged":
                diverged = diverged | part
                continue
            column, ndim = columns.get(name), np.ndim(part)
            if column is None or ndim >= column.ndim:  # until now common to all records
                columns[name] = np.empty((count, *np.shape(part)), np.asarray(part).dtype)
                if column is not None:
                    columns[name][:k].T[...] = column[:k].T
                column = columns[name]
            if ndim + 1 == column.ndim:
                column[k] = part
            else:
                column[k].T[...] = np.transpose(part)
    return with_divergence(Estimates(**columns, diverged=diverged))


def with_divergence(estimates: Estimates) -> Estimates:
    """Estimates that say which records have diverged, beside those of which it is known."""
    mean, cov, _, loglik, diverged, _ = estimates
    # what is no number once is none at the end, or on the way back at the beginning
    diverged = diverged | ~np.isfinite(mean).all(axis=(0, 1))
    if cov is not None:
        diverged = diverged | np.isnan(cov[[0, -1]]).all(axis=(1, 2)).any(axis=0)
    if loglik is not None:
        diverged = diverged | (loglik == -np.inf).any(axis=0)
    return estimates._replace(diverged=np.asarray(diverged))


CORE_AXES = Estimates(mean=2, cov=3, mode_prob=2, loglik=1, diverged=0, modes=1)
"""Axes of each array of the estimates before those of the batch."""


def joined(blocks: list[Estimates], batch: tuple[int, ...]) -> Estimates:
    """Estimates of all records, with their batch axes, from those of blocks of them."""
    whole = []
    for parts, core in zip(zip(*blocks, strict=True), CORE_AXES, strict=True):
        part = parts[0]
        if part is not None and any(
            other.ndim > core or not np.array_equal(other, part, equal_nan=True) for other in parts
        ):
            full = []
            for other, block in zip(parts, blocks, strict=True):
                records = block.mean.shape[2:]
                other = align(other, core, len(records))
                full.append(np.broadcast_to(other, other.shape[:core] + records))
            part = full[0] if len(full) == 1 else np.concatenate(full, axis=-1)
            part = part.reshape(part.shape[:core] + batch)
        whole.append(part)  # as it is where all records have it in common, or there is one
    return Estimates(*whole)


def clean(batch: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Fields of a state before any measurement: no log-likelihood, nothing diverged."""
    return {"loglik": np.zeros(batch), "diverged": np.zeros(batch, dtype=bool)}


ELSEWHERE = {
    "filter": "run(times, measurements)",
    "smooth": "seedslib.filters.smooth(filter, times, measurements)",
    "fit": "seedslib.evaluation.fit(filter, times, measurements, free)",
    "simulate": "filter.system.simulate(times, paths, seed)",
}
"""What other libraries have as verbs of a filter, and where it is here."""


class Filter(Pickled):
    """Estimates of a state from measurements, one after the other.

    A filter writes ``initial(batch=(), seed=None)``, ``propagate(state, t, p)`` and
    ``update(state, y, p)``, with the numbers p of the system's parameters, and an indicator as
    fourth argument where its system has one; and `report` where the fields of its states are not
    called as in `Estimates`. `predict` and `correct` check their arguments and call these. States
    are frozen, so every verb gives a new one. Whole records are run here, many at once.

    A kind of filter with formulas also writes `program`, `steps_alone`, `numbers_of` and
    `state_of`: `step` and `run` of one record then take a tenth of the time, with the same numbers
    but for rounding.

    Attributes
    ----------
    system : System
    takes : tuple of str
        What `run` looks at beside times and measurements: of ``"indicators"``, ``"modes"`` (the
        true ones), ``"seed"`` and ``"covariances"`` (whether they are wanted).
    records : int
        How many are worked on together: so many as stay in the processor's cache.
    alone : bool
        Whether a single record is run without an axis of records.
    """

    system: Any
    takes: ClassVar[tuple[str, ...]] = ()
    records: int = BLOCK
    alone: bool = False

    if not TYPE_CHECKING:

        def __getattr__(self, name):
            where = ELSEWHERE.get(name)
            hint = f"; wanted {where}" if where else ""
            raise AttributeError(f"{name}: {type(self).__name__} has no such attribute{hint}")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.system!r})"

    def bind(self, values: Mapping[Any, ArrayLike] | None = None, /, **named: Any) -> Self:
        """The same filter with other numbers of its model's parameters; nothing is compiled again.

        Parameters
        ----------
        values, **named
            As `bind` of the system; an array (*batch) gives each record its own number.
        """
        _ = self._single  # recorded once for all numbers
        return changed(self, system=self.system.bind(values, **named))

    def values(self, inputs: Mapping[Any, Any] | None = None, dt: float = np.nan) -> Values:
        """Numbers of the model's parameters, see `Parametrized.values`."""
        return self.system.values(inputs, dt)

    # One record: its program

    @cached_property
    def _single(self) -> Single:
        return Single()

    def program(self, **options: Any) -> Program:
        """The program of one measurement, see `seedslib.tape`.

        Parameters
        ----------
        **options
            Of `Program`.

        Raises
        ------
        TypeError, ValueError
            A kind of filter that has none; a part of the filter without formulas.
        """
        raise TypeError(
            "filter: wanted a FiniteOrderFilter, a TableFilter, a SwitchingFilter or a "
            f"CovarianceFilter, got {type(self).__name__}"
        )

    def steps_alone(self, state: Any, t: float) -> bool:
        """Whether a state is of one record, and one that the program steps on to time t from.

        Raises
        ------
        ValueError
            A time that `predict` refuses.
        """
        raise NotImplementedError

    def carries(self, state: Any) -> bool:
        """Whether the program can go on from a state of one record."""
        return True

    def numbers_of(self, state: Any) -> dict[str, Any]:
        """The arrays of the program's state, by their names; zero where they lack or are None."""
        raise NotImplementedError

    def state_of(self, parts: dict[str, Any], t: float, before: Any) -> Any:
        """The state after a measurement from the arrays of the program's state.

        Parameters
        ----------
        parts : dict of float or ndarray by name
        t : float
        before : NamedTuple
            An earlier state of the record.
        """
        raise NotImplementedError

    def estimates_of(self, parts: dict[str, Any], covariances: bool = True) -> Estimates:
        """Estimates of a record from the arrays of its program's states, (K+1, ...)."""
        cov, modes = (parts["cov"] if covariances else None), parts.get("mode")
        modes = None if modes is None else modes.astype(int)
        loglik, diverged = parts["loglik"], np.asarray(False)
        return Estimates(parts["mean"], cov, parts.get("prob"), loglik, diverged, modes)

    def initial(self, batch: tuple[int, ...] = (), seed: Seed | None = None) -> Any:
        """State before any measurement, for batch axes such as (paths,).

        A filter that draws nothing does not look at the seed; one that does takes None for 0.
        """
        raise NotImplementedError

    def predict(
        self, state: State, t: float, *modes: ArrayLike, inputs: Mapping[Any, Any] | None = None
    ) -> State:
        """Forecast to time t; a state without a time is only given one.

        Parameters
        ----------
        state : NamedTuple
            Left as it is.
        t : float
        *modes : array_like of int, shape (*batch)
            The mode at that time, for a filter that knows it.
        inputs : mapping of Input to number or ndarray, shape (*batch), optional
            Inputs that act from the time of the state on.

        Raises
        ------
        ValueError
            A time before that of the state; of a system in discrete time that does not mention
            the elapsed time, a step of another length than the first; an input without a value.
        """
        if stays(state, t):
            return state._replace(time=float(t))
        interval = first_step(state, t, self.system)
        p = self.values(inputs, t - state.time)
        later = self.propagate(state, float(t), p, *modes)
        return later._replace(time=float(t), interval=interval)

    def propagate(self, state: State, t: float, p: Values) -> State:
        """State at a later time, but for its fields `time` and `interval`."""
        raise NotImplementedError

    def correct(
        self,
        state: Any,
        y: ArrayLike,
        indicator: ArrayLike | None = None,
        *,
        inputs: Mapping[Any, Any] | None = None,
    ) -> Any:
        """Correct by a measurement at the time of the state.

        Parameters
        ----------
        state : NamedTuple
            Left as it is.
        y : array_like, shape (m, *batch)
            NaN marks a missing component.
        indicator : array_like of int, shape (*batch), optional
            Of a system that has one; -1 where it is missing.
        inputs : mapping of Input to number or ndarray, shape (*batch), optional
            Inputs at that time.

        Raises
        ------
        TypeError, ValueError
            A state without a time: `predict` gives it one. An indicator of a system without, or
            out of range; a measurement of another size; an input without a value.
        """
        require_time(state)
        y = as_real("y", y, (self.system.measurement_size, ...), nan=True, infinite=True)
        indicator = as_indicators(indicator, self.system, y.shape[1:], "indicator")
        p = self.values(inputs)
        if indicator is None:
            return self.update(state, y, p)
        return self.update(state, y, p, indicator)

    def update(
        self, state: Any, y: np.ndarray, p: Values, indicator: np.ndarray | None = None
    ) -> Any:
        """State given a measurement and an indicator; arguments as `correct`, checked."""
        raise NotImplementedError

    def report(self, state: Any) -> Estimates:
        """What is estimated in a state, without the axis of times."""
        parts = [getattr(state, name, None) for name in Estimates._fields[:-1]]
        modes, prob = getattr(state, "mode", None), parts[2]
        if modes is None and prob is not None:
            modes = most_probable(prob)
        return Estimates(*parts, modes)

    def step(
        self,
        state: Any,
        t: float,
        y: ArrayLike,
        indicator: ArrayLike | None = None,
        *,
        mode: ArrayLike | None = None,
        inputs: Mapping[Any, Any] | None = None,
    ) -> Any:
        """Forecast to time t and correct there.

        Where the inputs that act from the time of the state on, in the forecast, are not those of
        time t, which act in the correction, both verbs are called::

            state = filter.predict(state, t, inputs={u: 0.3})
            state = filter.correct(state, y, inputs={u: 0.5})

        Parameters
        ----------
        state : NamedTuple
            Left as it is.
        t : float
        y : array_like, shape (m, *batch)
            NaN marks a missing component.
        indicator : array_like of int, shape (*batch), optional
            Of a system that has one; -1 where it is missing.
        mode : array_like of int, shape (*batch), optional
            The true mode at time t, for a filter that knows it.
        inputs : mapping of Input to number or ndarray, shape (*batch), optional
            Inputs of the step and of the measurement.

        Raises
        ------
        TypeError, ValueError
            As `predict` and `correct`.
        """
        if mode is None:
            later = self._single.step(self, state, t, y, indicator, inputs)
            if later is not None:
                return later
        modes = () if mode is None else (mode,)
        indicators = () if indicator is None else (indicator,)
        state = self.predict(state, t, *modes, inputs=inputs)
        return self.correct(state, y, *indicators, inputs=inputs)

    def forecast(
        self,
        state: Any,
        t: float,
        *,
        mode: ArrayLike | None = None,
        inputs: Mapping[Any, Any] | None = None,
    ) -> Estimates:
        """What the filter expects at a later time, without a measurement; arguments as `step`."""
        modes = () if mode is None else (mode,)
        later = self.report(self.predict(state, t, *modes, inputs=inputs))
        return later._replace(loglik=None, diverged=None)

    def predictive(self, state: Any, p: Values) -> tuple[np.ndarray, np.ndarray]:
        """Mean (m, *batch) and covariance of the measurement at the time of a prediction.

        See `seedslib.filters.forecast_measurements`.

        Raises
        ------
        TypeError
            The filter does not say.
        """
        raise TypeError(
            "filter: wanted one that carries means and covariances (KalmanFilter, extended_kalman "
            f"and other covariance filters, SwitchingFilter), got {type(self).__name__}"
        )

    def smoother(self) -> Any:
        """How `seedslib.filters.smooth` goes back through the states, see `Smoother`.

        Raises
        ------
        TypeError
            The filter has none.
        """
        raise TypeError(
            "filter: wanted one that can be smoothed (extended_kalman and other covariance "
            f"filters, GridBayesFilter), got {type(self).__name__}"
        )

    def record(self, times: ArrayLike, measurements: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Times (K+1,) and measurements (K+1, m, *batch) of a run, checked."""
        times = as_grid("times", times, self.system)
        return times, as_record(measurements, len(times), self.system.measurement_size)

    def at_once(self, record: Record) -> Estimates | None:
        """Estimates of one record by a way of the filter's own that is quicker, if it has one."""
        return None

    def block(self, times: np.ndarray, paths: int, workers: int) -> int:
        """Number of records that are worked on together."""
        return self.records

    def run(
        self,
        times: ArrayLike,
        measurements: ArrayLike,
        *,
        indicators: ArrayLike | None = None,
        modes: ArrayLike | None = None,
        inputs: Inputs | None = None,
        seed: object = 0,
        workers: int = 1,
    ) -> Estimates:
        """Filter a record, or many at once.

        Parameters
        ----------
        times : array_like, shape (K+1,)
            Times of the measurements; the first is that of the initial state and has no forecast.
        measurements : array_like, shape (K+1, m, *batch)
            NaN marks a missing component; a time without any measurement gives a forecast.
        indicators : array_like of int, shape (K+1, *batch), optional
            -1 marks a missing one; wanted where the system has an indicator.
        modes : array_like of int, shape (K+1, *batch), optional
            The true modes, wanted by a filter that knows them.
        inputs : mapping of Input to array_like, shape (K+1,) or (K+1, *batch), optional
            Values of the inputs that the model mentions: those of a time act in the dynamics from
            there until the next time, and in the sensor at that time.
        seed : int, SeedSequence or Generator
            Of a filter that draws.
        workers : int
            Threads over blocks of records; the numbers do not depend on it.

        Returns
        -------
        Estimates
            ``mean`` (K+1, n, *batch), ``cov`` (K+1, n, n, *batch), or (K+1, n, n) where it is
            common to all records, ``loglik`` (K+1, *batch), ``diverged`` (*batch) and, of modes,
            ``mode_prob`` (K+1, L, *batch) and ``modes`` (K+1, *batch).

        Raises
        ------
        TypeError, ValueError
            Times that do not increase, infinite measurements, shapes that do not fit, inputs
            that are missing or that the model does not mention, and what `predict` and `correct`
            refuse.
        """
        batch, record = self.records_of(times, measurements, indicators, modes, inputs)
        alone = not batch and self._single.of(self)

        def work(record: Record, stream: Any) -> Estimates:
            one = record.y[0, 0].size == 1
            if one and (whole := self.at_once(record)) is not None:
                axes = record.y.shape[2:]
                parts = (None if p is None else np.reshape(p, (*np.shape(p), *axes)) for p in whole)
                return with_divergence(Estimates(*parts))
            if alone:
                return with_divergence(self.estimates_of(self._single.run(self, record)))
            reports = (self.report(state) for state in walk(self, record, stream))
            return stacked(reports, len(record.times))

        return self.in_blocks(work, record, batch, seed, workers)

    def _for_likelihoods(self) -> Self:
        """The same filter, of whose estimates nothing but the log-likelihood is looked at."""
        return self

    def records_of(
        self, times: ArrayLike, measurements: ArrayLike, indicators: Any, modes: Any, inputs: Any
    ) -> tuple[tuple[int, ...], Record]:
        """Batch axes, and the records of a run, checked."""
        times, y = self.record(times, measurements)
        batch, shape = y.shape[2:], (len(times), *y.shape[2:])
        trajectory = as_trajectory(self.system, inputs, len(times), batch)
        indicators = as_indicators(indicators, self.system, shape)
        if "modes" in self.takes:
            modes = as_modes("modes", modes, shape, self.system.modes)
        elif modes is not None:
            raise ValueError("modes: wanted none, the filter estimates them")
        axes = (-1,) if batch or not self.alone else ()
        indicators, modes = (
            None if part is None else part.reshape(len(times), *axes)
            for part in (indicators, modes)
        )
        y = y.reshape(*y.shape[:2], *axes)
        return batch, Record(times, y, indicators, modes, trajectory)

    def in_blocks(
        self,
        work: Callable[..., Estimates],
        record: Record,
        batch: tuple[int, ...],
        seed: object = 0,
        workers: int = 1,
    ) -> Estimates:
        """Estimates by ``work(record, stream)`` in each block of records, on threads."""

        def block(start: int, stop: int, stream: np.random.SeedSequence) -> Estimates:
            return work(record.of(slice(start, stop)), stream)

        paths = record.y[0, 0].size
        size = self.block(record.times, paths, workers)
        return joined(in_blocks(block, paths, seed, workers=workers, block=size), batch)
