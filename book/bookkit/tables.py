"""Tables of the generated pages, texts as HTML, and links from there to the boxes of claims."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from itertools import repeat

from bookkit.claims import Claim

LONG = 40
"""Signs of an equation that is cut into parts."""

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
    """A text as HTML; MathJax sets what stands between dollars, on a page and in JupyterLab.

    Equations are cut before their signs, where a line may end.
    """
    return _TEX.sub(lambda found: " ".join(map(_set, _pieces(found[1]))), html.escape(text))


def _set(tex: str) -> str:
    return rf'<span class="math">\({tex}\)</span>'


def _pieces(tex: str) -> list[str]:
    """A long equation in parts, cut before the signs that stand outside of brackets."""
    found, depth, begin = [], 0, 0
    for i, sign in enumerate(tex):
        depth += (sign in "([{") - (sign in ")]}")
        if depth == 0 and len(tex) > LONG and tex[i : i + 3] in (" = ", " + ", " - "):
            found.append(tex[begin:i])
            begin = i
    found.append(tex[begin:])
    return [found[0], *("{}" + part.strip() for part in found[1:])]
