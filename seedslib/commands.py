"""The command line: ``python -m seedslib design``, ``filter`` and ``fit``.

A model is a Python file that defines `system`; tables of measurements are read and written by
pandas, the extra ``tables``. Arguments are those of the functions in Python, as NAME=EXPRESSION,
and stand before the options.

May import: base, models, linearization, filters, designed, design, evaluation.
"""

from __future__ import annotations

import argparse
import ast
import json
import runpy
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from seedslib import base, design, designed, evaluation, filters, linearization, models
from seedslib.base.checks import optional
from seedslib.base.progress import listening
from seedslib.models.kinds import inputs_of

PACKAGES = base, models, linearization, filters, designed, design
"""Their public names may stand in an expression."""

DESIGN = """\
Design a filter, print the errors that it predicts, and write it to a file. Arguments are those of
seedslib.design.synthesize; memory, times and linearization (or ExactGaussian()) may also be
defined in MODEL.py.
  python -m seedslib design model.py "memory=Memory(2)" "times=np.arange(9) / 2" paths=20000 seed=1
      --out f.npz"""

FILTER = """\
Run a filter on a table and write its estimates, their deviations (x1_sd, ...), the probabilities
of modes and log-likelihoods. SOURCE is MODEL.py, with filter=EXPRESSION unless it defines `filter`,
or a design in a file, FILE.npz, which wants its model again by --system unless it holds tables.
Other arguments are those of the filter's run, such as seed=3, with --smooth those of smooth.
  python -m seedslib filter model.py data.csv "filter=unscented_kalman(system)" --out x.csv
  python -m seedslib filter f.npz data.csv --system model.py --out x.csv"""

FIT = """\
Find parameters of a model by maximum likelihood. free=[...] says which; all that MODEL.py names,
by default. Values are printed, and written as JSON for filter --values.
  python -m seedslib fit model.py data.csv "filter=KalmanFilter(system)" --out values.json"""

TABLE = """\

The first column of the table is the time, in numbers, or dates with --unit, the model's unit of
time. Columns with the names of the model's inputs are these, `indicator` is the indicator, and the
others, or those of --columns, the components of the measurement in order. An empty cell is missing;
a row without any measurement asks for a forecast."""


class Record(NamedTuple):
    """A table of measurements: its first column as it is and as numbers, what a run takes."""

    index: Any
    times: np.ndarray
    measurements: np.ndarray
    options: dict[str, Any]


def evaluated(texts: Sequence[str], names: dict[str, Any]) -> dict[str, Any]:
    """Values of arguments NAME=EXPRESSION.

    Parameters
    ----------
    texts : sequence of str
    names : dict
        Of the model's file; np and the library's public names are known too.

    Raises
    ------
    ValueError
        No such argument, or an expression that fails.
    """
    values = {}
    for text in texts:
        name, _, expression = text.partition("=")
        try:
            tree = ast.parse(expression.strip(), mode="eval")
            scope = {"np": np, **names}
            wanted = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} - {*scope}
            for package in PACKAGES:
                scope |= {word: getattr(package, word) for word in wanted & {*package.__all__}}
            values[name] = eval(compile(tree, name, "eval"), scope)
        except Exception as error:
            raise ValueError(f"{name}: wanted {name}=EXPRESSION, got {text!r} ({error})") from None
    return values


def load_model(path: str) -> dict[str, Any]:
    """Names that a Python file defines, `system` among them.

    Raises
    ------
    OSError, ValueError
        No such file, one that fails, or that defines no system.
    """
    try:
        names = runpy.run_path(path)
    except OSError:
        raise
    except (Exception, SystemExit) as error:
        raise ValueError(f"{path}: {type(error).__name__}: {error}") from None
    if "system" not in names:
        raise ValueError(f"{path}: wanted a model called `system`, got none")
    return names


def read_record(path: str, system: Any, options: argparse.Namespace) -> Record:
    """The table of measurements in a CSV file.

    Raises
    ------
    OSError, ValueError
        No such file or column, cells that are no numbers, dates without a unit.
    """
    with optional("tables"):
        import pandas

    table = pandas.read_csv(path, sep=options.sep, index_col=0)
    keywords: dict[str, Any] = {}
    try:
        if inputs := inputs_of(system):
            keywords["inputs"] = {u: table.pop(str(u)).to_numpy(float) for u in inputs}
        if getattr(system, "indicators", 0):
            keywords["indicators"] = table.pop("indicator").fillna(-1).to_numpy(int)
        y = table[options.columns or list(table)].to_numpy(float)
        if pandas.api.types.is_numeric_dtype(table.index):
            times = table.index.to_numpy(float)
        elif options.unit is None:
            raise ValueError("unit: wanted --unit, that of the model's time, such as D, for dates")
        else:
            dates = pandas.to_datetime(table.index)
            times = ((dates - dates[0]) / pandas.Timedelta(1, options.unit)).to_numpy()
    except KeyError as error:
        raise ValueError(f"{path}: wanted a column, {error}, got {list(table)}") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Record(table.index, times, y, keywords)


def run_design(options: argparse.Namespace) -> int:
    """Design, print and save."""
    names = load_model(options.model)
    defined = {k: names[k] for k in ("memory", "times", "linearization") if k in names}
    chosen = {"linearization": linearization.ExactGaussian()} | defined
    chosen |= evaluated(options.arguments, names)
    with listening(options.verbose):
        made = design.synthesize(names["system"], **chosen)
    designed.save(made, options.out)
    print(made)
    return 0


def run_filter(options: argparse.Namespace) -> int:
    """Run or smooth, and write; 1 where the filter diverged."""
    path = options.system if options.source.endswith(".npz") else options.source
    names = {} if path is None else load_model(path)
    arguments, values = evaluated(options.arguments, names), {}
    if options.values is not None:
        with open(options.values, encoding="utf-8") as file:
            written = json.load(file)
        values = {p: written[str(p)] for p in _parameters(names) if str(p) in written}
    if options.source.endswith(".npz"):
        if path is None:
            raise ValueError(f"{options.source}: wanted its model too, as --system")
        filter = designed.load(options.source, names["system"])
    else:
        filter = _filter(arguments, names)
    if not hasattr(filter, "run"):  # a function of the values that makes one
        filter = filter(values)
    elif values:
        filter = filter.bind({p: v for p, v in values.items() if p in filter.system.parameters})
    record = read_record(options.data, filter.system, options)
    arguments |= record.options
    if not options.smooth and "covariances" in getattr(filter, "takes", ()):
        arguments.setdefault("covariances", True)
    # numbers that are lost in a filter that diverges are said in one line below, not in many
    with np.errstate(all="ignore"):
        if options.smooth:
            found = filters.smooth(filter, record.times, record.measurements, **arguments)
        else:
            found = filter.run(record.times, record.measurements, **arguments)
    frame = found.to_dataframe(record.index)
    frame.rename_axis(record.index.name).to_csv(options.out)
    lost = int((~np.isfinite(found.mean).all(axis=1)).sum())
    if lost or np.any(found.diverged):
        rows = f"{lost} of {len(frame)} rows are no numbers"
        print(f"seedslib: {options.data}: the filter diverged: {rows}", file=sys.stderr)
    return int(bool(lost or np.any(found.diverged)))


def run_fit(options: argparse.Namespace) -> int:
    """Fit, print and write; 1 where the fit did not converge."""
    names = load_model(options.source)
    chosen = {"free": _parameters(names)} | evaluated(options.arguments, names)
    filter = _filter(chosen, names)
    record = read_record(options.data, names["system"], options)
    found = evaluation.fit(filter, record.times, record.measurements, **chosen, **record.options)
    print(found)
    if options.out is not None:
        values = dict(zip(map(str, found.parameters), found.values.tolist(), strict=True))
        with open(options.out, "w", encoding="utf-8") as file:
            json.dump(values, file)
    return int(not found.converged)


def _filter(arguments, names):
    """The filter among the arguments, or in the model's file."""
    filter = arguments.pop("filter", names.get("filter"))
    if not (hasattr(filter, "run") or callable(filter)):
        raise ValueError(f"filter: wanted filter=EXPRESSION or one in the model, got {filter}")
    return filter


def _parameters(names):
    """Parameters that a model's file names, without inputs."""
    return sorted({p for p in names.values() if type(p) is base.Parameter}, key=str)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command of the library."""
    parser = argparse.ArgumentParser(prog="python -m seedslib", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")
    for name, run, text in (
        ("design", run_design, DESIGN),
        ("filter", run_filter, FILTER + TABLE),
        ("fit", run_fit, FIT + TABLE),
    ):
        command = commands.add_parser(
            name,
            help=text.split(". ")[0],
            description=text,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.set_defaults(run=run)
        add = command.add_argument
        if name == "design":
            add("model", metavar="MODEL.py")
        else:
            add("source", metavar="MODEL.py" if name == "fit" else "SOURCE")
            add("data", metavar="DATA.csv")
        add("arguments", nargs="*", metavar="NAME=EXPRESSION")
        if name == "design":
            add("--verbose", action="store_true", help="tell on stderr how far the design has come")
        else:
            add("--columns", nargs="+", metavar="NAME", help="columns of the measurement")
            add("--sep", default=",", help="what stands between cells (a comma)")
            add("--unit", help="of the model's time, where the table has dates: D, h, min, s")
        if name == "filter":
            add("--system", metavar="MODEL.py", help="model of a design in a file")
            add("--values", metavar="FILE.json", help="values of parameters, written by fit")
            add("--smooth", action="store_true", help="each estimate from later measurements too")
        add("--out", required=name != "fit", metavar="FILE")
    return run_command(parser, "seedslib", arguments)


def run_command(parser: argparse.ArgumentParser, name: str, arguments: Sequence[str] | None) -> int:
    """Run one command; a fault in what was asked is one line on stderr and exit code 2."""
    options = parser.parse_args(arguments)
    try:
        return options.run(options)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith(("seedslib", "bookkit")):
            raise
        text = f"{error.name} is not installed, which this command wants"
    except (TypeError, ValueError, OSError, ImportError, MemoryError) as error:
        text = " ".join(str(error).split()) or type(error).__name__
    except KeyboardInterrupt:
        print(f"{name}: interrupted; what was finished is kept", file=sys.stderr)
        return 130
    print(f"{name}: {text}", file=sys.stderr)
    return 2
