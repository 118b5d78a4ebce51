"""The claims page: the ledger for readers, the papers' claims first and ours apart.

As a Sphinx extension it links the box of each claim to its row.
"""

from __future__ import annotations

import html
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from bookkit.claims import LEDGER, ORIGINS, PAPERS, Claim, read_ledger
from bookkit.ledger import read_verdicts
from bookkit.recording import evidence
from bookkit.strips import strip
from bookkit.tables import claim_link, table, typeset

DECIDED = ("reproduced", "corrected", "refuted", "open")
OURS = ("checked", "open")
FIRST = ("refuted", "corrected", "open", "reproduced", "checked")
"""The order of rows: what a reader of the papers wants to know comes first."""

FILTER = """```{raw} html
<div id="claims-filter" role="group" aria-label="Show claims of one verdict"></div>
<script src="../_static/claims.js" defer></script>
```"""
"""Where the buttons stand that a script makes; without it all rows are shown."""


def page(root: Path) -> str:
    """The claims page of the book, as MyST text."""
    claims, recorded = read_ledger(root / LEDGER), read_verdicts(root)
    theirs = [claim for claim in claims if claim.origin != "ours"]
    ours = [claim for claim in claims if claim.origin == "ours"]
    lines = [
        "# Claims",
        "",
        f"The papers make {len(theirs)} claims: {_summary(theirs, DECIDED)}. {len(ours)} findings",
        f"of our own stand apart: {_summary(ours, OURS)}. Each verdict is computed by the notebook",
        "it links to, which says as well which planted faults would turn it. What the words",
        r"mean is said in [](#verdicts), what letters mean ($\hat x$, $P$) in [](notation.md).",
        "",
        _counts(theirs),
        "",
        f"Of the papers' claims {_origins(theirs)}.",
        "",
        FILTER,
    ]
    for title, chosen in (("What the papers claim", theirs), ("What we found ourselves", ours)):
        lines += ["", f"## {title}"]
        for key, name in PAPERS.items():
            rows = sorted(
                (claim for claim in chosen if claim.paper == key),
                key=lambda claim: FIRST.index(claim.verdict),
            )
            if rows:
                head = ["claim", "statement", "what was found", "verdict"]
                marks = [f'id="{claim.id}" data-verdict="{claim.verdict}"' for claim in rows]
                body = table(head, [_row(claim, recorded) for claim in rows], marks)
                # Cells of a table in HTML are not searched, and words of two letters never are.
                ids = f"{len(rows)}: {', '.join(f'{{index}}`{claim.id}`' for claim in rows)}."
                lines += ["", f"### {name}{': ours' if chosen is ours else ''}", "", ids, "", body]
    return "\n".join(lines) + "\n"


def _summary(claims: Sequence[Claim], words: Sequence[str]) -> str:
    counts = Counter(claim.verdict for claim in claims)
    return ", ".join(f"{counts[word]} {word}" for word in words)


def _origins(claims: Sequence[Claim]) -> str:
    counts = Counter(claim.origin for claim in claims)
    told = (f"{counts[w]} are *{w}* ({ORIGINS[w]})" for w in ORIGINS if w != "ours")
    return "; ".join(told)


def _counts(claims: Sequence[Claim]) -> str:
    rows = []
    for key, name in PAPERS.items():
        own = Counter(claim.verdict for claim in claims if claim.paper == key)
        if own:
            rows.append([name, strip(own)])
    return table(["paper", "verdicts"], rows)


def _row(claim: Claim, recorded: dict[str, dict[str, dict]]) -> list[str]:
    entry = recorded.get(claim.id, {}).get(claim.notebook)
    says = [claim.statement]
    if claim.reading:
        says.append(f"Reading: {claim.reading}")
    if claim.printed_formula and claim.corrected_formula:
        says += [f"printed: {claim.printed_formula}", f"right: {claim.corrected_formula}"]
    found = evidence(entry) if entry else []
    if claim.because:
        found.append(claim.because)
    shown = found  # of what holds as it stands its numbers are enough
    if claim.verdict not in FIRST[:3]:
        numbers = ("computed", "printed", "reference")
        shown = [line for line in found if line.startswith(numbers)] or found[:1]
    rest = [line for line in found if line not in shown]
    folded = f"<details><summary>more</summary>{_lines(rest)}</details>" if rest else ""
    return [
        f"{claim_link(claim)}<br>{html.escape(claim.place)}"
        + (f"<br><i>{claim.origin}</i>" if claim.origin in ("restored", "implied") else ""),
        _lines(says),
        _lines(shown) + folded,
        f'<span class="claim {claim.verdict}"><span class="verdict">{claim.verdict}</span></span>',
    ]


def _lines(texts: Iterable[str]) -> str:
    return "<br>".join(typeset(" ".join(text.split())) for text in texts)


_BOX = re.compile(r'(<div class="claim \w+" id="([\w-]+)"><b>)([\w-]+)(</b>)')


def linked(body: str) -> str:
    """The text of a page of `notebooks/` with each box of a claim linked to its row."""
    return _BOX.sub(r'\1<a href="../book/claims.html#\2">\3</a>\4', body)


def setup(app) -> dict[str, bool]:
    """Called by Sphinx."""

    def link(app, page: str, template: str, context: dict, tree: object) -> None:
        if page.startswith("notebooks/") and "body" in context:
            context["body"] = linked(context["body"])

    app.connect("html-page-context", link)
    return {"parallel_read_safe": True}
