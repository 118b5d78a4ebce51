"""Tables of the generated pages, texts as HTML, and links from there to the boxes of claims."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from itertools import repeat

from bookkit.claims import Claim

_TEX = re.compile(r"\$([^$]+)\$")


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], marks: Iterable[str] | None = None
) -> str:
    """HTML of a table of cells that are HTML; `marks` are attributes of its rows."""
    body = "".join(
        f"<tr{mark and ' ' + mark}>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>\n"
        for row, mark in zip(rows, marks or repeat(""), strict=False)
    )
    heads = "".join(f"<th>{c}</th>" for c in head)
    return (
        f'<table class="claims table">\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{body}</tbody>\n'
        "</table>"
    )


def claim_link(claim: Claim) -> str:
    """Link to the box of a claim."""
    page = claim.notebook.removesuffix(".md")
    return f'<a href="../{page}.html#{claim.id}">{claim.id}</a>'


def typeset(text: str) -> str:
    """A text as HTML; MathJax sets what stands between dollars, on a page and in JupyterLab."""
    return _TEX.sub(r'<span class="math">\\(\1\\)</span>', html.escape(text))
