"""What all filters do that a design has made: their measurements are checked, their records run."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_real, as_times, is_whole, outside
from seedslib.base.clock import Clock, when
from seedslib.base.values import Inputs, InputTrajectory, as_trajectory
from seedslib.designed.checks import check_errors, check_times
from seedslib.designed.memory import Memory
from seedslib.filters.base import Estimates, Filter, as_indicators, as_record
from seedslib.models.simulation import Schedule

if TYPE_CHECKING:
    from typing import Self


def want_forecast(state: Any) -> None:
    """Refuse to correct a state that holds no forecast.

    Raises
    ------
    ValueError
        The state before any measurement, or after a correction.
    """
    if state.index < 0 or state.corrected:
        raise ValueError("state: wanted a forecast, got a state without; call predict first")


def want_corrected(state: Any) -> None:
    """Refuse to forecast from a state that holds a forecast.

    Raises
    ------
    ValueError
        A state after `predict`, or the one before any measurement.
    """
    if not state.corrected:
        raise ValueError("state: wanted a state after a correction, got a forecast")


def want_next(clock: Clock, k: int, t: float, cycle: int) -> None:
    """Refuse a time that is not the one of measurement k.

    Raises
    ------
    ValueError
        Another time, or no such measurement.
    """
    if k >= len(clock.times) and not cycle:
        raise ValueError(f"t: wanted at most the last measurement time {when(clock.times[-1])}")
    wanted = clock.moment(k, cycle)
    if not clock.same(t, wanted):
        raise ValueError(f"t: wanted the next measurement time {when(wanted)}, got {when(t)}")


def warn_of_mended(raised: int) -> None:
    """Tell the caller of a run or a design of covariances that had to be mended, if any."""
    if raised:
        warnings.warn(
            f"covariances: eigenvalues of {raised} were raised to 1e-12 of their scale",
            stacklevel=outside(),
        )


def freeze(part: object) -> None:
    """Make an array, or the arrays in a tuple, read-only: a designed filter does not change."""
    if isinstance(part, np.ndarray):
        part.flags.writeable = False
    elif isinstance(part, tuple):
        for piece in part:
            freeze(piece)


def expected(filter: Any, index: np.ndarray) -> MaybeArray:
    """Components that may be, and that must be, in measurements, by their numbers (J,).

    Shape (2, J, m'); None where the design expects all of them.
    """
    if filter.measured is filter.availability is None:
        return None
    mask, arriving = filter.schedule
    rate = 1.0 if arriving is None else arriving
    rows = [filter.served(int(k)) for k in index]
    return np.stack([mask & (rate > 0.0), mask & (rate == 1.0)])[:, rows]


def dropouts(
    y: np.ndarray,
    measured: np.ndarray,
    indicators: np.ndarray | None,
    expected: np.ndarray | None = None,
) -> np.ndarray | None:
    """Whether some of a measurement was missing at or before each time, shape (J+1, *batch).

    None where nothing was.

    Parameters
    ----------
    y : ndarray, shape (J+1, m, *batch)
    measured : ndarray of bool, shape (J+1,)
        Times at which the design has a measurement.
    indicators : ndarray of int, shape (J+1, *batch), or None
        -1 is a missing one.
    expected : ndarray of bool, shape (2, J+1, m'), or None
        Components that may be there, and those that must, where the design says so.
    """
    none = not np.isnan(y).any() and (indicators is None or not (indicators < 0).any())
    if none and expected is None:
        return None
    indicators = None if indicators is None else indicators[measured]
    expected = None if expected is None else expected[:, measured]
    gaps = np.zeros((len(y), *y.shape[2:]), dtype=bool)
    gaps[measured] = missing("measurements", y[measured], indicators, expected)
    return np.logical_or.accumulate(gaps)


def missing(
    name: str, y: np.ndarray, indicators: np.ndarray | None, expected: np.ndarray | None
) -> np.ndarray:
    """Whether something is missing in each measurement that the design expects, (J, *batch).

    Parameters
    ----------
    name : str
        Of the argument.
    y, indicators, expected : ndarray or None
        See `dropouts`.

    Raises
    ------
    ValueError
        A component that the schedule of the design leaves out.
    """
    absent = np.isnan(y)
    if indicators is not None:
        absent = np.concatenate([absent, (indicators < 0)[:, None]], axis=1)
    if expected is None:
        return absent.any(axis=1)
    may, must = expected.reshape(*expected.shape, *(1,) * (absent.ndim - 2))
    stray = ~(absent | may)
    if stray.any():
        row, component = np.argwhere(stray.any(axis=tuple(range(2, stray.ndim))))[0]
        raise ValueError(
            f"{name}: wanted what the schedule of the design has, got component {component} of a "
            f"measurement without it{f' in row {row}' if len(y) > 1 else ''}"
        )
    return (absent & must).any(axis=1)


def nan_where(gap: np.ndarray | bool, part: np.ndarray) -> np.ndarray:
    """NaN on the paths of a gap (*batch) in an array (a, b) or (a, b, ..., *batch)."""
    if not np.any(gap):
        return part
    return np.where(gap, np.nan, part.reshape(*part.shape, *(1,) * (np.ndim(gap) + 2 - part.ndim)))


def unclaimed(found: Estimates, gaps: np.ndarray | None, times: np.ndarray) -> Estimates:
    """Estimates of a run without the covariances and likelihoods that a filter cannot know.

    Parameters
    ----------
    found : Estimates
    gaps : ndarray of bool, shape (J+1, *batch), or None
        See `dropouts`.
    times : ndarray, shape (J+1,)

    Warns
    -----
    UserWarning
        Once where there are any; how many records, and from which time.
    """
    if gaps is None or not gaps.any():
        return found
    # the measurement at the first gap was still forecast from a memory without one
    after = np.concatenate([np.zeros_like(gaps[:1]), gaps[:-1]])
    cov, loglik = found.cov, found.loglik
    if cov is not None:
        cov = np.moveaxis(nan_where(gaps, np.moveaxis(cov, 0, 2)), 2, 0)
    if loglik is not None:
        loglik = np.where(after, np.nan, loglik)
    if cov is not None or (loglik is not None and after.any()):
        records = gaps[-1].size
        warnings.warn(
            f"measurements: {np.count_nonzero(gaps[-1])} of {records} records have gaps, from "
            f"{when(times[gaps.reshape(len(gaps), -1).any(axis=1).argmax()])} on, which the design "
            "does not know of: covariances are NaN from a gap on, likelihoods after it; a design "
            "knows of them by `measured` or `availability`",
            stacklevel=outside(),
        )
    return found._replace(cov=cov, loglik=loglik)


DTYPES = tuple(int if name == "modes" else float for name in Estimates._fields)
"""Numbers that the parts of estimates are of."""


class DesignedFilter(Filter):
    """A filter whose memory, and what it says, come from a design.

    Beside the verbs of every filter it writes `sizes` and `fill`, a loop of its own over the times
    of a record, and `finish` where something is formed for all times at once.

    Attributes
    ----------
    memory : Memory, or None
        None where nothing was designed, and whole laws are carried.
    cycle : int
        So many of the last steps of the design serve all later ones in turn; 0 where the filter
        ends with its design.
    measured : ndarray of bool, shape (K+1, m), or None
        Components that the schedule of the design has at each time; None for all. An indicator
        counts as the last one.
    availability : ndarray, shape (m,), or None
        Probabilities with which they arrive, where the design knows what to make of that.
    """

    measured: MaybeArray = None
    availability: MaybeArray = None
    takes = ("indicators", "covariances")
    memory: Memory | None
    cycle: int
    times: Any
    clock: Clock
    predicted: Any

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        freeze(tuple(state.values()))  # arrays that come from elsewhere can be written to

    @property
    def reach(self) -> tuple[float, float]:
        """First and last time that the design looked at."""
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
        the steps is kept, as if the steps between had been there; nothing was held out.
        """
        times, room = np.asarray(self.times), self.clock.tolerance
        shift = times[0] + np.cumsum(np.diff(times, prepend=times[0])[chosen]) - times[chosen]
        kept: dict[str, Any] = {}
        if self.measured is not None:
            kept["measured"] = self.measured[chosen]
        stamps = self.times if self.predicted is None else self.predicted.times
        rows = [
            np.flatnonzero((stamps <= times[k] + room) & (k == 0 or stamps > times[k - 1] + room))
            for k in chosen
        ]
        moved = np.concatenate([stamps[row] + by for row, by in zip(rows, shift, strict=True)])
        if self.predicted is not None:
            kept["predicted"] = self.predicted.of(np.concatenate(rows), moved)
        if len(getattr(self, "node_times", ())):
            led = [(k - 1, by) for k, by in zip(chosen[1:], shift[1:], strict=True)]
            kept["node_times"] = tuple(self.node_times[row] + by for row, by in led)
            kept["node_fits"] = tuple(self.node_fits[row] for row, _ in led)
        return replace(
            self, times=times[chosen] + shift, held_out=None, cycle=0, **kept, **self.parts(chosen)
        )

    def parts(self, chosen: list[int]) -> dict[str, Any]:
        """Fields of this kind of filter for `taking`."""
        raise NotImplementedError

    def check_shapes(self) -> None:
        """Refuse a filter whose parts do not fit together, when it is made or read.

        Regressions and tables are held against the memory, the times and the model's sizes;
        functions of one's own are taken as they are.

        Raises
        ------
        TypeError, ValueError
            Arrays of another shape or kind, numbers that are not finite, covariances that are not
            semidefinite, times out of order, axes other than those of the memory.
        """
        check_times(self.times)
        if not (is_whole(self.cycle) and 0 <= self.cycle < len(self.times)):
            raise ValueError(
                f"cycle: wanted 0 to {len(self.times) - 1} of the steps, got {self.cycle!r}"
            )
        mask = self.schedule.mask  # which refuses most
        if self.measured is not None and self.measured.shape != mask.shape:
            raise ValueError(f"measured: wanted a mask of shape {mask.shape}")
        self.check_parts()
        components = getattr(self, "components", None)  # all of them with modes
        check_errors(self.predicted, self.held_out, self.times, components)

    def check_parts(self) -> None:
        """What `check_shapes` asks of the parts that this kind of filter has by itself."""
        raise NotImplementedError

    def sizes(self, covariances: bool) -> Estimates:
        """Shapes of what `fill` writes at each time, without batch axes; None for no such thing."""
        raise NotImplementedError

    def fill(
        self,
        rows: Estimates,
        times: np.ndarray,
        index: np.ndarray,
        y: np.ndarray,
        indicators: np.ndarray | None,
        inputs: InputTrajectory,
    ) -> int:
        """Run over a block of records, and write what is found.

        Parameters
        ----------
        rows : Estimates
            Arrays (J+1, *shape, *batch) to write to; None for what is not wanted.
        times : ndarray, shape (J+1,)
        index : ndarray of int, shape (J+1,)
            See `placed`.
        y : ndarray, shape (J+1, m, *batch)
        indicators : ndarray of int, shape (J+1, *batch), or None
        inputs : InputTrajectory
            At these times.

        Returns
        -------
        int
            Covariances whose eigenvalues had to be raised.
        """
        raise NotImplementedError

    def finish(self, found: Estimates, lost: np.ndarray, index: np.ndarray) -> Estimates:
        """The estimates of a run, with what is formed for all times at once.

        Parameters
        ----------
        found : Estimates
        lost : ndarray of bool, shape (*batch)
            Where an estimate is not finite.
        index : ndarray of int, shape (J+1,)
        """
        return found._replace(diverged=lost)

    def record(self, times: ArrayLike, measurements: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Times (J+1,), any where there was a design, and measurements of a run, checked."""
        if self.memory is None:
            return super().record(times, measurements)
        times = as_times("times", times)
        return times, as_record(measurements, len(times), self.system.measurement_size)

    def placed(self, times: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Number of the measurement at each time, -1 where there is none, shape (J+1,).

        Raises
        ------
        ValueError
            A grid that starts elsewhere, goes too far, or leaves out a measurement time; a
            measurement at another time.
        """
        clock = self.clock.prolonged(times[-1], self.cycle) if self.cycle else self.clock
        wanted = np.array(clock.times)
        wanted = wanted[wanted <= times[-1] + clock.tolerance]
        if not clock.same(times[0], clock.times[0]):
            raise ValueError(
                f"times: wanted to begin at {when(clock.times[0])}, got {when(times[0])}"
            )
        if times[-1] > self.horizon + clock.tolerance:
            raise ValueError(
                f"times: wanted at most {when(self.horizon)}, where the design ends, got "
                f"{when(times[-1])}; seedslib.design.stationary makes it go on"
            )
        place = clock.rows(times)[: len(wanted)]
        if (place < 0).any():
            raise ValueError(
                f"times: wanted all measurement times of the design, {when(wanted[place < 0][0])} "
                "is not among them"
            )
        index = np.full(len(times), -1)
        index[place] = np.arange(len(wanted))
        for j in np.flatnonzero(index < 0):
            if not np.isnan(y[j]).all():
                raise ValueError(
                    f"measurements: wanted NaN at {when(times[j])}, which is no measurement time "
                    "of the design"
                )
        return index

    def admitted(
        self, y: ArrayLike, indicator: ArrayLike | None, batch: tuple[int, ...], k: int
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | bool]:
        """Measurement k (m, *batch), its indicator (*batch), and where it has a gap, checked.

        Raises
        ------
        TypeError, ValueError
            A wrong shape, an infinite measurement, an indicator out of range; a component that
            the schedule leaves out.
        """
        whole = type(y) is np.ndarray and y.dtype == np.float64 and np.isfinite(y).all()
        y = y.copy() if whole else as_real("y", y, nan=True)  # it may be remembered
        wanted = (self.system.measurement_size, *batch)
        if y.shape != wanted:
            raise ValueError(f"y: wanted shape {wanted}, got {y.shape}")
        if indicator is not None or self.system.indicators:
            if indicator is not None:
                indicator = np.asarray(indicator)[None]
            indicator = as_indicators(indicator, self.system, (1, *batch), "indicator")
        rows = expected(self, np.array([k]))
        if whole and indicator is rows is None:
            return y, None, False
        gap = missing("y", y[None], indicator, rows)[0]
        return y, None if indicator is None else indicator[0], gap

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
            Values of the inputs that the model mentions. Those of the design are wanted: its
            forecasts have them in their numbers.
        covariances : bool
            Whether `cov` is wanted.
        workers : int
            Threads over blocks of records.

        Returns
        -------
        Estimates
            ``mean`` (J+1, n', *batch), at measurement times after the correction and between
            them the forecasts; ``diverged`` (*batch), estimates that are not finite, or what no
            mode can have shown; with modes ``modes`` (J+1, *batch) and, where they are known,
            ``mode_prob`` (J+1, L, *batch). Filters of moments have ``loglik`` (J+1, *batch), zero
            between measurements, and ``cov`` (J+1, n', n', *batch); filters of output functions
            have no likelihoods, and the unconditional ``cov`` that the design found,
            (J+1, n', n') where no record has a gap. NaN is what a design does not know: ``cov``
            between measurement times, and from a gap that it was not told of, `loglik` after it.

        Raises
        ------
        TypeError, ValueError
            Times that do not increase or leave out a measurement time of the design; a
            measurement where the design has none; a missing one that the memory wants; infinite
            measurements; wrong shapes.

        Warns
        -----
        UserWarning
            Records with gaps, of a filter that was designed: how many, and from which time;
            covariances that had to be mended.
        """
        times, y = self.record(times, measurements)
        batch = y.shape[2:]
        told = as_indicators(indicators, self.system, (len(times), *batch))
        trajectory = as_trajectory(self.system, inputs, len(times), batch)
        index = self.placed(times, y)
        known = self.memory is not None
        lost = dropouts(y, index >= 0, told, expected(self, index)) if known else None
        tail = (y[0, 0].size,) if batch or not self.alone else ()
        y = y.reshape(*y.shape[:2], *tail)
        told = None if told is None else told.reshape(len(times), *tail)
        whole = Estimates(
            *[
                None if size is None else np.empty((len(times), *size, *tail), kind)
                for size, kind in zip(self.sizes(covariances), DTYPES, strict=True)
            ]
        )

        def work(a, b, _):
            parts = (None if part is None else part[..., a:b] for part in (*whole, y, told))
            *rows, shown, seen = parts
            own = trajectory.of(slice(a, b))
            return self.fill(Estimates(*rows), times, index, shown, seen, own)

        if tail:
            raised = sum(in_blocks(work, *tail, 0, workers=workers))
        else:
            raised = self.fill(whole, times, index, y, told, trajectory)
        found = whole
        if tail != batch:
            found = Estimates(
                *(p if p is None else p.reshape(*p.shape[:-1], *batch) for p in whole)
            )
        found = self.finish(found, ~np.isfinite(found.mean).all(axis=(0, 1)), index)
        if not covariances and found.cov is not None:
            found = found._replace(cov=None)
        warn_of_mended(raised)
        return unclaimed(found, lost, times)
