"""The commands of the library, ``python -m seedslib design | filter | fit``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from seedslib.commands import design, filtering, fitting


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m seedslib", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")
    design.add_design(commands)
    filtering.add_filter(commands)
    fitting.add_fit(commands)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command of the library."""
    return run_command(_parser(), "seedslib", arguments)


def run_command(parser: argparse.ArgumentParser, name: str, arguments: Sequence[str] | None) -> int:
    """Run one command; a fault in what was asked is one line on stderr and exit code 2."""
    options = parser.parse_args(arguments)
    try:
        return options.run(options)
    except (ValueError, OSError) as error:
        print(f"{name}: {error}".replace("\n", " "), file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"{name}: not enough memory: {error or 'nobody says how much'}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith(("seedslib", "bookkit")):
            raise
        print(
            f"{name}: {error.name} is not installed; this command wants the extra 'book'",
            file=sys.stderr,
        )
        return 2
    except KeyboardInterrupt:
        print(f"{name}: interrupted; what was finished is kept", file=sys.stderr)
        return 130
