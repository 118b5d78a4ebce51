"""The table of abuse: illegal and extreme input of all kinds, and what the library makes of it.

Run by hand, ``python benchmarks/abuse.py``; writes ``benchmarks/abuse.csv`` beside itself, and
``benchmarks/abuse_findings.csv`` where something is left. The attempts are in the package
`attempts`, a file a category; they are the same ones each time. Wants a C compiler, bash and
Linux; takes some ten minutes on one core. With names of categories only those are run, and take
the place of their rows.

Each attempt is judged by an oracle. `refused`: an error with a sentence, on the command line one
line and exit code 2. `right`: equal to an answer found in another way (the same numbers passed as
arrays, by hand, Python against C), or where there is none finite numbers and variances that are not
negative. `flagged`: a warning, or NaN that is marked as diverged. What is left should be zero:
`silently_wrong`, `wrongly_refused` (legal and refused), `crashed` (errors of another kind or
without a sentence, tracebacks, signals) and `hung` (above 20 s of the processor or 4 GB, each in a
process with limits).
"""

from __future__ import annotations

import csv
import importlib
import os
import sys
import tempfile
from collections import Counter
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from attempts.judge import VERDICTS, all_judged

CATEGORIES = ("numerical", "files", "commands", "grids", "exported", "programs", "security")
GOOD = ("refused", "right", "flagged")
HERE = Path(__file__).resolve().parent


def run(name: str) -> tuple[Counter, list[tuple[str, str, str, str]]]:
    """Verdicts of one category, and its findings."""
    counts, findings = Counter(), []
    for attempt, verdict, detail in all_judged(
        importlib.import_module(f"attempts.{name}").attempts()
    ):
        counts[verdict] += 1
        if verdict not in GOOD:
            findings.append((name, attempt.what, verdict, detail))
    return counts, findings


def replace(path: Path, head: tuple[str, ...], names: list[str], rows: list) -> None:
    """Put new rows of categories into a table; a table without rows is none."""
    kept = []
    if path.exists():
        with path.open(newline="") as file:
            kept = [row for row in list(csv.reader(file))[1:] if row[0] not in names]
    every = sorted([*kept, *rows], key=lambda row: CATEGORIES.index(row[0]))
    path.unlink(missing_ok=True)
    if every:
        with path.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([head, *every])


def main(names: list[str]) -> None:
    rows, findings = [], []
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for name in names or CATEGORIES:
            counts, found = run(name)
            rows.append((name, counts.total(), *(counts[verdict] for verdict in VERDICTS)))
            findings += found
            print(*rows[-1], flush=True)
        os.chdir(HERE)
    for finding in findings:
        print(*finding, sep=" | ")
    run_now = [row[0] for row in rows]
    replace(HERE / "abuse.csv", ("category", "attempts", *VERDICTS), run_now, rows)
    head = ("category", "attempt", "verdict", "detail")
    replace(HERE / "abuse_findings.csv", head, run_now, findings)


if __name__ == "__main__":
    main(sys.argv[1:])
