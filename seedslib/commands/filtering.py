"""``python -m seedslib filter`` and ``smooth``: run a filter on measurements in a CSV file."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from seedslib.commands.kinds import add_kind, chosen_filter

SMOOTHING = """\
As `seedslib filter`, whose help says what FILTER and the table are, but each estimate is made from
all measurements, or with --lag from those of a few later rows; measurements are not forecast. A
filter that has no smoother is refused.
  python -m seedslib smooth nile.py nile.csv --kind KalmanFilter --time year --out level.csv"""

DESCRIPTION = """\
Run a filter on a record of measurements. FILTER is a designed filter in a file, FILE.npz, or a
model, MODEL.py, with --kind, or one that defines `filter`.

The table has a first row t,y1,y2,... and a row a time; of a system with an indicator one more
column, j, whole numbers from 0. An empty cell, NA or NaN is missing; a row without any measurement
asks for a forecast. Columns of other names are chosen with --time and --columns, or all but the
time are taken, in order. The separator is the first of tab, semicolon and comma in the first line.
Dates want --unit, the unit of the model's time; --unit rows counts 0, 1, 2, ... whatever is
written. A designed filter wants a row for each measurement time of the design, in order, and may
end early; a system in discrete time wants equal steps.

The result has the column of times as it came in, x1,x2,... and sd1,sd2,..., the standard deviations
that the filter claims (a designed one at measurements only). Of a switching system mode comes
before x1, the decided mode from 0 on, and p1,p2,..., the probabilities of the modes 0,1,... With
--level, --forecast or --until intervals follow, x1_low,x1_high,... and, of filters that expect
measurements, y1,y1_low,y1_high,...: each measurement as expected from those before it.

Where a filter diverges there are no numbers from some row on: its cells are empty, a line on stderr
says from which time, and the exit code is 1."""

EPILOG = """\
A designed filter of tables runs from its file alone. Any other evaluates the sensor of the model
that it was designed for; a file holds numbers and no code, so --model gives the model's Python file
again, and another model is refused. With tables, --model only makes that comparison.
  python -m seedslib filter flip.npz data.csv --out estimates.csv
  python -m seedslib filter nile.py nile.csv --kind KalmanFilter --time year --forecast 10 \\
      --out level.csv"""


def add_filter(commands: Any) -> None:
    """Add both commands to a parser."""
    for name, words, description, epilog, run in (
        ("filter", "run a filter on measurements in a CSV file", DESCRIPTION, EPILOG, run_filter),
        ("smooth", "the same, each estimate from all measurements", SMOOTHING, None, run_smooth),
    ):
        parser = commands.add_parser(
            name, help=words, description=description, epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        add = parser.add_argument
        add("filter", metavar="FILTER", help="a designed filter FILE.npz, or MODEL.py")
        add_table(parser)
        add("--model", metavar="MODEL.py", help="model of a designed filter")
        add_kind(parser)
        add("--seed", type=int, help="of a filter that draws (default 0)")
        if name == "smooth":
            add("--lag", type=int, metavar="N", help="use the measurements of N later rows only")
        add("--forecast", type=int, metavar="N", help="N further steps")
        add("--until", metavar="TIME", help="further steps up to a time, as the table writes it")
        add("--every", type=float, metavar="DT", help="length of a further step (the record's)")
        add("--level", type=float, metavar="P", help="intervals of this probability (.95)")
        add("--out", required=True, metavar="FILE.csv", help="file of the estimates")
        parser.set_defaults(run=run)


def add_table(parser: argparse.ArgumentParser) -> None:
    """Add the table, and what says how to read it, to a parser."""
    add = parser.add_argument
    add("data", metavar="DATA.csv", help="measurements, t,y1,y2,...")
    add("--time", metavar="NAME", help="column of the times (t)")
    add("--columns", metavar="y1=NAME,...", help="columns of y1,y2,..., or their names in order")
    add_unit(parser)


def add_unit(parser: argparse.ArgumentParser) -> None:
    """Add what says how dates are numbers to a parser."""
    parser.add_argument("--unit", help="of dates: days | hours | seconds; or count rows")
    parser.add_argument("--epoch", metavar="DATE", help="date that is time 0 (the first)")


def run_filter(options: argparse.Namespace) -> int:
    """Read filter and record, run, write; 1 where the filter diverged.

    Raises
    ------
    OSError, ValueError
        A file that is missing or not what it should be; the message names it.
    """

    def estimates(filter, record, told):
        if "covariances" in getattr(filter, "takes", ()):
            told["covariances"] = True
        return filter.run(record.times, record.measurements, **told)

    return _written(options, estimates, True)


def run_smooth(options: argparse.Namespace) -> int:
    """As `run_filter`, by `seedslib.filters.smooth`.

    Raises
    ------
    OSError, ValueError
        As there; a filter that has no smoother.
    """
    from seedslib.filters import smooth

    def estimates(filter, record, told):
        try:
            return smooth(filter, record.times, record.measurements, lag=options.lag, **told)
        except TypeError as error:
            raise ValueError(f"smooth: {error}") from None

    return _written(options, estimates, False)


def _written(options, estimates, forward):
    import numpy as np

    from seedslib.commands.estimates import expected_measurements, prolonged, write_estimates
    from seedslib.commands.outputs import as_output
    from seedslib.commands.records import read_record

    out = as_output(
        options.out, filter=options.filter, measurements=options.data, model=options.model,
        values=options.set,
    )  # fmt: skip
    further = options.forecast is not None or options.until is not None
    expected = None
    with chosen_filter(options) as filter:
        told = _told(filter, options)
        record = read_record(options.data, filter, options)
        record = prolonged(record, options.forecast, options.until, options.every)
        if record.indicators is not None:
            told["indicators"] = record.indicators
        try:
            # what a filter that diverges computes is said in one line below, not by NumPy in many
            with np.errstate(all="ignore"):
                found = estimates(filter, record, told)
                if forward and (further or options.level is not None):
                    expected = expected_measurements(filter, record)
        except ValueError as error:
            raise ValueError(f"{options.data}: {error}") from None
    level = options.level
    if level is None and further and found.cov is not None:
        level = 0.95
    write_estimates(out, record, found, level=level, expected=expected)
    print(f"{len(record.times)} rows written to {options.out}")
    lost = ~np.isfinite(found.mean).all(axis=1)
    if not (lost.any() or np.any(found.diverged)):
        return 0
    since = f"{lost.sum()} of {len(lost)} rows are no numbers"
    if lost.any():
        since += f", the first at {record.name} = {record.cells[int(lost.argmax())]}"
    print(f"seedslib: {options.data}: the filter diverged: {since}", file=sys.stderr)
    return 1


def _told(filter, options):
    """The seed, of a filter that draws."""
    if options.seed is None:
        return {}
    if "seed" not in getattr(filter, "takes", ()):
        raise ValueError(f"seed: wanted none, {options.kind or options.filter} draws nothing")
    if options.seed < 0:
        raise ValueError(f"seed: wanted a whole number from 0 on, got {options.seed}")
    return {"seed": options.seed}
