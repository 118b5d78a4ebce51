"""``python -m seedslib fit``: parameters of a model from measurements in a CSV file."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from seedslib.commands.filtering import add_table
from seedslib.commands.kinds import ALWAYS_MADE_ANEW, add_kind, maker, parameter_named, set_values

DESCRIPTION = """\
Find the parameters of a model that make the measurements most likely, by the likelihood that a
filter gives. MODEL.py names each as a `Parameter` of seedslib.base and uses it in the formulas of
`system`; the table is read as by `filter`. What is written to --out the option --set of `filter`
takes. Where the search did not converge the exit code is 1.
  python -m seedslib fit nile.py nile.csv --kind KalmanFilter --time year --out nile.json"""


def add_fit(commands: Any) -> None:
    """Add the command to a parser."""
    parser = commands.add_parser(
        "fit", help="parameters of a model from measurements", description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    add("filter", metavar="MODEL.py", help="Python file that defines `system`")
    add_table(parser)
    add_kind(parser)
    add("--free", metavar="q,r", help="parameters to fit; else all that --set leaves")
    add("--out", metavar="FILE.json", help="file of the values")
    parser.set_defaults(run=run_fit)


def run_fit(options: argparse.Namespace) -> int:
    """Fit, print and save; 1 where it did not converge.

    Raises
    ------
    OSError, ValueError
        A file that is missing or not what it should be; the message names it. No parameters.
    """
    from seedslib.base import assigned
    from seedslib.commands.outputs import as_output
    from seedslib.commands.records import read_record
    from seedslib.evaluation import fit

    out = None
    if options.out is not None:
        out = as_output(
            options.out, model=options.filter, measurements=options.data, values=options.set
        )
    if not options.filter.endswith(".py"):
        raise ValueError(f"model: wanted MODEL.py, got {options.filter}")
    make, parameters = maker(options)
    values = set_values(options, parameters)
    if options.free is None:
        free = [p for p in parameters.values() if p not in values]
    else:
        free = [parameter_named("free", name, parameters) for name in options.free.split(",")]
    if not free:
        raise ValueError(f"free: wanted a `Parameter` that {options.filter} names, got none")
    with assigned(values):
        filter = make()
        record = read_record(options.data, filter, options)
        try:
            found = fit(
                make if options.kind in ALWAYS_MADE_ANEW else filter, record.times,
                record.measurements, free,
                indicators=record.indicators, inputs=record.inputs or None,
            )  # fmt: skip
        except (TypeError, ValueError) as error:
            raise ValueError(f"{options.data}: {error}") from None
    print(found)
    if out is not None:
        _save(out, found)
        print(f"written to {out}")
    if not found.converged:
        print(f"seedslib: {options.data}: the fit did not converge", file=sys.stderr)
    return 0 if found.converged else 1


def _save(out, found):
    """Values, standard errors (null where unknown), log-likelihood, as JSON."""
    import json
    import math

    from seedslib.base.atomic import write_whole

    names = [str(p) for p in found.parameters]
    errors = [e if math.isfinite(e) else None for e in found.errors.tolist()]
    told = {
        "values": dict(zip(names, found.values.tolist(), strict=True)),
        "errors": dict(zip(names, errors, strict=True)),
        "loglik": found.loglik,
        "converged": found.converged,
    }
    write_whole(out, (json.dumps(told, indent=2) + "\n").encode())
