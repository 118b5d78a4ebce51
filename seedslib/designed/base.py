"""What all designed filters do: check their measurements, run over records, stay honest in gaps."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray, align
from seedslib.base.checks import as_real, as_times, is_whole, outside, require_shape
from seedslib.base.clock import Clock, when
from seedslib.base.values import Inputs, Values
from seedslib.designed.between import Interval, at
from seedslib.designed.memory import Memory, Past
from seedslib.filters.base import (
    Estimates,
    Filter,
    Record,
    as_indicators,
    as_record,
    stacked,
    with_divergence,
)
from seedslib.models.kinds import switches
from seedslib.models.simulation import Schedule

if TYPE_CHECKING:
    from typing import Self


class FilterState(NamedTuple):
    """What a filter of finite order remembers.

    Attributes
    ----------
    index : int
        Number k of the last measurement time reached; -1 before the first.
    mean : ndarray
        After `predict` the forecast; after `correct` the estimate Z_k, (n', *batch).
    cov : ndarray or None
        Its covariance as the filter sees it, with or without batch axes; NaN from a gap on.
    past : Past
        The memory U_k; after `predict` still U_{k-1}.
    loglik : ndarray, or None
        Log-density of the last measurement as forecast by the filter, where it has one.
    mode : ndarray of int, shape (*batch), or None
        The decided mode, or the likeliest one of a forecast.
    before : FilterState or None
        The state after the measurement before the last, needed by linear forecasts.
    gap : ndarray of bool, shape (*batch), or False
        Whether something that the design expects has been missing so far.
    history : ndarray of int, shape (*batch), or 0
        Class of what has arrived so far, see `seedslib.designed.arrivals`.
    corrected : bool
        Whether the measurement at `index` has been used.
    """

    index: int
    mean: np.ndarray
    cov: MaybeArray = None
    past: Past = Past()
    loglik: np.ndarray | float | None = None
    mode: MaybeArray = None
    before: Any = None
    gap: np.ndarray | bool = False
    history: np.ndarray | int = 0
    corrected: bool = False


def require_forecast(state: Any) -> None:
    """Refuse to correct a state that is no forecast: before any measurement, or corrected.

    Raises
    ------
    ValueError
    """
    if state.index < 0 or state.corrected:
        raise ValueError("state: wanted a forecast, got a state without; call predict first")


def require_corrected(state: Any) -> None:
    """Refuse to forecast from a state that was not corrected.

    Raises
    ------
    ValueError
    """
    if not state.corrected:
        raise ValueError("state: wanted a state after a correction, got a forecast")


def freeze(part: object) -> None:
    """Make an array, or the arrays in a tuple, read-only: a designed filter does not change."""
    if isinstance(part, np.ndarray):
        part.flags.writeable = False
    elif isinstance(part, tuple):
        for piece in part:
            freeze(piece)


def nan_where(gap: np.ndarray | bool, part: MaybeArray) -> Any:
    """NaN on the paths of a gap (*batch) in an array (a, b) or (a, b, *batch)."""
    if part is None or not np.any(gap):
        return part
    return np.where(gap, np.nan, part.reshape(*part.shape, *(1,) * (np.ndim(gap) + 2 - part.ndim)))


class DesignedFilter(Filter):
    """A filter whose memory, and the forecasts from it, come from a design.

    A kind of filter writes `propagate` and `update`, its steps without checks, and `ahead`, its
    forecasts between measurements.

    Attributes
    ----------
    memory : Memory, or None
        None where nothing was designed, and whole distributions are carried.
    cycle : int
        So many of the last steps of the design serve all later ones in turn; 0 where the filter
        ends with its design.
    measured : ndarray of bool, shape (K+1, m), or None
        Components that the schedule of the design has at each time; None for all. An indicator
        counts as the last one.
    availability : ndarray, shape (m,), or None
        Probabilities with which they arrive, where the design takes account of that.
    between : str
        Kind of the forecasts between measurements, see `seedslib.designed.between.at`.
    """

    measured: MaybeArray = None
    availability: MaybeArray = None
    between: str = "interpolated"
    takes = ("indicators", "covariances")
    per_step: ClassVar[Mapping[str, int]] = {"fits": 1}
    """Fields with an entry for each measurement, and the number of the first that has one."""

    memory: Memory | None
    cycle: int
    node_times: tuple[np.ndarray, ...]
    node_fits: tuple[Any, ...]
    times: Any
    clock: Clock
    predicted: Any

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        freeze(tuple(state.values()))  # arrays that come from elsewhere can be written to

    # The steps of the design

    @property
    def reach(self) -> tuple[float, float]:
        """First and last time of the design."""
        return float(self.times[0]), float(self.times[-1])

    @property
    def horizon(self) -> float:
        """Last time the filter can forecast."""
        return np.inf if self.cycle else float(self.times[-1])

    def served(self, k: int) -> int:
        """Number of the step of the design that serves measurement k."""
        last = len(self.times) - 1
        return k if k <= last else last - self.cycle + 1 + (k - last - 1) % self.cycle

    @property
    def schedule(self) -> Schedule:
        """What the design has at its times, as a simulation takes it."""
        size = self.system.measurement_size + (self.system.indicators > 0)
        return Schedule.of(self.measured, self.availability, len(self.times), size)

    def taking(self, chosen: list[int]) -> Self:
        """The filter of some steps of the design, by their numbers, which are then the only ones.

        Each comes as long after the one before it as it did in the design. What was predicted of
        the whole design is left out.
        """
        times = np.asarray(self.times)
        shift = times[0] + np.cumsum(np.diff(times, prepend=times[0])[chosen]) - times[chosen]
        changed: dict[str, Any] = {}
        for name, first in self.per_step.items():
            part, rows = getattr(self, name), [k - first for k in chosen[first:]]
            of_rows = isinstance(part, np.ndarray)
            changed[name] = part[rows] if of_rows else tuple(part[k] for k in rows)
        if self.measured is not None:
            changed["measured"] = self.measured[chosen]
        if self.node_times:
            intervals = [(k - 1, by) for k, by in zip(chosen[1:], shift[1:], strict=True)]
            changed["node_times"] = tuple(self.node_times[k] + by for k, by in intervals)
            changed["node_fits"] = tuple(self.node_fits[k] for k, _ in intervals)
        changed |= {"times": times[chosen] + shift, "predicted": None, "held_out": None}
        return replace(self, cycle=0, **changed)

    def check(self) -> None:
        """Make the times an array; refuse steps that do not fit them.

        Raises
        ------
        TypeError, ValueError
        """
        vars(self).update(times=as_times("times", self.times))
        steps = len(self.times)
        if not (is_whole(self.cycle) and 0 <= self.cycle < steps):
            raise ValueError(f"cycle: wanted 0 to {steps - 1} of the steps, got {self.cycle!r}")
        mask = self.schedule.mask
        if self.measured is not None and self.measured.shape != mask.shape:
            raise ValueError(f"measured: wanted a mask of shape {mask.shape}")
        intervals, fits = len(self.node_times), len(self.node_fits)
        if intervals not in (steps - 1, 0) or intervals != fits:
            raise ValueError(
                f"node_times, node_fits: wanted {steps - 1} intervals, got {intervals} and {fits}"
            )

    def check_fits(self, n: int, m: int) -> None:
        """Refuse forecasts from another memory, by the sizes of an estimate and a measurement.

        Raises
        ------
        ValueError
        """
        modes = getattr(self.system, "modes", 1)
        if len(self.fits) != len(self.times) - 1:
            raise ValueError(f"fits: wanted {len(self.times) - 1}, got {len(self.fits)}")
        for k, fit in enumerate(self.fits):
            wanted = self.memory.dimension(k, n, m, modes)
            # a forecast of one's own need not have a dimension
            if (dimension := getattr(fit, "dimension", wanted)) != wanted:
                raise ValueError(
                    f"fits[{k}]: wanted forecasts from {wanted} numbers, for the memory "
                    f"{self.memory}, got {dimension}"
                )

    # Step by step

    def propagate(self, state: Any, t: float, p: Values, interval: Interval | None = None) -> Any:
        """The forecast for the next measurement, at t; `interval` is the one before, if known."""
        raise NotImplementedError

    def update(
        self,
        state: Any,
        y: np.ndarray,
        p: Values,
        indicator: MaybeArray = None,
        covariance: bool = True,
    ) -> Any:
        """The state after a measurement, with its covariance where that is wanted."""
        raise NotImplementedError

    def predict(self, state: Any, t: float, *, inputs: Mapping[Any, Any] | None = None) -> Any:
        """Forecast for the next measurement time t; the first state has nothing to forecast.

        Parameters
        ----------
        state : NamedTuple
        t : float
        inputs : mapping of Input to number or ndarray, shape (*batch), optional
            Inputs from the time of the state on.

        Raises
        ------
        ValueError
            Another time than the next of the design, or no more of them; a state that was not
            corrected.
        """
        k, clock = state.index + 1, self.clock
        if k >= len(clock.times) and not self.cycle:
            raise ValueError(f"t: wanted at most the last measurement time {when(clock.times[-1])}")
        wanted = clock.moment(k, self.cycle)
        if not clock.same(float(t), wanted):
            raise ValueError(f"t: wanted the next measurement time {when(wanted)}, got {when(t)}")
        if k:
            require_corrected(state)
        dt = wanted - clock.moment(k - 1, self.cycle) if k else np.nan
        return self.propagate(state, float(t), self.values(inputs, dt))

    def correct(
        self,
        state: Any,
        y: ArrayLike,
        indicator: ArrayLike | None = None,
        *,
        inputs: Mapping[Any, Any] | None = None,
    ) -> Any:
        """Correct the forecast by a measurement and the indicator.

        Parameters
        ----------
        state : NamedTuple
        y : array_like, shape (m, *batch)
            NaN where it is missing.
        indicator : array_like of int, shape (*batch), optional
            -1 where it is missing; wanted where the system has one.
        inputs : mapping of Input to number or ndarray, shape (*batch), optional
            Inputs at that time.

        Raises
        ------
        TypeError, ValueError
            A state without a forecast, a wrong shape, an infinite measurement, an indicator out
            of range, a component that the schedule of the design leaves out; what `run` refuses.
        """
        require_forecast(state)
        batch = self.batch_of(state)
        y = as_real("y", y, nan=True)
        require_shape("y", y, (self.system.measurement_size, *batch))
        if indicator is not None or self.system.indicators:
            given = indicator if indicator is None else np.asarray(indicator)[None]
            indicator = as_indicators(given, self.system, (1, *batch), "indicator")[0]
        corrected = self.update(state, y, self.values(inputs), indicator)
        if self.memory is None:
            return corrected
        rows = None if indicator is None else indicator[None]
        gap = state.gap | self.gaps("y", y[None], rows, [state.index])[0]
        return self.without_claims(corrected, state.gap, gap) if np.any(gap) else corrected

    # Of one record, by a program

    def steps_alone(self, state: Any, t: float) -> bool:
        """See `Filter.steps_alone`."""
        return (state.corrected or state.index < 0) and state.mean.ndim == 1

    def numbers_of(self, state: Any) -> dict[str, Any]:
        """See `Filter.numbers_of`."""
        number = state.index + 1
        over = number - len(self.times)
        laps = 1.0 + over // self.cycle if over >= 0 and self.cycle else 0.0
        served = self.served(number) if self.cycle else number
        return {"k": served, "laps": laps, "gap": state.gap, **self.remembered(state.past)}

    def state_of(self, parts: dict[str, Any], t: float, before: Any) -> Any:
        """See `Filter.state_of`."""
        index, gap = self.index_of(parts), parts["gap"] > 0.0
        return FilterState(
            index,
            parts["mean"],
            nan_where(gap, parts["cov"]),
            self.recalled(parts, index + 1),
            np.nan if before.gap else parts["loglik"],
            before=before._replace(before=None) if before.corrected else None,
            gap=gap,
            corrected=True,
        )

    def index_of(self, parts: dict[str, Any]) -> int:
        """Number of the last measurement, from the arrays of a program's state."""
        return int(parts["k"] + self.cycle * parts.get("laps", 0.0)) - 1

    def _blocks(self) -> list[tuple[str, int, int]]:
        """Blocks of numbers of the full memory: which, how many, and how many numbers of each."""
        memory, modes = self.memory, getattr(self.system, "modes", 1)
        n = getattr(self, "components", self.system.state_size) + memory.log_odds * (modes - 1)
        m = self.system.measurement_size
        return [("estimates", memory.estimates, n), ("measurements", memory.measurements, m)]

    def remembered(self, past: Past) -> dict[str, Any]:
        """Numbers of a program that are the memory; zero where it is not yet filled."""
        full: list[float] = []
        for name, count, size in self._blocks():
            blocks = getattr(past, name)
            for block in blocks:
                full += block.tolist()
            full += [0.0] * (size * (count - len(blocks)))
        return {"memory": full, "modes": past.modes, "indicators": past.indicators}

    def recalled(self, parts: dict[str, Any], count: int) -> Past:
        """The memory after so many measurements, from the numbers of a program."""
        blocks, start, full = {}, 0, parts["memory"]
        for name, most, size in self._blocks():
            stops = range(start + size, start + size * min(count, most) + 1, size)
            blocks[name] = tuple(full[stop - size : stop] for stop in stops)
            start += size * most
        for name in ("modes", "indicators"):
            if name in parts:
                blocks[name] = tuple(parts[name][:count].astype(np.intp))
        return Past(**blocks)

    def batch_of(self, state: Any) -> tuple[int, ...]:
        """Batch axes of a state."""
        return state.mean.shape[1:]

    def without_claims(self, state: Any, before: Any, gap: Any) -> Any:
        """A state after a gap: a covariance is NaN from there on, a likelihood afterwards."""
        loglik = None if state.loglik is None else np.where(before, np.nan, state.loglik)
        return state._replace(cov=nan_where(gap, state.cov), loglik=loglik, gap=gap)

    def gaps(self, name: str, y: np.ndarray, indicators: MaybeArray, numbers: Any) -> np.ndarray:
        """Whether a component that the design expects is missing in measurements, (J, *batch).

        Parameters
        ----------
        name : str
            Of the argument, for the message.
        y : ndarray, shape (J, m, *batch)
        indicators : ndarray of int, shape (J, *batch), or None
        numbers : sequence of int, length J
            Of the measurements.

        Raises
        ------
        ValueError
            A component that the schedule of the design leaves out.
        """
        missing = np.isnan(y)
        if indicators is not None:
            missing = np.concatenate([missing, (indicators < 0)[:, None]], axis=1)
        if self.measured is self.availability is None:
            return missing.any(axis=1)
        mask, rates = self.schedule
        mask = mask[[self.served(k) for k in numbers]]
        rates = np.ones(mask.shape[1]) if rates is None else rates
        possible = align(mask & (rates > 0.0), 2, missing.ndim - 2)
        sure = align(mask & (rates == 1.0), 2, missing.ndim - 2)
        unexpected = ~missing & ~possible
        if unexpected.any():
            row, component = np.argwhere(unexpected)[0, :2]
            raise ValueError(
                f"{name}: wanted what the schedule of the design has, got component {component} "
                f"of a measurement without it{f' in row {row}' if len(y) > 1 else ''}"
            )
        return (missing & sure).any(axis=1)

    def report(self, state: Any, covariance: bool = True) -> Estimates:
        """What is estimated after a correction."""
        cov = state.cov if covariance else None
        return Estimates(state.mean, cov, loglik=state.loglik, modes=state.mode)

    # Between measurements

    def ahead(self, state: Any, row: int, p: Values) -> list[np.ndarray]:
        """Estimates at the nodes of interval `row` of the design and at its end.

        Without the end where no measurement follows.
        """
        raise NotImplementedError

    def interval(self, state: Any, p: Values, with_before: bool = True) -> Interval:
        """Estimates from a correction to the next measurement, and those of the interval before."""
        k = state.index
        row = self.served(k + 1) - 1 if self.cycle else k
        start = self.clock.moment(k, self.cycle)
        times, values = [start], [state.mean]
        if row < len(self.times) - 1:
            nodes = self.node_times[row] if self.node_times else np.empty(0)
            # beyond the design the nodes lie as in the interval that serves
            times += [*(nodes + (start - self.times[row])), self.clock.moment(k + 1, self.cycle)]
            values += self.ahead(state, row, p)
        before = None
        if with_before and state.before is not None:
            before = self.interval(state.before, p, with_before=False)
        return Interval(np.array(times), values, before)

    def forecasting(self, kind: str) -> Self:
        """The same filter with another kind of forecast between measurements."""
        return replace(self, between=kind)

    def forecast(
        self,
        state: Any,
        t: float,
        kind: str | None = None,
        *,
        inputs: Mapping[Any, Any] | None = None,
    ) -> Estimates:
        """Estimate of the first n' components at a time up to the next measurement.

        Parameters
        ----------
        state : NamedTuple
            After a correction.
        t : float
            From the time of the state to the next measurement time (before that measurement),
            or to the horizon.
        kind : str, optional
            One of `FORECAST_KINDS`; the filter's own `between` by default.
        inputs : mapping of Input to number or ndarray, shape (*batch), optional
            Inputs from the time of the state on.

        Raises
        ------
        ValueError
            A time outside the interval, an unknown kind, a state that was not corrected.
        """
        require_corrected(state)
        interval = self.interval(state, self.values(inputs))
        tolerance = self.clock.tolerance
        start, end = interval.times[0], interval.times[-1]
        if not start - tolerance <= t <= end + tolerance:
            raise ValueError(f"t: wanted a time from {when(start)} to {when(end)}, got {when(t)}")
        return Estimates(at(interval, t, self.between if kind is None else kind))

    # Whole records

    def record(self, times: ArrayLike, measurements: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Times (J+1,), any where there was a design, and measurements of a run, checked."""
        if self.memory is None:
            return super().record(times, measurements)
        times = as_times("times", times)
        return times, as_record(measurements, len(times), self.system.measurement_size)

    def numbered(self, times: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Number of the measurement at each time, -1 where there is none, shape (J+1,).

        Raises
        ------
        ValueError
            A grid that starts elsewhere, goes too far, or leaves out a measurement time; a
            measurement at another time; with modes, another time than those of measurements.
        """
        if self.memory is None:
            return np.arange(len(times))
        clock = self.clock.prolonged(times[-1], self.cycle) if self.cycle else self.clock
        wanted = np.array(clock.times)
        wanted = wanted[wanted <= times[-1] + clock.tolerance]
        if not clock.same(times[0], clock.times[0]):
            raise ValueError(f"times: wanted {when(clock.times[0])} first, got {when(times[0])}")
        if times[-1] > self.horizon + clock.tolerance:
            raise ValueError(
                f"times: wanted at most {when(self.horizon)}, where the design ends, got "
                f"{when(times[-1])}; seedslib.design.stationary makes it go on"
            )
        rows = clock.rows(times)[: len(wanted)]
        if (rows < 0).any():
            raise ValueError(
                f"times: wanted all measurement times of the design, {when(wanted[rows < 0][0])} "
                "is not among them"
            )
        numbers = np.full(len(times), -1)
        numbers[rows] = np.arange(len(wanted))
        if switches(self.system) and (numbers < 0).any():
            raise ValueError(
                "times: wanted those of measurements alone, for the system has modes, got "
                f"{when(times[numbers < 0][0])}"
            )
        for j in np.flatnonzero(numbers < 0):
            if not np.isnan(y[j]).all():
                raise ValueError(
                    f"measurements: wanted NaN at {when(times[j])}, which is no measurement time "
                    "of the design"
                )
        return numbers

    def run(
        self,
        times: ArrayLike,
        measurements: ArrayLike,
        *,
        indicators: ArrayLike | None = None,
        inputs: Inputs | None = None,
        covariances: bool = False,
        workers: int = 1,
    ) -> Estimates:
        """Filter a record, or many at once.

        Parameters
        ----------
        times : array_like, shape (J+1,)
            The measurement times of the design up to some of them, evenly on beyond them where
            the filter is stationary; without modes also any times between.
        measurements : array_like, shape (J+1, m, *batch)
            NaN marks a missing component; between measurement times all must be NaN, and what
            the schedule of the design leaves out. Functions of the measurement, and tables, take
            one as a whole or not at all.
        indicators : array_like of int, shape (J+1, *batch), optional
            -1 marks a missing one; wanted where the system has an indicator.
        inputs : mapping of Input to array_like, shape (J+1,) or (J+1, *batch), optional
            Values of the inputs that the model mentions, of a filter without a design.
        covariances : bool
            Whether `cov` is wanted.
        workers : int
            Threads over blocks of records.

        Returns
        -------
        Estimates
            ``mean`` (J+1, n', *batch), at measurement times after the correction and between
            them the forecasts; ``diverged`` (*batch), estimates that are not finite, or
            measurements that are impossible; with modes ``modes`` (J+1, *batch) and, where they
            are known, ``mode_prob`` (J+1, L, *batch). Filters of moments have ``loglik``
            (J+1, *batch), zero between measurements; ``cov`` is (J+1, n', n', *batch), or
            (J+1, n', n') where it is common to all records. Filters of output functions have no
            likelihoods, and the unconditional ``cov`` that the design found. NaN is what a design
            does not know: ``cov`` between measurement times and from an unexpected gap on,
            `loglik` after it.

        Raises
        ------
        TypeError, ValueError
            Times that do not increase or leave out a measurement time of the design; a
            measurement where the design has none; a missing one that the memory wants; infinite
            measurements; wrong shapes.

        Warns
        -----
        UserWarning
            Records with gaps, of a filter that was designed: how many, and from which time.
        """
        batch, record = self.records_of(times, measurements, indicators, None, inputs)
        numbers = self.numbered(record.times, record.y)
        gaps = self.record_gaps(record.y, record.indicators, numbers)

        alone = not batch and (numbers >= 0).all() and self._single.of(self)

        def work(record: Record, stream: object) -> Estimates:
            if alone:
                parts = self._single.run(self, record)
                return with_divergence(self.estimates_of(parts, covariances))
            estimates = stacked(self._states(record, numbers, covariances), len(numbers))
            if covariances:  # they are those of measurement times
                estimates.cov[numbers < 0] = np.nan
            return estimates

        estimates = self.in_blocks(work, record, batch, 0, workers)
        return with_gaps(estimates, gaps.reshape(len(numbers), *batch), record.times)

    def record_gaps(self, y: np.ndarray, indicators: MaybeArray, numbers: np.ndarray) -> np.ndarray:
        """Whether a gap that the design does not expect was at or before each time, (J+1, *batch).

        Parameters
        ----------
        y : ndarray, shape (J+1, m, *batch)
        indicators : ndarray of int, shape (J+1, *batch), or None
        numbers : ndarray of int, shape (J+1,)
            See `numbered`.
        """
        gaps = np.zeros((len(y), *y.shape[2:]), dtype=bool)
        if self.memory is None:
            return gaps
        rows = numbers >= 0
        indicators = None if indicators is None else indicators[rows]
        gaps[rows] = self.gaps("measurements", y[rows], indicators, numbers[rows])
        return np.logical_or.accumulate(gaps)

    def _states(
        self, record: Record, numbers: np.ndarray, covariances: bool
    ) -> Iterator[Estimates]:
        """Estimates at each time of a block of records, one after the other."""
        state, interval = self.initial(record.y.shape[2:]), None
        times, parameters = record.times, self.system.parameters

        def values(row: int, dt: float = np.nan) -> Values:
            return self.values(record.inputs.at(row), dt) if parameters else ()

        last = 0  # row of the last measurement, whose inputs act until the next
        for j, k in enumerate(numbers):
            p = values(last, times[j] - times[last])
            if k < 0:
                interval = interval or self.interval(state, p)
                mean = at(interval, times[j], self.between)
                cov = state.cov if covariances else None
                yield Estimates(mean, cov, loglik=None if state.loglik is None else 0.0)
                continue
            state = self.propagate(state, times[j], p, interval)
            indicator = None if record.indicators is None else record.indicators[j]
            state = self.update(state, record.y[j], values(j), indicator, covariances)
            interval, last = None, j
            yield self.report(state, covariances)


def with_gaps(estimates: Estimates, gaps: np.ndarray, times: np.ndarray) -> Estimates:
    """Estimates without what a filter cannot know from unexpected gaps (J+1, *batch) on.

    Warns
    -----
    UserWarning
        How many records have gaps, and from which time.
    """
    if not gaps.any():
        return estimates
    # the measurement at the first gap was still forecast from a memory without one
    after = np.concatenate([np.zeros_like(gaps[:1]), gaps[:-1]])
    cov, loglik = estimates.cov, estimates.loglik
    if cov is not None:
        cov = np.moveaxis(nan_where(gaps, np.moveaxis(cov, 0, 2)), 2, 0)
    if loglik is not None:
        loglik = np.where(after, np.nan, loglik)
    if cov is not None or (loglik is not None and after.any()):
        first = times[gaps.reshape(len(gaps), -1).any(axis=1).argmax()]
        warnings.warn(
            f"measurements: {np.count_nonzero(gaps[-1])} of {gaps[-1].size} records have gaps, "
            f"from {when(first)} on, which the design does not know of: covariances are NaN from "
            "a gap on, likelihoods after it; a design knows of them by `measured` or "
            "`availability`",
            stacklevel=outside(),
        )
    return estimates._replace(cov=cov, loglik=loglik)
