"""``python -m seedslib``: the commands of the library."""

from seedslib.commands.cli import main

raise SystemExit(main())
