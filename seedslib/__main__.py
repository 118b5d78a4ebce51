"""``python -m seedslib``: the commands of the library and of the book."""

from seedslib.experiments.cli import main

raise SystemExit(main())
