"""The commands of the book, ``python -m bookkit``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from bookkit.execution import project_root
from seedslib.commands import run_command


def _report(errors: Sequence[str], good: str) -> int:
    """Print errors, a line each, or that all is well; the exit code."""
    print("\n".join(errors) or good)
    return 1 if errors else 0


def _execute(options: argparse.Namespace) -> int:
    from bookkit import execution

    root = project_root(Path.cwd())
    if options.check:
        stale = [
            p.name for p in execution.sources(root, options.notebooks) if execution.is_stale(p)
        ]
        lines = [f"{name}: its inputs changed since it was executed" for name in stale]
        return _report(lines, "all notebooks are up to date")
    outcomes = execution.execute(root, options.notebooks, force=options.force)
    failed = sum(1 for outcome in outcomes if outcome.problem)
    print(f"{len(outcomes) - failed} notebooks executed, {failed} failed")
    return 1 if failed else 0


def _sweep(options: argparse.Namespace) -> int:
    from bookkit.sweeps import run_sweep

    report = run_sweep(
        options.notebook,
        options.grid,
        options.out,
        scheduler=options.scheduler,
        workers=options.workers,
    )
    print(f"{report.total - report.failed} of {report.total} points done, table: {report.table}")
    if report.failed:
        print(f"{report.failed} points failed: the column 'problem' says why", file=sys.stderr)
    return 1 if report.failed else 0


def _claims(options: argparse.Namespace) -> int:
    from bookkit.ledger import disagreements

    errors = disagreements(project_root(Path.cwd()))
    return _report(errors, "the ledger and the notebooks agree")


def _live(options: argparse.Namespace) -> int:
    from bookkit import live

    live.write(project_root(Path.cwd()))
    return 0


def _programs(options: argparse.Namespace) -> int:
    from bookkit import programs

    programs.write(project_root(Path.cwd()), Path(options.folder))
    return 0


def _check_html(options: argparse.Namespace) -> int:
    from bookkit.html_check import network_loads

    return _report(network_loads(Path(options.folder)), "the pages load nothing from the network")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m bookkit", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")

    execute = commands.add_parser("execute", help="execute the text notebooks that changed")
    execute.add_argument("notebooks", nargs="*", help="which ones; all by default")
    execute.add_argument("--check", action="store_true", help="only say which are stale")
    execute.add_argument("--force", action="store_true", help="execute up-to-date ones as well")
    execute.set_defaults(run=_execute)

    sweep = commands.add_parser("sweep", help="run a notebook over a grid of parameters")
    sweep.add_argument("notebook", help="an executed notebook, .ipynb")
    sweep.add_argument("grid", help="YAML file: 'grid:' with a list of values per parameter")
    sweep.add_argument("--out", required=True, help="folder of the results")
    sweep.add_argument("--scheduler", help="address of a running Dask scheduler")
    sweep.add_argument("--workers", type=int, default=2, help="local worker processes")
    sweep.set_defaults(run=_sweep)

    claims = commands.add_parser("claims", help="compare the ledger with the notebooks")
    claims.set_defaults(run=_claims)

    live = commands.add_parser("live", help="design the filters that run in pages, write figures")
    live.set_defaults(run=_live)

    programs = commands.add_parser("programs", help="write the pages' programs, for a type checker")
    programs.add_argument("folder", help="a new folder")
    programs.set_defaults(run=_programs)

    check_html = commands.add_parser("check-html", help="check that pages load nothing outside")
    check_html.add_argument("folder", help="folder of the built HTML")
    check_html.set_defaults(run=_check_html)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command of the book."""
    return run_command(_parser(), "bookkit", arguments)


if __name__ == "__main__":
    raise SystemExit(main())
