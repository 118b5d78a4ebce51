"""Frozen mutants and planted faults against the tests of today: ``python tests/mutation VERB``.

``run`` plants every mutant of frozen.csv, ``faults`` every fault of faults.yml, and both say what
no test catches and what is not in the library any more; ``draw`` freezes new mutants, of those
that today's tests catch.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from itertools import islice

import mutants
from runner import Touches, judged

CAUGHT = mutants.HERE / "caught.csv"
SHARE = 0.95
"""What `run` asks for, of the mutants of a package that are in the library still."""


def report(every: Iterable[mutants.Mutant], touches: Touches) -> dict[str, Counter]:
    """Print what was not caught, and count verdicts by package."""
    counts: dict[str, Counter] = {}
    for mutant, verdict, _ in judged(every, touches):
        counts.setdefault(mutant.package, Counter())[verdict] += 1
        if verdict != "killed":
            where = f"{mutant.file}:{mutant.line} {mutant.function}"
            print(f"{verdict}: {where}\n- {mutant.before}+ {mutant.after}", flush=True)
    for package, count in sorted(counts.items()):
        there = count.total() - count["gone"]
        share = f"{100 * count['killed'] / there:.1f} %" if there else "nothing"
        print(f"{package}: {count['killed']} of {there} caught, {share}; {count['gone']} gone")
    return counts


def write_table(counts: dict[str, Counter]) -> None:
    """Write the table of the book: mutants by package, frozen, still in the library, caught."""
    with CAUGHT.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["package", "frozen", "still in the library", "caught"])
        for package, count in sorted(counts.items()):
            there = count.total() - count["gone"]
            writer.writerow([package, count.total(), there, count["killed"]])


def main() -> int:
    parser = argparse.ArgumentParser(prog="python tests/mutation", description=__doc__)
    parser.add_argument("verb", choices=["run", "faults", "draw"])
    parser.add_argument("packages", nargs="*", help="packages of the library; all by default")
    parser.add_argument("--tests", nargs="+", default=["tests"], help="files or folders of tests")
    parser.add_argument("--count", type=int, default=60, help="mutants a package, with draw")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    args = parser.parse_args()
    known = mutants.faults() if args.verb == "faults" else mutants.read()
    chosen = [m for m in known if not args.packages or m.package in args.packages]
    touches = Touches(args.tests)
    if args.verb == "draw":
        rest = [m for m in known if m not in chosen]
        for package in args.packages or sorted({m.package for m in known}):
            verdicts = judged(mutants.draw(package, args.seed), touches)
            caught = (replace(m, killed_by=by) for m, v, by in verdicts if v == "killed")
            rest += islice(caught, args.count)
            mutants.write(rest)
        return 0
    least = 1.0 if args.verb == "faults" else SHARE
    counts = report(chosen, touches)
    if args.verb == "run" and not args.packages and args.tests == ["tests"]:
        write_table(counts)
    return int(any(c["killed"] < least * (c.total() - c["gone"]) for c in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
