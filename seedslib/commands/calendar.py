"""Times of a column as numbers: numbers as they are, dates in a unit, rows that are counted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from seedslib.commands.cells import as_number

UNITS = ("days", "hours", "seconds", "rows")


@dataclass(frozen=True)
class Calendar:
    """How times are written.

    Parameters
    ----------
    unit : {"days", "hours", "seconds", "rows"}, optional
        Of the model's time, where they are dates; with "rows" they are 0, 1, 2, ... whatever is
        written. None where they are numbers.
    epoch : datetime, optional
        The date that is zero.
    like : str
        A date as the column has it.
    """

    unit: str | None = None
    epoch: datetime | None = None
    like: str = ""

    def number(self, text: str) -> float:
        """Time that is written.

        Raises
        ------
        ValueError
            No date, or no number; a date with a zone among those without.
        """
        if self.epoch is None:
            return as_number(text, needed=True)
        try:
            return (_date(text) - self.epoch) / timedelta(**{self.unit or "days": 1})
        except TypeError:
            raise ValueError(f"wanted a zone in all dates or in none, got {text!r}") from None

    def written(self, t: float) -> str:
        """A time as the column would have it."""
        if self.epoch is None:
            return f"{t:.15g}"
        date = self.epoch + timedelta(**{self.unit or "days": t})
        if len(self.like) <= len("2020-01-31") and date.time() == datetime.min.time():
            return date.date().isoformat()
        text = date.isoformat(sep="T" if "T" in self.like else " ")
        return text.replace("+00:00", "Z") if self.like.endswith("Z") else text


def as_calendar(unit: str | None, epoch: str | None) -> Calendar:
    """Calendar from what was typed.

    Raises
    ------
    ValueError
        Another unit, no date, an epoch where nothing is a date.
    """
    known = (None, *UNITS) if epoch is None else UNITS[:3]
    if unit not in known:
        raise ValueError(f"unit: wanted one of {', '.join(filter(None, known))}; got {unit}")
    return Calendar(unit, None if epoch is None else _date(epoch, "epoch: "))


def read_times(
    cells: Sequence[str], calendar: Calendar, place: Callable[[int], str]
) -> tuple[np.ndarray, Calendar]:
    """Times of the cells of a column, shape (J,), and the calendar, which knows the first date.

    Parameters
    ----------
    cells : sequence of str, at least one
    calendar : Calendar
    place : callable
        Where cell k is, for messages.

    Raises
    ------
    ValueError
        A cell that is no time; dates without a unit.
    """
    if calendar.unit == "rows":
        return np.arange(float(len(cells))), calendar
    times = np.empty(len(cells))
    for k, cell in enumerate(cells):
        try:
            if calendar.unit is not None and not k:
                calendar = Calendar(calendar.unit, calendar.epoch or _date(cell), cell)
            times[k] = calendar.number(cell)
        except ValueError as error:
            way = "" if calendar.unit else f"; dates want --unit {'|'.join(UNITS)}"
            raise ValueError(f"{place(k)}: {error}{way}") from None
    return times, calendar


def _date(text: str, name: str = "") -> datetime:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(
            f"{name}wanted a date such as 2020-01-31 or 2020-01-31T12:00, got {text[:40]!r}"
        ) from None
