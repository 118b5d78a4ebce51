"""Records of measurements and of estimates as CSV files."""

from __future__ import annotations

import csv
import math
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.atomic import write_whole
from seedslib.filters.estimates import Estimates
from seedslib.models.kinds import switches


class Record(NamedTuple):
    """Times (J,), measurements (J, m) and, where there are any, indicators (J,)."""

    times: np.ndarray
    measurements: np.ndarray
    indicators: MaybeArray = None


def read_record(path: str | PathLike[str], designed: Any) -> Record:
    """Record of a file, checked against the design.

    The first row is ``t,y1,...,ym``, and ``j`` for a system with an indicator; then one row for
    each measurement time of the design up to some of them. An empty cell is a missing measurement
    or indicator; rows without any may stand at other times, where a forecast is wanted, but not
    for a switching system.

    Parameters
    ----------
    path : path-like
    designed : FiniteOrderFilter, SwitchingFilter or TableFilter

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        Not such a file; the message names the row, counted as in the file.
    """
    path, system = Path(path), designed.system
    switching, told, m = switches(system), system.indicators, system.measurement_size
    wanted = ["t", *(f"y{i + 1}" for i in range(m)), *["j"] * bool(told)]
    rows = _rows(path)
    if not rows or rows[0][1] != wanted:
        got = ",".join(rows[0][1]) if rows else "an empty file"
        raise ValueError(f"{path}: wanted the first row {','.join(wanted)}, got {got[:60]}")
    if len(rows) == 1:
        raise ValueError(f"{path}: wanted a row for each measurement, got none")
    numbers, cells = zip(*rows[1:], strict=True)
    table = np.array(
        [_numbers(path, n, row, len(wanted)) for n, row in zip(numbers, cells, strict=True)]
    )
    measured = switching | ~np.isnan(table[:, 1:]).all(axis=1)
    _check_times(path, numbers, table[:, 0], measured, designed)
    indicators = _indicators(path, numbers, table[:, -1], told) if told else None
    return Record(table[:, 0], table[:, 1 : m + 1], indicators)


def _indicators(path, numbers, values, count):
    """Whole numbers, -1 for a missing one."""
    seen = np.where(np.isnan(values), -1.0, values)
    for number, value, given in zip(numbers, seen, values, strict=True):
        if value not in range(0 if value == given else -1, count):
            raise ValueError(
                f"{path}, row {number}: wanted an indicator j from 0 to {count - 1}, got {given:g}"
            )
    return seen.astype(int)


def write_estimates(path: str | PathLike[str], times: np.ndarray, found: Estimates) -> None:
    """Write ``t,x1,...,xn`` and, where the filter claims any, standard deviations ``sd1,...``.

    With modes ``mode,p1,...,pL`` stand before ``x1``: the decided mode, from 0 on, and the
    probabilities of the modes.

    Parameters
    ----------
    path : path-like
    times : ndarray, shape (J,)
    found : Estimates
        Of one record: mean (J, n), cov (J, n, n) or None. Where it is NaN, between measurements,
        and where the filter diverged, the cell is empty.
    """
    n = found.mean.shape[1]
    columns, names = [times[:, None]], ["t"]
    if found.mode_prob is not None:
        columns.append(found.mode_prob)
        names += [f"p{i + 1}" for i in range(found.mode_prob.shape[1])]
    columns.append(found.mean)
    names += [f"x{i + 1}" for i in range(n)]
    if found.cov is not None:
        variances = np.diagonal(found.cov, axis1=1, axis2=2)
        columns.append(np.sqrt(np.maximum(variances, 0.0)))
        names += [f"sd{i + 1}" for i in range(n)]
    rows = [
        [repr(value) if math.isfinite(value) else "" for value in row]
        for row in np.concatenate(columns, axis=1).tolist()
    ]
    if found.modes is not None:
        names.insert(1, "mode")
        known = np.isfinite(found.mean).all(axis=1)
        for row, mode, good in zip(rows, found.modes.tolist(), known, strict=True):
            row.insert(1, str(mode) if good else "")
    lines = [",".join(row) for row in [names, *rows]]
    write_whole(path, ("\n".join(lines) + "\n").encode())


def _rows(path) -> list[tuple[int, list[str]]]:
    """Number and cells of each row that is not blank."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text file in UTF-8") from None
    except csv.Error as error:
        raise ValueError(f"{path}: not a CSV file ({error})") from None
    return [(number, row) for number, row in rows if row]


def _numbers(path, number, row, count) -> list[float]:
    if len(row) != count:
        raise ValueError(f"{path}, row {number}: wanted {count} cells, got {len(row)}")
    values = []
    for i, cell in enumerate(row):
        try:
            if "_" in cell:  # a number in Python, and in no table
                raise ValueError
            values.append(float(cell) if cell else math.nan)
        except ValueError:
            raise ValueError(f"{path}, row {number}: wanted a number, got {cell[:40]!r}") from None
        if math.isinf(values[-1]) or (i == 0 and math.isnan(values[0])):
            raise ValueError(f"{path}, row {number}: wanted a finite number, got {cell[:40]!r}")
    return values


def _check_times(path, numbers, times, measured, designed):
    """Refuse a row at a time that the design does not know, and measurement times left out."""
    clock, tolerance = designed.times, designed.clock.tolerance
    horizon = getattr(designed, "horizon", clock[-1])
    lasting = designed.cycle > 0
    due = 0
    for j, (number, t) in enumerate(zip(numbers, times, strict=True)):
        place = f"{path}, row {number}"
        if j and not t > times[j - 1]:
            raise ValueError(f"{place}: wanted a time after {times[j - 1]:.12g}, got {t:.12g}")
        if due < len(clock) and t > clock[due] + tolerance:
            raise ValueError(
                f"{place}: t = {t:.12g} comes after the measurement time {clock[due]:.12g} of the "
                "design, which has no row; a lost measurement is a row of empty cells"
            )
        if due < len(clock) and abs(t - clock[due]) <= tolerance:
            due += 1
        elif (measured[j] or due == 0 or t > horizon + tolerance) and not (
            lasting and due == len(clock)
        ):
            nearest = clock[np.abs(clock - t).argmin()]
            between = ""
            if not switches(designed.system):
                between = (
                    f"; rows without measurements may stand from {clock[0]:.12g} to {horizon:.12g}"
                )
            raise ValueError(
                f"{place}: t = {t:.12g} is no measurement time of the design (the nearest is "
                f"{nearest:.12g}){between}"
            )
