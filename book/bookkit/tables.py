"""Tables of the generated pages, and links from there to the boxes of claims."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from bookkit.claims import Claim


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """HTML of a table of cells that are HTML."""
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>\n" for row in rows)
    heads = "".join(f"<th>{c}</th>" for c in head)
    return (
        f'<table class="claims table">\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{body}</tbody>\n'
        "</table>"
    )


def claim_link(claim: Claim) -> str:
    """Link to the box of a claim."""
    page = claim.notebook.removesuffix(".md")
    return f'<a href="../{page}.html#{claim.id}">{claim.id}</a>'
