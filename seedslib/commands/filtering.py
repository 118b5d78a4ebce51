"""``python -m seedslib filter``: run a designed filter on measurements in a CSV file."""

from __future__ import annotations

import argparse
import sys
from typing import Any

DESCRIPTION = """\
Run a designed filter on a record of measurements. The CSV file has a first row t,y1,y2,... and one
row for each measurement time of the design, in order; it may end early. An empty cell is a missing
measurement. Rows of empty cells between the measurement times ask for forecasts. A switching system
with an indicator has one more column, j, whole numbers from 0, empty where it is missing.

The result has the columns t,x1,x2,... and sd1,sd2,..., the standard deviations that the filter
claims at the measurements (between them it claims none). Of a switching system, whose filters make
no forecasts between measurements, mode comes before x1, the decided mode from 0 on, and p1,p2,...,
the probabilities of the modes 0,1,...

Where a filter diverges there are no numbers from some row on: its cells are empty, a line on stderr
says from which time, and the exit code is 1."""

EPILOG = """\
A filter of tables runs from its file alone. Any other evaluates the sensor of the model that it was
designed for; a file holds numbers and no code, so --model gives the model's Python file again, and
a model other than that of the design is refused. With tables, --model only makes that comparison.
  python -m seedslib filter flip.npz data.csv --out estimates.csv"""


def add_filter(commands: Any) -> None:
    """Add the command to a parser."""
    parser = commands.add_parser(
        "filter", help="run a designed filter on measurements in a CSV file",
        description=DESCRIPTION, epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("filter", metavar="FILE.npz", help="a designed filter")
    parser.add_argument("data", metavar="DATA.csv", help="measurements, t,y1,y2,...")
    parser.add_argument("--model", metavar="MODEL.py", help="Python file that defines `system`")
    parser.add_argument("--out", required=True, metavar="FILE.csv", help="file of the estimates")
    parser.set_defaults(run=run_filter)


def run_filter(options: argparse.Namespace) -> int:
    """Read filter and record, run, write; 1 where the filter diverged.

    Raises
    ------
    OSError, ValueError
        A file that is missing or not what it should be; the message names it.
    """
    import numpy as np

    from seedslib.commands.models import load_model
    from seedslib.commands.outputs import as_output
    from seedslib.commands.records import read_record, write_estimates
    from seedslib.designed import load

    out = as_output(
        options.out, filter=options.filter, measurements=options.data, model=options.model
    )
    system = None if options.model is None else load_model(options.model)[0]
    designed = load(options.filter, system)
    record = read_record(options.data, designed)
    shown = {} if record.indicators is None else {"indicators": record.indicators}
    try:
        # what a filter that diverges computes is said in one line below, not by NumPy in many
        with np.errstate(all="ignore"):
            found = designed.run(record.times, record.measurements, covariances=True, **shown)
    except ValueError as error:
        raise ValueError(f"{options.data}: {error}") from None
    write_estimates(out, record.times, found)
    print(f"{len(record.times)} rows written to {options.out}")
    lost = ~np.isfinite(found.mean).all(axis=1)
    if not (lost.any() or np.any(found.diverged)):
        return 0
    since = f"{lost.sum()} of {len(lost)} rows are no numbers"
    if lost.any():
        since += f", the first at t = {record.times[lost][0]:.12g}"
    print(f"seedslib: {options.data}: the filter diverged: {since}", file=sys.stderr)
    return 1
