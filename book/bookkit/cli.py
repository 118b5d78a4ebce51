"""The commands of the book, ``python -m bookkit``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from seedslib.commands import run_command


def _told(found: Sequence[str], some: str, none: str) -> int:
    """Print the faults that were found, a line each, and how many; the exit code."""
    for fault in found:
        print(fault)
    print(f"{len(found)} {some}" if found else none)
    return 1 if found else 0


def _execute(options: argparse.Namespace) -> int:
    from bookkit import execution, fingerprint

    root = fingerprint.project_root(Path.cwd())
    if options.check:
        stale = [p for p in execution.sources(root, options.notebooks) if execution.is_stale(p)]
        for path in stale:
            print(f"{path.relative_to(root)}: its inputs changed since it was executed")
        print(f"{len(stale)} notebooks are stale" if stale else "all notebooks are up to date")
        return 1 if stale else 0
    outcomes = execution.execute(root, options.notebooks, force=options.force)
    failed = [outcome for outcome in outcomes if outcome.problem]
    print(f"{len(outcomes) - len(failed)} notebooks executed, {len(failed)} failed")
    return 1 if failed else 0


def _sweep(options: argparse.Namespace) -> int:
    from bookkit.limits import Limits
    from bookkit.sweeps import run_sweep

    limits = Limits(options.seconds, options.memory)
    report = run_sweep(
        options.notebook,
        options.grid,
        options.out,
        scheduler=options.scheduler,
        workers=options.workers,
        retry=options.retry,
        limits=limits,
        most=options.points,
    )
    print(f"{report.total - report.failed} of {report.total} points done, table: {report.table}")
    if report.failed:
        print(f"{report.failed} points failed: the column 'problem' says why", file=sys.stderr)
    return 1 if report.failed else 0


def _claims(options: argparse.Namespace) -> int:
    from bookkit import fingerprint, ledger, places

    root = fingerprint.project_root(Path.cwd())
    found = ledger.faults(root) + places.faults(root)
    return _told(found, "faults in the ledger", "the ledger and the notebooks agree")


def _pages(options: argparse.Namespace) -> int:
    from bookkit import claims_page, fingerprint, places, reference
    from bookkit.files import replace

    root = fingerprint.project_root(Path.cwd())
    replace(root / "book" / "claims.md", claims_page.page(root))
    replace(root / "book" / "where.md", places.page(root))
    (root / "book" / "api").mkdir(exist_ok=True)
    for room in reference.ROOMS:
        replace(root / "book" / "api" / f"{room}.md", reference.page(room))
    return 0


def _chapter(options: argparse.Namespace) -> int:
    from bookkit import chapters, fingerprint

    root = fingerprint.project_root(Path.cwd())
    part = chapters.write(root, options.name, options.title, options.part)
    print(f"notebooks/{options.name}.md: a new chapter, the last one of {part!r}")
    print("_toc.yml, README.md: a line more")
    print(f"next: python -m bookkit execute notebooks/{options.name}.md")
    return 0


def _live(options: argparse.Namespace) -> int:
    from bookkit import fingerprint, live

    live.write(fingerprint.project_root(Path.cwd()))
    return 0


def _typecheck(options: argparse.Namespace) -> int:
    from bookkit import fingerprint, programs

    root = fingerprint.project_root(Path.cwd())
    found = programs.faults(root, [Path(page).resolve() for page in options.pages])
    return _told(found, "faults of types", "the programs agree with the types")


def _portable(options: argparse.Namespace) -> int:
    from bookkit import fingerprint, portable

    root = fingerprint.project_root(Path.cwd())
    names = options.settings or list(portable.settings())
    rows, passed = portable.try_all(root, names, not options.notebooks_only)
    for row in rows:
        print("{:24}{:36}{:>9}  {}".format(*row))
    if options.table:
        portable.write(rows, Path(options.table))
    return 0 if passed else 1


def _check_html(options: argparse.Namespace) -> int:
    from bookkit import html_check, weight

    folder = Path(options.folder)
    found = html_check.faults(folder) + weight.faults(folder)
    return _told(found, "faults in the built book", "the built book is sound")


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
    sweep.add_argument("--retry", action="store_true", help="run failed points again")
    sweep.add_argument("--seconds", type=float, default=3600, help="for a point (default 3600)")
    sweep.add_argument("--memory", type=float, default=4, help="GB for a point (default 4)")
    sweep.add_argument("--points", type=int, default=10_000, help="at most so many (10000)")
    sweep.set_defaults(run=_sweep)

    claims = commands.add_parser("claims", help="hold the ledger against the notebooks")
    claims.set_defaults(run=_claims)

    pages = commands.add_parser("pages", help="write claims, places and reference as pages")
    pages.set_defaults(run=_pages)

    chapter = commands.add_parser("chapter", help="begin a new chapter, from a template")
    chapter.add_argument("name", help="notebooks/NAME.md; words of a-z and 0-9 joined by '_'")
    chapter.add_argument("--title", required=True, help="its heading")
    chapter.add_argument("--part", help="caption of the part of the book that it closes")
    chapter.set_defaults(run=_chapter)

    live = commands.add_parser("live", help="design the filters that run in pages, write figures")
    live.set_defaults(run=_live)

    typecheck = commands.add_parser("typecheck", help="look over the types of pages' programs")
    typecheck.add_argument("pages", nargs="+", help="Markdown files with Python programs")
    typecheck.set_defaults(run=_typecheck)

    portable = commands.add_parser("portable", help="run again as on other processors")
    portable.add_argument("settings", nargs="*", help="which; all that this processor can be")
    portable.add_argument("--notebooks-only", action="store_true", help="leave the tests out")
    portable.add_argument("--table", metavar="FILE", help="write the deviations as CSV")
    portable.set_defaults(run=_portable)

    check_html = commands.add_parser("check-html", help="look over a built book")
    check_html.add_argument("folder", help="folder of the built HTML")
    check_html.set_defaults(run=_check_html)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command of the book."""
    return run_command(_parser(), "bookkit", arguments)
