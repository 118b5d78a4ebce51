"""``python -m seedslib design``: design a filter for the model in a Python file."""

from __future__ import annotations

import argparse
from typing import Any

from seedslib.commands.filtering import add_unit
from seedslib.models.kinds import switches

DESCRIPTION = """\
Design a finite-order filter for a model and write it to a file. MODEL.py is a Python file, run as
any script is, that defines `system` (a JumpDiffusion, DiscreteSystem or SwitchingSystem, or a
function that returns one) and, if --times is not given, `times`. The summary with the predicted
errors is printed."""

EPILOG = """\
A filter in a file evaluates the sensor of its model, so `python -m seedslib filter` wants MODEL.py
again: files hold numbers and no code. Only a filter of tables runs from its file alone; --table
makes one of a design with one estimated component.
  python -m seedslib design flip.py --memory estimates=1 --times 0:3:0.25 \\
      --table y=-8:8:161 z=-3:3:121 --out flip.npz"""


def add_design(commands: Any) -> None:
    """Add the command to a parser."""
    parser = commands.add_parser(
        "design", help="design a filter for the model in a Python file", description=DESCRIPTION,
        epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    add("model", metavar="MODEL.py", help="Python file that defines `system`")
    add(
        "--memory", required=True,
        help="estimates=2 | measurements=4 | estimates=2,measurements=2 | small_order | "
        "large_order:2 | finite_memory:4; of a switching system also indicators=1 and log_odds, as "
        "in estimates=1,indicators=1,log_odds",
    )  # fmt: skip
    add(
        "--linearization", default="gaussian",
        help="gaussian (default) | taylor | unscented[:alpha,beta,kappa] | cubature | "
        "gauss-hermite[:order]",
    )  # fmt: skip
    add(
        "--predictor",
        help="affine (default) | polynomial[:mean degree,covariance degree] | continuous",
    )  # fmt: skip
    add(
        "--times",
        help="measurement times, start:stop:step or 0,0.5,2 or @FILE.csv:COLUMN; else `times` of "
        "the model",
    )  # fmt: skip
    add_unit(parser)
    add("--nodes", type=int, help="forecasts inside each interval (default 4)")
    add("--paths", type=int, default=20_000, help="design paths (default 20000)")
    add("--seed", type=int, default=0, help="seed of the design paths (default 0)")
    add("--workers", type=int, default=1, help="threads; the filter does not depend on it")
    add("--components", type=int, metavar="N", help="estimate the first N components (all)")
    add(
        "--availability", metavar="P",
        help="probability that a measurement arrives, or one for each component, of an indicator "
        "the last, as in 0.9,1: the filter then knows its errors after gaps",
    )  # fmt: skip
    add(
        "--measured", nargs="+", metavar="TIMES",
        help="of the measurement times those at which the sensor is read, start:stop:step or "
        "0,0.5,2, or of components that are read more rarely y2=0:10:5 (indicator=...)",
    )  # fmt: skip
    add(
        "--table", nargs="+", metavar="AXIS",
        help="write tables with nodes y=low:high:count z=low:high:count (measurement, estimate)",
    )  # fmt: skip
    add(
        "--stationary", type=float, nargs="?", const=0.02, metavar="TOLERANCE",
        help="let the last step serve all later times; refused where a filter does not settle to "
        "so much of its error (default 0.02)",
    )  # fmt: skip
    add("--cycle", type=int, default=1, help="with --stationary: so many last steps in turn")
    add("--verbose", action="store_true", help="tell on stderr how far the design has come")
    add("--out", required=True, metavar="FILE.npz", help="file of the filter")
    parser.set_defaults(run=run_design)


def run_design(options: argparse.Namespace) -> int:
    """Design, print and save.

    Raises
    ------
    FileNotFoundError, ValueError
        No model, or an option that does not fit.
    """
    from seedslib import design as making
    from seedslib.base.progress import listening
    from seedslib.commands import words
    from seedslib.commands.models import load_model
    from seedslib.commands.outputs import as_output
    from seedslib.commands.records import times_of_column
    from seedslib.commands.schedules import as_availability, as_schedule
    from seedslib.designed import save

    memory = words.as_memory(options.memory)
    rule = words.linearization_of(options.linearization)
    predictor = words.as_choice(
        "predictor", options.predictor or "affine", words.PREDICTORS, making
    )
    given = options.times or ""
    if not given.startswith("@"):
        if options.unit or options.epoch:
            raise ValueError("unit, epoch: wanted --times @FILE.csv with dates beside them")
        times = None if options.times is None else words.as_time_grid(given)
    else:
        times = times_of_column(given[1:], options.unit, options.epoch)
    tables = None if options.table is None else words.axes_of("table", options.table, "y", "z")
    out = as_output(options.out, model=options.model, times=given[1:].partition(":")[0] or None)
    if options.seed < 0:
        raise ValueError(f"seed: wanted a whole number from 0 on, got {options.seed}")
    model = load_model(options.model)
    system, times = model.known, model.times if times is None else times
    if times is None:
        raise ValueError(f"times: wanted --times, or `times` in {options.model}; got neither")
    chosen = {"paths": options.paths, "seed": options.seed, "workers": options.workers}
    if tables is not None and (options.availability or options.measured):
        raise ValueError(
            "table: wanted without availability and measured; tables for those come from "
            "grid_synthesis in Python"
        )
    if options.availability is not None:
        chosen["availability"] = as_availability(options.availability)
    if options.measured is not None:
        chosen["measured"] = as_schedule(options.measured, times, system)
    if switches(system):
        for name in ("predictor", "nodes", "components", "table"):
            if getattr(options, name) is not None:
                raise ValueError(f"{name}: wanted none for a switching system")
    else:
        nodes = 4 if options.nodes is None else options.nodes
        chosen.update(predictor=predictor, nodes=nodes, components=options.components)
    with listening(options.verbose):
        designed = making.synthesize(system, memory, rule, times, **chosen)
    if tables is not None:
        designed = making.tabulated(designed, **tables)
    if options.stationary is not None:
        designed = making.stationary(
            designed, options.stationary, cycle=options.cycle, seed=options.seed + 1
        )
    save(designed, out)
    print(designed)
    print(f"written to {out}")
    return 0
