"""References beside what the library gives: errors in units of the scale that is stored."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from statistics import median
from typing import Any

HERE = Path(__file__).parent
Key = tuple[str, str, str]


def table(name: str) -> dict[Key, dict[str, str]]:
    """Rows of a table by family, case and quantity."""
    with (HERE / name).open(newline="") as file:
        return {(r["family"], r["case"], r["quantity"]): r for r in csv.DictReader(file)}


def found_errors(families: Iterable[str] | None = None) -> dict[Key, float]:
    """Errors of all values, or of those of some families; infinite for what is no number."""
    from references.library import CALLS

    told = table("values.csv")
    cases = {(family, case): row["arguments"] for (family, case, _), row in told.items()}
    errors: dict[Key, float] = {}
    for (family, case), arguments in cases.items():
        if families is None or family in families:
            for quantity, number in CALLS[family](**json.loads(arguments)).items():
                key = family, case, quantity
                errors[key] = error(number, told[key])
    return errors


def error(number: Any, row: dict[str, str]) -> float:
    """Distance from the reference in units of its scale."""
    try:
        exact = number if isinstance(number, Fraction) else Fraction(float(number))
    except (ValueError, OverflowError):
        return float("inf")
    return float(abs(exact - Fraction(row["value"])) / Fraction(row["scale"]))


def summary() -> list[tuple[str, int, float, float, str]]:
    """For each family: number of values, worst and median error, provenance."""
    told, measured = table("values.csv"), table("errors.csv")
    rows = []
    for family in dict.fromkeys(key[0] for key in told):
        errors = [float(row["error"]) for key, row in measured.items() if key[0] == family]
        provenance = next(row["provenance"] for key, row in told.items() if key[0] == family)
        rows.append((family, len(errors), max(errors), median(errors), provenance))
    return rows
