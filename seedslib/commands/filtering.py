"""``python -m seedslib filter``: run a filter on measurements in a CSV file."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from seedslib.commands.kinds import add_kind, chosen_filter

DESCRIPTION = """\
Run a filter on a record of measurements. FILTER is a designed filter in a file, FILE.npz, or a
model, MODEL.py, with --kind, or one that defines `filter`.

The table has a first row t,y1,y2,... (and j, of a system with an indicator: whole numbers from 0)
and a row a time. An empty cell, NA or NaN is missing; a row without any measurement asks for a
forecast. With --time alone all other columns are measurements, in order. The separator is the first
of tab, semicolon and comma that the first line has. Dates want --unit, the model's unit of time;
with --unit rows times are 0, 1, 2, ... whatever is written. A designed filter wants a row for each
measurement time of the design, and may end early; a system in discrete time wants equal steps.

The result has the times as they came in, x1,x2,... and sd1,sd2,..., the deviations that the filter
claims, of a designed one at measurements only. Of a switching system mode, from 0 on, and
p1,p2,..., the probabilities of the modes, come first. With --level, --forecast or --until also
x1_low,x1_high,... and, of filters that expect measurements, y1,y1_low,y1_high,...: each measurement
as expected from those before it. Where the filter diverges cells are empty and the exit code is 1.

Files hold numbers and no code: a designed filter wants --model again, the model that it was
designed for, unless it consists of tables.
  python -m seedslib filter nile.py nile.csv --kind KalmanFilter --time year --out x.csv
"""


def add_filter(commands: Any) -> None:
    """Add the command to a parser."""
    parser = commands.add_parser(
        "filter", help="run a filter on measurements in a CSV file", description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    add("filter", metavar="FILTER", help="a designed filter FILE.npz, or MODEL.py")
    add_table(parser)
    add("--model", metavar="MODEL.py", help="model of a designed filter")
    add_kind(parser)
    add("--seed", type=int, help="of a filter that draws (default 0)")
    add("--smooth", action="store_true", help="each estimate from later measurements too")
    add("--lag", type=int, metavar="N", help="of smoothing: those of N later rows only (all)")
    add("--forecast", type=int, metavar="N", help="N further steps")
    add("--until", metavar="TIME", help="further steps up to a time, as the table writes it")
    add("--every", type=float, metavar="DT", help="length of a further step (the record's)")
    add("--level", type=float, metavar="P", help="intervals of this probability (.95)")
    add("--out", required=True, metavar="FILE.csv", help="file of the estimates")
    parser.set_defaults(run=run_filter)


def add_table(parser: argparse.ArgumentParser) -> None:
    """Add the table, and what says how to read it, to a parser."""
    add = parser.add_argument
    add("data", metavar="DATA.csv", help="measurements, t,y1,y2,...")
    add("--time", metavar="NAME", help="column of the times (t)")
    add("--columns", metavar="y1=NAME,...", help="columns of y1,y2,..., or their names in order")
    add("--inputs", metavar="u=NAME,...", help="columns of the inputs of the model")
    add_unit(parser)


def add_unit(parser: argparse.ArgumentParser) -> None:
    """Add what says how dates are numbers to a parser."""
    parser.add_argument("--unit", help="of dates: days | hours | seconds; or count rows")
    parser.add_argument("--epoch", metavar="DATE", help="date that is time 0 (the first)")


def run_filter(options: argparse.Namespace) -> int:
    """Read filter and record, run or smooth, write; 1 where the filter diverged.

    Raises
    ------
    OSError, ValueError
        A file that is missing or not what it should be; the message names it. A filter that has no
        smoother where one is wanted.
    """
    import numpy as np

    from seedslib.commands.estimates import expected_measurements, prolonged, write_estimates
    from seedslib.commands.outputs import as_output
    from seedslib.commands.records import read_record

    out = as_output(
        options.out, filter=options.filter, measurements=options.data, model=options.model,
        values=options.set,
    )  # fmt: skip
    if options.lag is not None and not options.smooth:
        raise ValueError(f"lag: wanted --smooth with it, got {options.lag} alone")
    further = options.forecast is not None or options.until is not None
    expected = None
    with chosen_filter(options) as filter:
        told = _told(filter, options)
        record = read_record(options.data, filter, options)
        record = prolonged(record, options.forecast, options.until, options.every)
        if record.indicators is not None:
            told["indicators"] = record.indicators
        if record.inputs:
            told["inputs"] = record.inputs
        try:
            # what a filter that diverges computes is said in one line below, not by NumPy in many
            with np.errstate(all="ignore"):
                found = _found(filter, record, told, options)
                if not options.smooth and (further or options.level is not None):
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


def _found(filter, record, told, options):
    from seedslib.filters import smooth

    times, y = record.times, record.measurements
    if not options.smooth:
        claims = "covariances" in getattr(filter, "takes", ())
        return filter.run(times, y, **told, **({"covariances": True} if claims else {}))
    told.pop("seed", None)  # filters that draw have no smoother, and say so
    try:
        return smooth(filter, times, y, lag=options.lag, **told)
    except TypeError as error:
        raise ValueError(f"smooth: {error}") from None


def _told(filter, options):
    """The seed, of a filter that draws."""
    if options.seed is None:
        return {}
    if "seed" not in getattr(filter, "takes", ()):
        raise ValueError(f"seed: wanted none, {options.kind or options.filter} draws nothing")
    if options.seed < 0:
        raise ValueError(f"seed: wanted a whole number from 0 on, got {options.seed}")
    return {"seed": options.seed}
