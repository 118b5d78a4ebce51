"""Recorded numbers in the text of any page: ``{{ '%.3f' % notebook__name }}``.

A Sphinx extension. What a notebook recorded under a name is a substitution of MyST; the entries
of a list are ``notebook__name_0`` and so on.
"""

from __future__ import annotations

import json
from pathlib import Path

from bookkit.recording import read_records


def recorded(root: Path) -> dict[str, str | int | float]:
    """Every value that a notebook recorded, by the notebook's name and its own."""
    found: dict[str, str | int | float] = {}
    for path in sorted((root / "notebooks").glob("*.ipynb")):
        for name, value in read_records(
            json.loads(path.read_text(encoding="utf-8"))
        ).values.items():
            entries = enumerate(value) if isinstance(value, list) else ()
            found |= {f"{path.stem}__{name}_{place}": entry for place, entry in entries}
            if isinstance(value, str | int | float):
                found[f"{path.stem}__{name}"] = value
    return found


def setup(app) -> dict[str, bool]:
    """Called by Sphinx."""
    app.config.myst_substitutions = recorded(Path(app.srcdir))
    return {"parallel_read_safe": True}
