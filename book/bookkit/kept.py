"""What a sweep keeps of each point, and the table of all of them.

A point is kept as its parameters, the values it recorded and the problem it met, with a checksum;
what was changed by hand, or is of another point, is refused when it is read.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bookkit import fingerprint
from bookkit.files import replace
from bookkit.recording import plain, read_records

PROBLEM = "problem"


def read_entry(out: Path, key: str, point: Mapping[str, Any]) -> dict[str, Any] | None:
    """What is kept of a point; None when there is nothing, or nothing whole.

    Raises
    ------
    ValueError
        A file that is whole and not what a sweep writes there: of another point, changed by hand,
        or with values that no notebook records.
    """
    path = out / f"{key}.json"
    try:
        entry = json.loads(path.read_text())
        if not (isinstance(entry["values"], dict) and isinstance(entry["problem"], str)):
            return None
    except (FileNotFoundError, ValueError, TypeError, KeyError, RecursionError):
        return None
    if entry.get("parameters") != json.loads(json.dumps(dict(point))):
        raise ValueError(f"{path}: wanted the point {dict(point)}, got another; remove the file")
    if entry != sealed(entry):
        raise ValueError(f"{path}: was changed after the point was run; remove the file")
    try:
        for name, value in entry["values"].items():
            plain(name, value)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{path}: {error}; remove the file") from None
    return entry


def sealed(entry: Mapping[str, Any]) -> dict[str, Any]:
    """What is kept of a point, with its checksum."""
    parts = {name: entry.get(name) for name in ("parameters", "values", "problem")}
    return {**parts, "checksum": fingerprint.digest(json.dumps(parts))}


def entry_of(point: Mapping[str, Any], result: Mapping[str, Any]) -> dict[str, Any]:
    """What is kept of a point that ran: its parameters, its values, its problem."""
    values: dict[str, Any] = {}
    problem = result["problem"]
    try:
        if result["notebook"]:
            values = read_records(json.loads(result["notebook"])).values
        names = [*columns_of(point), *(name for v in values for name in columns_of({v: values[v]}))]
        twice = [n for n in dict.fromkeys(names) if names.count(n) > 1 or n == PROBLEM]
        if twice:
            raise ValueError(f"{', '.join(twice)}: the name of another column of the table")
    except ValueError as error:
        values, problem = {}, problem or f"{type(error).__name__}: {error}"
    return sealed({"parameters": dict(point), "values": values, "problem": problem})


def write_table(path: Path, points: Mapping[str, dict], results: Mapping[str, dict | None]) -> None:
    rows = []
    for key, point in points.items():
        entry = results[key] or {"values": {}, "problem": "not run"}
        rows.append({**columns_of(point), **columns_of(entry["values"]), PROBLEM: entry["problem"]})
    names = list(dict.fromkeys(name for row in rows for name in row if name != PROBLEM))
    text = io.StringIO()
    writer = csv.DictWriter(text, [*names, PROBLEM], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    replace(path, text.getvalue())


def columns_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """One column per number: a list ``x`` becomes ``x_0``, ``x_1``, ..."""
    columns: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, list):
            columns |= {f"{name}_{index}": item for index, item in enumerate(value)}
        else:
            columns[name] = value
    return columns
