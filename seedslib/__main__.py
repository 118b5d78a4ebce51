"""``python -m seedslib``: the commands of the library."""

from seedslib.commands import main

raise SystemExit(main())
