"""What the theme leaves unsaid to a screen reader, said in the built pages.

A Sphinx extension. The theme's arrows have no name, names of its buttons leave out what is seen on
them, and the bibliography says that it is a list of what is no list item.
"""

from __future__ import annotations

import re
from pathlib import Path

_ARROW = '<span class="toctree-toggle"'
MENDED = (
    (f"<summary>{_ARROW}", f'<summary aria-label="Pages of this chapter">{_ARROW}'),
    ('<summary aria-label="Toggle hidden content">', "<summary>"),
    (
        '<div id="pst-primary-sidebar"',
        '<div id="pst-primary-sidebar" role="navigation" aria-label="Book"',
    ),
    ('<div role="list" class="citation-list">', '<div class="citation-list">'),
    (' role="doc-biblioentry"', ""),
)
"""What stands in a page and what stands there instead."""

_SEARCH = re.compile(r'(<button class="btn search-button-field[^>]*?) aria-label="Search"')
"""The wide button, which shows its name and a key."""


def mend(text: str) -> str:
    """A page with the names that were missing.

    Parameters
    ----------
    text : str
        HTML of a page as the theme made it.
    """
    for there, instead in MENDED:
        text = text.replace(there, instead)
    return _SEARCH.sub(r"\1", text)


def setup(app) -> dict[str, bool]:
    """Called by Sphinx."""

    def finished(app, error: Exception | None) -> None:
        if error is None and app.builder.name == "html":
            for path in Path(app.outdir).rglob("*.html"):
                text = path.read_text(encoding="utf-8")
                if (mended := mend(text)) != text:
                    path.write_text(mended, encoding="utf-8")

    app.connect("build-finished", finished)
    return {"parallel_read_safe": True}
