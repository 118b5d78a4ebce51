"""Tables in text files: their separator, their rows, their columns, numbers in their cells."""

from __future__ import annotations

import csv
import io
import math
import re
from pathlib import Path
from typing import NamedTuple

MISSING = ("", "NA")
"""What stands in a cell without a number, beside NaN in whatever letters."""


class TextTable(NamedTuple):
    """Names of the columns, and of each further row its number in the file and its cells."""

    path: Path
    header: list[str]
    numbers: list[int]
    rows: list[list[str]]

    @property
    def shown(self) -> str:
        """The first row, for messages."""
        return ",".join(self.header)[:60] or "an empty file"

    def place(self, row: int, column: int) -> str:
        """Where a cell is, for messages."""
        return f"{self.path}, row {self.numbers[row]}, column {self.header[column]}"

    def column(self, name: str) -> int:
        """Number of a column.

        Raises
        ------
        ValueError
            None of this name, or two.
        """
        if self.header.count(name) != 1:
            raise ValueError(f"{self.path}: wanted one column called {name}, got {self.shown}")
        return self.header.index(name)


def read_table(path: str | Path) -> TextTable:
    """Table of a file with a row of names and at least one further row.

    The separator is the first of tab, semicolon and comma that the first line has. Blank lines are
    passed over, and spaces about a cell dropped.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        No such table; the message names the row, counted as in the file.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text file in UTF-8") from None
    first = text.partition("\n")[0]
    separator = next((mark for mark in "\t;" if mark in first), ",")
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
        lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if row]
    except csv.Error as error:
        raise ValueError(f"{path}: not a CSV file ({error})") from None
    header = lines[0][1] if lines else []
    for number, row in lines[1:]:
        if len(row) != len(header):
            raise ValueError(f"{path}, row {number}: wanted {len(header)} cells, got {len(row)}")
    return TextTable(path, header, [n for n, _ in lines[1:]], [row for _, row in lines[1:]])


def as_number(cell: str, *, needed: bool = False) -> float:
    """Number of a cell, NaN where it is missing.

    Raises
    ------
    ValueError
        Something else; infinite, or missing where it is needed.
    """
    if cell in MISSING and not needed:
        return math.nan
    try:
        if "_" in cell:  # a number in Python, and in no table
            raise ValueError
        value = float(cell or "nan")
    except ValueError:
        comma = re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", cell)
        point = " with a decimal point" * bool(comma)
        raise ValueError(f"wanted a number{point}, got {cell[:40]!r}") from None
    if math.isinf(value) or (needed and math.isnan(value)):
        raise ValueError(f"wanted a finite number, got {cell[:40]!r}")
    return value
