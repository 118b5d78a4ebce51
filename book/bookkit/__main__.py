"""The commands of the book, ``python -m bookkit``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
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
    problems = execution.execute(root, options.notebooks, force=options.force)
    failed = sum(map(bool, problems.values()))
    print(f"{len(problems) - failed} notebooks executed, {failed} failed")
    return 1 if failed else 0


def _sweep(options: argparse.Namespace) -> int:
    from bookkit.sweeps import TABLE, run_sweep

    table = run_sweep(
        options.notebook,
        options.grid,
        options.out,
        scheduler=options.scheduler,
        workers=options.workers,
    )
    failed = sum(table["problem"] != "")
    print(f"{len(table)} points, {failed} failed, table: {options.out}/{TABLE}")
    return 1 if failed else 0


def _claims(options: argparse.Namespace) -> int:
    from bookkit.claims import disagreements
    from bookkit.recording import read_verdicts

    root = project_root(Path.cwd())
    return _report(disagreements(root, read_verdicts(root)), "the ledger and the notebooks agree")


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

    def command(name: str, run: Callable, text: str) -> Callable:
        added = commands.add_parser(name, help=text)
        added.set_defaults(run=run)
        return added.add_argument

    argument = command("execute", _execute, "execute the text notebooks that changed")
    argument("notebooks", nargs="*", help="which ones; all by default")
    argument("--check", action="store_true", help="only say which are stale")
    argument("--force", action="store_true", help="execute up-to-date ones as well")
    argument = command("sweep", _sweep, "run a notebook over a grid of parameters")
    argument("notebook", help="an executed notebook, .ipynb")
    argument("grid", help="YAML file: 'grid:' with a list of values per parameter")
    argument("--out", required=True, help="folder of the results")
    argument("--scheduler", help="address of a running Dask scheduler")
    argument("--workers", type=int, default=2, help="local worker processes")
    command("claims", _claims, "compare the ledger with the notebooks")
    command("live", _live, "write the pictures that can be dragged, with their filters")
    argument = command("programs", _programs, "write the pages' programs, for a type checker")
    argument("folder", help="a new folder")
    argument = command("check-html", _check_html, "check that pages load nothing from outside")
    argument("folder", help="folder of the built HTML")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command of the book."""
    return run_command(_parser(), "bookkit", arguments)


if __name__ == "__main__":
    raise SystemExit(main())
