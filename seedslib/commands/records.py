"""Records of measurements in tables: which columns they are, held against a filter."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.commands.calendar import Calendar, as_calendar, read_times
from seedslib.commands.cells import TextTable, as_number, read_table
from seedslib.models.kinds import inputs_of, switches


class Record(NamedTuple):
    """Times (J,), measurements (J, m) and, where there are any, indicators (J,).

    ``name`` and ``cells`` (J,) are the column of the times as it came in; ``inputs`` (J,) each are
    what the model is told.
    """

    times: np.ndarray
    measurements: np.ndarray
    indicators: MaybeArray = None
    name: str = "t"
    cells: Sequence[str] = ()
    calendar: Calendar = Calendar()
    inputs: Mapping[Any, np.ndarray] = {}


def read_record(path: str, filter: Any, options: argparse.Namespace) -> Record:
    """Record of a file for a filter; of a designed one, checked against the design.

    With neither `--columns` nor `--time` the first row is ``t,y1,...,ym``, and ``j`` for a system
    with an indicator. A missing measurement or indicator is an empty cell, NA or NaN; rows without
    any ask for a forecast, of a designed filter without modes also between its measurement times.

    Parameters
    ----------
    path : str
    filter : Filter
    options : argparse.Namespace
        With ``columns``, ``time``, ``unit``, ``epoch`` and ``inputs``, as they were typed.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        Not such a file; the message names the row, counted as in the file.
    """
    system, table = filter.system, read_table(path)
    m, told = system.measurement_size, getattr(system, "indicators", 0)
    wanted = [*(f"y{i + 1}" for i in range(m)), *["j"] * bool(told)]
    told_by = _input_columns(table, options.inputs, system)
    time, places = _places(table, wanted, told_by.values(), options.time, options.columns)
    if not table.rows:
        raise ValueError(f"{path}: wanted a row for each measurement, got none")
    cells = [row[time] for row in table.rows]
    times, calendar = read_times(
        cells, as_calendar(options.unit, options.epoch), lambda k: table.place(k, time)
    )
    for k in range(1, len(times)):
        if not times[k] > times[k - 1]:
            raise ValueError(
                f"{table.place(k, time)}: wanted a time after {cells[k - 1]}, got {cells[k]}"
            )
    values = np.array([[_cell(table, k, c) for c in places] for k in range(len(cells))])
    if getattr(filter, "memory", None) is not None:
        measured = switches(system) | ~np.isnan(values).all(axis=1)
        _check_times(table, times, measured, filter)
    indicators = _indicators(table, places[-1], values[:, -1], told) if told else None
    name = table.header[time]
    rows = range(len(cells))
    inputs = {u: np.array([_cell(table, k, c) for k in rows]) for u, c in told_by.items()}
    return Record(times, values[:, :m], indicators, name, cells, calendar, inputs)


def times_of_column(text: str, unit: str | None, epoch: str | None) -> np.ndarray:
    """Times of ``FILE.csv``, whose column is called t, or of ``FILE.csv:column``, shape (J,).

    Raises
    ------
    OSError, ValueError
        No such file or column, cells that are no times.
    """
    path, _, name = text.partition(":")
    table = read_table(path)
    column = table.column(name or "t")
    if not table.rows:
        raise ValueError(f"{path}: wanted a row for each time, got none")
    cells = [row[column] for row in table.rows]
    return read_times(cells, as_calendar(unit, epoch), lambda k: table.place(k, column))[0]


def _input_columns(table: TextTable, chosen: str | None, system: Any) -> dict[Any, int]:
    """Columns of the inputs that a model mentions."""
    known = {str(u): u for u in inputs_of(system)}
    parts = [part.partition("=") for part in next(csv.reader([chosen or ""]))]
    names = {name: column for name, _, column in parts}
    if names.keys() != known.keys():
        such = ",".join(f"{name}=COLUMN" for name in sorted(known)) or "none"
        raise ValueError(f"inputs: wanted {such}, those of the model; got {chosen}")
    return {known[name]: table.column(column) for name, column in names.items()}


def _places(
    table: TextTable, wanted: list[str], others: Iterable[int], time: str | None, chosen: str | None
) -> tuple[int, list[int]]:
    """Columns of the time and of what is wanted."""
    path = table.path
    header = [name for c, name in enumerate(table.header) if c not in others]
    if time is None and chosen is None:
        if header != ["t", *wanted]:
            raise ValueError(
                f"{path}: wanted the first row {','.join(['t', *wanted])}, got "
                f"{table.shown}; or choose with --time and --columns"
            )
        return table.column("t"), [table.column(name) for name in wanted]
    at = table.column(time or "t")
    if chosen is None:
        names = [name for name in header if name != table.header[at]]
        if len(names) != len(wanted):
            raise ValueError(
                f"{path}: wanted a column for {', '.join(wanted)} beside {table.header[at]}, got "
                f"{','.join(names)[:60]}; choose with --columns"
            )
    else:
        names = next(csv.reader([chosen]))
        pairs = dict(name.split("=", 1) for name in names if "=" in name)
        if pairs.keys() == set(wanted):
            names = [pairs[name] for name in wanted]
        elif len(names) != len(wanted) or pairs.keys() & set(wanted):
            such = ",".join(f"{name}=COLUMN" for name in wanted)
            raise ValueError(
                f"columns: wanted {such}, or {len(wanted)} names in this order; got {chosen}"
            )
    return at, [table.column(name) for name in names]


def _cell(table, row, column):
    try:
        return as_number(table.rows[row][column])
    except ValueError as error:
        raise ValueError(f"{table.place(row, column)}: {error}") from None


def _indicators(table, column, values, count):
    """Whole numbers, -1 for a missing one."""
    seen = np.where(np.isnan(values), -1.0, values)
    for k, (value, given) in enumerate(zip(seen, values, strict=True)):
        if value not in range(0 if value == given else -1, count):
            raise ValueError(
                f"{table.place(k, column)}: wanted an indicator j from 0 to {count - 1}, got "
                f"{given:g}"
            )
    return seen.astype(int)


def _check_times(table, times, measured, designed):
    """Refuse a row at a time that the design does not know, and measurement times left out."""
    clock, tolerance = designed.times, designed.clock.tolerance
    horizon = getattr(designed, "horizon", clock[-1])
    lasting = designed.cycle > 0
    due = 0
    for j, (number, t) in enumerate(zip(table.numbers, times, strict=True)):
        place = f"{table.path}, row {number}"
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
