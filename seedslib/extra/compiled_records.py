"""Whole records of a filter whose steps are C."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import BLOCK, in_blocks
from seedslib.base.values import Inputs, current
from seedslib.designed.base import DesignedFilter
from seedslib.extra.c.driver import REFUSED, side_by_side
from seedslib.filters.base import Estimates, Filter, as_indicators
from seedslib.models.kinds import course_of


class CompiledRecords(Filter):
    """Runs of whole records, many side by side; a `CompiledFilter` sets the attributes.

    Attributes
    ----------
    filter : Filter
        The one that was compiled.
    """

    filter: Any
    _twin: Any
    _whole: Any
    _inputs: list[Any]

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
        """Filter a record, or many at once; arguments, results and errors as of the filter."""
        if isinstance(self.filter, DesignedFilter):
            return self._twin.run(
                times,
                measurements,
                indicators=indicators,
                inputs=inputs,
                covariances=covariances,
                workers=workers,
            )
        times, y = self.filter.record(times, measurements)
        as_indicators(indicators, self.system, (len(times), *y.shape[2:]))
        batch, n = y.shape[2:], self.filter.n
        told = self._course(inputs, len(times), batch)
        y = y.reshape(*y.shape[:2], -1)
        parts = [np.empty((len(times), *size, y.shape[2])) for size in ((n,), (n, n), ())]
        found = Estimates(*parts[:2], loglik=parts[2])

        def work(a, b, _):
            rows = (None if part is None else part[..., a:b] for part in found)
            given = None if told is None else told[..., a:b]
            index = np.zeros(len(times), int)
            self._fill(Estimates(*rows), times, index, y[..., a:b], None, given=given)

        in_blocks(work, y.shape[2], 0, workers=workers, block=4 * BLOCK)
        finite = np.isfinite(found.mean[-1]).all(axis=0) & np.isfinite(found.cov[-1]).all((0, 1))
        with np.errstate(invalid="ignore"):
            lost = ~finite | (np.abs(found.mean) > self.filter.bound).any(axis=(0, 1))
        parts = (p if p is None else p.reshape(*p.shape[:-1], *batch) for p in found)
        return Estimates(*parts)._replace(diverged=lost.reshape(batch))

    def _course(self, inputs: Inputs | None, count: int, batch: tuple[int, ...]) -> Any:
        """Inputs that C is told, (K+1, inputs, records), or None."""
        course = course_of(self.filter.system, inputs, count, batch)
        if not self._inputs:
            return None
        rows = []
        for p in self._inputs:
            row = course.values.get(p)
            if row is None:  # one that is assigned is the same at all times
                row = current([p])[0]
            elif row.ndim == 1:
                row = row.reshape(count, *(1,) * len(batch))
            rows.append(np.broadcast_to(row, (count, *batch)).reshape(count, -1))
        return np.stack(rows, axis=1)

    def _fill(
        self,
        rows: Estimates,
        times: Any,
        index: Any,
        y: Any,
        indicators: Any,
        held: object = None,
        given: Any = None,
    ) -> int:
        """Run over a block of records, see `DesignedFilter.fill`."""
        alone = y.ndim == 2
        count, wide = (1, 1) if alone else (y.shape[2], rows.mean.strides[1] // 8)
        y = side_by_side(y, wide, alone)
        told = indicators
        if told is not None:
            told = side_by_side(told.astype(np.int64, copy=False), wide, alone)
        times, index = np.ascontiguousarray(times), np.ascontiguousarray(index, dtype=np.int64)
        given = None if given is None else side_by_side(given, wide, alone)
        parts = (
            times,
            index,
            y,
            told,
            rows.mean,
            rows.cov,
            rows.loglik,
            rows.mode_prob,
            rows.modes,
            given,
        )
        if rows.modes is not None and rows.modes.dtype != np.int64:
            raise TypeError("modes: wanted 64-bit integers")
        places = [None if part is None else part.ctypes.data for part in parts]
        if code := self._whole(count, wide, len(times), *places):
            raise ValueError(REFUSED[code])
        return 0
