"""``python -m bookkit``: the commands of the book."""

from bookkit.cli import main

raise SystemExit(main())
