"""What a filter says, as a table: estimates, intervals, forecasts of measurements."""

from __future__ import annotations

import csv
import io
import math
from os import PathLike
from typing import Any

import numpy as np

from seedslib.base import assigned
from seedslib.base.atomic import write_whole
from seedslib.commands.records import Record
from seedslib.commands.words import in_steps_of
from seedslib.filters.estimates import Estimates
from seedslib.models.kinds import UNEVEN


def prolonged(record: Record, count: int | None, until: str | None, every: float | None) -> Record:
    """A record with further times at which nothing is measured, so that a filter forecasts.

    Parameters
    ----------
    record : Record
    count : int, optional
        How many.
    until : str, optional
        Up to this time, as the record writes times.
    every : float, optional
        The step; without it that of the record.

    Raises
    ------
    ValueError
        Both a count and an end, an end before that of the record, a step that is not positive, no
        step where those of the record differ.
    """
    if count is None and until is None and every is None:
        return record
    if (count is None) == (until is None) or (count is not None and count < 1):
        raise ValueError("forecast: wanted a positive number of steps, or --until, one of the two")
    if record.inputs:
        raise ValueError("forecast: wanted rows without measurements in the table, with inputs")
    last, steps = float(record.times[-1]), np.diff(record.times)
    if every is None:
        if not len(steps) or np.ptp(steps) > UNEVEN * steps.min():
            raise ValueError("every: wanted the step of the forecasts, for the record has no one")
        every = (last - float(record.times[0])) / len(steps)
    if not 0 < every < math.inf:
        raise ValueError(f"every: wanted a positive step, got {every:g}")
    if until is None:
        times = last + every * np.arange(1, (count or 0) + 1)
    else:
        try:
            times = in_steps_of(last, record.calendar.number(until), every)[1:]
        except ValueError as error:
            raise ValueError(f"until: {error}") from None
    empty = np.full((len(times), record.measurements.shape[1]), np.nan)
    seen, calendar = record.indicators, record.calendar
    if seen is not None:
        seen = np.concatenate([seen, np.full(len(times), -1)])
    if calendar.unit == "rows":
        cells = [f"+{t - last:g}" for t in times]
    else:
        cells = [calendar.written(t) for t in times.tolist()]
    return record._replace(
        times=np.concatenate([record.times, times]), indicators=seen,
        measurements=np.concatenate([record.measurements, empty]), cells=[*record.cells, *cells],
    )  # fmt: skip


def expected_measurements(filter: Any, record: Record) -> Estimates | None:
    """What a filter expects of each measurement from those before, or None where it cannot say.

    Returns
    -------
    Estimates
        ``mean`` (J, m) and ``cov`` (J, m, m), NaN where it does not know: between the measurement
        times of a design, after a gap, while the state depends on numbers that nothing has told.
    """
    if not hasattr(filter, "expect"):
        return None
    times, y = record.times, record.measurements
    designed = getattr(filter, "memory", None) is not None
    at = filter.placed(times, y) if designed else range(len(times))
    mean, cov = np.full_like(y, np.nan), np.full((*y.shape, y.shape[1]), np.nan)
    state, before = filter.initial(), 0
    for k, place in enumerate(at):
        if place < 0:
            continue
        with assigned({u: value[before] for u, value in record.inputs.items()}):
            state = filter.predict(state, times[k])
        before = k
        said = filter.report(state)
        with assigned({u: value[k] for u, value in record.inputs.items()}):
            # where something is unknown, a state given it says nothing of measurements
            if np.array_equal(said.mean, state.mean) and not np.isinf(said.cov).any():
                mean[k], _, cov[k] = filter.expect(state)
            state = filter.correct(state, y[k])
    return Estimates(mean, cov)


def write_estimates(
    path: str | PathLike[str], record: Record, found: Estimates, *,
    level: float | None = None, expected: Estimates | None = None,
) -> None:  # fmt: skip
    """Write the times as they came in, ``x1,...,xn`` and deviations ``sd1,...`` where claimed.

    With modes ``mode,p1,...,pL`` stand before ``x1``: the decided mode, from 0 on, and the
    probabilities of the modes. With a level ``x1_low,x1_high,...`` follow, and with expected
    measurements ``y1,y1_low,y1_high,...``.

    Parameters
    ----------
    path : path-like
    record : Record
    found : Estimates
        Of one record: mean (J, n), cov (J, n, n) or None. What is no number is an empty cell.
    level : float, optional
        Probability of the intervals.
    expected : Estimates, optional
        See `expected_measurements`.

    Raises
    ------
    ValueError
        A level that is not between 0 and 1, or no covariances for the intervals.
    """
    n = found.mean.shape[1]
    columns: dict[str, np.ndarray] = {}
    if found.mode_prob is not None:
        columns |= {f"p{i + 1}": part for i, part in enumerate(found.mode_prob.T)}
    columns |= {f"x{i + 1}": part for i, part in enumerate(found.mean.T)}
    if found.cov is not None:
        variances = np.diagonal(found.cov, axis1=1, axis2=2)
        deviations = np.sqrt(np.maximum(variances, 0.0))
        columns |= {f"sd{i + 1}": deviations[:, i] for i in range(n)}
    if level is not None:
        columns |= _intervals("x", found, level)
        if expected is not None:
            bounds = _intervals("y", expected, level)
            for i, part in enumerate(expected.mean.T):
                columns[f"y{i + 1}"] = part
                columns |= {f"y{i + 1}_{end}": bounds[f"y{i + 1}_{end}"] for end in ENDS}
    rows = [
        [repr(value) if math.isfinite(value) else "" for value in row]
        for row in np.stack(list(columns.values()), axis=1).tolist()
    ]
    names = list(columns)
    if found.modes is not None:
        names.insert(0, "mode")
        known = np.isfinite(found.mean).all(axis=1)
        for row, mode, good in zip(rows, found.modes.tolist(), known, strict=True):
            row.insert(0, str(mode) if good else "")
    lines = [[record.name, *names]]
    lines += [[cell, *row] for cell, row in zip(record.cells, rows, strict=True)]
    write_whole(path, _as_csv(lines))


ENDS = ("low", "high")


def _intervals(name: str, found: Estimates, level: float) -> dict[str, np.ndarray]:
    with np.errstate(invalid="ignore"):
        bounds = found.interval(level)
    size = found.mean.shape[1]
    return {
        f"{name}{i + 1}_{end}": bounds[k][:, i] for i in range(size) for k, end in enumerate(ENDS)
    }


def _as_csv(lines: list[list[str]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue().encode()
