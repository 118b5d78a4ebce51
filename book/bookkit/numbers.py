"""Recorded numbers in the text of any page: ``{{ '%.3f' % notebook__name }}``.

A Sphinx extension. What a notebook recorded under a name is a substitution of MyST; the entries
of a list are ``notebook__name_0`` and so on. Beside them stand the verdicts of the
ledger, and the small pictures.
"""

from __future__ import annotations

from pathlib import Path

from bookkit.ledger import read_notebooks
from bookkit.pictures import pictures
from bookkit.strips import strips


def recorded(root: Path) -> dict[str, str | int | float]:
    """Every value that a notebook recorded, by the notebook's name and its own."""
    found: dict[str, str | int | float] = {}
    for stem, records in read_notebooks(root).items():
        for name, value in records.values.items():
            if isinstance(value, list):
                found |= {f"{stem}__{name}_{place}": entry for place, entry in enumerate(value)}
            else:
                found[f"{stem}__{name}"] = value
    return found


def setup(app) -> dict[str, bool]:
    """Called by Sphinx."""
    root = Path(app.srcdir)
    values = recorded(root)
    told = strips(root)
    app.config.myst_substitutions = values | told | pictures(root, values)
    known = (told[f"project__{part}"] for part in ("version", "date", "licence"))
    line = "seedslib {}, {}, {} licence".format(*known)
    app.config.html_theme_options["extra_footer"] = f"<p>{line}</p>"
    return {"parallel_read_safe": True}
