"""Write the references: ``python tests/references/make.py`` gives the same bytes each time.

With names of families only these are made again. All of them take about five minutes. The cases are
those of the table: to add one, add a row of its family, name, provenance and arguments.

Each value with 20 digits or more, the arguments it is for, where it comes from, what its error is
relative to, and its condition number: the relative change of the value, in units of that scale,
for a change of one part of each argument, added up over the arguments.
"""

import csv
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mpmath as mp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from references import (  # noqa: F401
    covariances,
    errors,
    filters,
    high,
    means,
    modes,
    motion,
    regions,
)
from references.high import STEP
from references.record import STEPS

FILE = Path(__file__).with_name("values.csv")
COLUMNS = ["family", "case", "quantity", "value", "scale", "condition", "provenance", "arguments"]


def raised(arguments: Any) -> Any:
    """Arguments with each float as a number of high precision; whole numbers stay."""
    if isinstance(arguments, dict):
        return {name: raised(part) for name, part in arguments.items()}
    if isinstance(arguments, list):
        return [raised(part) for part in arguments]
    return mp.mpf(arguments) if isinstance(arguments, float) else arguments


def shifted(arguments: Any, place: list[Any]) -> Iterator[Any]:
    """Arguments with each nonzero float, in turn, larger by a small part of itself."""
    part = arguments
    for key in place:
        part = part[key]
    if isinstance(part, dict | list):
        for key in part if isinstance(part, dict) else range(len(part)):
            yield from shifted(arguments, [*place, key])
    elif isinstance(part, float) and part and abs(part) < 1e299:
        moved = raised(arguments)
        inner = moved
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] *= 1 + STEP
        yield moved


def number(value: Any) -> tuple[Any, Any]:
    return value if isinstance(value, tuple) else (value, abs(value))


def rows(name: str, case: str, arguments: dict) -> list[list[str]]:
    """The rows of one case."""
    mp.mp.dps = high.DIGITS
    made = high.FAMILIES[name]
    values = {k: number(v) for k, v in made.values(**raised(arguments)).items()}
    condition: dict[str, Any] = dict.fromkeys(values, mp.mpf(0))
    moves = list(shifted(arguments, []))
    if made.provenance == "recursion" and "offset" in arguments:  # each measurement as well
        moves += [raised(arguments) | {"nudge": k} for k in range(STEPS + 1)]
    for moved in moves if made.sensitive else ():
        try:
            found = made.values(**moved)
            changes = {k: abs(number(v)[0] - values[k][0]) for k, v in found.items()}
        except (ValueError, AssertionError, TypeError):
            changes = dict.fromkeys(values, mp.inf)  # no distribution any more: singular
        for k in values:
            condition[k] += changes[k] / STEP / values[k][1]
    return [
        [
            name,
            case,
            k,
            mp.nstr(value, 25, min_fixed=0, max_fixed=0),
            mp.nstr(scale, 6, min_fixed=0, max_fixed=0),
            mp.nstr(condition[k], 2) if made.sensitive else "",
            made.provenance,
            json.dumps(arguments),
        ]
        for k, (value, scale) in values.items()
    ]


def main() -> None:
    only = set(sys.argv[1:]) or set(high.FAMILIES)
    table: dict[tuple[str, str], list[list[str]]] = {}
    with FILE.open(newline="") as file:
        for row in list(csv.reader(file))[1:]:
            table.setdefault((row[0], row[1]), []).append(row)
    for name, case in table:
        if name in only:
            print(name, case, flush=True)
            table[name, case] = rows(name, case, json.loads(table[name, case][0][-1]))
    with FILE.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(row for case in table.values() for row in case)


if __name__ == "__main__":
    main()
