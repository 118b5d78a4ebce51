"""Enclosures beside what the library gives: errors that are proved, in exact fractions."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterator
from fractions import Fraction
from operator import itemgetter
from pathlib import Path
from typing import Any

from certified.library import numbers

HERE = Path(__file__).parent


def rows(name: str) -> list[dict[str, str]]:
    with (HERE / name).open(newline="") as file:
        return list(csv.DictReader(file))


def errors() -> Iterator[tuple[str, str, str, float]]:
    """Function, case, quantity, and the largest error that the enclosure allows, in its units."""
    found: dict[str, Any] = {}
    for row in rows("enclosures.csv"):
        if row["arguments"]:  # the first quantity of a case
            found = numbers(row["function"], json.loads(row["arguments"]))
        values = [Fraction(text) for text in row["values"].split()]
        units = [Fraction(text) for text in row["units"].split()] or [abs(v) for v in values]
        radius = Fraction(row["radius"])
        away = [
            (abs(Fraction(number) - value) + radius) / unit
            for number, value, unit in zip(found[row["quantity"]], values, units, strict=True)
        ]
        yield row["function"], row["case"], row["quantity"], float(max(away))


def summary() -> list[list[Any]]:
    """Largest proved error of each function, with its quantity, and the number of values."""
    count: Counter[str] = Counter()
    for row in rows("enclosures.csv"):
        count[row["function"]] += len(row["values"].split())
    found = [*errors()]
    table: list[list[Any]] = [["function", "values", "largest proved error", "it is that of"]]
    for name, values in count.items():
        _, _, quantity, error = max((row for row in found if row[0] == name), key=itemgetter(3))
        table.append([name, values, f"{error:.1e}", quantity])
    return table
