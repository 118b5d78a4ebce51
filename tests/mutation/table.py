"""The committed tables of the mutation test."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import NamedTuple

import yaml
from mutants import ROOMS, ROOT, Mutant, files_of, fingerprint, mutants_of
from runner import Outcome

MUTANTS = ROOT / "benchmarks" / "mutants.csv"
FILES = ROOT / "benchmarks" / "mutants_files.csv"
FAULTS = ROOT / "benchmarks" / "mutants_faults.csv"
SUMMARY = ROOT / "benchmarks" / "mutants_rooms.csv"
SURVIVORS = ROOT / "benchmarks" / "mutants_survived.csv"
DRAWS = {1: (0, 60), 2: (300, 400), 3: (500, 600)}
"""The last one that a room has is fresh, and tells; of earlier ones survivors have been read."""

EQUIVALENT = Path(__file__).with_name("equivalent.yml")


class Score(NamedTuple):
    """Mutants of a draw: all, those that nothing can tell from the original, those caught."""

    tried: int
    equivalent: int
    killed: int

    def words(self) -> list[str]:
        """The numbers, and the share of those that could be caught, in per cent."""
        share = 100.0 * self.killed / max(1, self.tried - self.equivalent)
        return [*map(str, self), f"{share:.1f}"]


@dataclass(frozen=True)
class Row:
    """One mutant of a draw and what became of it."""

    room: str
    draw: int
    file: str
    function: str
    operator: str
    before: str
    after: str
    verdict: str
    by: str
    key: str


def row(room: str, draw: int, m: Mutant, outcome: Outcome) -> Row:
    """The row of a mutant; pieces of text are shortened."""
    text = (ROOT / "seedslib" / m.file).read_text()
    before = " ".join(text[m.start : m.stop].split())[:80]
    after = " ".join(m.after.split())[:80]
    told = (outcome.verdict, outcome.by, m.key)
    return Row(room, draw, m.file, m.function, m.operator, before, after, *told)


def read() -> list[Row]:
    """Rows of the committed table."""
    if not MUTANTS.exists():
        return []
    with MUTANTS.open(newline="") as file:
        return [Row(**{**found, "draw": int(found["draw"])}) for found in csv.DictReader(file)]


def write(rows: list[Row]) -> None:
    """Write rows by room and key."""
    order = list(ROOMS)
    rows = sorted(rows, key=lambda r: (order.index(r.room), r.draw, r.key))
    with MUTANTS.open("w", newline="") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(Row)], lineterminator="\n")
        writer.writeheader()
        writer.writerows(map(asdict, rows))


def write_files() -> None:
    """Write how many mutants each file has, and the fingerprint of its program."""
    with FILES.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["room", "file", "mutants", "fingerprint"])
        for room in ROOMS:
            for name in files_of(room):
                writer.writerow([room, name, len(mutants_of(name)), fingerprint(name)])


def fingerprints() -> dict[str, str]:
    """Fingerprint of each file when the table was written."""
    with FILES.open(newline="") as file:
        return {found["file"]: found["fingerprint"] for found in csv.DictReader(file)}


def equivalent() -> dict[str, str]:
    """Mutants that change nothing that can be seen, with the reason."""
    return yaml.safe_load(EQUIVALENT.read_text()) or {} if EQUIVALENT.exists() else {}


def score(rows: list[Row], room: str, draw: int) -> Score:
    """What became of the mutants of one draw in a room."""
    known = equivalent()
    here = [r for r in rows if r.room == room and r.draw == draw]
    alike = sum(r.key in known for r in here)
    survived = sum(r.verdict == "survived" and r.key not in known for r in here)
    return Score(len(here), alike, len(here) - alike - survived)


def fresh(rows: list[Row], room: str) -> int:
    """The last draw of a room."""
    return max((r.draw for r in rows if r.room == room), default=max(DRAWS))


def write_rooms() -> None:
    """Write the score of each room in its fresh draw, of all together, and what survived."""
    rows = read()
    populations = dict.fromkeys(ROOMS, 0)
    with FILES.open(newline="") as file:
        for found in csv.DictReader(file):
            populations[found["room"]] += int(found["mutants"])
    last = {room: fresh(rows, room) for room in ROOMS}
    scores = {room: score(rows, room, draw) for room, draw in last.items()}
    whole = Score(*map(sum, zip(*scores.values(), strict=True)))
    with SUMMARY.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["room", "mutants", "tried", "equivalent", "caught", "per cent"])
        for room, found in scores.items():
            writer.writerow([room, populations[room], *found.words()])
        writer.writerow(["all", sum(populations.values()), *whole.words()])
    known = equivalent()
    with SURVIVORS.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["room", "where", "what stands there", "instead", "why no test can tell"])
        for r in rows:
            if r.verdict == "survived" and r.draw == last[r.room]:
                where = f"`{r.file}` {r.function}"
                writer.writerow(
                    [r.room, where, f"`{r.before}`", f"`{r.after}`", known.get(r.key, "")]
                )


def killers(there: set[str]) -> Callable[[str], list[str]]:
    """Function that names tests to try on a file: those that caught mutants of it or its room.

    Of the tests that there are.
    """
    rows = [r for r in read() if r.by in there]
    rooms = {file: room for room in ROOMS for file in files_of(room)}

    def of(file: str) -> list[str]:
        near = [r.by for r in rows if r.file == file]
        near += [r.by for r in rows if r.room == rooms[file]]
        return list(dict.fromkeys(near))[:40]

    return of


def write_faults(found: list[tuple[Mutant, Outcome]]) -> None:
    """Write what caught each fault that was planted."""
    with FAULTS.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["fault", "file", "verdict", "by"])
        for m, outcome in sorted(found, key=lambda pair: pair[0].key):
            writer.writerow([m.function, m.file, outcome.verdict, outcome.by])
