"""Where everything is: every formula, theorem, example and figure of the papers, and its place."""

from __future__ import annotations

import html
import json
import re
from functools import cache
from pathlib import Path
from typing import Annotated

from docutils.nodes import make_id
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bookkit.claims import LEDGER, PAPERS, read_ledger
from bookkit.files import read_yaml
from bookkit.parameters import explain
from bookkit.tables import claim_link, table

PLACES = "book/places.yml"


class Place(BaseModel):
    """One item of a paper: what it says in a few words, where the book has it, which claims."""

    model_config = ConfigDict(extra="forbid")
    item: str
    says: str
    at: list[Annotated[str, Field(pattern=r"^(notebooks|book)/\w+\.md(#.+)?$")]] = []
    claims: list[str] = []


def read_places(path: Path) -> dict[str, list[Place]]:
    """The items of each paper, from a file that maps papers to lists of items.

    Raises
    ------
    ValueError
        No such file, another shape, or an entry that is no place; it is named.
    """
    content = read_yaml(path, "list of places") or {}
    if not isinstance(content, dict) or not set(content) <= set(PAPERS):
        raise ValueError(f"{path.name}: wanted papers, of {', '.join(PAPERS)}")
    found, problems = {}, []
    for paper, entries in content.items():
        found[paper] = []
        for entry in entries or []:
            try:
                found[paper].append(Place.model_validate(entry))
            except ValidationError as error:
                problems.append(f"{paper}: {entry!s:.60}: {explain(error)}")
    if problems:
        raise ValueError(f"{path.name}: " + "; ".join(problems))
    return found


def faults(root: Path) -> list[str]:
    """Items without a place, places that do not exist, and claims of a paper with no item."""
    known = {claim.id: claim for claim in read_ledger(root / LEDGER)}
    found, seen = [], set()
    for paper, items in read_places(root / PLACES).items():
        for place in items:
            name = f"{PLACES}: {paper} {place.item}"
            if not place.at and not place.claims:
                found.append(f"{name}: nowhere in the book")
            found += [f"{name}: no claim {c}" for c in place.claims if c not in known]
            found += [f"{name}: no {at}" for at in place.at if not _exists(root, at)]
            seen |= set(place.claims)
    found += [
        f"{PLACES}: {claim.paper}: no item has the claim {claim.id}"
        for claim in known.values()
        if claim.origin != "ours" and claim.id not in seen
    ]
    return found


def page(root: Path) -> str:
    """The page "where everything is", as MyST text."""
    known = {claim.id: claim for claim in read_ledger(root / LEDGER)}
    lines = [
        "# Where everything is",
        "",
        "Every definition, formula, theorem, example and figure of the papers, in their order and",
        "with their numbers, and where this book has it.",
    ]
    for paper, items in read_places(root / PLACES).items():
        rows = []
        for place in items:
            here = [_link(root, at) for at in place.at]
            here += [f"{claim_link(known[name])} {known[name].verdict}" for name in place.claims]
            rows.append((html.escape(place.item), html.escape(place.says), "<br>".join(here)))
        head = ("in the paper", "what", "here")
        lines += ["", f"## {PAPERS[paper]}: where", "", table(head, rows)]
    return "\n".join(lines) + "\n"


def _link(root: Path, at: str) -> str:
    file, _, heading = at.partition("#")
    title = heading or _headings(root, file)[0]
    anchor = f"#{make_id(heading)}" if heading else ""
    return f'<a href="../{file.removesuffix(".md")}.html{anchor}">{html.escape(title)}</a>'


def _exists(root: Path, at: str) -> bool:
    file, _, heading = at.partition("#")
    return (root / file).is_file() and (not heading or heading in _headings(root, file))


def _headings(root: Path, file: str) -> list[str]:
    """Headings of a page, those of a notebook from its text cells only."""
    executed = (root / file).with_suffix(".ipynb")
    page = executed if executed.is_file() else root / file
    return _headings_of(page, page.stat().st_mtime_ns)


@cache
def _headings_of(page: Path, changed: int) -> list[str]:
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    return re.findall(r"^#+ +(.+?) *$", text, re.M)
