"""What all filters do that a design has made: their measurements are checked, their records run."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_real, as_times, is_whole
from seedslib.base.clock import Clock
from seedslib.base.values import Course, Inputs, on_paths
from seedslib.designed.gaps import check_schedule, dropouts, expected, missing, unclaimed
from seedslib.designed.guards import positions, warn_of_mended
from seedslib.designed.memory import Memory
from seedslib.designed.shapes import check_errors, check_times
from seedslib.filters.base import Estimates, Filter, as_indicators, as_record
from seedslib.models.kinds import course_of
from seedslib.models.simulation import Schedule

if TYPE_CHECKING:
    from typing import Self

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

    @property
    def reach(self) -> tuple[float, float]:
        """First and last time that the design looked at."""
        end = self.times[-1] if self.cycle else getattr(self, "horizon", self.times[-1])
        return float(self.times[0]), float(end)

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
        )  # fmt: skip

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
        check_schedule(self)
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
        self, rows: Estimates, times: np.ndarray, index: np.ndarray, y: np.ndarray,
        indicators: np.ndarray | None, held: Course,
    ) -> int:  # fmt: skip
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
        held : Course
            Inputs at these times.

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
        """Number of the measurement at each time, -1 where there is none, shape (J+1,)."""
        clock = self.clock.prolonged(times[-1], self.cycle) if self.cycle else self.clock
        return positions(times, y, clock, self.horizon)

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
        self, times: ArrayLike, measurements: ArrayLike, *, indicators: ArrayLike | None = None,
        inputs: Inputs | None = None, covariances: bool = False, workers: int = 1,
    ) -> Estimates:  # fmt: skip
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
        course = course_of(self.system, inputs, len(times), batch)
        index = self.placed(times, y)
        known = self.memory is not None
        lost = dropouts(y, index >= 0, told, expected(self, index)) if known else None
        tail = (y[0, 0].size,) if batch or not self.alone else ()
        y = y.reshape(*y.shape[:2], *tail)
        told = None if told is None else told.reshape(len(times), *tail)
        whole = Estimates(*[
            None if size is None else np.empty((len(times), *size, *tail), kind)
            for size, kind in zip(self.sizes(covariances), DTYPES, strict=True)
        ])  # fmt: skip

        def work(a, b, _):
            parts = (None if part is None else part[..., a:b] for part in (*whole, y, told))
            *rows, shown, seen = parts
            with on_paths(batch, slice(a, b)) if batch else nullcontext():
                held = course.of(slice(a, b))
                return self.fill(Estimates(*rows), times, index, shown, seen, held)

        if tail:
            raised = sum(in_blocks(work, *tail, 0, workers=workers))
        else:
            raised = self.fill(whole, times, index, y, told, course)
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
