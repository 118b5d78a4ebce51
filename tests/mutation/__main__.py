"""Mutation test of the rooms that compute: ``python tests/mutation`` and one of its verbs."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from itertools import zip_longest
from pathlib import Path

import table
from gather import gathered, run
from mutants import ROOMS, ROOT, Mutant, files_of, fingerprint, planted, sample
from runner import Outcome, Touches, outcomes, preload

FOLDER = ROOT / "runs" / "mutation"
TOUCHES = FOLDER / "touches.json"
STAGES = ((2.0, 4), (10.0, 12), (60.0, 80))
"""Seconds of tests and modules of tests: nearest those of the line, then more, then of the file."""


def judge(found: list[Mutant], touches: Touches, note, stages: int = len(STAGES)) -> None:
    """Run mutants against more and more tests, until one fails or those of the file are through."""
    texts = {m.file: (ROOT / "seedslib" / m.file).read_text() for m in found}
    tried: dict[str, set[str]] = {m.key: set() for m in found}
    last: dict[str, Outcome] = {}
    left = found
    with tempfile.TemporaryDirectory() as folder:
        for k, (seconds, modules) in enumerate(STAGES[:stages]):
            survivors: list[Mutant] = []

            def jobs(left=left, seconds=seconds, modules=modules, k=k, survivors=survivors):
                for m in left:
                    near = touches.of(m.file, m.line, m.end)
                    tests = near if near and k < 2 else touches.of_file(m.file)
                    tests = [t for t in tests if t not in tried[m.key]]
                    tests = touches.chosen(tests, m.file.partition("/")[0], seconds, modules)
                    if not tests:
                        survivors.append(m)
                        continue
                    tried[m.key].update(tests)
                    limit = 10.0 + 6.0 * touches.spent(tests)
                    yield m, m.file, m.applied(texts[m.file]), tests, limit

            for m, outcome in outcomes(jobs(), Path(folder)):
                last[m.key] = Outcome(outcome.verdict, outcome.by, len(tried[m.key]))
                if outcome.verdict == "survived":
                    survivors.append(m)
                else:
                    note(m, last[m.key])
            left = survivors
    for m in left:
        note(m, Outcome("survived", "", len(tried[m.key])))


def command_run(args) -> int:
    """Run the draws of rooms; the table is written anew after each mutant."""
    touches, rows = Touches.read(TOUCHES, preload()), table.read()
    for room in args.rooms:
        found = sample(files_of(room), *table.DRAWS[args.draw])
        keys = {m.key for m in found}
        rows = [r for r in rows if (r.room, r.draw) != (room, args.draw) or r.key in keys]
        known = {r.key for r in rows if r.verdict in args.keep}
        todo = [m for m in found if m.key not in known]

        def note(m, outcome, room=room):
            nonlocal rows
            rows = [r for r in rows if r.key != m.key] + [table.row(room, args.draw, m, outcome)]
            table.write(rows)
            print(f"{outcome.verdict} {m.key} {m.file}:{m.line} {m.function} {m.operator} -> "
                  f"{m.after[:90]!r} {outcome.by[-60:]}", flush=True)  # fmt: skip

        judge(todo, touches, note, args.stages)
        print(f"{room}: {table.score(rows, room, args.draw)}", flush=True)
    table.write(rows)
    table.write_files()
    table.write_rooms()
    return 0


def command_faults(args) -> int:
    """Plant the faults written by hand, one by one; every one has to be caught."""
    touches, found, told = Touches.read(TOUCHES, preload()), planted(), []

    def note(m, outcome):
        told.append((m, outcome))
        print(outcome.verdict, m.function, outcome.by, flush=True)

    judge(found, touches, note)
    table.write_faults(told)
    return int(any(outcome.verdict == "survived" for _, outcome in told))


def command_sound(args) -> int:
    """Every test that caught a mutant passes in the same place where nothing is spoilt."""
    preload()
    left, failed = {row.by for row in table.read() if "::" in row.by}, set()
    file = files_of("models")[0]
    text = (ROOT / "seedslib" / file).read_text()
    with tempfile.TemporaryDirectory() as folder:
        while left:
            job = "", file, text, sorted(left), 10.0 * len(left)
            ((_, outcome),) = outcomes([job], Path(folder), 1)
            if outcome.verdict == "survived":
                break
            failed.add(outcome.by)
            print(f"{outcome.by}: {outcome.verdict} where nothing is spoilt", flush=True)
            left -= failed
    print(f"{len(failed)} tests fail where nothing is spoilt, {len(left)} pass")
    return int(bool(failed))


def command_changed(args) -> int:
    """A few mutants of every file that has changed since the table was written, in a given time."""
    known = table.fingerprints()
    changed = sorted(f for room in ROOMS for f in files_of(room) if known.get(f) != fingerprint(f))
    print(f"{len(changed)} files have changed since the table was written", flush=True)
    if not changed:
        return 0
    killers = table.killers(preload())
    ends, survived, tried = time.monotonic() + args.seconds, 0, 0

    def jobs():
        for found in zip_longest(*(sample([file], 0, args.each) for file in changed)):
            for m in filter(None, found):
                if time.monotonic() > ends:
                    return
                text = (ROOT / "seedslib" / m.file).read_text()
                yield m, m.file, m.applied(text), killers(m.file), 60.0

    with tempfile.TemporaryDirectory() as folder:
        for m, outcome in outcomes(jobs(), Path(folder)):
            tried += 1
            if outcome.verdict == "survived":
                survived += 1
                print(f"not caught: {m.file}:{m.line} {m.function}: {m.after!r}", flush=True)
    print(f"{tried - survived} of {tried} mutants of changed files were caught")
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python tests/mutation", description=__doc__)
    parser.set_defaults(run=None)
    verbs = parser.add_subparsers(required=True)
    verbs.add_parser("touches", help="note which test runs which lines")
    several = verbs.add_parser("run", help="run the sample of each room and write the table")
    several.add_argument("--rooms", nargs="+", default=list(ROOMS), choices=list(ROOMS))
    several.add_argument("--draw", type=int, default=2, choices=table.DRAWS)
    several.add_argument("--keep", nargs="*", default=["killed", "slow", "survived"])
    several.add_argument("--stages", type=int, default=len(STAGES))
    several.set_defaults(run=command_run)
    faults = verbs.add_parser("faults", help="plant the faults of faults.yml")
    faults.set_defaults(run=command_faults)
    checked = verbs.add_parser("sound", help="run the tests of the table where nothing is spoilt")
    checked.set_defaults(run=command_sound)
    new = verbs.add_parser(
        "changed", help="try mutants of files changed since the table was written"
    )
    new.add_argument("--seconds", type=float, default=100.0)
    new.add_argument("--each", type=int, default=20)
    new.set_defaults(run=command_changed)
    args = parser.parse_args()
    if args.run is None:
        run(FOLDER)
        TOUCHES.write_text(json.dumps(gathered(FOLDER)))
        return 0
    return args.run(args)


if __name__ == "__main__":
    sys.exit(main())
